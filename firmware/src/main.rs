//! The image for a controller board: wires a board to the app, which is `ihd_firmware`.
//!
//! Built by `cargo xtask firmware`, one board each time.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
#[expect(unsafe_code, reason = "registers; each block says why it holds")]
mod board;

#[cfg(not(target_os = "none"))]
fn main() -> std::process::ExitCode {
    eprintln!(
        "this program runs on a controller board; build its image with `cargo xtask firmware`"
    );
    std::process::ExitCode::FAILURE
}
