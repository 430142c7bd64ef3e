//! Windows that no worker could identify: the edge asks for those that it has sent and that stay without an answer.

use std::sync::Arc;
use std::time::Duration;

use super::Link;
use crate::dead;

/// Between two looks.
const LOOK_EVERY: Duration = Duration::from_secs(10);

/// Windows that are asked for at a look; those behind them are asked for at the next.
const AT_ONCE: usize = 64;

/// Time without an answer after which a window is asked for among the dead, in milliseconds.
const ASKED_AFTER_MS: i64 = 20_000;

/// Looks until the edge ends.
pub async fn run(link: Arc<Link>) {
    let mut passed = 0;
    loop {
        if link.is_admitted() {
            match link.unless_stopping(look(&link, passed)).await {
                None => return,
                Some(Ok(next)) => {
                    link.works("given up");
                    passed = next;
                }
                Some(Err(why)) => link.failed("given up", &why),
            }
        }
        if !link.wait(LOOK_EVERY).await {
            return;
        }
    }
}

/// Asks for those behind the first `passed` that are not answered; behind how many the next look begins.
async fn look(link: &Link, passed: usize) -> Result<usize, String> {
    let before_ms = link.daemon.now_ms() - ASKED_AFTER_MS;
    let windows = link.daemon.unanswered(before_ms, passed, AT_ONCE).await;
    let windows = windows.map_err(|e| e.to_string())?;
    let (mut still, count) = (0, windows.len());
    for window in windows {
        let (hob, boot, seq) = (&window.device, window.boot, window.seq);
        let why = dead::why(&link.server, hob, boot, seq).await;
        let Some(why) = why.map_err(|e| e.to_string())? else {
            still += 1;
            continue;
        };
        let noted = link.daemon.given_up(&window, &why).await;
        noted.map_err(|e| e.to_string())?;
        tracing::warn!(hob, boot, seq, why, "the fleet has given up a window");
        link.state().answers.came(&(hob.clone(), boot, seq));
    }
    Ok(if count < AT_ONCE { 0 } else { passed + still })
}
