//! `ihd convert` as a user calls it, and files that are no captures.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

fn fixture(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/formats");
    path.join(name).display().to_string()
}

/// Runs `ihd convert`; gives exit code, stdout and stderr.
fn convert(args: &[&str]) -> (i32, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ihd"));
    let output = command
        .arg("convert")
        .args(args)
        .output()
        .expect("ihd runs");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("UTF-8");
    let stderr = text(output.stderr);
    assert!(!stderr.contains("panicked"), "{args:?}: {stderr}");
    (
        output.status.code().expect("a code"),
        text(output.stdout),
        stderr,
    )
}

fn converted(args: &[&str]) -> Value {
    let (code, stdout, stderr) = convert(&[args, &["--json"]].concat());
    assert_eq!(code, 0, "{args:?}: {stderr}");
    serde_json::from_str(&stdout).expect("JSON")
}

fn refused(args: &[&str], words: &[&str]) {
    let (code, stdout, stderr) = convert(args);
    assert!(code == 1 || code == 2, "{args:?}: {code} {stdout}");
    for word in words {
        assert!(stderr.contains(word), "{args:?}: {word:?} not in {stderr}");
    }
}

fn samples(path: &Path) -> ihd_signal::Capture {
    ihd_capture::open(path, &ihd_capture::OpenOptions::default()).expect("readable")
}

#[test]
fn every_format_that_is_written_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let first = folder.path().join("a.mcap");
    let report = converted(&[
        &fixture("tek_wfm3le_v.wfm"),
        &fixture("tek_wfm3le_i.wfm"),
        "--out",
        first.to_str().unwrap(),
    ]);
    assert_eq!(report["samples"], 300);
    assert_eq!(report["format"], "Tektronix WFM 3");
    assert!((report["rate_hz"].as_f64().unwrap() / 2e6 - 1.0).abs() < 1e-9);
    let again = converted(&[
        first.to_str().unwrap(),
        "-o",
        folder.path().join("c.npz").to_str().unwrap(),
    ]);
    assert_eq!(
        again["format"], "MCAP",
        "of this file, not of the one before"
    );
    let whole = samples(&first);
    for ending in ["csv", "npz", "mcap"] {
        let next = folder.path().join(format!("b.{ending}"));
        converted(&[first.to_str().unwrap(), "-o", next.to_str().unwrap()]);
        let back = samples(&next);
        assert_eq!((&back.v_v, &back.i_a), (&whole.v_v, &whole.i_a), "{ending}");
        for k in [0, 150, 299] {
            let (t, wanted) = (back.time.at(k).unwrap(), whole.time.at(k).unwrap());
            assert!((t - wanted).abs() < 1e-9, "{ending}: {t:e} and {wanted:e}");
        }
    }
}

#[test]
fn flags_reach_the_capture() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.mcap");
    let report = converted(&[
        &fixture("picoscope.csv"),
        "--input",
        "columns=1,3,2,units=mA,V,invert=v,i,probe=2,1",
        "--input=rate=1M",
        "--out",
        out.to_str().unwrap(),
    ]);
    assert_eq!(report["rate_hz"], 1e6);
    let (v, i) = (&report["v_V"], &report["i_A"]);
    // The current of ±30 A, in mA, doubled; the voltage of ±150 V and its third harmonic.
    assert!((v[1].as_f64().unwrap() - 60.0).abs() < 0.5, "{v}");
    assert!((i[1].as_f64().unwrap() - 135.0).abs() < 10.0, "{i}");
}

/// Counts as volt gave an R four times too large that passed the gate.
#[test]
fn a_unit_that_is_neither_volt_nor_ampere_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.mcap");
    let out = out.to_str().unwrap();
    let file = |name: &str, content: Vec<u8>| {
        let path = folder.path().join(name);
        std::fs::write(&path, content).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let table = |unit: &str| {
        let rows: String = (0..100)
            .map(|k| format!("{k}e-6,{},{}\n", k % 10, k % 7))
            .collect();
        let heading = format!("time_s,v ({unit}),i (A)\n");
        file("a.csv", (heading + &rows).into_bytes())
    };
    for unit in ["counts", "div", "Vrms", "MV"] {
        let table = table(unit);
        let remedy = "--input units=V,A";
        refused(&[&table, "-o", out], &["channel 1 `v`", unit, remedy]);
        let report = converted(&[&table, "-o", out, "--input", "units=mV,A"]);
        assert_eq!(report["v_V"][1], 0.009_f32);
    }
    for unit in ["KV", "mVolts", "V"] {
        converted(&[&table(unit), "-o", out]);
    }
    converted(&[&table("coil"), "-o", out]);
    let scope = std::fs::read(fixture("tek_isf_v.isf")).unwrap();
    let current = fixture("tek_isf_i.isf");
    let at = |part: &[u8]| scope.windows(part.len()).position(|w| w == part);
    let at = at(b"\"V\"").expect("a unit");
    for unit in ["W", "VV", "div"] {
        let quoted = format!("\"{unit}\"").into_bytes();
        let scope = file(
            "a.isf",
            [&scope[..at], &quoted[..], &scope[at + 3..]].concat(),
        );
        refused(&[&scope, &current, "-o", out], &[unit, "--input units=V,A"]);
        let channels = "channels=1,2,units=V,A";
        converted(&[&scope, &current, "-o", out, "--input", channels]);
    }
}

#[test]
fn a_stated_rate_replaces_times_that_do_not_hold() {
    let folder = tempfile::tempdir().unwrap();
    let table = folder.path().join("a.csv");
    let out = folder.path().join("a.mcap");
    let (table, out) = (table.to_str().unwrap(), out.to_str().unwrap());
    for (name, time) in [
        (
            "time_s",
            (|k| format!("{:.4}", f64::from(k) * 2e-7)) as fn(i32) -> String,
        ),
        ("time_s", |k| (100 - k).to_string()),
        ("Time (min)", |k| k.to_string()),
        ("time", |k| format!("12:00:00.{k:06}")),
    ] {
        let rows: String = (0..100).map(|k| format!("{},{k},{k}\n", time(k))).collect();
        std::fs::write(table, format!("{name},v_V,i_A\n{rows}")).unwrap();
        refused(&[table, "-o", out], &["line"]);
        let report = converted(&[table, "-o", out, "--input", "rate=1M"]);
        assert_eq!(
            (&report["samples"], &report["rate_hz"]),
            (&100.into(), &1e6.into())
        );
    }
}

#[test]
fn columns_go_by_their_headings_with_the_unit_or_without() {
    let folder = tempfile::tempdir().unwrap();
    let table = folder.path().join("a.csv");
    let mut text = String::from("t_s,coil_V,bus_V,coil_A\n");
    for k in 0..1_000 {
        text.push_str(&format!("{}e-6,{},325,{}\n", k, k % 100, k % 10));
    }
    std::fs::write(&table, text).unwrap();
    let out = folder.path().join("a.mcap");
    for columns in ["t_s,coil_V,coil_A", "t,coil,coil_A"] {
        let report = converted(&[
            table.to_str().unwrap(),
            "--input",
            &format!("columns={columns}"),
            "--out",
            out.to_str().unwrap(),
        ]);
        assert_eq!(report["v_V"][1].as_f64().unwrap(), 99.0, "{columns}");
        assert_eq!(report["i_A"][1].as_f64().unwrap(), 9.0, "{columns}");
    }
}

#[test]
fn wrong_usage_is_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = |name: &str| folder.path().join(name).display().to_string();
    let good = fixture("siglent.csv");
    refused(&[&good, "--out", &out("a.xlsx")], &["a.xlsx", ".parquet"]);
    refused(&[&good, "--out", &good], &["another name"]);
    refused(
        &[&good, "--out", &out("a.npz"), "--input", "rate=0"],
        &["rate=0"],
    );
    refused(
        &[&good, "--out", &out("a.npz"), "--input", "units=V,Hz"],
        &["mV,A"],
    );
    refused(
        &[&good, "--out", &out("a.npz"), "--input", "channels=1"],
        &["2 numbers or names"],
    );
    refused(
        &[&good, "--out", &out("a.npz"), "--input", "channels=1,9"],
        &["no channel 9", "CH2"],
    );
    refused(
        &[&good, "--out", &out("no/folder/a.csv")],
        &["no/folder/a.csv"],
    );
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    if !cfg!(feature = "parquet") {
        refused(
            &[&good, "--out", &out("a.parquet")],
            &["--features parquet"],
        );
    }
}

/// File that is no capture, and the text on stderr.
#[test]
fn what_is_no_capture_is_refused_by_name_and_place() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let out = at("out.npz").display().to_string();
    let written = |name: &str, bytes: &[u8]| -> PathBuf {
        fs::write(at(name), bytes).unwrap();
        at(name)
    };
    let check = |path: &Path, words: &[&str]| {
        let name = path.display().to_string();
        let words = [words, &[name.as_str()]].concat();
        refused(&[&name, "--out", &out], &words);
    };
    check(folder.path(), &["a directory"]);
    check(&at("absent.csv"), &["No such file"]);
    let pipe = at("pipe");
    assert!(
        Command::new("mkfifo")
            .arg(&pipe)
            .status()
            .unwrap()
            .success()
    );
    check(&pipe, &["a pipe"]);
    check(Path::new("/dev/zero"), &["a device"]);
    let row = "0.000,1,2\n0.001,3,4\n";
    check(
        &written("nan.csv", b"t,v,i\n0,1,2\nnan,1,2\n2,1,2\n"),
        &["line 3", "`nan`"],
    );
    check(
        &written("back.csv", format!("t,v,i\n{row}{row}").as_bytes()),
        &["line 4", "does not ascend"],
    );
    check(
        &written("short.csv", b"t,v,i\n0,1,2\n1,1\n"),
        &["line 3", "2 fields"],
    );
    // Windows' line ends: a field, times, a row cut short.
    for (name, text, line) in [
        (
            "crlf-nan.csv",
            "t,v,i\r\n0,1,2\r\n1,bad,2\r\n2,1,2\r\n",
            "line 3",
        ),
        (
            "crlf-back.csv",
            "t,v,i\r\n0,1,2\r\n1,3,4\r\n0,1,2\r\n",
            "line 4",
        ),
        (
            "crlf-short.csv",
            "t,v,i\r\n0,1,2\r\n1,1,2\r\n2,1\r\n",
            "line 4",
        ),
    ] {
        check(&written(name, text.as_bytes()), &[line]);
    }
    check(
        &written("long.csv", &[b'1'; 3 << 20]),
        &["more than 1048576 bytes"],
    );
    check(
        &written("words.csv", b"no numbers\nat all\n"),
        &["line", "no row of numbers"],
    );
    check(&written("utf16.csv", b"\xFF\xFEt\0,\0"), &["UTF-8"]);
    check(&written("a.mat", b"MATLAB 7.3 MAT-file"), &["-v7"]);
    check(
        &written("a.png", b"\x89PNG\r\n\x1a\n\0\0\0"),
        &["binary", "Tektronix WFM"],
    );
    // The byte order's mark alone exchanged: all lengths are then wrong.
    let mut swapped = fs::read(fixture("tek_wfm3le_v.wfm")).unwrap();
    swapped[..2].copy_from_slice(&[0xF0, 0xF0]);
    check(&written("swapped.wfm", &swapped), &["byte "]);
}

#[test]
fn thousands_of_channels_are_no_trouble() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("many.csv");
    let channels = 5000;
    let heading: Vec<_> = (0..channels).map(|k| format!("CH{k}")).collect();
    let mut text = format!("time_s,{}\n", heading.join(","));
    for k in 0..20 {
        let row: Vec<_> = (0..channels).map(|c| format!("{}.{k}", c)).collect();
        text += &format!("{}e-6,{}\n", k, row.join(","));
    }
    fs::write(&path, text).unwrap();
    let path = path.to_str().unwrap();
    let out = folder.path().join("a.npz").display().to_string();
    refused(
        &[path, "--out", &out],
        &["--input channels=V,I", "and 4988 more"],
    );
    let report = converted(&[path, "--input", "channels=CH4999,CH7", "--out", &out]);
    assert_eq!(report["samples"], 20);
    assert_eq!(report["v_V"][0], 4999.0);
}

/// The library of ZIP files printed a line of its own when it was dropped.
#[test]
#[cfg(target_os = "linux")]
fn an_archive_beyond_the_limit_of_a_file_is_one_line_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    // Digits that deflate cannot shorten.
    let row = |k: u32| {
        let [v, i] = [7919, 104_729].map(|by| u64::from(k * k) * by % 1_000_003);
        format!("{:.9},{v},{i}\n", f64::from(k) * 1e-7)
    };
    let text: String = (0..20_000).map(row).collect();
    fs::write(
        folder.path().join("a.csv"),
        format!("time_s,v_V,i_A\n{text}"),
    )
    .unwrap();
    let limited = |blocks: u32| {
        let script =
            format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$0\" convert a.csv --out a.npz");
        let mut command = Command::new("sh");
        command
            .current_dir(folder.path())
            .args(["-c", &script, env!("CARGO_BIN_EXE_ihd")]);
        command.output().expect("sh runs")
    };
    // From the first bytes on, and within the arrays.
    for blocks in [0, 16] {
        let output = limited(blocks);
        let stderr = String::from_utf8(output.stderr).expect("UTF-8");
        assert_eq!(output.status.code(), Some(1), "{stderr}");
        assert!(
            stderr.contains("a.npz") && !stderr.contains("ZipWriter"),
            "{stderr}"
        );
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "{stderr}");
    }
}
