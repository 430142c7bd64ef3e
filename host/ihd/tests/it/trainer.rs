//! Ends of `ihd trainer`: a signal, a hob that goes away, one that comes back.
#![cfg(unix)]

use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::process::{Hob, PATIENCE, Process};

/// `ihd trainer` with a store of its own.
fn trainer(device: &str, store: &Path, rest: &[&str]) -> Process {
    let store = store.to_str().expect("UTF-8");
    let mut args = vec!["trainer", "--json", "--device", device, "--store", store];
    args.extend(rest);
    let mut command = Command::new(env!("CARGO_BIN_EXE_ihd"));
    Process::start(command.args(&args), true)
}

/// Waits until a point has been found and kept: the second lookup comes with the point after it.
fn until_a_point_is_found(store: &Path) {
    let until = Instant::now() + PATIENCE;
    let lookups = || {
        let files = std::fs::read_dir(store.join("run-001"));
        let names = files.into_iter().flatten().flatten();
        let names = names.map(|file| file.file_name().to_string_lossy().into_owned());
        let is_lookup = |name: &String| name.starts_with("lookup-v") && name.ends_with(".json");
        names.filter(is_lookup).count()
    };
    while lookups() < 2 {
        assert!(Instant::now() < until, "it finds nothing");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn report(out: &str) -> Value {
    serde_json::from_str(out).unwrap_or_else(|e| panic!("{e}: {out}"))
}

fn points(report: &Value) -> usize {
    report["points"].as_array().map_or(0, Vec::len)
}

/// Far more powers than there is time for.
const LONG: &str = "1500,2000,1000,700,1500,2000,1000,700,1500,2000,1000,700,1500,2000,1000,700,1500,2000,1000,700";

#[test]
fn a_signal_ends_a_plain_run_with_the_hob_off_and_what_was_found() {
    let mut hob = Hob::start();
    for signal in ["INT", "TERM"] {
        let store = tempfile::tempdir().unwrap();
        let trainer = trainer(&hob.place(), store.path(), &["--power", LONG]);
        until_a_point_is_found(store.path());
        trainer.signal(signal);
        let (code, out, err) = trainer.ended();
        assert_eq!(code, 1, "{err}");
        assert!(err.contains("interrupted"), "{err}");
        let report = report(&out);
        assert!(points(&report) >= 1, "{report:#}");
        assert_eq!(report["error"], "interrupted");
        assert_eq!(hob.left_with_w(), 0);
    }
}

#[test]
fn a_hob_that_goes_away_leaves_what_was_found_and_exits_with_3() {
    let hob = Hob::start();
    let store = tempfile::tempdir().unwrap();
    let trainer = trainer(&hob.place(), store.path(), &["--power", LONG]);
    until_a_point_is_found(store.path());
    drop(hob);
    let (code, out, err) = trainer.ended();
    assert_eq!(code, 3, "{err}");
    let report = report(&out);
    assert!(points(&report) >= 1, "{report:#}");
    let error = report["error"].as_str().unwrap_or_default();
    assert!(error.contains("could not be switched off"), "{report:#}");
}

/// A hob that was started anew is not switched on again: somebody has had a hand in it.
#[test]
fn following_survives_a_hob_that_comes_back_and_a_signal_is_its_ordinary_end() {
    let hob = Hob::start();
    let address = hob.address.clone();
    let store = tempfile::tempdir().unwrap();
    let follow = ["--power", "1500", "--follow"];
    let mut trainer = trainer(&hob.place(), store.path(), &follow);
    trainer.line_with("active on the device");
    drop(hob);
    trainer.line_with("trying again for 60 s");
    let mut hob = Hob::start_with(&["--listen", &address]);
    trainer.line_with("connected again; it has started anew");
    trainer.signal("INT");
    let (code, out, err) = trainer.ended();
    assert_eq!(code, 0, "{err}");
    let report = report(&out);
    assert!(
        points(&report) >= 1 && report["error"].is_null(),
        "{report:#}"
    );
    assert_eq!(hob.left_with_w(), 0);
}

/// The report of a run with a simulated hob: the map that it taught itself, against the load's own law, and the powers of its windows, of
/// which 300 W are made in bursts.
#[test]
fn it_reports_the_maps_error_and_the_power_of_each_window() {
    let args = "trainer --store none --json --power 1500,300,1000 --sim load=reduced,lift=2mm";
    let mut command = Command::new(env!("CARGO_BIN_EXE_ihd"));
    let output = command.args(args.split(' ')).output().expect("ihd runs");
    let report = report(&String::from_utf8_lossy(&output.stdout));
    for point in report["points"].as_array().expect("points") {
        let of = |place: &str| point.pointer(place).and_then(Value::as_f64).expect(place);
        // ½·R·I² at the crest, and about half of it in the mean over the half-cycle.
        let half_w = 0.25 * of("/truth/r_ohm") * of("/i_crest_a").powi(2);
        let share = of("/delivered_w") / half_w;
        assert!((0.85..1.15).contains(&share), "{share} in {point:#}");
    }
    let error = &report["map_error"];
    let number = |place: &str| {
        let found = error.pointer(place).and_then(Value::as_f64);
        found.unwrap_or_else(|| panic!("no number at {place} in {error:#}"))
    };
    assert!(number("/observed/cells") > 9.0, "{error:#}");
    assert!(number("/observed/r_mean_pct") < 2.0, "{error:#}");
    assert!(number("/observed/l_mean_pct") < 1.0, "{error:#}");
    assert!(number("/unseen/cells") > 0.0, "{error:#}");
    assert!(number("/unseen/r_worst_pct") >= number("/unseen/r_mean_pct"));
}
