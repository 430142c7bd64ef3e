//! No room for windows: said everywhere while it lasts, and over when there is room again.

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::daemon::{Daemon, configure, store};
use crate::http;
use crate::player::{Player, Tape};
use crate::process::{PATIENCE, ihd, ihd_with_limits};

/// Asks for the daemon's health until it is as wanted.
fn until_health(daemon: &Daemon, what: &str, wanted: impl Fn(u16, &Value) -> bool) -> Value {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let (status, text) = http::ask(daemon.address, "GET", "/healthz", "", PATIENCE).unwrap();
        let health: Value = serde_json::from_str(&text).unwrap();
        if wanted(status, &health) {
            return health;
        }
        assert!(Instant::now() < deadline, "never: {what}; {status} {text}");
        thread::sleep(Duration::from_millis(100));
    }
}

/// The check `store` of `ihd doctor`.
fn doctors_word(folder: &Path) -> Value {
    let arguments = [
        "doctor",
        "tcp:127.0.0.1:1",
        "--config",
        "ihd.toml",
        "--json",
    ];
    let output = ihd(folder).args(arguments).output().unwrap();
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let checks = report["groups"][0]["checks"].as_array().unwrap();
    let store = checks.iter().find(|check| check["name"] == "store");
    store.unwrap().clone()
}

#[test]
fn a_full_disk_is_said_with_what_it_costs_until_there_is_room_again() {
    let folder = tempfile::tempdir().unwrap();
    let tapes = Arc::new(vec![Tape::record(3, &[700], 2)]);
    let hob = Player::start(1, tapes, 1.0).unwrap();
    let devices = [("hob".to_owned(), hob.address())];
    let address = configure(folder.path(), "", &devices).unwrap();
    let mut daemon =
        Daemon::start_as(ihd_with_limits(folder.path()), folder.path(), address).unwrap();
    let number = |all: &[Value], fate: &str| all[0]["windows"][fate].as_u64().unwrap_or(0);
    daemon.until("windows are stored", |all| number(all, "stored") > 3);
    // Events and results are smaller than windows, and fit for a while.
    daemon.process.limit_files(Some(400_000));
    let full = until_health(&daemon, "full", |status, health| {
        status == 503 && health["store_failure"]["dropped"]["windows"].as_u64() > Some(2)
    });
    assert_eq!(
        (&full["store"], &full["store_failure"]["cause"]),
        (&false.into(), &"disk-full".into())
    );
    let dropped = full["store_failure"]["dropped"]["windows"]
        .as_u64()
        .unwrap();
    let check = doctors_word(folder.path());
    assert_eq!(check["verdict"], "fail", "{check}");
    let finding = check["finding"].as_str().unwrap();
    assert!(
        finding.contains("disk is full") && finding.contains("window"),
        "{finding}"
    );
    let number_of = |name: &str| {
        let told = check["evidence"].as_array().unwrap();
        let found = told.iter().find(|e| e["name"] == name);
        found.unwrap()["value"].as_f64().unwrap()
    };
    assert_eq!(
        Some(number_of("since_ms")),
        full["store_failure"]["since_ms"].as_f64()
    );
    assert!(number_of("lost_windows") >= dropped as f64, "{check}");
    assert_eq!(check["remedy"], full["store_failure"]["advice"]);
    for arguments in [&["device", "status"][..], &["device", "hob", "status"][..]] {
        let output = ihd(folder.path()).args(arguments).output().unwrap();
        let told = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(told.contains("disk is full"), "{arguments:?}: {told}");
    }
    let all = daemon.until("the device's account", |all| {
        number(all, "not_stored") >= dropped
    });
    let metrics = daemon.metrics();
    assert!(
        metrics.lines().any(|line| line == "ihd_store_well 0"),
        "{metrics}"
    );
    let stored = number(&all, "stored");
    daemon.process.limit_files(None);
    until_health(&daemon, "well again", |status, _| status == 200);
    daemon.until("windows are stored again", |all| {
        number(all, "stored") > stored + 3
    });
    let metrics = daemon.metrics();
    let counted = metrics
        .lines()
        .find_map(|line| line.strip_prefix("ihd_store_dropped_total{record=\"windows\"} "));
    assert!(
        counted.unwrap().parse::<u64>().unwrap() >= dropped,
        "{metrics}"
    );
    assert!(daemon.stop(), "{}", daemon.log_tail());
    let log = fs::read_to_string(folder.path().join("daemon.log")).unwrap();
    assert!(
        log.contains("disk is full") && log.contains("works again"),
        "{log}"
    );
    let report = store(folder.path(), &["check"]).unwrap();
    assert_eq!(report["integrity"], "ok", "{report}");
    assert!(
        report["space"][0]["with_samples"].as_u64() > Some(6),
        "{report}"
    );
}
