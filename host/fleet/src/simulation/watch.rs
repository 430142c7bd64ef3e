//! Invariants of the edge, checked during its life. Checks at the end of a course: `ihd_daemon::simulation`.

use std::time::Duration;

use ihd_daemon::Daemon;
use ihd_daemon::fleet::DELEGATION_TIME;
use ihd_daemon::simulation::LOAD;
use ihd_store::{ResultFilter, StoreReader};
use tokio::time::{Instant, sleep};

use super::line::{SimulatedConnection, SimulatedKey};
use super::workers::LIAR;
use crate::edge::trust::FORGOTTEN_AFTER;

/// Period of the checks.
const CHECK_EVERY: Duration = Duration::from_millis(100);

/// Longest time from an acknowledgement to its record: a batch has 8 s, then waits for the store.
const NOTED_WITHIN: Duration = Duration::from_secs(10);

/// Largest deviation of a confirmed answer from the truth in percent: error and noise of the check.
const BELIEVED_PCT: f64 = 0.1;

/// Checks that no false answer was confirmed, and no other refuted.
fn check_answers(line: &SimulatedConnection, daemon: &Daemon) {
    for (name, answers) in daemon.fleet().workers() {
        let is_liar = name.starts_with(LIAR);
        if is_liar && answers.confirmed > 0 {
            line.world
                .note_broken(format!("a lie of {name} was confirmed"));
        }
        if name.starts_with("worker") && answers.refuted > 0 {
            let why = &answers.why;
            line.world
                .note_broken(format!("{name} was refuted and has not lied: {why}"));
        }
    }
}

/// Checks that every stored R is the truth, after all results have come.
pub fn check_results(line: &SimulatedConnection, daemon: &Daemon) {
    let filter = ResultFilter {
        limit: Some(u32::MAX),
        ..ResultFilter::default()
    };
    let results =
        StoreReader::open(daemon.fleet().store_folder()).and_then(|reader| reader.results(&filter));
    let results = match results {
        Ok(results) => results,
        Err(why) => return line.world.note_broken(why.to_string()),
    };
    let passed: Vec<_> = results.iter().filter(|result| result.pass).collect();
    for result in &passed {
        let differs_pct = 100.0 * (result.r_ohm / LOAD.r_ohm - 1.0);
        // NaN is wrong, too.
        if differs_pct.is_nan() || differs_pct.abs() > BELIEVED_PCT {
            let text = format!(
                "{} {} has R wrong by {differs_pct} %",
                result.boot, result.seq
            );
            line.world.note_broken(text);
        }
    }
    line.world.note(&format!(
        "{} of {} results teach",
        passed.len(),
        results.len()
    ));
}

/// Checks until the daemon's life ends.
pub async fn watch(line: SimulatedConnection, daemon: Daemon) {
    loop {
        sleep(CHECK_EVERY).await;
        check_answers(&line, &daemon);
        if !daemon.fleet().is_delegated() {
            continue;
        }
        let now = Instant::now();
        let (last, oldest) = {
            let received = line.received();
            let waits = |(_, since): &(&SimulatedKey, &Instant)| now - **since < FORGOTTEN_AFTER;
            let oldest = received.waited_for.iter().filter(waits);
            let oldest = oldest.min_by_key(|(_, since)| **since);
            (
                received.last,
                oldest.map(|(key, since)| (key.clone(), *since)),
            )
        };
        let silent_for = last.map(|last| now - last);
        if silent_for.is_none_or(|time| time > DELEGATION_TIME) {
            let text = format!("the fleet is trusted, and has been silent for {silent_for:?}");
            line.world.note_broken(text);
        }
        if let Some((key, since)) = oldest
            && now - since > DELEGATION_TIME + NOTED_WITHIN
        {
            let text = format!(
                "the fleet is trusted, and {key:?} waits since {:?}",
                now - since
            );
            line.world.note_broken(text);
        }
    }
}
