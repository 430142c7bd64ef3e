//! Hostile devices all at once at a daemon that also has one that means well.

use std::fs;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use crate::daemon::{Daemon, Pulse, configure};
use crate::device::Port;
use crate::hostile;
use crate::kills::setting;
use crate::player::{Player, Tape};

/// Devices of one daemon.
const GROUP: usize = 9;

/// What a hostile device may cost, in bytes.
const RSS_PER_DEVICE: u64 = 64 << 20;

/// Longest answer of `/healthz`, in seconds, on a machine that does other things too: later is a hang. On a quiet
/// machine it is one second, which the long form asks for.
const HEALTHY_WITHIN_S: f64 = 5.0;

#[test]
#[ignore = "minutes: cargo xtask daemon runs it"]
fn hostile_devices_cost_neither_time_nor_memory_nor_the_others() {
    let seconds = setting("IHD_HOSTILE_S", 12.0);
    let healthy_within = Duration::from_secs_f64(setting("IHD_HEALTHY_S", HEALTHY_WITHIN_S));
    let tapes = Arc::new(vec![Tape::record(3, &[1_000], 2)]);
    let mut wrong = Vec::new();
    for (k, group) in hostile::ALL.chunks(GROUP).enumerate() {
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
        thread::sleep(Duration::from_secs(3));
        let alone = daemon.process.rss();
        assert!(daemon.stop(), "{}", daemon.log_tail());

        let address = configure(folder.path(), "", &devices).unwrap();
        let mut daemon = Daemon::start(folder.path(), address).unwrap();
        let pulse = Pulse::of(address, healthy_within);
        let began = Instant::now();
        while began.elapsed().as_secs_f64() < seconds {
            thread::sleep(Duration::from_millis(200));
            daemon.process.rss();
        }
        let (worst_ms, missed) = pulse.seen();
        let grown = daemon.process.peak_rss.saturating_sub(alone);
        let reports = daemon.devices();
        let stored = reports
            .iter()
            .flatten()
            .find(|r| r["name"] == "good")
            .map(|r| r["windows"]["stored"].clone());
        let named: Vec<_> = group.iter().map(|(name, _)| *name).collect();
        println!(
            "group {k} ({}): /healthz {worst_ms} ms at worst, {missed} late, {:+.1} MB, {stored:?} windows of the good one",
            named.join(", "),
            grown as f64 * 1e-6
        );
        for (report, name) in reports.iter().flatten().skip(1).zip(&named) {
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
        let text = serde_json::to_string(&reports.unwrap_or_default()).unwrap();
        let log = fs::read_to_string(folder.path().join("daemon.log")).unwrap();
        let raw = text
            .chars()
            .chain(log.chars())
            .find(|c| c.is_control() && *c != '\n');
        let stopped = daemon.stop();
        let mut check = |ok: bool, what: String| {
            if !ok {
                wrong.push(format!("group {k}: {what}"));
            }
        };
        check(
            missed == 0,
            format!("{missed} answers of /healthz were late, {worst_ms} ms at worst"),
        );
        check(
            grown <= RSS_PER_DEVICE * group.len() as u64,
            format!("{grown} bytes more"),
        );
        check(
            stored.is_some_and(|n| n.as_u64() > Some(0)),
            "no window of the good one".into(),
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
