//! Deterministic simulation of the daemon: one seed defines devices, links, disk, clocks and users with all their faults, in simulated time.
//!
//! ```text
//!  users ──► Daemon ──► link ──► hob        scripts, or the firmware on the simulated board; one runtime, one thread, a paused clock
//!              │         faults.rs: cut, lost, doubled, late; reboots, trips; disk slow or full; clock put on and back; kills
//!              ├──► store (SQLite, in memory-backed files)
//!              └──► part in a fleet, if given (ihd-fleet)
//!  checks.rs checks at every frame that a hob receives, at every response, and every 100 ms
//! ```
//!
//! The daemon is that of the product; only blocking calls are replaced ([`crate::machine`]). `IHD_SEED=4711 cargo nextest run -p ihd-daemon
//! simulation` repeats one seed and prints its course; `IHD_SEEDS` and `IHD_BOARD_SEEDS` set the number of seeds without and with a board.

mod board;
#[cfg(test)]
mod calm;
mod checks;
pub(crate) mod disk;
mod faults;
mod hob;
mod life;
mod link;
mod promises;
mod recovery;
#[cfg(test)]
mod refused_power;
mod samples;
mod script;
#[cfg(test)]
mod slow_store;
#[cfg(test)]
mod stale_lookup;
#[cfg(test)]
mod unanswered;
mod users;
mod world;

use std::ops::Range;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

pub use disk::{DiskState, SimulatedDisk};
pub use hob::HOBS;
pub use life::{Course, DaemonPart, Life, run, spawn_learner, start};
pub use samples::LOAD;
pub use world::{HobKind, World};

/// Returns the number in an environment variable; `None` if it is not set.
///
/// # Panics
/// Panics if the value is not a number.
pub fn env_number(name: &str) -> Option<u64> {
    let value = std::env::var(name).ok()?;
    Some(value.parse().expect("a number"))
}

/// Runs a range of seeds, or the one in `IHD_SEED`, on as many threads as there are cores.
///
/// # Panics
/// Panics if a promise was broken.
pub fn run_all(seeds: Range<u64>, run_one: impl Fn(u64) -> Course + Sync) {
    let one = env_number("IHD_SEED");
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

/// Number of seeds of a normal test run.
#[cfg(test)]
const SEEDS: u64 = 12;

/// Seeds of a normal test run with the firmware as one of the hobs: five seconds of a core.
#[cfg(test)]
const BOARD_SEEDS: Range<u64> = 1..4;

#[test]
fn promises_hold_whatever_fails() {
    let seeds = env_number("IHD_SEEDS").unwrap_or(SEEDS);
    run_all(0..seeds, |seed| run(seed, HobKind::Script, None));
}

#[test]
fn promises_hold_with_the_firmware_as_a_hob() {
    let more = env_number("IHD_BOARD_SEEDS");
    let seeds = more.map_or(BOARD_SEEDS, |seeds| 0..seeds);
    run_all(seeds, |seed| run(seed, HobKind::Board, None));
}

/// Tested with each kind of hob. The daemon compares its power every 2 s.
#[test]
fn a_strangers_hello_ends_the_lease_and_the_daemon_says_why() {
    for left in [HobKind::Script, HobKind::Board] {
        let (delay, why) = life::foreign_hello(left);
        assert!(
            delay < std::time::Duration::from_millis(2_500),
            "{left:?}: {delay:?}"
        );
        assert!(why.contains("another host"), "{left:?}: {why}");
    }
}

#[test]
fn one_seed_gives_one_course() {
    for (seed, left) in [(1, HobKind::Script), (6, HobKind::Board)] {
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
