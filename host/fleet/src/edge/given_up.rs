//! Windows that no worker could identify: the edge searches the dead letters for sent windows without an answer.

use std::sync::Arc;
use std::time::Duration;

use super::link::Link;
use crate::dead_letters;

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
        .turn_until_stop("given up", POLL_PERIOD, take_turn(&link, &mut passed))
        .await
    {}
}

/// Checks windows behind the first `passed`; returns the pause before the next check.
async fn take_turn(link: &Link, passed: &mut usize) -> Result<Duration, String> {
    if link.is_admitted() {
        *passed = check_dead_letters(link, *passed).await?;
        link.works("given up");
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
    let (mut still, count) = (0, windows.len());
    for window in windows {
        let (hob, boot, seq) = (&window.device, window.boot, window.seq);
        let why = dead_letters::why(&link.server, hob, boot, seq).await;
        let Some(why) = why.map_err(|e| e.to_string())? else {
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
