//! Condition of the store, from the outcomes of its jobs. No clock and no I/O: times are given.
//!
//! Each kind of record fails and recovers for itself: an event that is written says nothing of windows that are not. A kind is well
//! again when a record of it is written, or when a trial shows that its cause is gone, as for a hob that was switched off meanwhile.

use std::collections::BTreeMap;

use ihd_store::StoreError;

use crate::model::{Dropped, Record, StoreCause, StoreFailure};

/// Looks without a record that found no room, after which the store is fast enough again.
const QUIET_LOOKS: u32 = 6;

/// A kind of record that is not written.
#[derive(Clone, Debug)]
struct Trouble {
    cause: StoreCause,
    /// The error, with paths: for the log.
    detail: String,
}

/// A change of condition, to be told once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Change {
    /// It fails, or fails for another cause.
    Failing {
        /// The failure.
        failure: StoreFailure,
        /// The error, with paths.
        detail: String,
    },
    /// It takes all records again.
    Well {
        /// Since when it had failed, in milliseconds since 1970, UTC.
        since_ms: i64,
        /// Records that were dropped meanwhile.
        dropped: Dropped,
    },
}

/// Condition of the store.
#[derive(Debug, Default)]
pub struct StoreHealth {
    troubles: BTreeMap<Record, Trouble>,
    /// Looks since a record found no room in its queue; `None` if all had.
    crowded: Option<u32>,
    is_silent: bool,
    /// When the present failure began, and what had been dropped before.
    began: Option<(i64, Dropped)>,
    dropped: Dropped,
    /// The failure that is over, since when it had lasted and what it cost.
    ended: Option<(i64, Dropped)>,
    told: Option<StoreCause>,
}

/// The cause of an error; `None` if the store is not at fault.
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
    /// A record of this kind was written.
    pub fn written(&mut self, record: Record) {
        self.is_silent = false;
        self.troubles.remove(&record);
        self.end_if_well();
    }

    /// A record of this kind was not written, and `lost` of them are dropped.
    pub fn failed(
        &mut self,
        record: Record,
        cause: StoreCause,
        detail: &str,
        lost: u64,
        now_ms: i64,
    ) {
        self.begin(now_ms);
        self.is_silent = false;
        self.dropped.add(record, lost);
        let detail = detail.to_owned();
        self.troubles.insert(record, Trouble { cause, detail });
    }

    /// Records of this kind are dropped, because there was no room for them to wait.
    pub fn found_no_room(&mut self, record: Record, lost: u64, now_ms: i64) {
        self.begin(now_ms);
        self.dropped.add(record, lost);
        self.crowded = Some(0);
    }

    /// The store has been at one job since the last look, or is at another one now.
    pub fn answers(&mut self, answers: bool, now_ms: i64) {
        if !answers {
            self.begin(now_ms);
        }
        self.is_silent = !answers;
        self.end_if_well();
    }

    /// A trial has written to every database and found room.
    pub fn proved(&mut self) {
        self.is_silent = false;
        self.troubles.retain(|_, trouble| !is_proved(trouble.cause));
        self.end_if_well();
    }

    /// A look, every ten seconds; returns `true` if a trial may end what is wrong.
    pub fn look(&mut self) -> bool {
        if let Some(quiet) = &mut self.crowded {
            *quiet += 1;
            if *quiet > QUIET_LOOKS {
                self.crowded = None;
            }
        }
        self.end_if_well();
        self.troubles
            .values()
            .any(|trouble| is_proved(trouble.cause))
    }

    /// The failure; `None` while all records are taken.
    pub fn failure(&self) -> Option<StoreFailure> {
        let (since_ms, before) = self.began?;
        let cause = self.gravest()?;
        Some(StoreFailure::new(
            cause,
            since_ms,
            self.dropped.since(&before),
        ))
    }

    /// Records dropped since the daemon began.
    pub fn dropped(&self) -> Dropped {
        self.dropped
    }

    /// Returns the change of condition since the last call; `None` if there is none.
    pub fn take_change(&mut self) -> Option<Change> {
        let failure = self.failure();
        let cause = failure.as_ref().map(|failure| failure.cause);
        if cause == self.told {
            return None;
        }
        self.told = cause;
        let Some(failure) = failure else {
            let (since_ms, dropped) = self.ended?;
            return Some(Change::Well { since_ms, dropped });
        };
        let detail = self.detail(failure.cause);
        Some(Change::Failing { failure, detail })
    }

    fn gravest(&self) -> Option<StoreCause> {
        let of_kinds = self.troubles.values().map(|trouble| trouble.cause);
        let silent = self.is_silent.then_some(StoreCause::Silent);
        let crowded = self.crowded.map(|_| StoreCause::TooSlow);
        of_kinds.chain(silent).chain(crowded).min()
    }

    fn detail(&self, cause: StoreCause) -> String {
        let mut troubles = self.troubles.values();
        let of_cause = troubles.find(|trouble| trouble.cause == cause);
        of_cause.map_or_else(String::new, |trouble| trouble.detail.clone())
    }

    fn begin(&mut self, now_ms: i64) {
        if self.began.is_none() {
            self.began = Some((now_ms, self.dropped));
        }
    }

    fn end_if_well(&mut self) {
        if self.gravest().is_none()
            && let Some((since_ms, before)) = self.began.take()
        {
            self.ended = Some((since_ms, self.dropped.since(&before)));
        }
    }
}

/// Causes that a trial of writing shows to be gone. Damage and faults of this program may lie in one kind of record alone.
fn is_proved(cause: StoreCause) -> bool {
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
        health.failed(Record::Windows, FULL, "/store/windows.db: full", 1, 1_000);
        let Some(Change::Failing { failure, detail }) = health.take_change() else {
            panic!("a failure is told");
        };
        assert_eq!(
            (failure.cause, failure.since_ms, detail.as_str()),
            (FULL, 1_000, "/store/windows.db: full")
        );
        // Events fit where windows do not.
        for record in [Record::Events, Record::State, Record::Telemetry] {
            health.written(record);
            assert_eq!(cause(&health), Some(FULL));
        }
        health.failed(Record::Windows, FULL, "", 1, 2_000);
        health.failed(Record::Audits, FULL, "", 1, 3_000);
        assert_eq!(health.take_change(), None, "told once");
        let failure = health.failure().unwrap();
        let dropped = Dropped {
            windows: 2,
            audits: 1,
            ..Dropped::default()
        };
        assert_eq!((failure.since_ms, failure.dropped), (1_000, dropped));
        health.written(Record::Windows);
        assert_eq!(cause(&health), Some(FULL), "the audit is not written yet");
        health.written(Record::Audits);
        let well = Change::Well {
            since_ms: 1_000,
            dropped,
        };
        assert_eq!((health.failure(), health.take_change()), (None, Some(well)));
        // The next failure counts anew, the daemon's own count goes on.
        health.failed(Record::Windows, FULL, "", 1, 9_000);
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
        health.failed(Record::Windows, FULL, "", 1, 0);
        health.failed(Record::State, StoreCause::Locked, "", 0, 0);
        assert!(health.look());
        health.proved();
        assert_eq!(health.failure(), None);
        health.failed(Record::Audits, StoreCause::Defect, "", 1, 0);
        assert!(
            !health.look(),
            "no trial shows that a fault of this program is gone"
        );
        health.proved();
        assert_eq!(cause(&health), Some(StoreCause::Defect));
        health.written(Record::Audits);
        assert_eq!(health.failure(), None);
    }

    #[test]
    fn a_store_is_fast_enough_again_after_a_minute_in_which_all_found_room() {
        let mut health = StoreHealth::default();
        health.found_no_room(Record::Windows, 1, 0);
        health.written(Record::Windows);
        for _ in 0..QUIET_LOOKS {
            health.look();
            assert_eq!(cause(&health), Some(StoreCause::TooSlow));
        }
        health.found_no_room(Record::Events, 1, 0);
        for _ in 0..QUIET_LOOKS {
            health.look();
        }
        let dropped = health.failure().unwrap().dropped;
        assert_eq!((dropped.windows, dropped.events), (1, 1));
        health.look();
        assert_eq!(health.failure(), None);
    }

    #[test]
    fn the_gravest_cause_is_told_and_each_change_of_it() {
        let mut health = StoreHealth::default();
        health.found_no_room(Record::Windows, 1, 0);
        health.answers(false, 10);
        assert_eq!(cause(&health), Some(StoreCause::Silent));
        assert!(matches!(health.take_change(), Some(Change::Failing { .. })));
        health.failed(Record::Windows, FULL, "", 1, 20);
        assert_eq!(cause(&health), Some(FULL));
        assert!(matches!(health.take_change(), Some(Change::Failing { .. })));
        assert_eq!(health.take_change(), None);
        assert_eq!(health.failure().unwrap().since_ms, 0);
    }
}
