//! How the daemon starts and ends: signals, systemd, kills.

use std::os::unix::net::UnixDatagram;
use std::time::{Duration, Instant};

use super::processes::{Kitchen, Process, asked_w_directly, daemon, free_port, ihd, live_directly};

#[test]
fn a_signal_ends_it_in_order_with_the_hob_off() {
    for signal in ["TERM", "INT", "HUP"] {
        let mut kitchen = Kitchen::start();
        let mut power = kitchen.in_the_background(&["bench", "power", "900"]);
        kitchen.until("it heats", |r| r["asked_by_daemon_w"] == 900);
        let began = Instant::now();
        kitchen.daemon.signal(signal);
        assert_eq!(
            kitchen.daemon.code_within(Duration::from_secs(10)),
            0,
            "{signal}"
        );
        kitchen.daemon.line_with("stopped");
        assert_eq!(asked_w_directly(&kitchen.hob_address), 0, "{signal}");
        assert!(began.elapsed() < Duration::from_secs(6), "{signal}");
        assert_ne!(power.code_within(Duration::from_secs(20)), 0);
    }
}

#[test]
fn a_killed_daemon_leaves_no_hob_heating_and_its_store_whole() {
    let mut kitchen = Kitchen::start();
    let _power = kitchen.in_the_background(&["bench", "power", "900"]);
    kitchen.until("windows are stored", |r| {
        r["windows"]["stored"].as_u64() > Some(2)
    });
    kitchen.daemon.signal("KILL");
    kitchen.daemon.code_within(Duration::from_secs(5));
    off_within_1000_half_cycles(&kitchen.hob_address);
    // The same port and the same store, at once.
    kitchen.daemon = daemon(&kitchen.dir.path().join("ihd.toml"));
    let report = kitchen.until("it is back", |r| r["state"] == "idle");
    assert_eq!(report["live"]["asked_w"], 0);
    assert!(
        !kitchen.daemon.said.contains("damaged"),
        "{}",
        kitchen.daemon.said
    );
}

/// The device's 10 s are its own, which a simulated one on a busy machine is slow to live through. Each look is a host that is heard,
/// so that it is left alone for longer each time.
fn off_within_1000_half_cycles(address: &str) {
    let mut before = 0;
    for wait_s in [0, 11, 22, 44, 88] {
        std::thread::sleep(Duration::from_secs(wait_s));
        let live = live_directly(address);
        if live["asked_w"] == 0 {
            return;
        }
        let now = live["half_cycle"].as_u64().unwrap();
        assert!(
            before == 0 || now - before < 1_100,
            "it still heats: {live:#}"
        );
        before = now;
    }
    panic!("this machine is too slow for a simulated hob");
}

#[test]
fn a_second_signal_ends_it_at_once() {
    let mut kitchen = Kitchen::start();
    // A hob that does not answer any more makes the end long.
    kitchen.hob.signal("STOP");
    kitchen.daemon.signal("INT");
    std::thread::sleep(Duration::from_millis(200));
    kitchen.daemon.signal("INT");
    let code = kitchen.daemon.code_within(Duration::from_secs(4));
    assert!([0, 130].contains(&code), "{code}");
    kitchen.hob.signal("CONT");
}

#[test]
fn systemd_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("notify");
    let socket = UnixDatagram::bind(&path).unwrap();
    socket
        .set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    let config = dir.path().join("ihd.toml");
    let text = format!(
        "store = {:?}\nlisten = \"127.0.0.1:{}\"\ndiscover_usb = false\n",
        dir.path().join("store"),
        free_port()
    );
    std::fs::write(&config, text).unwrap();
    let mut command = ihd();
    command
        .args(["trainer", "serve", "--log-format", "json", "--config"])
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
    assert_eq!(daemon.code_within(Duration::from_secs(5)), 0);
}
