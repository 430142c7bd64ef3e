//! Tests that cross crates: one binary, so that there is one to link.

#[cfg(unix)]
mod archive;
mod capture_damage;
mod circles;
mod circuit_oracle;
mod closed_loop;
mod closed_loop_link;
mod control_doc;
mod document;
mod document_links;
mod document_words;
mod estimator;
mod field_loop;
// Each target is a program of its own, with the modules that it needs.
#[allow(clippy::duplicate_mod)]
mod fuzz_targets;
mod hot_pots;
mod import;
mod link_device;
mod link_late;
mod link_loss;
mod link_tcp;
mod link_windows;
mod protocol_doc;
mod regression;
mod replay;
mod scenario_table;
mod scenarios;
mod schematic;
mod service;
mod session_file;
mod two_zones;
mod window_damage;
mod wire_golden;
