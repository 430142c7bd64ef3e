//! With the feature `image`: copies the firmware's image to the place from which the program includes it.

use std::path::PathBuf;
use std::{env, fs};

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-env-changed=IHD_IMAGE");
    if env::var_os("CARGO_FEATURE_IMAGE").is_none() {
        return;
    }
    let root = env::var_os("CARGO_MANIFEST_DIR").map(PathBuf::from);
    let built = root.unwrap_or_default();
    let built = built.join("../../target/firmware/images/stm32g474.elf");
    let image = env::var_os("IHD_IMAGE").map_or(built, PathBuf::from);
    println!("cargo:rerun-if-changed={}", image.display());
    let out = env::var_os("OUT_DIR")
        .map(PathBuf::from)
        .unwrap_or_default();
    if let Err(why) = fs::copy(&image, out.join("stm32g474.elf")) {
        println!(
            "cargo::error=feature `image`: cannot take {}: {why}; build it with `cargo xtask firmware`, or name one with IHD_IMAGE",
            image.display()
        );
    }
}
