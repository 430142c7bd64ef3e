//! Figures of the daemon's operation.

use std::sync::atomic::Ordering;

use ihd_model::{DroppedRecords, StoreFailure};

use crate::learning::LearnerFigures;
use crate::store_thread::StoreThread;

/// Figures of the daemon since its start.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DaemonFigures {
    /// Number of devices.
    pub devices: usize,
    /// Uptime in seconds.
    pub up_s: f64,
    /// The store's failure; `None` while it takes all records.
    pub store_failure: Option<StoreFailure>,
    /// Records dropped since the start.
    pub store_dropped: DroppedRecords,
    /// Jobs waiting for the store.
    pub store_waiting: usize,
    /// Jobs completed by the store, including failures.
    pub store_jobs: u64,
    /// Failed jobs of the store.
    pub store_failures: u64,
    /// Busy time of the store in seconds.
    pub store_busy_s: f64,
    /// Duration of the store's longest job in seconds.
    pub store_longest_s: f64,
    /// Figures of the learner.
    pub learner: LearnerFigures,
    /// `true` if no command is missing in the audit and the store accepts audits.
    pub audit_is_healthy: bool,
    /// Commands lost to the audit.
    pub audits_lost: u64,
    /// Resident memory in bytes; `None` if the system does not report it.
    pub rss_bytes: Option<u64>,
}

impl DaemonFigures {
    /// Returns the figures of the store's thread; the others are zero.
    pub(crate) fn from_store(store: &StoreThread) -> Self {
        let gauge = store.gauge();
        let seconds = |us: u64| us as f64 * 1e-6;
        Self {
            store_failure: store.failure(),
            store_dropped: store.all_dropped(),
            store_waiting: store.waiting(),
            store_jobs: gauge.jobs.load(Ordering::Relaxed),
            store_failures: gauge.failures.load(Ordering::Relaxed),
            store_busy_s: seconds(gauge.busy_us.load(Ordering::Relaxed)),
            store_longest_s: seconds(gauge.longest_us.load(Ordering::Relaxed)),
            ..Self::default()
        }
    }
}

/// Returns the resident memory of this process in bytes; `None` except on Linux.
pub(crate) fn rss_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}
