//! Promises of the edge, checked while it lives. What is checked at the end of a course: `ihd_daemon::simulation`.

use std::time::Duration;

use ihd_daemon::Daemon;
use ihd_daemon::fleet::TRUSTED_FOR;
use ihd_daemon::simulation::LOAD;
use ihd_store::{Reader, ResultFilter};
use tokio::time::{Instant, sleep};

use super::line::{Key, Line};
use super::workers::LIAR;

/// Between two looks.
const CHECK_EVERY: Duration = Duration::from_millis(100);

/// Longest time from an acknowledgement to its note: a batch has 8 s, and waits for the store after that.
const NOTED_WITHIN: Duration = Duration::from_secs(10);

/// After so long the edge counts on the windows behind one that never came.
const FORGOTTEN_AFTER: Duration = Duration::from_secs(300);

/// Largest difference from the truth that an answer may have and be confirmed: the check's own error, and its noise.
const BELIEVED_PCT: f64 = 0.1;

/// Checks that no lie was confirmed, and nothing else refuted.
fn check_answers(line: &Line, daemon: &Daemon) {
    for (name, answers) in daemon.workers() {
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

/// Checks that what is stored of R is the truth, now that all has come back.
pub fn check_results(line: &Line, daemon: &Daemon) {
    let filter = ResultFilter {
        limit: Some(u32::MAX),
        ..ResultFilter::default()
    };
    let results = Reader::open(daemon.store_folder()).and_then(|reader| reader.results(&filter));
    let results = match results {
        Ok(results) => results,
        Err(why) => return line.world.note_broken(why.to_string()),
    };
    let passed: Vec<_> = results.iter().filter(|result| result.pass).collect();
    for result in &passed {
        let differs_pct = 100.0 * (result.r_ohm / LOAD.r_ohm - 1.0);
        // Not a number is no truth.
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
pub async fn watch(line: Line, daemon: Daemon) {
    loop {
        sleep(CHECK_EVERY).await;
        check_answers(&line, &daemon);
        if !daemon.trusts_fleet() {
            continue;
        }
        let now = Instant::now();
        let (last, oldest) = {
            let heard = line.heard();
            let waits = |(_, since): &(&Key, &Instant)| now - **since < FORGOTTEN_AFTER;
            let oldest = heard.waited_for.iter().filter(waits);
            let oldest = oldest.min_by_key(|(_, since)| **since);
            (heard.last, oldest.map(|(key, since)| (key.clone(), *since)))
        };
        let silent_for = last.map(|last| now - last);
        if silent_for.is_none_or(|time| time > TRUSTED_FOR) {
            let text = format!("the fleet is trusted, and has been silent for {silent_for:?}");
            line.world.note_broken(text);
        }
        if let Some((key, since)) = oldest
            && now - since > TRUSTED_FOR + NOTED_WITHIN
        {
            let text = format!(
                "the fleet is trusted, and {key:?} waits since {:?}",
                now - since
            );
            line.world.note_broken(text);
        }
    }
}
