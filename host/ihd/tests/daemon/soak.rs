//! Long runs in little time: pots put, lifted and exchanged, dips, faults, boots, cut cables and a disk that fills.

use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::chance::Chance;
use crate::daemon::{Daemon, configure, store};
use crate::kills::{bad_cable, setting};
use crate::player::{Act, Player, Tape};
use crate::proxy::{Faults, Proxy};

/// A file system of its own that can be filled; none where this may not be had.
pub struct Disk<'a>(&'a Path);

impl<'a> Disk<'a> {
    pub fn mount(at: &'a Path, megabytes: u32) -> Option<Self> {
        fs::create_dir_all(at).ok()?;
        let mut mount = Command::new("mount");
        mount
            .args(["-t", "tmpfs", "-o", &format!("size={megabytes}m"), "tmpfs"])
            .arg(at);
        mount
            .status()
            .is_ok_and(|s| s.success())
            .then_some(Self(at))
    }

    /// Fills it to the last byte, or frees that again.
    pub fn fill(&self, full: bool) {
        let ballast = self.0.join("ballast");
        if !full {
            let _ = fs::remove_file(ballast);
            return;
        }
        let block = vec![0x55; 1 << 20];
        let Ok(mut file) = fs::File::create(&ballast) else {
            return;
        };
        // Smaller and smaller pieces, so that not a block is left.
        for size in [1 << 20, 4_096, 1] {
            while file.write_all(&block[..size]).is_ok() {}
        }
    }
}

impl Drop for Disk<'_> {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(self.0).status();
    }
}

/// Action of a person on a device that heats, and its simulated time until the next one.
fn something(player: &Player, chance: &mut Chance) -> (Act, f64) {
    let (act, lasts_s) = match chance.next() % 8 {
        0 | 1 => (Act::Lift, 5.0),
        2 => (Act::Off, 30.0),
        3 => (Act::Fault, 4.0),
        4 => (Act::Dip, 2.0),
        5 => (Act::Boot, 1.0),
        _ => {
            // Another pot, or the same hotter.
            player.truth().put(chance.next() as usize % 4);
            (Act::Heat, 60.0)
        }
    };
    player.truth().act(act);
    (act, lasts_s)
}

fn count(report: &Value, fate: &str) -> u64 {
    report["windows"][fate].as_u64().unwrap_or(0)
}

#[test]
fn every_window_is_accounted_for() {
    soak(4.0, 10.0, false);
}

#[test]
#[ignore = "full tier: minutes"]
fn for_long_nothing_grows_and_every_window_is_accounted_for() {
    let (seconds, speed) = (setting("IHD_SOAK_S", 60.0), setting("IHD_SOAK_SPEED", 10.0));
    soak(seconds, speed, true);
}

/// Windows that were announced, and those of which it is known what became of them.
fn accounts(report: &Value) -> (u64, u64) {
    let fates = [
        "stored",
        "refused",
        "dropped_by_device",
        "lost",
        "not_stored",
    ];
    let accounted = fates.iter().map(|fate| count(report, fate)).sum();
    (count(report, "announced"), accounted)
}

/// Windows that the daemon may not know of: the last ones before a boot or a cut.
fn unseen_at_most(report: &Value, player: &Player) -> u64 {
    10 * report["connections"].as_u64().unwrap_or(0) + player.truth().windows_due / 20
}

/// For so many seconds of devices so many times faster; `is_long` where memory has had time to settle.
fn soak(seconds: f64, speed: f64, is_long: bool) {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path().join("store");
    let disk = Disk::mount(&at, 512);
    let tapes: Vec<_> = [(3, 1_000), (4, 1_500), (5, 700), (6, 1_800)]
        .map(|(seed, power_w)| Tape::record(seed, &[power_w], 2))
        .into();
    let tapes = Arc::new(tapes);
    let players: Vec<_> = (0..3)
        .map(|k| Player::start(k + 1, Arc::clone(&tapes), speed).unwrap())
        .collect();
    let cables: Vec<_> = players
        .iter()
        .zip(1..)
        .map(|(player, seed)| {
            // Cut every few minutes of simulated time, but not all the time on the wall's.
            let faults = Faults {
                cut_every_s: (300.0 / speed).max(10.0),
                ..bad_cable(seed)
            };
            Proxy::start(player.address(), faults).unwrap()
        })
        .collect();
    let named: Vec<_> = cables
        .iter()
        .enumerate()
        .map(|(k, c)| (format!("hob-{k}"), c.address()))
        .collect();
    let keep =
        "[keep]\nwindows = \"one-in-10\"\nmax_bytes = 200_000_000\n[learning]\nthreads = 1\n";
    let address = configure(folder.path(), keep, &named).unwrap();
    let mut daemon = Daemon::start(folder.path(), address).unwrap();

    let (mut chance, began, mut rss) = (Chance::new(11), Instant::now(), Vec::new());
    let mut next = vec![began + Duration::from_secs_f64(20.0 / speed); players.len()];
    let (mut heats, mut filled) = (vec![true; players.len()], false);
    let passed = || began.elapsed().as_secs_f64() / seconds;
    while passed() < 1.0 {
        for k in 0..players.len() {
            if Instant::now() < next[k] {
                continue;
            }
            let rest_s = if heats[k] {
                let (act, lasts_s) = something(&players[k], &mut chance);
                heats[k] = act == Act::Heat || act == Act::Boot;
                lasts_s
            } else {
                players[k].truth().act(Act::Heat);
                heats[k] = true;
                chance.between(20.0, 120.0)
            };
            next[k] = Instant::now() + Duration::from_secs_f64(rest_s / speed);
        }
        let full = (0.40..0.48).contains(&passed());
        if let Some(disk) = &disk
            && full != filled
        {
            disk.fill(full);
            filled = full;
            println!(
                "{:.0} s: disk {}",
                began.elapsed().as_secs_f64(),
                if full { "full" } else { "free again" }
            );
        }
        rss.push(daemon.process.rss());
        assert!(daemon.process.ended().is_none(), "{}", daemon.log_tail());
        thread::sleep(Duration::from_millis(500));
    }
    // What is on its way arrives.
    players.iter().for_each(|p| p.truth().act(Act::Off));
    let balances = |(r, player): (&Value, &Player)| {
        let (announced, accounted) = accounts(r);
        let unseen = player.truth().windows_due.saturating_sub(announced);
        announced == accounted && count(r, "stored") > 0 && unseen <= unseen_at_most(r, player)
    };
    let reports = daemon.until("every window is accounted for", |all| {
        all.iter().zip(&players).all(balances)
    });
    let most = |part: std::ops::Range<f64>| {
        let index = |share: f64| (share * rss.len() as f64) as usize;
        rss[index(part.start)..index(part.end)]
            .iter()
            .copied()
            .max()
            .unwrap_or(0)
    };
    let (middle, end) = (most(0.5..0.75), most(0.75..1.0));
    println!(
        "{:.2} h simulated of each of {} devices in {seconds:.0} s; RSS {:.1} MB, then {:.1} MB",
        seconds * speed / 3_600.0,
        players.len(),
        middle as f64 * 1e-6,
        end as f64 * 1e-6
    );
    let (mut wrong, mut never_announced) = (Vec::new(), 0);
    for ((report, player), cable) in reports.iter().zip(&players).zip(&cables) {
        let name = report["name"].as_str().unwrap_or_default();
        println!(
            "{name}: {}, {} connections",
            report["windows"], report["connections"]
        );
        println!("{name}: {}", cable.counted());
        let announced = count(report, "announced");
        let (due, dropped) = {
            let truth = player.truth();
            (truth.windows_due, truth.windows_dropped_ever)
        };
        let unseen = due.saturating_sub(announced);
        never_announced += unseen;
        println!(
            "{name}: {due} due on the device, {unseen} never announced, {dropped} dropped by it"
        );
        let connections = report["connections"].as_u64().unwrap_or(0);
        if announced > due {
            wrong.push(format!(
                "{name}: {announced} announced of {due} in {connections} connections"
            ));
        }
        if player.truth().asked_by_host > 0 {
            wrong.push(format!("{name}: the daemon asked for power"));
        }
    }
    if is_long && end as f64 > 1.1 * middle as f64 {
        wrong.push(format!("memory grows: {middle}, then {end} bytes"));
    }
    if disk.is_none() {
        println!("the disk was not filled: no file system of its own may be mounted here");
    }
    if !daemon.stop() {
        wrong.push(format!("it does not end in order: {}", daemon.log_tail()));
    }
    let stored: u64 = reports.iter().map(|r| count(r, "stored")).sum();
    match store(folder.path(), &["check"]) {
        Ok(check) => {
            println!(
                "store: {}, {} windows, {} results",
                check["integrity"], check["windows"], check["results"]
            );
            // One that the link still held at the last report may have come before the daemon stopped.
            let whole = stored..=stored + never_announced;
            let windows = check["windows"].as_u64();
            if check["integrity"] != "ok" || !windows.is_some_and(|n| whole.contains(&n)) {
                wrong.push(format!(
                    "the store has not the {whole:?} windows that were counted: {check}"
                ));
            }
        }
        Err(e) => wrong.push(e.to_string()),
    }
    drop(disk);
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
