//! Periodic check of the store's condition: trials while it fails, and a log line each minute.

use std::time::Duration;

use crate::context::Context;

/// Period of polling, and time limit of a trial.
const POLL_PERIOD: Duration = Duration::from_secs(10);

/// Polls per log line while the store fails.
const POLLS_PER_LINE: u32 = 6;

/// Polls the store's condition until the daemon stops.
pub async fn watch(context: Context) {
    let (mut job, mut failing) = (None, 0_u32);
    loop {
        tokio::select! {
            biased;
            () = context.stopping() => return,
            () = tokio::time::sleep(POLL_PERIOD) => {}
        }
        job = context.store.poll_health(job, POLL_PERIOD).await;
        let Some(failure) = context.store.failure() else {
            failing = 0;
            continue;
        };
        failing += 1;
        if failing.is_multiple_of(POLLS_PER_LINE) {
            let (dropped, advice) = (failure.dropped.text(), failure.advice);
            tracing::warn!(text = failure.text, dropped, advice, "store: still");
        }
    }
}
