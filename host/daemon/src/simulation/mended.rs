//! Checks at the end of a course: all works once nothing fails any more, and what was acknowledged is in the store.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use ihd_store::{Reader, ResultFilter, ResultRow, WindowFilter, WindowRow};
use tokio::time::{Instant, sleep};

use super::faults::greet;
use super::users::User;
use super::world::{HOBS, World};
use crate::daemon::Daemon;
use crate::model::{Command, DeviceState};

/// From when nothing fails any more until all has to work again: the longest wait between two tries to connect, what a
/// hello and a silent device take, and what the store is asked again after.
pub const MENDED_WITHIN: Duration = Duration::from_secs(40);

/// The same for all windows to come back from the fleet: one that a dead worker had comes again after 30 s, and so does a result that a dead
/// edge had; what was late when the faults ended may be so for 30 s more.
const SETTLED_WITHIN: Duration = Duration::from_secs(120);

/// Between two looks at a board's world for whether all works again.
const LOOK_EVERY: Duration = Duration::from_millis(500);

fn works(daemon: &Daemon, name: &str) -> bool {
    use DeviceState::{Incompatible, Searching, Suspended};
    let state = daemon.device(name).map(|report| report.state);
    !matches!(state, None | Some(Searching | Suspended | Incompatible))
}

/// Waits no longer than it has to.
pub async fn until_all_works(daemon: &Daemon) {
    let began = Instant::now();
    while !HOBS.iter().all(|name| works(daemon, name)) && began.elapsed() < MENDED_WITHIN {
        sleep(LOOK_EVERY).await;
    }
    // What waited for the store.
    sleep(LOOK_EVERY).await;
}

/// Checks that all works, now that nothing fails.
pub async fn check_mended(world: &Arc<World>, daemon: &Daemon) {
    for (hob, name) in HOBS.into_iter().enumerate() {
        if !works(daemon, name) {
            let state = daemon.device(name).map(|report| report.state);
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
        // What tripped is cleared first.
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
        greet(world, hob);
        if !eve.off().await {
            world.note_broken(format!("{name} cannot be switched off"));
        }
        check_windows(world, daemon, name);
        check_lookup(world, daemon, hob).await;
    }
}

/// Checks that the fleet owes nothing, now that nothing fails: each window has come to its end, most of them with one result, and the states of
/// windows add up to those that are stored.
pub async fn check_settled(world: &World, daemon: &Daemon, store: &Path) {
    let began = Instant::now();
    loop {
        let why = match daemon.fleet_tally().await {
            Ok(tally) if tally.due + tally.sent > 0 => {
                format!("windows are still at the fleet: {tally:?}")
            }
            Ok(tally) => match in_store(store) {
                // No window came between: the store's task did not run.
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
        if began.elapsed() >= SETTLED_WITHIN {
            return world.note_broken(why);
        }
        sleep(2 * LOOK_EVERY).await;
    }
}

fn in_store(folder: &Path) -> Result<(Vec<WindowRow>, Vec<ResultRow>), String> {
    let unread = |e: ihd_store::StoreError| {
        let why = format!("the store cannot be read: {e}");
        why.chars().take(300).collect::<String>()
    };
    let reader = Reader::open(folder).map_err(unread)?;
    let windows = reader.windows(&WindowFilter::default()).map_err(unread)?;
    let results = reader.results(&ResultFilter {
        limit: Some(u32::MAX),
        ..ResultFilter::default()
    });
    Ok((windows, results.map_err(unread)?))
}

/// Checks that each window that was announced is counted in one place.
fn check_windows(world: &World, daemon: &Daemon, name: &str) {
    let Some(report) = daemon.device(name) else {
        return;
    };
    let w = &report.windows;
    let counted = w.stored + w.refused + w.dropped_by_device + w.lost + w.not_stored;
    // The one that is at the store.
    if w.announced.abs_diff(counted) > 1 {
        world.note_broken(format!("{name}'s windows do not add up: {w:?}"));
    }
}

/// Checks that the lookup that a hob uses is one that the store knows.
async fn check_lookup(world: &World, daemon: &Daemon, hob: usize) {
    let used = world.lock().sockets[hob].hob.lookup().clone();
    let rows = daemon.lookups(HOBS[hob]).await.unwrap_or_default();
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

/// Checks that what was acknowledged is in the store.
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
    let kept = results.iter().filter_map(|r| key(&r.device, r.boot, r.seq));
    let (stored, kept): (BTreeSet<_>, BTreeSet<_>) = (stored.collect(), kept.collect());
    let twice = results.len() - kept.len();
    let promises = &mut world.lock().promises;
    let lost = promises.stored.difference(&stored).next();
    let lost_result = promises.results.difference(&kept).next();
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
