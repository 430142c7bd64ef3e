//! `ihd inspect` and `ihd calibrate` as a user calls them, on captures of `ihd simulate`.

use std::path::Path;
use std::process::Output;

use assert_cmd::Command;

fn ihd(dir: &Path, args: &str) -> Output {
    let mut command = Command::cargo_bin("ihd").expect("the ihd binary is built with its tests");
    command
        .current_dir(dir)
        .env_remove("RUST_BACKTRACE")
        .args(args.split_whitespace());
    command.output().expect("ihd runs")
}

fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn json(output: &Output) -> serde_json::Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {}", stdout(output)))
}

fn simulate(dir: &Path, args: &str, out: &str) {
    let all = format!("simulate --set load=behavioural,rate=12.5M,duration=10ms {args} -o {out}");
    let output = ihd(dir, &all);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
}

#[test]
fn inspect_tells_what_is_in_a_capture_and_draws_it() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    // No multiple of 47 kHz is the sampling rate: harmonics fold beside the fundamental.
    simulate(dir, "--set fsw=47k,snr=30", "a.mcap");
    let text = stdout(&ihd(dir, "inspect a.mcap --plot a.svg"));
    for word in [
        "47.000 kHz",
        "12.5000 MS/s",
        "SNR 30.",
        "findings   none",
        "10/20/100 ns",
    ] {
        assert!(text.contains(word), "{word} not in {text}");
    }
    let svg = std::fs::read_to_string(dir.join("a.svg")).unwrap();
    for word in [
        "<svg",
        "Two periods",
        "Spectra",
        "nothing found wrong",
        "voltage (left)",
        "current (right)",
        "to half the sampling rate, 6.25 MHz",
        "10⁴",
        "10⁶",
    ] {
        assert!(svg.contains(word), "{word}");
    }
    assert!(svg.len() < 300_000, "{}", svg.len());
    let report = json(&ihd(dir, "inspect a.mcap --json"));
    assert!((report["spans"][0]["f_sw_hz"].as_f64().unwrap() - 47e3).abs() < 1.0);
    assert_eq!(report["samples"], 125_000);
    assert_eq!(report["half_cycles_s"].as_array().unwrap().len(), 1);
    assert_eq!(report["findings"], serde_json::json!([]));
}

#[test]
fn a_capture_with_its_channels_exchanged_ends_with_7_and_the_remedy() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    simulate(dir, "--set fsw=50k", "a.mcap");
    let wrong = ihd(dir, "inspect a.mcap --input swap --json");
    assert_eq!(wrong.status.code(), Some(7));
    let report = json(&wrong);
    assert_eq!(report["findings"][0]["code"], "swapped");
    assert_eq!(report["findings"][0]["severity"], "error");
    assert!(
        report["findings"][0]["text"]
            .as_str()
            .unwrap()
            .contains("--input swap")
    );
    let inverted = json(&ihd(dir, "inspect a.mcap --input invert=i --json"));
    assert_eq!(inverted["findings"][0]["code"], "inverted");
    let hint = ihd(dir, "inspect a.mcap --input fsw=70k");
    assert_eq!(hint.status.code(), Some(1));
    let stderr = String::from_utf8_lossy(&hint.stderr).into_owned();
    assert!(
        stderr.contains("70.00 kHz") && stderr.contains("50.00 kHz"),
        "{stderr}"
    );
}

#[test]
fn a_calibration_is_written_and_applied() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let chain = "--set skew=40n,gain=1.01,1,offsets=3,0.5";
    simulate(dir, &format!("{chain},pot=none"), "empty.mcap");
    simulate(dir, chain, "hot.mcap");
    simulate(dir, "", "right.mcap");
    let found = ihd(
        dir,
        "calibrate empty.mcap --reference no-pot,r=0.1,l=50.5u -o c.toml --json",
    );
    let skew_s = json(&found)["skew_s"].as_f64().unwrap();
    assert!((skew_s - 40e-9).abs() < 1e-9, "{skew_s}");
    let r = |args: &str| {
        json(&ihd(dir, args))["spans"][0]["load"]["r_ohm"]
            .as_f64()
            .unwrap()
    };
    let right = r("inspect right.mcap --json");
    let as_it_is = r("inspect hot.mcap --self-calibrate off --json");
    assert!((as_it_is / right - 1.0).abs() > 0.02);
    let mended = r("inspect hot.mcap --calibration c.toml --json");
    assert!((mended / right - 1.0).abs() < 2e-3, "{mended} {right}");
    for out in ["mended.mcap", "mended.npz"] {
        let args = format!("convert hot.mcap --calibration c.toml --out {out}");
        assert!(ihd(dir, &args).status.success());
    }
    for (args, word) in [
        (
            "inspect mended.mcap --calibration c.toml",
            "calibrated already (skew",
        ),
        (
            "inspect mended.npz --calibration c.toml",
            "calibrated already (skew",
        ),
        (
            "identify mended.mcap --calibration c.toml",
            "leave --calibration out",
        ),
        (
            "calibrate hot.mcap --reference r=3,l=19 -o d.toml",
            "25u is 25 µH",
        ),
        ("calibrate hot.mcap --reference no-pot", "no empty coil"),
        ("calibrate hot.mcap --reference wood", "no-pot"),
        ("inspect hot.mcap --calibration hot.mcap", "hot.mcap"),
    ] {
        let refused = ihd(dir, args);
        let stderr = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(
            !refused.status.success() && stderr.contains(word),
            "{args}: {stderr}"
        );
        assert!(!stderr.contains("panicked"), "{stderr}");
    }
    assert!(!dir.join("d.toml").exists());
}

/// A scope writes NaN or its overflow mark where it has no sample: the capture is cut there, in every format.
#[test]
fn samples_that_are_no_numbers_are_cut_out_with_a_warning() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    simulate(dir, "", "whole.mcap");
    assert!(
        ihd(dir, "convert whole.mcap --out whole.csv")
            .status
            .success()
    );
    let text = std::fs::read_to_string(dir.join("whole.csv")).unwrap();
    let mut rows: Vec<String> = text.lines().map(str::to_owned).collect();
    let damage = |row: &mut String, column: usize, by: &str| {
        let mut fields: Vec<&str> = row.split(',').collect();
        fields[column] = by;
        *row = fields.join(",");
    };
    let first = rows.len() / 2;
    damage(&mut rows[first], 1, "NaN");
    damage(&mut rows[first + 40], 2, "∞");
    std::fs::write(dir.join("holes.csv"), rows.join("\n") + "\n").unwrap();
    let converted = ihd(dir, "convert holes.csv --out holes.npz");
    assert!(converted.status.success(), "{}", stdout(&converted));
    for file in ["holes.csv", "holes.npz"] {
        let found = json(&ihd(dir, &format!("inspect {file} --json")));
        let findings = found["findings"].as_array().unwrap();
        let cut = findings.iter().find(|f| f["code"] == "not_finite");
        let cut = cut.unwrap_or_else(|| panic!("{file}: {found}"));
        assert_eq!(cut["severity"], "warning", "{file}");
        assert_eq!(cut["samples"], 2, "{file}");
        let spans = found["spans"].as_array().unwrap();
        assert_eq!(spans.len(), 2, "{file}: {found}");
    }
}
