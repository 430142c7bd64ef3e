//! Checks at the end of a course: after all faults have ended everything works, and acknowledged records are in the store.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use ihd_model::{Command, DeviceState};
use ihd_store::{ResultFilter, ResultRow, StoreReader, WindowFilter, WindowRow};
use tokio::time::{Instant, sleep};

use super::faults::send_foreign_hello;
use super::hob::HOBS;
use super::users::User;
use super::world::World;
use crate::daemon::Daemon;

/// Longest time from the end of all faults until everything works again: the longest wait between two attempts to connect, the
/// time of a hello and of a silent device, and the retry period of the store.
pub const RECOVERY_TIME: Duration = Duration::from_secs(40);

/// Longest time until all windows have come back from the fleet: messages held by a dead worker or edge are delivered again after 30 s, and
/// those that were late when the faults ended may be so for another 30 s.
const SETTLING_TIME: Duration = Duration::from_secs(120);

/// Period of checking if everything works again.
const POLL_PERIOD: Duration = Duration::from_millis(500);

fn is_working(daemon: &Daemon, name: &str) -> bool {
    use DeviceState::{Incompatible, Searching, Suspended};
    let state = daemon.view().device(name).map(|report| report.state);
    !matches!(state, None | Some(Searching | Suspended | Incompatible))
}

/// Waits until all hobs work, at most [`RECOVERY_TIME`].
pub async fn wait_until_working(daemon: &Daemon) {
    let began = Instant::now();
    while !HOBS.iter().all(|name| is_working(daemon, name)) && began.elapsed() < RECOVERY_TIME {
        sleep(POLL_PERIOD).await;
    }
    // Time for jobs that waited for the store.
    sleep(POLL_PERIOD).await;
}

/// Checks that everything works after the end of all faults.
pub async fn check_recovery(world: &Arc<World>, daemon: &Daemon) {
    for (hob, name) in HOBS.into_iter().enumerate() {
        if !is_working(daemon, name) {
            let state = daemon.view().device(name).map(|report| report.state);
            world.note_broken(format!("{name} is {state:?} though nothing fails any more"));
        }
        let eve = User {
            world: Arc::clone(world),
            daemon: daemon.clone(),
            hob,
            name: "eve",
        };
        if let Err(error) = daemon.take_lease(name, "eve", true).await {
            world.note_broken(format!("{name} cannot be taken over: {error}"));
        }
        // A fault is cleared first.
        let _ = daemon.command(name, "eve", Command::ClearFault).await;
        world.number_heating_request(hob);
        let power_w = 700;
        let heats = daemon
            .command(name, "eve", Command::Power { power_w })
            .await;
        let asked_w = world.lock().sockets[hob].hob.asked_w();
        if heats.is_err() || asked_w != power_w {
            world.note_broken(format!("{name} has {asked_w} of {power_w} W: {heats:?}"));
        }
        send_foreign_hello(world, hob);
        if !eve.off().await {
            world.note_broken(format!("{name} cannot be switched off"));
        }
        check_windows(world, daemon, name);
        check_lookup(world, daemon, hob).await;
    }
}

/// Checks after the end of all faults that no window is pending at the fleet: each has at most one result, and the numbers of
/// windows by state add up to those in the store.
pub async fn check_settled(world: &World, daemon: &Daemon, store: &Path) {
    let began = Instant::now();
    loop {
        let why = match daemon.fleet().tally().await {
            Ok(tally) if tally.due + tally.sent > 0 => {
                format!("windows are still at the fleet: {tally:?}")
            }
            Ok(tally) => match in_store(store) {
                // No window came in between: the store's task did not run.
                Ok((windows, results))
                    if windows.len() as u64 == tally.stored()
                        && results.len() as u64 == tally.answered + tally.learned_here =>
                {
                    return world.note(&format!("all have come back: {tally:?}"));
                }
                Ok((windows, results)) => format!(
                    "{} windows and {} results are stored: {tally:?}",
                    windows.len(),
                    results.len()
                ),
                Err(why) => why,
            },
            Err(why) => format!("windows cannot be counted: {why}"),
        };
        if began.elapsed() >= SETTLING_TIME {
            return world.note_broken(why);
        }
        sleep(2 * POLL_PERIOD).await;
    }
}

fn in_store(folder: &Path) -> Result<(Vec<WindowRow>, Vec<ResultRow>), String> {
    let unread = |e: ihd_store::StoreError| {
        let why = format!("the store cannot be read: {e}");
        why.chars().take(300).collect::<String>()
    };
    let reader = StoreReader::open(folder).map_err(unread)?;
    let windows = reader.windows(&WindowFilter::default()).map_err(unread)?;
    let results = reader.results(&ResultFilter {
        limit: Some(u32::MAX),
        ..ResultFilter::default()
    });
    Ok((windows, results.map_err(unread)?))
}

/// Checks that each announced window is counted exactly once.
fn check_windows(world: &World, daemon: &Daemon, name: &str) {
    let Some(report) = daemon.view().device(name) else {
        return;
    };
    let w = &report.windows;
    let counted = w.stored + w.refused + w.dropped_by_device + w.lost + w.not_stored;
    // One window may be at the store.
    if w.announced.abs_diff(counted) > 1 {
        world.note_broken(format!("{name}'s windows do not add up: {w:?}"));
    }
}

/// Checks that the active lookup of a hob is in the store.
async fn check_lookup(world: &World, daemon: &Daemon, hob: usize) {
    let used = world.lock().sockets[hob].hob.lookup().clone();
    let rows = daemon.view().lookups(HOBS[hob]).await.unwrap_or_default();
    let blob = used.to_bytes();
    let is_known = rows
        .iter()
        .any(|row| row.version == used.version && row.blob == blob);
    if used.version > 0 && !is_known {
        let name = HOBS[hob];
        world.note_broken(format!(
            "{name} uses lookup {} that the store does not know",
            used.version
        ));
    }
}

/// Checks that acknowledged windows and results are in the store.
pub fn check_store(world: &World, folder: &Path) {
    let (windows, results) = match in_store(folder) {
        Ok(found) => found,
        Err(why) => return world.note_broken(why),
    };
    let key = |device: &str, boot, seq| {
        let hob = HOBS.iter().position(|hob| *hob == device)?;
        Some((hob, boot, seq))
    };
    let stored = windows.iter().filter_map(|w| key(&w.device, w.boot, w.seq));
    let results_stored = results.iter().filter_map(|r| key(&r.device, r.boot, r.seq));
    let (stored, results_stored): (BTreeSet<_>, BTreeSet<_>) =
        (stored.collect(), results_stored.collect());
    let twice = results.len() - results_stored.len();
    let promises = &mut world.lock().promises;
    let lost = promises.stored.difference(&stored).next();
    let lost_result = promises.results.difference(&results_stored).next();
    if let Some(lost) = lost.or(lost_result) {
        promises.broken.get_or_insert(format!(
            "hob, boot, number {lost:?} was acknowledged, and is not in the store"
        ));
    }
    if twice > 0 {
        let why = format!("{twice} windows have more than one result");
        promises.broken.get_or_insert(why);
    }
}
