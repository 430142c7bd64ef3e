//! Exit codes of every command, and what it says: docs of each are in its --help.

use std::path::{Path, PathBuf};
use std::process::{Output, Stdio};

use assert_cmd::Command;
use ihd_fakes::free_address;

use crate::process::closed_pipe;

/// Text that names a terminal's window, where it reaches one raw.
const ESCAPES: &str = "\x1b]0;owned\x07";

fn ihd(dir: &Path, args: &[&str]) -> Output {
    let mut command = Command::cargo_bin("ihd").expect("the ihd binary is built with its tests");
    command
        .current_dir(dir)
        .env_remove("RUST_BACKTRACE")
        .args(args);
    let output = command.output().expect("ihd runs");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(!stderr.contains("panicked"), "{args:?}: {stderr}");
    output
}

fn run(dir: &Path, args: &str) -> (i32, String, String) {
    let args: Vec<&str> = args.split_whitespace().collect();
    let output = ihd(dir, &args);
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (
        output.status.code().expect("an exit code"),
        text(&output.stdout),
        text(&output.stderr),
    )
}

/// A folder with a capture of two half-cycles in some chunks, `a.mcap`.
fn folder() -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let args = "simulate --set load=behavioural,rate=50M,duration=20ms -o a.mcap";
    let (code, _, stderr) = run(dir.path(), args);
    assert_eq!(code, 0, "{stderr}");
    let path = dir.path().to_owned();
    (dir, path)
}

#[test]
fn wrong_usage_is_2_whoever_finds_it() {
    let (_keep, dir) = folder();
    let mut table = vec![
        ("calibrate a.mcap --reference wood", "no-pot"),
        ("calibrate a.mcap", "--reference"),
        (
            "calibrate a.mcap --reference r=3 --input resonance-capacitance=1080n",
            "resonance-capacitance",
        ),
        (
            "calibrate a.mcap --reference blind --input mains=50",
            "mains",
        ),
        ("convert a.mcap --out b.xyz", ".mcap"),
        ("convert a.mcap --out a.mcap", "also what is read"),
        ("convert a.mcap --out b.csv --input rate=0", "rate=0"),
        ("convert a.mcap --out b.csv --input fsw=45k", "fsw"),
        ("simulate --set lift=-1mm", "lift_m"),
        ("hob --speed 0", "--speed"),
        ("hob --sim mains=20", "mains=20"),
        ("hob --sim anti-alias=1", "anti-alias=1"),
        ("hob --sim snr=1", "snr=1"),
        ("hob --script k.toml --pot none", "seed=N"),
        ("identify a.mcap --method nope", "least-squares"),
        ("identify a.mcap --preset nope", ""),
        ("identify a.mcap --network backend=wgpu", ""),
        ("identify a.mcap --method pinn --preset nope", ""),
        ("identify a.mcap --input rate=-1", "rate=-1"),
        ("identify a.mcap --input mains=-5", "mains=-5"),
        ("identify a.mcap --input mains=0", "mains=0"),
        ("identify a.mcap --input mains=1M", "1 kHz"),
        ("identify a.mcap --input fsw=0", "fsw=0"),
        ("identify a.mcap --input fsw=-50k", "fsw=-50k"),
        ("identify a.mcap --input zero-crossing=1e999", "no number"),
        ("inspect", "FILE"),
        ("inspect a.mcap --input rate=0", "rate=0"),
        ("inspect a.mcap --input probe=1", "2 numbers"),
        ("inspect a.mcap --input probe=0,1", "other than zero"),
        ("record", "--out"),
        ("record --out b.mcap --duration 0", "--duration"),
        ("record --out b.mcap --max-size=-1", "--max-size"),
        ("record --out b.mcap --power 10001", "10000"),
        ("record --out b.mcap --device bluetooth", "tcp:HOST:PORT"),
        ("record --out b.mcap --sim mains=20", "mains=20"),
        ("replay a.mcap --speed 0", "--speed"),
        ("simulate none.toml --json --out x.mcap", "scenario"),
        ("simulate nope", "paper-45"),
        ("simulate --set fsw=1", "f_sw_hz"),
        ("simulate --set bits=40", "bits"),
        ("nonsense", "nonsense"),
        ("hob --json", "--json"),
        ("inspect a.mcap --config ihd.toml", "--config"),
        ("study map", "ihd-study"),
    ];
    if cfg!(feature = "pinn") {
        table.extend([
            ("trainer --store none --power 0", "--power"),
            ("trainer --store none --power 10001", "10000"),
            ("trainer --store none --sim mains=16.7", "mains=16.7"),
            ("trainer --network backend=torch", "ndarray"),
            ("trainer --device tcp:localhost", "port is missing"),
            ("trainer --pot copper", "aluminium"),
            ("trainer --store none --sim lift=5mm", "load=reduced"),
            ("trainer --store none --sim load=reduced,lift=1", "lift_m"),
            ("trainer --store none --sim perturb=round", "sharp-knee"),
        ]);
    }
    for (args, word) in table {
        let (code, stdout, stderr) = run(&dir, args);
        assert_eq!(code, 2, "{args}: {stderr}");
        assert!(stdout.is_empty(), "{args}: {stdout}");
        assert!(stderr.contains(word), "{args}: {word} not in {stderr}");
    }
}

/// A capture cannot be recorded again: no command writes its result over it, under no name of it.
#[test]
fn what_is_read_is_not_overwritten() {
    let (_keep, dir) = folder();
    for name in ["a.csv", "a.svg"] {
        std::fs::copy(dir.join("a.mcap"), dir.join(name)).unwrap();
    }
    std::fs::hard_link(dir.join("a.csv"), dir.join("b.csv")).unwrap();
    let before = std::fs::read(dir.join("a.csv")).unwrap();
    for args in [
        "identify a.csv --out found.svg --out a.csv",
        "identify a.csv --out b.csv",
        "convert a.csv --out b.csv",
        "calibrate a.csv --reference r=3,l=19u --out a.csv",
        "inspect a.svg --plot a.svg",
    ] {
        let (code, _, stderr) = run(&dir, args);
        assert_eq!(code, 2, "{args}: {stderr}");
        assert!(stderr.contains("also what is read"), "{args}: {stderr}");
    }
    for name in ["a.csv", "a.svg", "b.csv"] {
        assert!(std::fs::read(dir.join(name)).unwrap() == before, "{name}");
    }
}

/// A name of a file need not be UTF-8.
#[test]
#[cfg(target_os = "linux")]
fn results_go_to_a_file_of_any_name() {
    use std::os::unix::ffi::OsStrExt;
    let (_keep, dir) = folder();
    let name = std::ffi::OsStr::from_bytes(b"b\xff.csv");
    let mut command = Command::cargo_bin("ihd").expect("the ihd binary is built with its tests");
    command
        .current_dir(&dir)
        .args(["identify", "a.mcap", "--out"]);
    let output = command.arg(name).output().expect("ihd runs");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{stderr}");
    let table = std::fs::read_to_string(dir.join(name)).unwrap();
    assert!(
        table.starts_with("method,") && table.ends_with('\n'),
        "{table}"
    );
}

#[test]
fn what_fails_is_1_and_names_the_file() {
    let dir = tempfile::tempdir().unwrap();
    let mut all = vec![
        "calibrate none.mcap --reference no-pot",
        "convert none.mcap --out b.csv",
        "identify none.mcap",
        "inspect none.mcap",
        "replay none.mcap",
        "simulate none.toml",
    ];
    if cfg!(feature = "pinn") {
        all.push("trainer --store none --network none.toml");
    }
    for args in all {
        let (code, _, stderr) = run(dir.path(), args);
        assert_eq!(code, 1, "{args}: {stderr}");
        assert!(stderr.contains("none."), "{args}: {stderr}");
    }
}

#[test]
fn a_missed_limit_of_a_scenario_is_7_and_named() {
    let dir = tempfile::tempdir().unwrap();
    let text = "duration_s = 0.05\nload = \"behavioural\"\n[limits]\nstarts = [0, 0]\n";
    std::fs::write(dir.path().join("met.toml"), text).unwrap();
    std::fs::write(
        dir.path().join("missed.toml"),
        text.replace("[0, 0]", "[1, 2]"),
    )
    .unwrap();
    let (code, stdout, stderr) = run(dir.path(), "simulate met.toml");
    assert_eq!(code, 0, "{stderr}");
    assert!(stdout.ends_with("limit met: starts is 0, allowed [0, 0]\n"));
    for args in ["simulate missed.toml", "simulate missed.toml --json"] {
        let (code, _, stderr) = run(dir.path(), args);
        assert_eq!(code, 7, "{args}: {stderr}");
        assert!(stderr.contains("1 of 1 limits missed: starts is 0, allowed [1, 2]"));
    }
}

#[test]
fn a_device_that_is_not_there_is_3() {
    let dir = tempfile::tempdir().unwrap();
    let address = free_address();
    for args in [
        format!("record --device tcp:{address} --out b.mcap"),
        "record --device serial:/dev/none --out b.mcap".to_owned(),
    ] {
        let (code, _, stderr) = run(dir.path(), &args);
        assert_eq!(code, 3, "{args}: {stderr}");
    }
}

/// Damaged or cut files are 7, with the part that could be read: a result and how much of the file it is of.
#[test]
fn a_cut_and_a_damaged_file_are_told_and_worked_on() {
    let (_keep, dir) = folder();
    let bytes = std::fs::read(dir.join("a.mcap")).unwrap();
    std::fs::write(dir.join("cut.mcap"), &bytes[..bytes.len() * 4 / 5]).unwrap();
    let mut damaged = bytes.clone();
    let at = damaged.len() / 2;
    damaged[at..at + 3].copy_from_slice(b"???");
    std::fs::write(dir.join("damaged.mcap"), damaged).unwrap();
    for (file, word) in [("cut.mcap", "is cut"), ("damaged.mcap", "damaged")] {
        for (args, result) in [
            (format!("inspect {file}"), "switching"),
            (format!("inspect {file} --json"), "incomplete"),
            (format!("identify {file}"), "least-squares"),
            (format!("convert {file} --out {file}.npz"), "wrote"),
            (format!("replay {file}"), "identical"),
        ] {
            let (code, stdout, stderr) = run(&dir, &args);
            assert_eq!(code, 7, "{args}: {stderr}");
            assert!(stdout.contains(result), "{args}: {stdout}");
            for word in [word, file, "pairs of samples were read"] {
                assert!(stderr.contains(word), "{args}: {word} not in {stderr}");
            }
        }
    }
    // Nothing of an empty file, and nothing but a header.
    std::fs::write(dir.join("empty.mcap"), b"").unwrap();
    std::fs::write(dir.join("header.mcap"), &bytes[..600]).unwrap();
    for (file, word) in [
        ("empty.mcap", "is empty"),
        ("header.mcap", "holds no samples"),
    ] {
        let (code, _, stderr) = run(&dir, &format!("inspect {file}"));
        assert_eq!(code, 7, "{stderr}");
        assert!(stderr.contains(word) && !stderr.contains("0 s"), "{stderr}");
    }
}

#[test]
fn one_channel_is_described_and_is_7() {
    let formats = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/formats");
    for (file, words) in [
        (
            "tektronix_v.csv",
            ["Tektronix", "in V", "300", "2.0000 MS/s"],
        ),
        ("lecroy_i.trc", ["TRC", "in A", "300", "2.0000 MS/s"]),
        ("tek_wfm3le_v.wfm", ["WFM 3", "in V", "300", "2.0000 MS/s"]),
        ("tek_isf_i.isf", ["ISF", "in A", "300", "2.0000 MS/s"]),
    ] {
        let (code, stdout, stderr) = run(&formats, &format!("inspect {file}"));
        assert_eq!(code, 7, "{file}: {stderr}");
        for word in words {
            assert!(stdout.contains(word), "{file}: {word} not in {stdout}");
        }
        assert!(stderr.contains("holds one channel"), "{stderr}");
        let (_, json, _) = run(&formats, &format!("inspect {file} --json"));
        let json: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!(json["samples"], 300);
    }
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_standard_output_is_an_error_line_and_1() {
    use std::fs::File;
    use std::process::{Command, Stdio};
    let (_keep, dir) = folder();
    std::fs::write(
        dir.join("s.toml"),
        "duration_s = 0.05\nload = \"behavioural\"\n",
    )
    .unwrap();
    let mut table = vec![
        "--help",
        "--version",
        "inspect --help",
        "inspect a.mcap",
        "inspect a.mcap --json",
        "identify a.mcap",
        "identify a.mcap --json",
        "convert a.mcap --out b.npz",
        "convert a.mcap --out b.npz --json",
        "calibrate a.mcap --reference blind",
        "hob --listen 127.0.0.1:0",
        "record --duration 100ms --out b.mcap",
        "replay a.mcap",
        "simulate --set load=behavioural,duration=1ms",
        "simulate --approximations",
        "simulate s.toml",
        "simulate s.toml --json",
    ];
    if cfg!(feature = "pinn") {
        table.push("trainer --store none --power 1500");
    }
    for args in table {
        let output = Command::new(assert_cmd::cargo::cargo_bin("ihd"))
            .current_dir(&dir)
            .args(args.split(' '))
            .stdout(Stdio::from(File::create("/dev/full").unwrap()))
            .output()
            .unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{args}: {stderr}");
        assert!(!stderr.contains("panicked"), "{args}: {stderr}");
        assert!(stderr.contains("standard output"), "{args}: {stderr}");
        // And with nowhere to complain.
        if args.starts_with("inspect") || args == "record" {
            let full = || Stdio::from(File::create("/dev/full").unwrap());
            let mut silent = Command::new(assert_cmd::cargo::cargo_bin("ihd"));
            silent.current_dir(&dir).args(args.split(' '));
            let status = silent.stdout(full()).stderr(full()).status().unwrap();
            assert_eq!(status.code(), Some(1), "{args}");
        }
    }
}

/// Text in a file's tables and headings reaches neither a terminal nor JSON raw.
#[test]
fn control_characters_of_a_file_are_escaped() {
    let (_keep, dir) = folder();
    let mut capture = ihd_capture::mcap::read(&dir.join("a.mcap")).unwrap();
    for key in ["calibration", "format", "device_build"] {
        capture.metadata.insert(key.into(), format!("x{ESCAPES}"));
    }
    ihd_capture::mcap::write(&capture, &dir.join("b.mcap")).unwrap();
    // A control character of one byte makes the file binary.
    let escapes = "\u{9b}31mowned";
    let mut heading = format!("time_s,one{escapes},two{escapes}\n");
    for k in 0..1000 {
        heading += &format!("{},{},{}\n", f64::from(k) * 1e-6, k % 20, k % 7);
    }
    std::fs::write(dir.join("c.csv"), heading).unwrap();
    std::fs::write(dir.join(format!("{ESCAPES}.mcap")), b"no capture").unwrap();
    let mut seen = 0;
    for args in [
        &["inspect", "b.mcap"][..],
        &["identify", "b.mcap"],
        &["identify", "b.mcap", "--json"],
        &["convert", "b.mcap", "--out", "d.npz"],
        &["convert", "b.mcap", "--out", "d.npz", "--json"],
        &["inspect", "c.csv"],
        &["identify", "c.csv", "--input", "channels=9,9"],
        &["inspect", &format!("{ESCAPES}.mcap")],
    ] {
        let output = ihd(&dir, args);
        for bytes in [&output.stdout, &output.stderr] {
            let text = String::from_utf8_lossy(bytes);
            let raw = text.chars().find(|c| c.is_control() && *c != '\n');
            assert_eq!(raw, None, "{args:?}: {text:?}");
            seen += usize::from(text.contains("owned"));
        }
    }
    assert!(seen >= 4, "only {seen} of the outputs hold the text at all");
}

/// The errors against a truth that came through NumPy's format are those against the original's.
#[test]
fn the_truth_of_an_npz_is_compared_with() {
    let (_keep, dir) = folder();
    let (code, _, stderr) = run(&dir, "convert a.mcap --out a.npz");
    assert_eq!(code, 0, "{stderr}");
    let errors = |file: &str| {
        let (code, stdout, stderr) = run(&dir, &format!("identify {file} --json"));
        assert_eq!(code, 0, "{stderr}");
        let json: serde_json::Value = serde_json::from_str(&stdout).unwrap();
        ["mre_r_pct", "mre_l_pct"].map(|name| json[0][name].as_f64().unwrap_or(f64::NAN))
    };
    let (mcap, npz) = (errors("a.mcap"), errors("a.npz"));
    for (a, b) in mcap.into_iter().zip(npz) {
        assert!(
            a > 0.0 && a < 1.0 && (a - b).abs() < 1e-3,
            "{mcap:?} {npz:?}"
        );
    }
}

/// 12 V and 3 A of offset cost next to nothing: before their means were taken off, pinn lost 1.98/.83 % by them.
#[test]
fn offsets_do_not_bend_r_and_l() {
    let dir = tempfile::tempdir().unwrap();
    let simulate = "simulate --set load=behavioural,rate=12.5M,snr=60";
    for args in ["-o clean.mcap", "--set offsets=12,3 -o off.mcap"] {
        assert_eq!(run(dir.path(), &format!("{simulate} {args}")).0, 0);
    }
    let methods = if cfg!(feature = "pinn") {
        "least-squares,pinn"
    } else {
        "least-squares"
    };
    let errors = |file: &str| -> Vec<f64> {
        let (code, stdout, stderr) = run(
            dir.path(),
            &format!("identify {file} --json --method {methods}"),
        );
        assert_eq!(code, 0, "{stderr}");
        let json: serde_json::Value = serde_json::from_str(&stdout).unwrap();
        let all = json.as_array().unwrap().iter();
        all.flat_map(|of| ["mre_r_pct", "mre_l_pct"].map(|name| of[name].as_f64().unwrap()))
            .collect()
    };
    let (clean, off) = (errors("clean.mcap"), errors("off.mcap"));
    for (a, b) in clean.iter().zip(&off) {
        assert!(
            (a - b).abs() < 0.05,
            "clean {clean:?}, with offsets {off:?}"
        );
    }
}

/// `ihd … | head -0`: no word of it, as of other programs.
#[test]
fn a_reader_that_is_gone_is_no_news() {
    for args in [
        &["--help"][..],
        &["--version"],
        &["inspect", "--help"],
        &["--json"],
    ] {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_ihd"));
        command
            .args(args)
            .stdout(closed_pipe())
            .stderr(Stdio::piped());
        let ended = command.spawn().unwrap().wait_with_output().unwrap();
        assert_eq!(ended.status.code(), Some(1), "{args:?}: {ended:?}");
        assert_eq!(String::from_utf8_lossy(&ended.stderr), "", "{args:?}");
    }
}
