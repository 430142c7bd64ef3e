//! Makes the board's constants from its file: `IHD_BOARD`, or boards/reference.toml.

use std::path::PathBuf;
use std::{env, fs};

use ihd_board::Board;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-env-changed=IHD_BOARD");
    // Relative to the package, in which cargo starts this: an absolute name would have the workspace of `cargo xtask test --only board`,
    // whose path to the same file is another one, compile everything again, and the main one after it.
    let reference = PathBuf::from("../boards/reference.toml");
    let path = env::var_os("IHD_BOARD").map_or(reference, PathBuf::from);
    println!("cargo:rerun-if-changed={}", path.display());
    match Board::read(&path) {
        Ok(board) => fs::write(
            PathBuf::from(env::var("OUT_DIR")?).join("board.rs"),
            board.constants(),
        )?,
        Err(why) => println!("cargo::error={why}"),
    }
    Ok(())
}
