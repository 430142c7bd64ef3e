//! Periodic write of buffered telemetry to the store.

use std::time::Duration;

use ihd_model::RecordKind;

use crate::context::Context;
use crate::history::TelemetryBuffer;
use crate::store_thread::StoreThread;

/// Period of writing, and so the largest loss of history if the daemon is killed.
const WRITE_PERIOD: Duration = Duration::from_secs(5);

/// Writes the buffer periodically until the daemon stops.
pub async fn write_periodically(context: Context) {
    let mut counted = 0;
    loop {
        tokio::select! {
            biased;
            () = context.stopping() => return,
            () = tokio::time::sleep(WRITE_PERIOD) => {}
        }
        let now_ms = context.machine.now_ms();
        write(&context.telemetry, &context.store, now_ms, false).await;
        let dropped = context.telemetry.dropped();
        let seconds = dropped - std::mem::replace(&mut counted, dropped);
        context.store.count_dropped(RecordKind::Telemetry, seconds);
    }
}

/// Writes all completed seconds; with `all` the present ones, too.
pub async fn write(buffer: &TelemetryBuffer, store: &StoreThread, now_ms: i64, all: bool) {
    let batch = buffer.take_batch(now_ms, all);
    if batch.is_empty() {
        return;
    }
    let store = store.writing(RecordKind::Telemetry);
    let written = store.run(move |store| store.keep_telemetry(&batch)).await;
    match written {
        Ok(_) => buffer.confirm_batch(),
        // Errors of the store are reported by its thread.
        Err(_) => buffer.return_batch(),
    }
}
