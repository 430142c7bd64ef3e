//! Tests that cross crates: one binary, so that there is one to link.

mod capture_damage;
mod closed_loop;
mod closed_loop_link;
mod control_doc;
// Needs the firmware's image and QEMU: `cargo xtask test` builds the one and installs the other.
#[cfg(feature = "emulator")]
mod emulated_board;
mod estimator;
mod field_loop;
mod import;
mod link_device;
mod link_loss;
mod link_tcp;
mod link_windows;
mod protocol_doc;
mod regression;
mod replay;
mod service;
mod session_file;
mod window_damage;
mod wire_golden;
