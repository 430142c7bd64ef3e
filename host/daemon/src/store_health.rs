//! Condition of the store, from the outcomes of its jobs. No clock and no I/O: times are arguments.
//!
//! Each kind of record fails and recovers independently: a written event does not show that windows can be written. A kind
//! recovers when one of its records is written. It also recovers when a trial shows that the cause is gone, as no window comes
//! from a hob that was switched off meanwhile.

use std::collections::BTreeMap;

use ihd_model::{DroppedRecords, RecordKind, StoreCause, StoreFailure};
use ihd_store::StoreError;

/// Successive polls without a full queue after which the store is fast enough again.
const QUIET_POLLS: u32 = 6;

/// Failure of one kind of record.
#[derive(Clone, Debug)]
struct RecordFailure {
    cause: StoreCause,
    /// Error with paths, for the log.
    detail: String,
}

/// Change of condition, to be published once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum HealthChange {
    /// The store fails, or fails for another cause.
    Failing {
        /// Failure for reports.
        failure: StoreFailure,
        /// Error with paths.
        detail: String,
    },
    /// The store accepts all records again.
    Recovered {
        /// Start of the failure, in milliseconds since 1970, UTC.
        since_ms: i64,
        /// Records dropped during the failure.
        dropped: DroppedRecords,
    },
}

/// Condition of the store.
#[derive(Debug, Default)]
pub struct StoreHealth {
    failures: BTreeMap<RecordKind, RecordFailure>,
    /// Polls since a queue was full; `None` after `QUIET_POLLS` of them.
    polls_since_full: Option<u32>,
    is_silent: bool,
    /// Start of the present failure in milliseconds since 1970, UTC, and the records dropped before it.
    began: Option<(i64, DroppedRecords)>,
    dropped: DroppedRecords,
    /// Start of the last failure that is over, and the records dropped during it.
    ended: Option<(i64, DroppedRecords)>,
    /// Cause of the last published change.
    reported: Option<StoreCause>,
}

/// Returns the cause of an error; `None` if the store is not at fault.
pub fn cause_of(error: &StoreError) -> Option<StoreCause> {
    let cause = if error.is_full() {
        StoreCause::DiskFull
    } else if error.is_locked() {
        StoreCause::Locked
    } else if error.is_denied() {
        StoreCause::NoPermission
    } else if error.is_damage() {
        StoreCause::Damaged
    } else {
        StoreCause::Failing
    };
    error.is_of_storage().then_some(cause)
}

impl StoreHealth {
    /// Clears the failure of this kind, because a record of it was written.
    pub fn written(&mut self, record: RecordKind) {
        self.is_silent = false;
        self.failures.remove(&record);
        self.end_if_recovered();
    }

    /// Sets the failure of this kind: a record could not be written, and `lost` of them are dropped.
    pub fn failed(
        &mut self,
        record: RecordKind,
        cause: StoreCause,
        detail: &str,
        lost: u64,
        now_ms: i64,
    ) {
        self.begin(now_ms);
        self.is_silent = false;
        self.dropped.add(record, lost);
        let detail = detail.to_owned();
        self.failures
            .insert(record, RecordFailure { cause, detail });
    }

    /// Counts `lost` records of this kind that were dropped because their queue was full.
    pub fn count_no_room(&mut self, record: RecordKind, lost: u64, now_ms: i64) {
        self.begin(now_ms);
        self.dropped.add(record, lost);
        self.polls_since_full = Some(0);
    }

    /// Sets the response state: `false` if the store has been busy with one job since the last poll.
    pub fn set_responding(&mut self, is_responding: bool, now_ms: i64) {
        if !is_responding {
            self.begin(now_ms);
        }
        self.is_silent = !is_responding;
        self.end_if_recovered();
    }

    /// Clears failures after a trial has written to every database.
    pub fn trial_succeeded(&mut self) {
        self.is_silent = false;
        self.failures
            .retain(|_, failure| !is_cleared_by_trial(failure.cause));
        self.end_if_recovered();
    }

    /// Polls the condition, every ten seconds. Returns `true` if a trial can clear a failure.
    pub fn poll(&mut self) -> bool {
        if let Some(polls) = &mut self.polls_since_full {
            *polls += 1;
            if *polls > QUIET_POLLS {
                self.polls_since_full = None;
            }
        }
        self.end_if_recovered();
        self.failures
            .values()
            .any(|failure| is_cleared_by_trial(failure.cause))
    }

    /// Returns the failure; `None` while all records are accepted.
    pub fn failure(&self) -> Option<StoreFailure> {
        let (since_ms, before) = self.began?;
        let cause = self.worst_cause()?;
        Some(StoreFailure::new(
            cause,
            since_ms,
            self.dropped.since(&before),
        ))
    }

    /// Returns the records dropped since the start of the daemon.
    pub fn dropped(&self) -> DroppedRecords {
        self.dropped
    }

    /// Returns the change of condition since the last call; `None` if there is none.
    pub fn take_change(&mut self) -> Option<HealthChange> {
        let failure = self.failure();
        let cause = failure.as_ref().map(|failure| failure.cause);
        if cause == self.reported {
            return None;
        }
        self.reported = cause;
        let Some(failure) = failure else {
            let (since_ms, dropped) = self.ended?;
            return Some(HealthChange::Recovered { since_ms, dropped });
        };
        let detail = self.detail(failure.cause);
        Some(HealthChange::Failing { failure, detail })
    }

    fn worst_cause(&self) -> Option<StoreCause> {
        let of_kinds = self.failures.values().map(|failure| failure.cause);
        let silent = self.is_silent.then_some(StoreCause::Silent);
        let too_slow = self.polls_since_full.map(|_| StoreCause::TooSlow);
        of_kinds.chain(silent).chain(too_slow).min()
    }

    fn detail(&self, cause: StoreCause) -> String {
        let mut failures = self.failures.values();
        let of_cause = failures.find(|failure| failure.cause == cause);
        of_cause.map_or_else(String::new, |failure| failure.detail.clone())
    }

    fn begin(&mut self, now_ms: i64) {
        if self.began.is_none() {
            self.began = Some((now_ms, self.dropped));
        }
    }

    fn end_if_recovered(&mut self) {
        if self.worst_cause().is_none()
            && let Some((since_ms, before)) = self.began.take()
        {
            self.ended = Some((since_ms, self.dropped.since(&before)));
        }
    }
}

/// Returns `true` if a successful trial shows that the cause is gone. Damage and faults of this program may affect one kind of
/// record alone.
fn is_cleared_by_trial(cause: StoreCause) -> bool {
    use StoreCause as C;
    matches!(
        cause,
        C::DiskFull | C::NoPermission | C::Locked | C::Failing
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    const FULL: StoreCause = StoreCause::DiskFull;

    fn cause(health: &StoreHealth) -> Option<StoreCause> {
        health.failure().map(|failure| failure.cause)
    }

    #[test]
    fn a_kind_that_is_written_hides_none_that_is_not() {
        let mut health = StoreHealth::default();
        assert_eq!((health.failure(), health.take_change()), (None, None));
        health.failed(
            RecordKind::Windows,
            FULL,
            "/store/windows.db: full",
            1,
            1_000,
        );
        let Some(HealthChange::Failing { failure, detail }) = health.take_change() else {
            panic!("a failure is published");
        };
        assert_eq!(
            (failure.cause, failure.since_ms, detail.as_str()),
            (FULL, 1_000, "/store/windows.db: full")
        );
        // Events fit where windows do not.
        for record in [RecordKind::Events, RecordKind::State, RecordKind::Telemetry] {
            health.written(record);
            assert_eq!(cause(&health), Some(FULL));
        }
        health.failed(RecordKind::Windows, FULL, "", 1, 2_000);
        health.failed(RecordKind::Audits, FULL, "", 1, 3_000);
        assert_eq!(health.take_change(), None, "published once");
        let failure = health.failure().unwrap();
        let dropped = DroppedRecords {
            windows: 2,
            audits: 1,
            ..DroppedRecords::default()
        };
        assert_eq!((failure.since_ms, failure.dropped), (1_000, dropped));
        health.written(RecordKind::Windows);
        assert_eq!(cause(&health), Some(FULL), "the audit is not written yet");
        health.written(RecordKind::Audits);
        let recovered = HealthChange::Recovered {
            since_ms: 1_000,
            dropped,
        };
        assert_eq!(
            (health.failure(), health.take_change()),
            (None, Some(recovered))
        );
        // The next failure counts anew, the daemon's own count goes on.
        health.failed(RecordKind::Windows, FULL, "", 1, 9_000);
        let failure = health.failure().unwrap();
        assert_eq!(
            (
                failure.since_ms,
                failure.dropped.windows,
                health.dropped().windows
            ),
            (9_000, 1, 3)
        );
    }

    #[test]
    fn a_trial_ends_what_it_proves_and_nothing_else() {
        let mut health = StoreHealth::default();
        health.failed(RecordKind::Windows, FULL, "", 1, 0);
        health.failed(RecordKind::State, StoreCause::Locked, "", 0, 0);
        assert!(health.poll());
        health.trial_succeeded();
        assert_eq!(health.failure(), None);
        health.failed(RecordKind::Audits, StoreCause::Defect, "", 1, 0);
        assert!(
            !health.poll(),
            "no trial shows that a fault of this program is gone"
        );
        health.trial_succeeded();
        assert_eq!(cause(&health), Some(StoreCause::Defect));
        health.written(RecordKind::Audits);
        assert_eq!(health.failure(), None);
    }

    #[test]
    fn a_store_is_fast_enough_again_after_a_minute_in_which_all_found_room() {
        let mut health = StoreHealth::default();
        health.count_no_room(RecordKind::Windows, 1, 0);
        health.written(RecordKind::Windows);
        for _ in 0..QUIET_POLLS {
            health.poll();
            assert_eq!(cause(&health), Some(StoreCause::TooSlow));
        }
        health.count_no_room(RecordKind::Events, 1, 0);
        for _ in 0..QUIET_POLLS {
            health.poll();
        }
        let dropped = health.failure().unwrap().dropped;
        assert_eq!((dropped.windows, dropped.events), (1, 1));
        health.poll();
        assert_eq!(health.failure(), None);
    }

    #[test]
    fn the_gravest_cause_is_told_and_each_change_of_it() {
        let mut health = StoreHealth::default();
        health.count_no_room(RecordKind::Windows, 1, 0);
        health.set_responding(false, 10);
        assert_eq!(cause(&health), Some(StoreCause::Silent));
        assert!(matches!(
            health.take_change(),
            Some(HealthChange::Failing { .. })
        ));
        health.failed(RecordKind::Windows, FULL, "", 1, 20);
        assert_eq!(cause(&health), Some(FULL));
        assert!(matches!(
            health.take_change(),
            Some(HealthChange::Failing { .. })
        ));
        assert_eq!(health.take_change(), None);
        assert_eq!(health.failure().unwrap().since_ms, 0);
    }
}
