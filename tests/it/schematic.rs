//! Picture of the circuit in docs/: what its script draws of the board's file and the firmware's constants.

use std::path::Path;
use std::process::Command;

#[test]
fn the_schematic_is_what_its_script_draws() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut script = Command::new("python3");
    let drawn = script.arg(root.join("docs/schematic.py")).arg("--check");
    let drawn = drawn.output().expect("python3 on the PATH");
    let why = String::from_utf8_lossy(&drawn.stderr);
    assert!(drawn.status.success(), "{why}");
}
