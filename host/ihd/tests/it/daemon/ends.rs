//! Starts and ends of the daemon: signals, systemd, kills.

use std::os::unix::net::UnixDatagram;

use ihd_fakes::free_address;

use super::processes::{Kitchen, daemon_command, ihd};
use crate::process::{PATIENCE, Process, closed_pipe, wait_for};

#[test]
fn a_signal_ends_it_in_order_with_the_hob_off() {
    let mut kitchen = Kitchen::start();
    for signal in ["TERM", "INT", "HUP"] {
        kitchen.until("the hob is there", |r| r["state"] == "idle");
        let _power = kitchen.in_the_background(&["bench", "power", "900"]);
        kitchen.until("it heats", |r| r["asked_by_daemon_w"] == 900);
        kitchen.daemon.signal(signal);
        assert_eq!(kitchen.daemon.code(), 0, "{signal}");
        kitchen.daemon.line_with("stopped");
        assert_eq!(kitchen.hob.left_with_w(), 0, "{signal}");
        kitchen.start_daemon_again();
    }
}

/// `ihd trainer --daemon 2>&1 | tee log`, where ^C ends `tee` first.
#[test]
fn a_daemon_whose_log_has_no_reader_ends_in_order_too() {
    let mut kitchen = Kitchen::start();
    kitchen.daemon.signal("TERM");
    assert_eq!((kitchen.daemon.code(), kitchen.hob.left_with_w()), (0, 0));
    let mut command = daemon_command(&kitchen.dir.path().join("ihd.toml"));
    kitchen.daemon = Process::start(command.stderr(closed_pipe()), false);
    let answers = || (kitchen.device(&["bench", "status"]).0 == 0).then_some(());
    wait_for(answers, || "it does not listen".into());
    kitchen.until("the hob is there", |r| r["state"] == "idle");
    let _power = kitchen.in_the_background(&["bench", "power", "900"]);
    kitchen.until("it heats", |r| r["asked_by_daemon_w"] == 900);
    kitchen.daemon.signal("INT");
    assert_eq!((kitchen.daemon.code(), kitchen.hob.left_with_w()), (0, 0));
}

/// The hob does not heat for it: `a_host_that_falls_silent_no_longer_heats` (tests/it/link_device.rs).
#[test]
fn a_killed_daemon_leaves_its_store_whole_and_its_port_free() {
    let mut kitchen = Kitchen::start();
    let _power = kitchen.in_the_background(&["bench", "power", "900"]);
    kitchen.until("windows are stored", |r| {
        r["windows"]["stored"].as_u64() > Some(2)
    });
    kitchen.daemon.signal("KILL");
    assert_eq!(kitchen.daemon.code(), -1);
    kitchen.start_daemon_again();
    let report = kitchen.until("it is back", |r| r["state"] == "idle");
    // What the one before had asked for is switched off.
    assert_eq!(report["live"]["asked_w"], 0);
    assert!(
        !kitchen.daemon.said.contains("damaged"),
        "{}",
        kitchen.daemon.said
    );
}

#[test]
fn a_second_signal_ends_it_at_once() {
    let mut kitchen = Kitchen::start();
    // A hob that does not answer any more makes the end long.
    kitchen.hob.process.signal("STOP");
    kitchen.daemon.signal("INT");
    kitchen.daemon.line_with("stopping");
    kitchen.daemon.signal("INT");
    kitchen.daemon.line_with("once more: ending at once");
    assert_eq!(kitchen.daemon.code(), 130);
    kitchen.hob.process.signal("CONT");
}

#[test]
fn systemd_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("notify");
    let socket = UnixDatagram::bind(&path).unwrap();
    socket.set_read_timeout(Some(PATIENCE)).unwrap();
    let config = dir.path().join("ihd.toml");
    let text = format!(
        "store = {:?}\nlisten = \"{}\"\ndiscover_usb = false\n",
        dir.path().join("store"),
        free_address()
    );
    std::fs::write(&config, text).unwrap();
    let mut command = ihd();
    command
        .args(["trainer", "--daemon", "--log-format", "json", "--config"])
        .arg(&config)
        .env("NOTIFY_SOCKET", &path)
        .env("WATCHDOG_USEC", "600000");
    let mut daemon = Process::start(&mut command, true);
    let line = daemon.line_with("the daemon listens");
    let log: serde_json::Value = serde_json::from_str(&line).unwrap();
    assert!(
        log["timestamp"].is_string() && log["url"].is_string(),
        "{line}"
    );
    let told = |word: &str| {
        let mut buffer = [0; 256];
        loop {
            let n = socket
                .recv(&mut buffer)
                .unwrap_or_else(|e| panic!("{word}: {e}"));
            if String::from_utf8_lossy(&buffer[..n]).contains(word) {
                return;
            }
        }
    };
    told("READY=1");
    for _ in 0..3 {
        told("WATCHDOG=1");
    }
    daemon.signal("TERM");
    told("STOPPING=1");
    assert_eq!(daemon.code(), 0);
}
