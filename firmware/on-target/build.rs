//! Memory of the part that the tests run on, and the scripts that list them.

use std::path::PathBuf;
use std::{env, fs};

fn main() {
    let out = PathBuf::from(env::var_os("OUT_DIR").unwrap_or_default());
    // RAM as far as both parts have it; the stack grows down from its end.
    let flash = match env::var_os("CARGO_FEATURE_STM32G474") {
        Some(_) => "0x08000000, LENGTH = 508K",
        None => "0x00000000, LENGTH = 508K",
    };
    let memory = format!(
        "MEMORY {{ FLASH : ORIGIN = {flash}\n RAM : ORIGIN = 0x20000000, LENGTH = 96K }}\n"
    );
    if let Err(why) = fs::write(out.join("memory.x"), memory) {
        println!("cargo::error=cannot write memory.x: {why}");
    }
    println!("cargo::rustc-link-search={}", out.display());
    println!("cargo::rustc-link-arg-tests=-Tembedded-test.x");
    // embedded-test's macro asks for it.
    println!("cargo::rustc-check-cfg=cfg(rust_analyzer)");
    println!("cargo::rerun-if-changed=build.rs");
}
