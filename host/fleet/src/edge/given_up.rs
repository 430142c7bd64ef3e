//! Sent windows without an answer: the edge searches the dead letters for them, and identifies those here whose answer cannot arrive.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

use super::inbox;
use super::link::Link;
use crate::dead_letters;

/// Part of which failures are recorded.
const PART: &str = "given up";

/// Period of the checks.
const POLL_PERIOD: Duration = Duration::from_secs(10);

/// Windows for each check; the next check continues behind them.
const CHECK_BATCH: usize = 64;

/// Time in milliseconds without an answer after which a window is searched among the dead letters.
const ASKED_AFTER_MS: i64 = 20_000;

/// Checks until the edge stops.
pub async fn run(link: Arc<Link>) {
    let mut passed = 0;
    while link
        .turn_until_stop(PART, POLL_PERIOD, take_turn(&link, &mut passed))
        .await
    {}
}

/// Checks windows behind the first `passed`; returns the pause before the next check.
async fn take_turn(link: &Link, passed: &mut usize) -> Result<Duration, String> {
    if link.is_admitted() {
        *passed = check_dead_letters(link, *passed).await?;
        link.works(PART);
    }
    Ok(POLL_PERIOD)
}

/// Checks unanswered windows behind the first `passed`; returns `passed` of the next check.
async fn check_dead_letters(link: &Link, passed: usize) -> Result<usize, String> {
    let before_ms = link.daemon.view().now_ms() - ASKED_AFTER_MS;
    let windows = link
        .daemon
        .fleet()
        .unanswered(before_ms, passed, CHECK_BATCH)
        .await;
    let windows = windows.map_err(|e| e.to_string())?;
    let (mut still, count, began) = (0, windows.len(), Instant::now());
    for window in windows {
        let (hob, boot, seq) = (&window.device, window.boot, window.seq);
        if !link.may_try(PART, hob) {
            still += 1;
            continue;
        }
        let why = match dead_letters::why(&link.server, hob, boot, seq).await {
            Ok(why) => why,
            Err(why) => {
                link.refused(PART, hob, &why, began);
                still += 1;
                continue;
            }
        };
        link.accepted(PART, hob);
        let Some(why) = why else {
            let key = (hob.clone(), boot, seq);
            let is_early = link.state().oddities.is_early(&key);
            if is_early {
                inbox::receive_nothing(link, &key).await;
            }
            still += 1;
            continue;
        };
        let noted = link.daemon.fleet().mark_given_up(&window, &why).await;
        noted.map_err(|e| e.to_string())?;
        tracing::warn!(hob, boot, seq, why, "the fleet has given up a window");
        link.state().answers.remove(&(hob.clone(), boot, seq));
    }
    Ok(if count < CHECK_BATCH {
        0
    } else {
        passed + still
    })
}
