//! Deterministic simulation of the daemon: one seed gives devices, links, disk, clocks and users with all their faults, in simulated time.
//!
//! ```text
//!  users ──► Daemon ──► link ──► hob        scripts, or the firmware on the simulated board; one runtime, one thread, a paused clock
//!              │         faults.rs: cut, lost, doubled, late; reboots, trips; disk slow or full; clock put on and back; kills
//!              ├──► store (SQLite, in memory-backed files)
//!              └──► part in a fleet, where somebody brings one (ihd-fleet)
//!  promises.rs checks at every frame that a hob receives, at every answer, and every 100 ms
//! ```
//!
//! The daemon is the product's own; only what blocks runs otherwise ([`crate::machine`]). `IHD_SEED=4711 cargo nextest run -p ihd-daemon
//! simulation` runs one seed again and prints its course; `IHD_SEEDS=100000` runs so many, `IHD_BOARD_SEEDS=100` so many with a board.

mod board;
mod disk;
mod faults;
mod hob;
mod life;
mod link;
mod mended;
mod promises;
mod samples;
mod script;
mod users;
mod world;

use std::ops::Range;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

pub use disk::Disk;
pub use life::{Course, Life, Part, run};
pub use samples::LOAD;
pub use world::{HOBS, Left, World};

/// A number of the environment.
///
/// # Panics
/// It is none.
pub fn of_environment(name: &str) -> Option<u64> {
    let value = std::env::var(name).ok()?;
    Some(value.parse().expect("a number"))
}

/// Runs seed after seed, or that of `IHD_SEED`, on as many threads as there are cores.
///
/// # Panics
/// A promise was broken.
pub fn run_all(seeds: Range<u64>, run_one: impl Fn(u64) -> Course + Sync) {
    let one = of_environment("IHD_SEED");
    let seeds = one.map_or(seeds, |seed| seed..seed + 1);
    let next = AtomicU64::new(seeds.start);
    let broken = Mutex::new(Vec::new());
    let (courses, lasted_ms) = (AtomicU64::new(0), AtomicU64::new(0));
    let run = || {
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if !seeds.contains(&seed) || broken.lock().unwrap().len() >= 5 {
                return;
            }
            let course = run_one(seed);
            if one.is_some() {
                println!("{}", course.text());
            }
            courses.fetch_add(1, Ordering::Relaxed);
            lasted_ms.fetch_add(course.lasted.as_millis() as u64, Ordering::Relaxed);
            if let Some(why) = course.broken() {
                broken.lock().unwrap().push(format!("seed {seed}: {why}"));
            }
        }
    };
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|threads| {
        for _ in 0..cores {
            threads.spawn(run);
        }
    });
    let (courses, lasted_s) = (courses.into_inner(), 1e-3 * lasted_ms.into_inner() as f64);
    println!("{courses} seeds, {:.1} h simulated", lasted_s / 3_600.0);
    let broken = broken.into_inner().unwrap();
    assert!(
        broken.is_empty(),
        "{}\nIHD_SEED=… cargo nextest run -p PACKAGE simulation --no-capture shows a course",
        broken.join("\n")
    );
}

/// Seeds of the short form.
#[cfg(test)]
const SEEDS: u64 = 100;

/// Seeds of the short form with the firmware as one of the hobs: ten seconds of a core.
#[cfg(test)]
const BOARD_SEEDS: Range<u64> = 1..8;

#[test]
fn promises_hold_whatever_fails() {
    let seeds = of_environment("IHD_SEEDS").unwrap_or(SEEDS);
    run_all(0..seeds, |seed| run(seed, Left::Script, None));
}

#[test]
fn promises_hold_with_the_firmware_as_a_hob() {
    let more = of_environment("IHD_BOARD_SEEDS");
    let seeds = more.map_or(BOARD_SEEDS, |seeds| 0..seeds);
    run_all(seeds, |seed| run(seed, Left::Board, None));
}

/// Of every kind of hob. Its power is compared every 2 s.
#[test]
fn a_strangers_hello_ends_the_lease_and_the_daemon_says_why() {
    for left in [Left::Script, Left::Board] {
        let (told, why) = life::greeted(left);
        assert!(
            told < std::time::Duration::from_millis(2_500),
            "{left:?}: {told:?}"
        );
        assert!(why.contains("another host"), "{left:?}: {why}");
    }
}

#[test]
fn one_seed_gives_one_course() {
    let scripts = [1, 2, 3].map(|seed| (seed, Left::Script));
    for (seed, left) in scripts.into_iter().chain([(6, Left::Board)]) {
        let [first, second] = [(), ()].map(|()| run(seed, left, None).text());
        assert!(first.lines().count() > 20, "something happens");
        let mut lines = first.lines().zip(second.lines());
        let differ = lines.find(|(first, second)| first != second);
        assert_eq!(differ, None, "seed {seed}");
        assert_eq!(first, second);
    }
}

#[test]
fn idle_hobs_stay_connected() {
    assert_eq!(life::idle(std::time::Duration::from_secs(600)), [1, 1]);
}

#[test]
fn idle_hobs_stay_connected_for_a_day_at_length() {
    let day = std::time::Duration::from_secs(24 * 3_600);
    assert_eq!(life::idle(day), [1, 1]);
}
