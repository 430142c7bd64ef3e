//! The daemon in numbers.

use std::sync::atomic::Ordering;

use crate::learning::LearnerFigures;
use crate::model::{Dropped, StoreFailure};
use crate::store_thread::StoreThread;

/// How the daemon does, since it began.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figures {
    /// Devices.
    pub devices: usize,
    /// Seconds since the daemon began.
    pub up_s: f64,
    /// The store's failure; `None` while it takes all records.
    pub store_failure: Option<StoreFailure>,
    /// Records dropped since the daemon began.
    pub store_dropped: Dropped,
    /// Jobs that wait for the store.
    pub store_waiting: usize,
    /// Jobs that the store has done, failures included.
    pub store_jobs: u64,
    /// Those that failed.
    pub store_failures: u64,
    /// Seconds that the store was busy.
    pub store_busy_s: f64,
    /// Seconds of its longest job.
    pub store_longest_s: f64,
    /// Learning.
    pub learner: LearnerFigures,
    /// All commands so far are in the audit, or on their way to a store that writes.
    pub audit_is_well: bool,
    /// Commands that the audit does not have and will not get.
    pub audits_lost: u64,
    /// Memory in use, in bytes; none where the system does not say.
    pub rss_bytes: Option<u64>,
}

impl Figures {
    /// What the store's thread counts.
    pub(crate) fn of_store(store: &StoreThread) -> Self {
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

/// Resident memory of this process, in bytes, where Linux says it.
pub(crate) fn rss_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}
