//! Writes seconds to the store, some at a time.

use std::time::Duration;

use crate::device::Context;
use crate::history::Seconds;
use crate::model::Record;
use crate::store_thread::StoreThread;

/// Between two writes: what a daemon that is killed loses of its history at most.
const WRITE_EVERY: Duration = Duration::from_secs(5);

/// Writes until the daemon stops.
pub async fn keep(context: Context) {
    let mut told = 0;
    loop {
        tokio::select! {
            biased;
            () = context.stopping() => return,
            () = tokio::time::sleep(WRITE_EVERY) => {}
        }
        let now_ms = context.machine.now_ms();
        write(&context.seconds, &context.store, now_ms, false).await;
        let dropped = context.seconds.dropped();
        let seconds = dropped - std::mem::replace(&mut told, dropped);
        context.store.dropped(Record::Telemetry, seconds);
    }
}

/// Writes what waits; with `all` the present seconds, too.
pub async fn write(seconds: &Seconds, store: &StoreThread, now_ms: i64, all: bool) {
    let batch = seconds.take(now_ms, all);
    if batch.is_empty() {
        return;
    }
    let store = store.writing(Record::Telemetry);
    let kept = store.run(move |store| store.keep_telemetry(&batch)).await;
    match kept {
        Ok(_) => seconds.written(),
        // The store's trouble is told by its thread.
        Err(_) => seconds.not_written(),
    }
}
