//! Many devices at once: what a machine keeps up with.

use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::daemon::{Daemon, Pulse, configure};
use crate::kills::setting;
use crate::player::{Player, Tape};

fn sum(reports: &[Value], fate: &str) -> u64 {
    reports
        .iter()
        .filter_map(|r| r["windows"][fate].as_u64())
        .sum()
}

#[test]
fn eight_devices_are_stored_and_learned_from() {
    many(8, 0.0);
}

#[test]
#[ignore = "full tier: a minute"]
fn thirty_two_devices_are_stored_and_learned_from_as_far_as_the_machine_goes() {
    many(
        setting("IHD_MANY", 32.0) as usize,
        setting("IHD_MANY_S", 30.0),
    );
}

/// So many devices for at least so many seconds, and until a window of each is stored and half of them were learned from.
fn many(count: usize, seconds: f64) {
    let folder = tempfile::tempdir().unwrap();
    let tapes = Arc::new(vec![Tape::record(3, &[700, 1_200, 1_800], 2)]);
    let players: Vec<_> = (0..count)
        .map(|k| Player::start(k as u32 + 1, Arc::clone(&tapes), 1.0).unwrap())
        .collect();
    let devices: Vec<_> = players
        .iter()
        .enumerate()
        .map(|(k, p)| (format!("hob-{k}"), p.address()))
        .collect();
    let address = configure(folder.path(), "", &devices).unwrap();
    let mut daemon = Daemon::start(folder.path(), address).unwrap();
    let pulse = Pulse::start(address);
    let number = |r: &Value, fate: &str| r["windows"][fate].as_u64().unwrap_or(0);
    daemon.until("each has a window", |all| {
        all.iter().all(|r| number(r, "stored") > 0)
    });
    let (began, cpu) = (Instant::now(), daemon.process.processor_s());
    let before = daemon.devices().unwrap();
    thread::sleep(Duration::from_secs_f64(seconds));
    // What was not learned from is stored all the same, and no device is left out.
    let after = daemon.until("one starves the others", |all| {
        all.iter().filter(|r| number(r, "learned") > 0).count() * 2 > count
    });
    let passed = began.elapsed().as_secs_f64();
    let rate = |fate: &str| (sum(&after, fate) - sum(&before, fate)) as f64 / passed;
    println!("{count} devices for {passed:.0} s, windows a second:");
    for fate in [
        "announced",
        "stored",
        "learned",
        "unfit",
        "unlearned",
        "not_stored",
        "lost",
        "refused",
        "dropped_by_device",
    ] {
        println!("  {fate:<18} {:.1}", rate(fate));
    }
    let metrics = daemon.metrics();
    for line in metrics
        .lines()
        .filter(|l| !l.starts_with('#') && !l.contains('{'))
    {
        println!("  {line}");
    }
    let cores = (daemon.process.processor_s() - cpu) / passed;
    let (worst_ms, missed) = pulse.seen();
    println!(
        "  {cores:.2} cores, {:.0} MB, /healthz {worst_ms} ms at worst, {missed} missed",
        daemon.process.rss() as f64 * 1e-6
    );
    assert!(
        daemon.process.peak_rss < 1_000_000_000,
        "{} bytes",
        daemon.process.peak_rss
    );
    assert_eq!(missed, 0, "answers of /healthz did not come");
    drop(pulse);
    assert!(daemon.stop(), "{}", daemon.log_tail());
}
