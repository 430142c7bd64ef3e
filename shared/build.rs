//! Makes the board's constants from its file: `IHD_BOARD`, or boards/reference.toml.

use std::path::{Path, PathBuf};
use std::{env, fs};

use ihd_board::{Board, BoardError};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-env-changed=IHD_BOARD");
    // From the checkout's root, seen from the package, in which cargo starts this: an absolute name would have the workspace of
    // `cargo xtask test --only board`, whose path to the same file is another one, compile everything again, and the main one after it.
    let named = env::var_os("IHD_BOARD").unwrap_or_else(|| "boards/reference.toml".into());
    let path = Path::new("..").join(named);
    println!("cargo:rerun-if-changed={}", path.display());
    match Board::read(&path) {
        Ok(board) => fs::write(
            PathBuf::from(env::var("OUT_DIR")?).join("board.rs"),
            board.constants(),
        )?,
        Err(why @ BoardError::Read { .. }) => {
            println!(
                "cargo::error=IHD_BOARD is a name from the checkout's root, or an absolute one: {why}"
            );
        }
        Err(why) => println!("cargo::error={why}"),
    }
    Ok(())
}
