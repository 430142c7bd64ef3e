//! `ihd identify` and `ihd-study` as a person or a program calls them.

use std::path::Path;

use assert_cmd::Command;
use serde_json::Value;

pub fn ihd() -> Command {
    Command::cargo_bin("ihd").expect("the command is built")
}

/// A mains cycle of the behavioural reference load, 50 kHz, 5 MS/s, 50 dB, as a table with other column names.
pub fn table(folder: &Path) -> (std::path::PathBuf, Vec<f64>) {
    use ihd_sim::recording::sensing::{Rate, Sensing};
    use ihd_sim::recording::settings::{CaptureSpec, LoadKind};
    use ihd_sim::trial::Trial;
    let settings = CaptureSpec {
        load: LoadKind::Behavioural,
        f_sw_hz: 50e3,
        sensing: Sensing {
            rate: Rate::Hz(5e6),
            allow_aliasing: true,
            ..Sensing::default()
        },
        ..CaptureSpec::default()
    };
    let trial = Trial::record(&settings).expect("the preset simulates");
    let noisy = trial.noisy(Some(50.0), 3);
    let path = folder.join("capture.csv");
    let mut text = String::from("seconds,u_coil,i_coil\n");
    for k in 0..noisy.len() {
        let line = format!(
            "{:.9},{:.5},{:.6}\n",
            noisy.t_s(k),
            noisy.v_v[k],
            noisy.i_a[k]
        );
        text.push_str(&line);
    }
    std::fs::write(&path, text).expect("a temporary file");
    let crest = trial
        .truth
        .iter()
        .filter(|t| (t.t_s - 15e-3).abs() < 0.2e-3);
    (path, crest.map(|t| t.r_ohm[0]).collect())
}

#[test]
fn a_table_with_named_columns_is_identified_by_every_method() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (path, crest_r) = table(folder.path());
    let csv = folder.path().join("found.csv");
    let plot = folder.path().join("found.svg");
    let output = ihd()
        .args(["identify", "--input", "columns=seconds,u_coil,i_coil"])
        .arg("--method")
        .arg("kf,ekf,ekf-paper,rts,lockin,least-squares,rls,firmware")
        .arg("--json")
        .arg("--out")
        .arg(&csv)
        .arg("--out")
        .arg(&plot)
        .arg(&path)
        .output()
        .expect("it runs");
    let stderr = String::from_utf8_lossy(&output.stderr);
    // As printed, ekf-paper does not find the load: everything is printed, and the command ends with 7.
    assert_eq!(output.status.code(), Some(7), "{stderr}");
    let found: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let entries = found.as_array().expect("an array");
    assert_eq!(entries.len(), 8);
    let right = crest_r.iter().sum::<f64>() / crest_r.len() as f64;
    for entry in entries {
        let method = entry["method"].as_str().expect("a name");
        let numbers = |key: &str| -> Vec<f64> {
            let values = entry[key].as_array().expect("an array");
            values
                .iter()
                .map(|x| x.as_f64().expect("a number"))
                .collect()
        };
        let (t, r) = (numbers("t_s"), numbers("r_ohm"));
        assert!(t.len() == r.len() && t.len() == numbers("l_h").len() && !t.is_empty());
        assert!((entry["f_sw_hz"].as_f64().expect("f_sw") / 50e3 - 1.0).abs() < 1e-3);
        assert!(entry.get("mre_r_pct").is_none(), "a table carries no truth");
        assert!(entry["elapsed_s"].as_f64().expect("a time") > 0.0);
        for key in ["nmse_v_pct", "nmse_i_pct"] {
            assert!(entry.get(key).is_some(), "{method}: {key}");
        }
        if method == "ekf-paper" {
            // As printed it does not find the load: the notes state it.
            assert!(!entry["notes"].as_array().expect("notes").is_empty());
            assert_eq!(entry["gate"]["verdict"], "refuse");
            continue;
        }
        // At 100 samples a period the linear filter's chord costs 1 % of L, which the gate may refuse.
        if method != "kf" {
            assert_eq!(
                entry["gate"]["verdict"], "pass",
                "{method}: {}",
                entry["findings"]
            );
        }
        let near = t
            .iter()
            .zip(&r)
            .filter(|(t, _)| (**t - 15e-3).abs() < 0.2e-3);
        let (n, sum) = near.fold((0, 0.0), |(n, sum), (_, r)| (n + 1, sum + r));
        let off = sum / f64::from(n) / right - 1.0;
        assert!(
            off.abs() < 0.05,
            "{method}: {} for {right}",
            sum / f64::from(n)
        );
    }
    let text = std::fs::read_to_string(&csv).expect("the table");
    assert!(text.starts_with("method,f_sw_hz,t_s,r_ohm,l_h,r_sigma_ohm,l_sigma_h,r_power_ohm\n"));
    assert!(text.contains("\nrls,"));
    let svg = std::fs::read_to_string(&plot).expect("the figure");
    for word in ["Resistance", "Inductance", "reconstructed", "least-squares"] {
        assert!(svg.contains(word), "{word}");
    }
}

#[test]
fn what_cannot_be_identified_is_reported_and_fails() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("short.csv");
    std::fs::write(&path, "time_s,v_V,i_A\n0,1,2\n1e-6,2,1\n2e-6,1,0\n").expect("a file");
    let output = ihd().arg("identify").arg(&path).output().expect("it runs");
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("ihd: "));
    let unknown = ihd()
        .args(["identify", "--method", "guess"])
        .arg(&path)
        .output()
        .expect("it runs");
    assert_eq!(unknown.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&unknown.stderr).contains("least-squares"));
}

/// A coil beside this one is removed, and said. By the linear filter in noise the result is printed with its findings, the command
/// ends with 7, and with 0 on request.
#[test]
fn a_refused_result_is_printed_and_ends_with_7() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let simulate = "simulate --set load=behavioural,rate=12.5M,snr=50";
    for args in ["-o clean.mcap", "--set neighbour=1.2k,8 -o tone.mcap"] {
        let words = simulate.split(' ').chain(args.split(' '));
        let output = ihd().current_dir(&folder).args(words).output();
        assert!(output.expect("it runs").status.success());
    }
    let identified = |args: &[&str]| {
        let output = ihd()
            .current_dir(&folder)
            .arg("identify")
            .args(args)
            .output();
        let output = output.expect("it runs");
        (output.status.code(), output.stdout)
    };
    let (code, stdout) = identified(&["clean.mcap", "--json"]);
    let clean: Value = serde_json::from_slice(&stdout).expect("JSON");
    assert_eq!(
        (code, &clean[0]["gate"]["verdict"]),
        (Some(0), &"pass".into())
    );
    assert_eq!(clean[0]["gate"]["why"], serde_json::json!([]));
    let half_cycles = clean[0]["half_cycles"].as_array().expect("verdicts");
    assert!(half_cycles.iter().all(|h| h["verdict"] == "pass"));
    assert!(clean[0]["pooled"]["r_ohm"].is_array());
    let (_, stdout) = identified(&["tone.mcap", "--json"]);
    let corrected: Value = serde_json::from_slice(&stdout).expect("JSON");
    let findings = corrected[0]["findings"].as_array().expect("findings");
    let tone = findings.iter().find(|f| f["code"] == "interference");
    assert_eq!(tone.expect("the tone is named")["severity"], "warning");
    let refused = ["clean.mcap", "--method", "ekf-paper"];
    let (code, stdout) = identified(&[&refused[..], &["--json"]].concat());
    assert_eq!(code, Some(7));
    let results: Value = serde_json::from_slice(&stdout).expect("JSON");
    let first = &results[0];
    assert!(first["r_ohm"].as_array().is_some_and(|r| !r.is_empty()));
    assert_eq!(first["gate"]["verdict"], "refuse");
    let (code, stdout) = identified(&[&refused[..], &["--anyway"]].concat());
    assert_eq!(code, Some(0));
    let text = String::from_utf8_lossy(&stdout);
    assert!(text.contains("gate: refuse: "), "{text}");
}

/// Simulates at 50 MS/s: a part for each 40 ms.
pub fn long_capture(folder: &Path, duration_s: f64) {
    let settings = format!("load=behavioural,rate=50M,snr=40,duration={duration_s}");
    let words = ["simulate", "--set", &settings, "-o", "long.mcap"];
    let output = ihd().current_dir(folder).args(words).output();
    assert!(output.expect("it runs").status.success());
}

/// Results without the times that they took.
fn timeless(stdout: &[u8]) -> Value {
    let mut found: Value = serde_json::from_slice(stdout).expect("JSON");
    for entry in found.as_array_mut().expect("an array") {
        entry["elapsed_s"] = Value::Null;
    }
    found
}

#[test]
fn a_long_capture_is_identified_in_parts_with_the_same_digits_on_any_number_of_threads() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    long_capture(folder.path(), 0.09);
    let identified = |threads: &str| {
        let output = ihd()
            .current_dir(&folder)
            .args(["identify", "long.mcap", "--json", "--method"])
            .args(["least-squares,lockin", "--out", "found.csv", "--out"])
            .args(["found.svg", "--threads", threads])
            .output()
            .expect("it runs");
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(0), "{stderr}");
        let read = |name: &str| std::fs::read(folder.path().join(name)).expect("a file");
        let files = (read("found.csv"), read("found.svg"));
        (timeless(&output.stdout), files, stderr)
    };
    let one = identified("1");
    assert!(one == identified("4"), "other digits on four threads");
    let entries = one.0.as_array().expect("an array");
    assert_eq!(entries.len(), 4, "two methods on two parts");
    let mut half_cycles = 0;
    for entry in entries {
        assert_eq!(entry["gate"]["verdict"], "pass", "{}", entry["findings"]);
        // The whole half-cycle, zero crossings included.
        assert!(entry["mre_r_pct"].as_f64().expect("truth") < 0.5);
        let half = entry["half_cycles"].as_array().expect("verdicts");
        half_cycles += half.iter().filter(|h| h["verdict"] == "pass").count();
    }
    assert_eq!(half_cycles, 2 * 9, "no half-cycle is lost at a cut");
}

#[test]
#[cfg(all(feature = "pinn", unix))]
fn what_was_found_before_an_interruption_is_kept() {
    use std::io::{BufRead, BufReader, Read};
    use std::process::Stdio;
    let folder = tempfile::tempdir().expect("a temporary folder");
    long_capture(folder.path(), 0.13);
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_ihd"))
        .current_dir(&folder)
        .args(["identify", "long.mcap", "--json", "--threads", "1"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("it starts");
    // The first part is being written, more than a pipe holds: it cannot go on before the rest is read.
    let mut stdout = BufReader::with_capacity(16, child.stdout.take().expect("piped"));
    let mut text = String::new();
    stdout.read_line(&mut text).expect("a line");
    let sent = std::process::Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status();
    assert!(sent.expect("kill runs").success());
    stdout.read_to_string(&mut text).expect("UTF-8");
    let ended = child.wait_with_output().expect("it ends");
    let stderr = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("interrupted"), "{stderr}");
    let found: Value = serde_json::from_str(&text).expect("complete JSON");
    let parts = found.as_array().expect("an array").len();
    assert!((1..3).contains(&parts), "{parts} parts");
}
