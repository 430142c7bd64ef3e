//! Counters of link and learner, read once per second, and retries of the store.

use std::time::Duration;

use ihd_link::ClientCounters;
use tokio::time::Instant;

use super::session::{DeviceSession, SessionEnd};

/// Period of retrying failed jobs of the store.
const STORE_RETRY_PERIOD: Duration = Duration::from_secs(10);

impl DeviceSession<'_> {
    /// Reads the counters of link and learner, logs what exceeds its limit, and retries the store.
    pub(super) async fn poll_counters(&mut self) -> Result<(), SessionEnd> {
        let counted = self.link.client.with(|client| client.counters()).await;
        let Ok(ClientCounters {
            windows,
            frames_beyond,
            ..
        }) = counted
        else {
            return Err(self.link_end());
        };
        if windows.received > 0 || windows.missing > 0 {
            let mut inner = self.record.lock();
            inner.windows.dropped_by_device(windows.dropped_by_device);
        }
        self.report_flood(frames_beyond);
        let unlearned = self.context.learner.unlearned_count(&self.record.name);
        let jumps = {
            let mut inner = self.record.lock();
            inner.windows.set_unlearned(unlearned);
            inner.windows.jumps()
        };
        if jumps > std::mem::replace(&mut self.logged_jumps, jumps) {
            tracing::warn!(
                device = self.record.name,
                jumps,
                "its windows are numbered in jumps"
            );
        }
        let beyond = self.flood.take_rejected();
        if beyond > 0 {
            tracing::warn!(
                device = self.record.name,
                beyond,
                "more windows and faults than a device sends: dropped"
            );
        }
        if self.last_store_retry.elapsed() >= STORE_RETRY_PERIOD {
            self.last_store_retry = Instant::now();
            self.retry_store().await?;
        }
        Ok(())
    }

    /// Counts frames beyond what a hob sends, of this link `frames_beyond` so far; reports them once per connection.
    fn report_flood(&mut self, frames_beyond: u64) {
        let more = self.flood.new_frames(frames_beyond);
        if more == 0 {
            return;
        }
        self.record.lock().frames_beyond += more;
        if more == frames_beyond {
            let text = "it sends more than a hob does: what is beyond that is dropped and counted";
            tracing::warn!(device = self.record.name, frames = more, "{text}");
            self.store_event("flood", text);
        }
    }
}
