//! `ihd record` and `ihd replay` as a user calls them.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use assert_cmd::cargo::cargo_bin;
use ihd_capture::mcap;
use ihd_capture::mcap::SessionReader;
use serde_json::Value;

use crate::process::{Hob, Process};

fn ihd(args: &str, dir: &Path) -> Command {
    let mut command = Command::new(cargo_bin("ihd"));
    command
        .current_dir(dir)
        .env_remove("RUST_BACKTRACE")
        .args(args.split(' '));
    command
}

fn run(args: &str, dir: &Path) -> Output {
    ihd(args, dir).output().expect("ihd runs")
}

fn json(output: &Output) -> Value {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    serde_json::from_slice(&output.stdout).expect("JSON on stdout")
}

/// Longest wait for an event; it only ends a hang.
const PATIENCE: Duration = Duration::from_secs(300);

/// Waits until a file is larger than `bytes`.
fn await_size(path: &Path, bytes: u64) {
    let deadline = Instant::now() + PATIENCE;
    while std::fs::metadata(path).map_or(0, |m| m.len()) < bytes {
        assert!(Instant::now() < deadline, "{} stays small", path.display());
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Events of a recorded session, and whether it ends without its end mark.
fn events(path: &Path) -> (usize, bool) {
    let mut session = SessionReader::open(path).expect("a session");
    let mut events = 0;
    while session.next_event().expect("readable").is_some() {
        events += 1;
    }
    assert!(session.file_damage().is_none());
    (events, session.is_cut())
}

#[test]
fn a_recording_replays_identically() {
    let dir = tempfile::tempdir().unwrap();
    let args = "record --power 1500 --duration 1.5s --out hob.mcap --json";
    let report = json(&run(args, dir.path()));
    assert_eq!(report["ended_by"], "duration");
    let number = |pointer: &str| report.pointer(pointer).and_then(Value::as_f64).unwrap();
    assert!((number("/seconds") - 1.5).abs() < 0.2, "{report:#}");
    // 150 half-cycles, each with its telemetry; 400 kB/s carry a window each 14.
    assert!(
        (120.0..200.0).contains(&number("/link/telemetry")),
        "{report:#}"
    );
    assert!(number("/link/windows") >= 3.0, "{report:#}");
    assert_eq!(number("/link/frames_bad"), 0.0);
    let path = dir.path().join("hob.mcap");
    let (seen, cut) = events(&path);
    assert!(!cut && seen as f64 >= number("/link/telemetry"));
    // The same again gives the same bytes: time is the simulation's.
    json(&run(&args.replace("hob.mcap", "again.mcap"), dir.path()));
    let bytes = |name: &str| std::fs::read(dir.path().join(name)).unwrap();
    assert!(bytes("hob.mcap") == bytes("again.mcap"));

    let outcome = json(&run("replay hob.mcap --json", dir.path()));
    assert_eq!(outcome["differences"], 0);
    assert!(outcome["estimates"].as_u64() > Some(400), "{outcome:#}");
    let text = run("replay hob.mcap", dir.path());
    let text = String::from_utf8_lossy(&text.stdout).into_owned();
    assert!(
        text.contains("identical, bit for bit") && text.contains("locked off"),
        "{text}"
    );
}

/// Regression test: 4 ms of a scope hold no half-cycle, and the result was "identical, bit for bit" with nothing compared.
#[test]
fn a_replay_without_a_half_cycle_says_that_none_was_compared() {
    let dir = tempfile::tempdir().unwrap();
    let row = |k: i32| {
        let t_s = 2e-3 + f64::from(k) * 2e-7;
        let angle = std::f64::consts::TAU * 45e3 * t_s;
        format!(
            "{t_s:.8},{:.4},{:.4}\n",
            150.0 * angle.sin(),
            30.0 * (angle - 1.2).sin()
        )
    };
    let rows: String = (0..20_000).map(row).collect();
    let table = dir.path().join("short.csv");
    std::fs::write(&table, format!("time_s,v_V,i_A\n{rows}")).unwrap();
    let args = "replay short.csv --input mains=50,zero-crossing=0";
    let output = run(args, dir.path());
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(0), "{text}");
    assert!(
        text.contains("nothing to compare: no whole half-cycle")
            && !text.contains("result     identical"),
        "{text}"
    );
}

/// Killed at any moment a recording can be inspected, and holds what came until half a second before.
#[test]
fn a_recording_killed_at_any_moment_is_inspected() {
    let dir = tempfile::tempdir().unwrap();
    let mut with_windows = 0;
    // Moments by what is in the file, however slow the machine is: nothing, its head, half-cycles, windows.
    for bytes in [0, 1, 3_000, 40_000, 300_000] {
        let file = format!("killed-{bytes}.mcap");
        let args = format!("record --device sim --power 1500 --out {file}");
        let mut recorder = Process::start(&mut ihd(&args, dir.path()), true);
        let path = dir.path().join(&file);
        await_size(&path, bytes);
        recorder.kill();
        if !path.exists() {
            continue;
        }
        let output = run(&format!("inspect {file}"), dir.path());
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        // Nothing that a recorder which is killed leaves has an end mark.
        assert_eq!(output.status.code(), Some(7), "{bytes}: {stderr}");
        assert!(
            !stderr.contains("panicked") && stderr.contains(&file),
            "{stderr}"
        );
        if std::fs::metadata(&path).unwrap().len() == 0 {
            continue;
        }
        // Every window whose frames are in the file is in the samples too.
        let mut session = SessionReader::open(&path).expect("a session");
        let (mut windows, mut half_cycle_s) = (0, 0.0);
        while let Some(event) = session.next_event().expect("readable") {
            if let ihd_link::DeviceEvent::Window(window) = event {
                windows += 1;
                half_cycle_s = 0.5 / window.f_mains_hz();
            }
        }
        assert!(session.file_damage().is_none());
        let capture = mcap::salvage(&path).unwrap().capture;
        if windows > 0 {
            with_windows += 1;
            let pairs_s = capture.len() as f64 / 1.2e6;
            assert!(
                pairs_s > 0.8 * half_cycle_s * f64::from(windows),
                "{windows} windows"
            );
        }
    }
    assert!(with_windows > 0, "no recording lived long enough");
}

#[test]
fn a_device_that_vanishes_leaves_a_summary_and_3() {
    let dir = tempfile::tempdir().unwrap();
    let hob = Hob::start();
    let address = hob.address.clone();
    let args = format!("record --device tcp:{address} --out vanished.mcap --json");
    let recorder = ihd(&args, dir.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("ihd record runs");
    let path = dir.path().join("vanished.mcap");
    await_size(&path, 15_000);
    drop(hob);
    let output = recorder.wait_with_output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(3), "{stderr}");
    let report: Value = serde_json::from_slice(&output.stdout).expect("JSON on stdout");
    assert_eq!(report["ended_by"], "error");
    assert!(
        report["error"].as_str().is_some_and(|e| !e.is_empty()),
        "{report:#}"
    );
    assert!(report["link"]["telemetry"].as_u64() > Some(5), "{report:#}");
    assert!(report["device_windows_dropped"].is_null(), "{report:#}");
    let (seen, cut) = events(&path);
    assert!(!cut && seen > 5, "{seen}");
}

#[test]
#[cfg(unix)]
fn an_interrupted_recorder_ends_the_file_in_order() {
    let dir = tempfile::tempdir().unwrap();
    let hob = Hob::start();
    let address = &hob.address;
    let args = format!("record --device tcp:{address} --out ended.mcap --json");
    let recorder = ihd(&args, dir.path()).stdout(Stdio::piped()).spawn();
    let recorder = recorder.expect("ihd record runs");
    let path = dir.path().join("ended.mcap");
    await_size(&path, 15_000);
    let pid = recorder.id().to_string();
    let sent = Command::new("kill").args(["-INT", &pid]).status();
    assert!(sent.expect("kill runs").success());
    let output = recorder.wait_with_output().unwrap();
    let report = json(&output);
    assert_eq!(report["ended_by"], "interrupt");
    let (seen, cut) = events(&path);
    assert!(!cut && seen > 10, "{seen}");
}

#[test]
fn a_simulated_hob_is_recorded_from_a_trigger_on() {
    let dir = tempfile::tempdir().unwrap();
    let args = "record --power 1500 --trigger level:power>1000 --pre-trigger 0.05 --duration 0.1 --out t.mcap --json";
    let report = json(&run(args, dir.path()));
    assert_eq!(report["ended_by"], "duration");
    let path = dir.path().join("t.mcap");
    assert_eq!(report["bytes"], std::fs::metadata(&path).unwrap().len());
    let (seen, cut) = events(&path);
    // 15 half-cycles of telemetry, and what the device still sends when it is left.
    assert!(!cut && (15..40).contains(&seen), "{seen}");
}

/// A script that waits for a fault must not take a recording for made.
#[test]
#[cfg(unix)]
fn a_trigger_that_did_not_come_is_1_and_said() {
    let dir = tempfile::tempdir().unwrap();
    let args = "record --device sim --trigger fault --duration 1 --out t.mcap";
    let mut recorder = ihd(args, dir.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("ihd record runs");
    let mut said = String::new();
    let stdout = recorder.stdout.take().expect("a pipe");
    BufReader::new(stdout).read_line(&mut said).unwrap();
    assert!(said.contains("waits for"), "{said}");
    let pid = recorder.id().to_string();
    let sent = Command::new("kill").args(["-INT", &pid]).status();
    assert!(sent.expect("kill runs").success());
    let output = recorder.wait_with_output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("nothing was recorded"), "{stderr}");
    assert!(!dir.path().join("t.mcap").exists());
}

#[test]
fn a_recording_without_a_pot_did_not_heat() {
    let dir = tempfile::tempdir().unwrap();
    let args = "record --pot none --power 1500 --duration 1 --out n.mcap";
    let output = run(args, dir.path());
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(4), "{stderr}");
    assert!(stderr.contains("put a pot on"), "{stderr}");
    assert!(dir.path().join("n.mcap").exists());
}

#[test]
fn limits_are_checked_and_a_size_ends_a_recording() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("there.mcap"), "").unwrap();
    for (args, word) in [
        ("record --out a.mcap --duration 0", "--duration"),
        ("record --out a.mcap --pre-trigger 1", "--trigger"),
        ("record --out there.mcap --trigger fault", "there already"),
        ("record --out there.mcap", "exists already"),
        ("record --out a.mcap --max-size=-1", "--max-size"),
        ("record --out a.mcap --power 10001", "10000"),
        ("record", "--out"),
        ("replay missing.mcap", "missing.mcap"),
        ("replay missing.mcap --speed 0", "--speed"),
    ] {
        let output = run(args, dir.path());
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(
            !output.status.success() && stderr.contains(word),
            "{args}: {stderr}"
        );
        assert!(!stderr.contains("panicked"), "{stderr}");
    }
    let args = "record --power 1500 --max-size 200k --out small.mcap --json";
    let report = json(&run(args, dir.path()));
    assert_eq!(report["ended_by"], "size");
    let bytes = report["bytes"].as_u64().unwrap();
    assert!((200_000..800_000).contains(&bytes), "{bytes}");
}
