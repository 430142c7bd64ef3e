//! `ihd flash` as far as it goes without a board. Each call names a probe that there is not: one that is plugged in here, with
//! somebody's board behind it, is left alone.

use std::path::{Path, PathBuf};

use assert_cmd::Command;
use ihd_fakes::SampleImage;

const NO_PROBE: &str = "1209:0000:none";

/// Exit code and standard error.
fn flash(arguments: &[&str]) -> (Option<i32>, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ihd"));
    let output = command.arg("flash").args(arguments).output().unwrap();
    (
        output.status.code(),
        String::from_utf8(output.stderr).unwrap(),
    )
}

fn image(folder: &Path) -> PathBuf {
    let path = folder.join("sample.elf");
    std::fs::write(&path, SampleImage::default().elf()).unwrap();
    path
}

#[test]
fn without_a_probe_it_says_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let image = image(folder.path());
    let (code, told) = flash(&["--probe", NO_PROBE, "--image", image.to_str().unwrap()]);
    if cfg!(feature = "probe") {
        assert_eq!(code, Some(3), "{told}");
        assert!(
            told.contains(NO_PROBE) && told.contains("ihd doctor"),
            "{told}"
        );
    } else {
        assert_eq!(code, Some(2), "{told}");
        assert!(
            told.contains("--features probe") && told.contains("--dfu"),
            "{told}"
        );
    }
}

#[test]
fn a_file_that_is_no_image_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notes.txt");
    std::fs::write(&path, "no image").unwrap();
    let (code, told) = flash(&["--probe", NO_PROBE, "--image", path.to_str().unwrap()]);
    assert_eq!(code, Some(1), "{told}");
    assert!(
        told.contains("notes.txt") && told.contains("cargo xtask firmware"),
        "{told}"
    );
    // What the linker leaves has no CRC.
    let mut unsealed = SampleImage::default().elf();
    *unsealed.last_mut().unwrap() ^= 1;
    std::fs::write(&path, unsealed).unwrap();
    let (code, told) = flash(&["--probe", NO_PROBE, "--image", path.to_str().unwrap()]);
    assert_eq!(code, Some(1), "{told}");
    assert!(told.contains("is not sealed"), "{told}");
}

#[test]
fn a_simulated_hob_has_no_flash() {
    for device in ["sim", "tcp:127.0.0.1:4711"] {
        let (code, told) = flash(&["--probe", NO_PROBE, "--device", device]);
        assert_eq!(code, Some(2), "{told}");
    }
    let (code, _) = flash(&["--probe", "yellow", "--device", "sun"]);
    assert_eq!(code, Some(2));
}

/// A serial number that no bootloader has: none that is plugged in here is written, and no board is sent into it.
#[test]
fn a_bootloader_that_is_not_there_is_told_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let image = image(folder.path());
    let (code, told) = flash(&["--dfu=NONE", "--image", image.to_str().unwrap()]);
    assert_eq!(code, Some(3), "{told}");
    let words = ["0483:df11", "PA11", "BOOT0"];
    // Another bootloader may be plugged in here, and a container has no USB at all.
    let others = [
        "no bootloader has the serial number NONE",
        "is USB available here?",
    ];
    let here = others.iter().any(|other| told.contains(other));
    assert!(
        here || words.iter().all(|word| told.contains(word)),
        "{told}"
    );
    let (code, told) = flash(&["--dfu", "--probe", NO_PROBE]);
    assert_eq!(code, Some(2), "{told}");
    let (code, told) = flash(&["--dfu", "--device", "sim"]);
    assert_eq!(code, Some(2), "{told}");
}
