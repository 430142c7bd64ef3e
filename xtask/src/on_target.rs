//! Tests that run on the controller (firmware/on-target, embedded-test): on a board behind a debug probe if there is one, and in
//! QEMU, which has the core but no peripherals of the part.

use std::path::{Path, PathBuf};
use std::process::Stdio;

use anyhow::{Context, ensure};
use object::{Object, ObjectSection, ObjectSymbol};
use serde::Deserialize;

use crate::toolchain::{self, TARGET};
use crate::workspace::{Workspace, run};
use crate::{emulator, images};

const MANIFEST: &str = "firmware/on-target/Cargo.toml";

/// Section in which embedded-test stores the tests: for each a symbol whose name is JSON, and its entry's address.
const SECTION: &str = ".embedded_test";

/// Test in the image.
#[derive(Deserialize)]
struct Test {
    name: String,
    ignored: bool,
    should_panic: bool,
}

/// Builds the tests for a part and returns their ELF file.
fn build(on: &Workspace, board: bool) -> anyhow::Result<PathBuf> {
    let mut build = toolchain::linting(on, "build");
    build.args(["--manifest-path", MANIFEST, "--tests", "--release"]);
    build.args(["--message-format", "json-render-diagnostics"]);
    if board {
        build.args(["--features", "stm32g474"]);
    }
    let output = build.stderr(Stdio::inherit()).output()?;
    ensure!(output.status.success(), "the tests do not build");
    let text = String::from_utf8_lossy(&output.stdout);
    let executable = |line: &str| {
        let message: serde_json::Value = serde_json::from_str(line).ok()?;
        Some(PathBuf::from(message.get("executable")?.as_str()?))
    };
    let file = text.lines().filter_map(executable).next_back();
    file.with_context(|| format!("cargo named no test of {TARGET}"))
}

/// Reads the tests that run, each with the address of its entry.
fn tests(image: &[u8]) -> anyhow::Result<Vec<(Test, u32)>> {
    let elf = object::File::parse(image)?;
    let section = elf.section_by_name(SECTION);
    let section = section.with_context(|| format!("no section {SECTION}"))?;
    let data = section.data()?;
    let mut tests = Vec::new();
    for symbol in elf.symbols() {
        let Ok(test) = serde_json::from_str::<Test>(symbol.name().unwrap_or_default()) else {
            continue;
        };
        let at = symbol.address().wrapping_sub(section.address()) as usize;
        let entry = data.get(at..).and_then(|data| data.first_chunk());
        let entry = entry.with_context(|| format!("{} has no entry", test.name))?;
        tests.push((test, u32::from_le_bytes(*entry)));
    }
    tests.retain(|(test, _)| !test.ignored);
    ensure!(!tests.is_empty(), "the image has no tests");
    Ok(tests)
}

/// Formatting, then the tests, linted as they compile, in QEMU, each from a reset.
pub fn in_emulator(on: &Workspace, qemu: &Path) -> anyhow::Result<()> {
    run(&mut on.cargo(["fmt", "--manifest-path", MANIFEST, "--check"]))?;
    // Tests for the board cannot run here, but must link.
    build(on, true)?;
    let image = build(on, false)?;
    let bytes = std::fs::read(&image).with_context(|| image.display().to_string())?;
    let tests = tests(&bytes)?;
    let mut failed = Vec::new();
    for (test, entry) in &tests {
        // Semihosting's command line selects the test, and its exit code has the result, as with probe-rs.
        let semihosting = format!("enable=on,target=native,arg=run_addr,arg={entry}");
        let output = emulator::an386(qemu, &semihosting, &image).output()?;
        let passed = output.status.success() != test.should_panic;
        let verdict = if passed { "ok" } else { "FAILED" };
        println!("on target, QEMU: {} … {verdict}", test.name);
        if !passed {
            print!("{}", String::from_utf8_lossy(&output.stderr));
            failed.push(test.name.as_str());
        }
    }
    let (passed, failures) = (tests.len() - failed.len(), failed.len());
    println!("on target, QEMU: {passed} passed, {failures} failed");
    ensure!(failed.is_empty(), "failed: {}", failed.join(", "));
    Ok(())
}

/// Runs the tests on the board behind a debug probe.
pub fn on_board(on: &Workspace) -> anyhow::Result<()> {
    images::probe_rs_run(&build(on, true)?)
}
