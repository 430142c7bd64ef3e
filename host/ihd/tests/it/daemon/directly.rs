//! Commands where no daemon runs.

use std::path::PathBuf;
use std::process::Stdio;
use std::sync::MutexGuard;

use ihd_fakes::free_address;

use super::processes::{alone, command, device, heated, ihd};
use crate::process::{Hob, Process, closed_pipe};

struct Bench {
    hob: Hob,
    place: String,
    config: PathBuf,
    dir: tempfile::TempDir,
    _alone: MutexGuard<'static, ()>,
}

fn bench() -> Bench {
    let alone = alone();
    let hob = Hob::start();
    let place = hob.place();
    let dir = tempfile::tempdir().unwrap();
    let config = dir.path().join("ihd.toml");
    let text = format!(
        "listen = \"{}\"\nstore = {:?}\n[[device]]\nname = \"bench\"\naddress = \"{place}\"\n",
        free_address(),
        dir.path().join("store"),
    );
    std::fs::write(&config, text).unwrap();
    Bench {
        hob,
        place,
        config,
        dir,
        _alone: alone,
    }
}

#[test]
fn names_and_addresses_are_found() {
    let bench = bench();
    for name in ["bench", &bench.place] {
        let (code, stdout, stderr) = device(&bench.config, &[name, "status"]);
        assert_eq!(code, 0, "{stderr}");
        assert!(
            stdout.contains("Idle") && stdout.contains("without a daemon"),
            "{stdout}"
        );
    }
    let (code, stdout, _) = device(&bench.config, &["status"]);
    assert_eq!(code, 0);
    assert!(
        stdout.contains("no daemon") && stdout.contains("bench"),
        "{stdout}"
    );
}

#[test]
fn power_ends_off_however_it_ends() {
    let mut bench = bench();
    // The last half-cycle that it saw has the power that was asked for, once there was time for that.
    let mut for_s = 2;
    let heated = loop {
        let for_s_text = for_s.to_string();
        let args = ["bench", "power", "1000", "--for", &for_s_text, "--json"];
        let (code, stdout, stderr) = device(&bench.config, &args);
        assert!([0, 4].contains(&code), "{stderr}");
        let heated: serde_json::Value = serde_json::from_str(&stdout).unwrap();
        assert_eq!(bench.hob.left_with_w(), 0);
        assert_eq!(heated["granted_w"], 1_000, "{heated:#}");
        if heated["last"]["live"]["power_w"].as_f64() > Some(900.0) {
            assert_eq!(code, 0);
            break heated;
        }
        assert!(for_s < 100, "{heated:#}");
        for_s *= 2;
    };
    assert!(
        heated["heating_seconds"].as_f64().unwrap() > 0.0,
        "{heated:#}"
    );
    let live = &heated["last"]["live"];
    assert!(
        (live["power_w"].as_f64().unwrap() / 1_000.0 - 1.0).abs() < 0.1,
        "{live:#}"
    );
    assert!(live["r_ohm"].as_f64().is_some_and(|r| r > 0.5), "{live:#}");
    // A kill leaves it to the hob.
    for (signal, code, left_w) in [("INT", 0, 0), ("TERM", 0, 0), ("KILL", -1, 900)] {
        let mut command = ihd();
        command
            .args(["device", "bench", "power", "900", "--config"])
            .arg(&bench.config);
        let mut power = Process::start(&mut command, false);
        // Its first line: it was asked for then.
        power.line_with("bench: ");
        power.signal(signal);
        assert_eq!(power.code(), code);
        assert_eq!(bench.hob.left_with_w(), left_w, "{signal}");
    }
    // As with `| head -0`. Its lines are an error once it heats.
    let mut command = ihd();
    command
        .args(["device", "bench", "power", "900", "--config"])
        .arg(&bench.config)
        .stdout(closed_pipe())
        .stderr(Stdio::piped());
    let ended = command.spawn().unwrap().wait_with_output().unwrap();
    assert_eq!(ended.status.code(), Some(1), "{ended:?}");
    assert_eq!(bench.hob.left_with_w(), 0, "{ended:?}");
}

#[test]
fn a_sweep_shows_what_the_device_finds() {
    let mut bench = bench();
    let (stdout, times) = heated(&bench.config, |times| {
        let powers = vec!["1500"; times].join(",");
        ["bench", "power", &powers, "--windows"]
            .map(str::to_owned)
            .into()
    });
    assert!(stdout.contains("nothing is learned"), "{stdout}");
    assert!(stdout.contains("of 1500 W"), "{stdout}");
    for _ in 0..=times.ilog2() {
        assert_eq!(bench.hob.left_with_w(), 0);
    }
}

#[test]
fn a_device_that_does_not_heat_exits_with_4() {
    let hob = Hob::start_with(&["--listen", "127.0.0.1:0", "--pot", "none"]);
    let place = hob.place();
    let bench = bench();
    let (code, _, stderr) = device(&bench.config, &[&place, "power", "1000", "--for", "3"]);
    assert_eq!(code, 4, "{stderr}");
    assert!(
        stderr.contains("did not heat as asked: put a pot on"),
        "{stderr}"
    );
}

#[test]
fn a_recording_and_the_one_that_is_not_overwritten() {
    let bench = bench();
    let out = bench.dir.path().join("a.mcap");
    let args = [
        "record",
        "--device",
        "bench",
        "--duration",
        "1",
        "--out",
        out.to_str().unwrap(),
    ];
    let (code, _, stderr) = command(&bench.config, &args);
    assert_eq!(code, 0, "{stderr}");
    assert!(std::fs::metadata(&out).unwrap().len() > 1_000);
    assert_ne!(command(&bench.config, &args).0, 0);
}

#[test]
fn wrong_usage_exits_with_2_and_nobody_with_3() {
    let bench = bench();
    for (args, word) in [
        (&["bench", "power", "0"][..], "1 to 10000 W"),
        (&["bench", "power", "10001"], "1 to 10000 W"),
        (&["bench", "power", "NaN"], "NaN"),
        (&["bench", "power", "500", "--for", "0"], "--for"),
        (&["bench"], "Usage"),
        (&["off"], "which device"),
        (&["bench", "list"], "ihd device status"),
        (&["bench", "sweep"], "power W,W,"),
        (&["bench", "power", "500,600", "--for", "1"], "--for"),
        (&["kitchen", "status"], "bench"),
        (&["sim", "status"], "ihd hob"),
    ] {
        let (code, _, stderr) = device(&bench.config, args);
        assert_eq!(code, 2, "{args:?}: {stderr}");
        assert!(stderr.contains(word), "{args:?}: {stderr}");
    }
    let nobody = format!("tcp:{}", free_address());
    assert_eq!(device(&bench.config, &[&nobody, "status"]).0, 3);
}
