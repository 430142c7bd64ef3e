//! Hostile devices all at once at a daemon that also has one that means well.

use std::fs;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::daemon::{Daemon, Pulse, configure};
use crate::device::Port;
use crate::hostile;
use crate::kills::setting;
use crate::player::{Player, Tape};

/// Devices of one daemon.
const GROUP: usize = 9;

/// Largest memory that a hostile device may cost, in bytes.
const RSS_PER_DEVICE: u64 = 64 << 20;

#[test]
fn hostile_devices_cost_neither_memory_nor_the_others() {
    // One of three, for a second each: every kind of them.
    let some: Vec<_> = hostile::ALL.iter().step_by(3).copied().collect();
    against(&some, 1.0);
}

#[test]
#[ignore = "full tier: minutes"]
fn all_hostile_devices_cost_neither_memory_nor_the_others() {
    against(hostile::ALL, setting("IHD_HOSTILE_S", 12.0));
}

/// Windows of the good device that are stored.
fn stored(reports: &[Value]) -> u64 {
    let good = reports.iter().find(|r| r["name"] == "good");
    good.map_or(0, |r| r["windows"]["stored"].as_u64().unwrap_or(0))
}

/// Each group for so many seconds, and until a window of the good device has come.
fn against(all: &[(&str, hostile::Serve)], seconds: f64) {
    let tapes = Arc::new(vec![Tape::record(3, &[1_000], 2)]);
    let mut wrong = Vec::new();
    for (k, group) in all.chunks(GROUP).enumerate() {
        let folder = tempfile::tempdir().unwrap();
        let good = Player::start(1, Arc::clone(&tapes), 1.0).unwrap();
        let ports: Vec<_> = group
            .iter()
            .map(|&(_, serve)| Port::open(serve).unwrap())
            .collect();
        let mut devices = vec![("good".to_owned(), good.address())];
        devices.extend(
            ports
                .iter()
                .enumerate()
                .map(|(n, port)| (format!("bad-{n}"), port.address())),
        );
        let address = configure(folder.path(), "", &devices[..1]).unwrap();
        // Its size with the good one alone.
        let mut daemon = Daemon::start(folder.path(), address).unwrap();
        daemon.until("a window of it alone", |r| stored(r) > 0);
        let alone = daemon.process.rss();
        assert!(daemon.stop(), "{}", daemon.log_tail());

        let address = configure(folder.path(), "", &devices).unwrap();
        let mut daemon = Daemon::start(folder.path(), address).unwrap();
        let pulse = Pulse::start(address);
        let until = Instant::now() + Duration::from_secs_f64(seconds);
        while Instant::now() < until {
            thread::sleep(Duration::from_millis(200));
            daemon.process.rss();
        }
        let reports = daemon.until("a window of the good one", |r| stored(r) > 0);
        let (worst_ms, missed) = pulse.seen();
        let grown = daemon.process.peak_rss.saturating_sub(alone);
        let named: Vec<_> = group.iter().map(|(name, _)| *name).collect();
        println!(
            "group {k} ({}): /healthz {worst_ms} ms at worst, {missed} missed, {:+.1} MB, {} windows of the good one",
            named.join(", "),
            grown as f64 * 1e-6,
            stored(&reports)
        );
        for (report, name) in reports.iter().skip(1).zip(&named) {
            let (state, windows) = (&report["state"], &report["windows"]);
            println!(
                "  {name}: {state} {} ({} connections, windows {} announced, {} stored, {} refused, {} unfit)",
                report["detail"],
                report["connections"],
                windows["announced"],
                windows["stored"],
                windows["refused"],
                windows["unfit"]
            );
        }
        let text = serde_json::to_string(&reports).unwrap();
        let log = fs::read_to_string(folder.path().join("daemon.log")).unwrap();
        let raw = text
            .chars()
            .chain(log.chars())
            .find(|c| c.is_control() && *c != '\n');
        drop(pulse);
        let stopped = daemon.stop();
        let mut check = |ok: bool, what: String| {
            if !ok {
                wrong.push(format!("group {k}: {what}"));
            }
        };
        check(
            missed == 0,
            format!("{missed} answers of /healthz did not come"),
        );
        check(
            grown <= RSS_PER_DEVICE * group.len() as u64,
            format!("{grown} bytes more"),
        );
        check(raw.is_none(), format!("{raw:?} reached the log or the API"));
        check(
            stopped,
            format!("it does not end in order: {}", daemon.log_tail()),
        );
        check(!log.contains("panicked"), "something panicked".into());
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
