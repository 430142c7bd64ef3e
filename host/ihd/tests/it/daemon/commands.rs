//! Commands through the daemon.

use super::processes::{Kitchen, command, heated};

fn asked_w(report: &serde_json::Value) -> u64 {
    report["asked_by_daemon_w"].as_u64().unwrap()
}

#[test]
fn a_daemon_heats_nothing_by_itself_and_is_seen() {
    let kitchen = Kitchen::start();
    let (code, stdout, _) = kitchen.device(&["status"]);
    assert_eq!(code, 0);
    assert!(stdout.contains("daemon at http://127.0.0.1:"), "{stdout}");
    assert!(
        stdout.contains("bench") && stdout.contains("idle"),
        "{stdout}"
    );
    let (_, stdout, _) = kitchen.device(&["status", "--json"]);
    let listed: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(listed[0]["name"], "bench");
    // By its address, too.
    let place = kitchen.hob.place();
    let (code, stdout, _) = kitchen.device(&[&place, "status"]);
    assert_eq!(code, 0);
    assert!(stdout.contains("idle"), "{stdout}");
    let report = kitchen.report();
    assert_eq!(report["live"]["asked_w"], 0, "{report:#}");
    assert_eq!(report["live"]["f_sw_hz"], 0, "{report:#}");
}

/// A link has one host: a log beside the daemon comes through a debug probe.
#[test]
#[cfg(feature = "log")]
fn a_log_of_what_the_daemon_has_says_so() {
    let kitchen = Kitchen::start();
    let config = kitchen.dir.path().join("ihd.toml");
    let place = kitchen.hob.place();
    for device in ["bench", &place] {
        let mut log = super::processes::ihd();
        log.args(["log", device, "--config"]).arg(&config);
        let output = log.output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{stderr}");
        assert!(
            stderr.contains("the daemon at http://") && stderr.contains("--probe"),
            "{stderr}"
        );
    }
    // The daemon's link goes on.
    assert!(kitchen.report()["live"].is_object());
}

#[test]
fn power_heats_for_its_time_and_is_off_after() {
    let kitchen = Kitchen::start();
    let (stdout, times) = heated(&kitchen.dir.path().join("ihd.toml"), |times| {
        format!("bench power 1200 --for {} --json", 2 * times)
            .split(' ')
            .map(str::to_owned)
            .collect()
    });
    let heated: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(heated["ended_by"], "time");
    let number = |name: &str| heated[name].as_f64().unwrap();
    assert!(number("seconds") >= 2.0 * times as f64, "{heated:#}");
    assert!(number("heating_seconds") > 0.0, "{heated:#}");
    // 1200 W for as long as it was seen to heat at most.
    let most_wh = 1.1 * 1_200.0 * number("heating_seconds") / 3_600.0;
    let energy_wh = number("energy_wh");
    assert!(energy_wh > 0.0 && energy_wh < most_wh, "{heated:#}");
    let report = kitchen.report();
    assert_eq!(
        (asked_w(&report), report["lease"].is_null()),
        (0, true),
        "{report:#}"
    );
    kitchen.until("the hob is off", |r| r["live"]["asked_w"] == 0);
}

/// One that is killed renews its lease no more; what follows, `power_ends_with_the_lease_that_nobody_renews` shows (host/daemon).
#[test]
fn an_interrupted_power_leaves_the_hob_off() {
    let kitchen = Kitchen::start();
    for signal in ["INT", "TERM"] {
        let mut power = kitchen.in_the_background(&["bench", "power", "900"]);
        kitchen.until("it heats", |r| asked_w(r) == 900);
        power.signal(signal);
        assert_eq!(power.code(), 0, "{signal}");
        // At its end, not when its lease runs out.
        let report = kitchen.report();
        assert!(
            asked_w(&report) == 0 && report["lease"].is_null(),
            "{report:#}"
        );
    }
}

#[test]
fn power_ends_with_a_hob_that_is_gone() {
    let mut kitchen = Kitchen::start();
    let mut power = kitchen.in_the_background(&["bench", "power", "900"]);
    kitchen.until("it heats", |r| r["live"]["power_w"].as_f64() > Some(500.0));
    kitchen.hob.process.kill();
    kitchen.until("nothing is known of it", |r| r["live"].is_null());
    assert_eq!(power.code(), 3, "no device");
}

#[test]
fn one_commands_and_force_takes_over_and_the_other_is_told() {
    let kitchen = Kitchen::start();
    let mut first = kitchen.in_the_background(&["bench", "power", "900"]);
    kitchen.until("it heats", |r| asked_w(r) == 900);
    let (code, _, stderr) = kitchen.device(&["bench", "power", "500", "--for", "1"]);
    assert_eq!(code, 1, "{stderr}");
    assert!(stderr.contains("--force"), "{stderr}");
    assert_eq!(
        asked_w(&kitchen.report()),
        900,
        "the refused one changed nothing"
    );
    let mut second = kitchen.in_the_background(&["bench", "power", "700", "--force"]);
    kitchen.until("the other heats", |r| asked_w(r) == 700);
    // The first ends by itself, and does not switch the second off.
    assert_eq!(first.code(), 1);
    assert_eq!(asked_w(&kitchen.report()), 700);
    // Off is anybody's.
    let (code, _, stderr) = kitchen.device(&["bench", "off"]);
    assert_eq!(code, 0, "{stderr}");
    kitchen.until("it is off", |r| asked_w(r) == 0);
    // Who had asked for it notices.
    assert_eq!(second.code(), 4);
}

/// Between two renewals of its lease a client does not know yet that another one has it.
#[test]
fn who_lost_the_lease_does_not_switch_off_what_another_heats() {
    let kitchen = Kitchen::start();
    let mut first = kitchen.in_the_background(&["bench", "power", "900"]);
    kitchen.until("it heats", |r| asked_w(r) == 900);
    let _second = kitchen.in_the_background(&["bench", "power", "700", "--force"]);
    kitchen.until("the other heats", |r| asked_w(r) == 700);
    first.signal("INT");
    assert_eq!(first.code(), 1);
    assert_eq!(asked_w(&kitchen.report()), 700);
    // Nor does who only thinks of heating.
    for wrong in [
        &["bench", "power", "1000", "--for", "0", "--force"][..],
        &["bench", "lookup", "push", "/nonexistent", "--force"],
    ] {
        assert_ne!(kitchen.device(wrong).0, 0);
        assert_eq!(asked_w(&kitchen.report()), 700, "{wrong:?}");
    }
}

#[test]
fn what_happens_is_watched() {
    let kitchen = Kitchen::start();
    let mut watch = kitchen.command_in_the_background(&["watch", "bench", "--lines", "--json"]);
    let mut words = kitchen.command_in_the_background(&["watch", "bench", "--lines"]);
    watch.line_with("\"event\":\"telemetry\"");
    let _power = kitchen.in_the_background(&["bench", "power", "800"]);
    let line = watch.line_with("\"event\":\"window-stored\"");
    let notice: serde_json::Value = serde_json::from_str(&line).unwrap();
    assert_eq!(notice["device"], "bench");
    words.line_with("commands it");
    words.line_with("stored");
}

#[test]
fn lookups_are_shown_and_a_reset_is_carried_out() {
    let kitchen = Kitchen::start();
    let (code, stdout, stderr) = kitchen.device(&["bench", "lookup", "show"]);
    assert_eq!(code, 0, "{stderr}");
    assert!(stdout.contains("built-in"), "{stdout}");
    let (code, stdout, stderr) = kitchen.device(&["bench", "lookup", "push", "builtin"]);
    assert_eq!(code, 0, "{stderr}");
    assert!(stdout.contains("built-in"), "{stdout}");
    let (code, _, stderr) = kitchen.device(&["bench", "lookup", "push", "previous"]);
    assert_eq!(code, 3, "{stderr}");
    assert!(stderr.contains("active before"), "{stderr}");
    let file = kitchen.dir.path().join("noise.bin");
    std::fs::write(&file, [7; 600]).unwrap();
    let (code, _, stderr) = kitchen.device(&["bench", "lookup", "push", file.to_str().unwrap()]);
    assert_eq!(code, 1, "{stderr}");
    assert!(stderr.contains("is no lookup"), "{stderr}");
}

/// A recording whose file cannot be made when its trigger comes.
#[test]
fn a_recording_that_fails_in_the_daemon_fails_the_command() {
    let kitchen = Kitchen::start();
    let recordings = kitchen.dir.path().join("store/recordings");
    std::os::unix::fs::symlink(kitchen.dir.path().join("nowhere"), recordings).unwrap();
    let config = kitchen.dir.path().join("ihd.toml");
    let trigger = "level:power>300";
    let recording = std::thread::spawn(move || {
        command(
            &config,
            &["record", "--device", "bench", "--trigger", trigger],
        )
    });
    kitchen.until("it waits", |report| report["recording_now"].is_object());
    let _power = kitchen.in_the_background(&["bench", "power", "800"]);
    let (code, stdout, stderr) = recording.join().unwrap();
    assert_eq!(code, 1, "{stdout}{stderr}");
    assert!(stderr.contains("the recording failed"), "{stderr}");
}

#[test]
fn a_recording_through_the_daemon_can_be_inspected() {
    let kitchen = Kitchen::start();
    let out = kitchen.dir.path().join("a.mcap");
    let (code, _, stderr) = kitchen.command(&[
        "record",
        "--device",
        "bench",
        "--duration",
        "2",
        "--out",
        out.to_str().unwrap(),
    ]);
    assert_eq!(code, 0, "{stderr}");
    assert!(std::fs::metadata(&out).unwrap().len() > 10_000);
    let (code, _, stderr) = kitchen.command(&[
        "record",
        "--device",
        "bench",
        "--out",
        out.to_str().unwrap(),
    ]);
    assert_eq!(code, 2, "{stderr}");
    let nowhere = kitchen.dir.path().join("nowhere/a.mcap");
    let nowhere = [
        "record",
        "--device",
        "bench",
        "--out",
        nowhere.to_str().unwrap(),
    ];
    let (code, _, stderr) = kitchen.command(&nowhere);
    assert_eq!(code, 2, "{stderr}");
    assert!(stderr.contains("its folder does not exist"), "{stderr}");
    let (code, _, stderr) = kitchen.command(&["record", "--device", "bench", "--power", "900"]);
    assert_eq!(code, 2, "{stderr}");
    assert!(stderr.contains("--power"), "{stderr}");
}
