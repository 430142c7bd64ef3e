//! The store's condition over time: trials while it fails, and a line in the log each minute.

use std::time::Duration;

use crate::device::Context;

/// Between two looks.
const LOOK_EVERY: Duration = Duration::from_secs(10);

/// Looks between two lines in the log while the store fails.
const LOOKS_A_LINE: u32 = 6;

/// Watches until the daemon stops.
pub async fn watch(context: Context) {
    let (mut job, mut failing) = (None, 0_u32);
    loop {
        tokio::select! {
            biased;
            () = context.stopping() => return,
            () = tokio::time::sleep(LOOK_EVERY) => {}
        }
        job = context.store.look(job, LOOK_EVERY).await;
        let Some(failure) = context.store.failure() else {
            failing = 0;
            continue;
        };
        failing += 1;
        if failing.is_multiple_of(LOOKS_A_LINE) {
            let (dropped, advice) = (failure.dropped.text(), failure.advice);
            tracing::warn!(text = failure.text, dropped, advice, "store: still");
        }
    }
}
