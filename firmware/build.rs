//! Hands the linker what differs between the boards; the rest is in memory.x at the root.

use std::path::{Path, PathBuf};
use std::{env, fs};

/// The STM32's flash without the two pages of the last good lookup, and its CCM SRAM.
const STM32G474: &str = "FLASH : ORIGIN = 0x08000000, LENGTH = 508K\n\
                         CCM : ORIGIN = 0x10000000, LENGTH = 32K\n";
const INSTRUCTION_COUNTS: &str = "FLASH : ORIGIN = 0x00000000, LENGTH = 508K\n";
/// Linker script of the CCM SRAM.
const IN_CCM: &str = include_str!("ccm.x");

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=ccm.x");
    println!("cargo:rerun-if-changed=../memory.x");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    let out = env::var_os("OUT_DIR")
        .map(PathBuf::from)
        .unwrap_or_default();
    println!("cargo:rustc-link-search={}", out.display());
    if env::var_os("CARGO_FEATURE_STM32G474").is_some() {
        write(&out.join("flash.x"), STM32G474);
        write(&out.join("ccm.x"), IN_CCM);
        // Not in .cargo/config.toml: only an image that logs has this script on its path.
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
        // By it the host finds the ELF file that belongs to what is on a chip (firmware/ccm.x places it).
        println!("cargo:rustc-link-arg-bins=--build-id=sha1");
    } else {
        write(&out.join("flash.x"), INSTRUCTION_COUNTS);
        write(&out.join("ccm.x"), "");
        // Where a vendor's crate would name its interrupt handlers; this board names its own.
        write(&out.join("device.x"), "");
    }
}

fn write(path: &Path, text: &str) {
    if let Err(why) = fs::write(path, text) {
        println!("cargo::error=cannot write {}: {why}", path.display());
    }
}
