//! The active lookup: what power control uses, and the one that takes its place at the next half-cycle.

use core::ops::Deref;

use ihd_shared::lookup::prior::prior;
use ihd_shared::lookup::{LOOKUP_VERSION_STEP, RlLookup};
use ihd_shared::wire::messages::Outcome;

use crate::self_test::guarded::GuardedLookup;

/// The active lookup, read like one, and its successor.
pub struct ActiveLookup {
    active: GuardedLookup,
    pending: Option<RlLookup>,
    /// Lookups that became active since boot.
    changes: u32,
}

impl Default for ActiveLookup {
    /// The built-in prior.
    fn default() -> Self {
        Self {
            active: GuardedLookup::new(prior()),
            pending: None,
            changes: 0,
        }
    }
}

impl ActiveLookup {
    /// Starts from a lookup that was kept, in place of the prior. Version 0 marks a
    /// reset lookup: this build's prior stays, which may be a newer one.
    pub fn restore(&mut self, lookup: RlLookup) {
        if lookup.version > 0 {
            self.active = GuardedLookup::new(lookup);
        }
    }

    /// Returns `true` if the lookup in use is unchanged since it became active (a self-test).
    pub fn is_intact(&self) -> bool {
        self.active.is_intact()
    }

    /// Number of times that another lookup became active since boot.
    pub fn changes(&self) -> u32 {
        self.changes
    }

    /// Checks and accepts the bytes of a lookup. Returns outcome and detail.
    // In the caller's frame, which has room for a lookup anyway: the stack is scarce.
    #[inline(always)]
    pub fn push(&mut self, bytes: &[u8]) -> (Outcome, u32) {
        match RlLookup::from_bytes(bytes) {
            Ok(lookup) => self.accept(lookup),
            Err(why) => why.outcome(),
        }
    }

    /// Accepts a lookup that passed every check of its content; it must still be newer than the active one, and
    /// leave room for later ones. Returns outcome and detail.
    fn accept(&mut self, lookup: RlLookup) -> (Outcome, u32) {
        let highest = self.active.version.saturating_add(LOOKUP_VERSION_STEP);
        if self.pending.is_some() {
            (Outcome::Busy, 0)
        } else if lookup.version <= self.active.version {
            (Outcome::LookupStale, self.active.version)
        } else if lookup.version > highest {
            (Outcome::LookupStep, highest)
        } else {
            self.replace(lookup)
        }
    }

    /// Replaces the active lookup at the half-cycle boundary, so that one half-cycle sees one lookup, or while nothing uses it. Returns
    /// outcome and detail.
    pub fn replace(&mut self, lookup: RlLookup) -> (Outcome, u32) {
        if self.pending.is_some() {
            return (Outcome::Busy, 0);
        }
        self.pending = Some(lookup);
        (Outcome::Ok, 0)
    }

    /// Returns `true` if a successor waits.
    pub fn has_successor(&self) -> bool {
        self.pending.is_some()
    }

    /// Activates a successor at a half-cycle boundary, or while nothing uses a lookup; returns its version, `None` if there is none.
    pub fn activate(&mut self) -> Option<u32> {
        let lookup = self.pending.take()?;
        let version = lookup.version;
        // One that is repeated wears no flash.
        self.changes = self.changes.wrapping_add(u32::from(lookup != *self.active));
        self.active = GuardedLookup::new(lookup);
        Some(version)
    }
}

impl Deref for ActiveLookup {
    type Target = RlLookup;

    fn deref(&self) -> &RlLookup {
        &self.active
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn version(version: u32) -> RlLookup {
        RlLookup { version, ..prior() }
    }

    #[test]
    fn a_lookup_becomes_active_at_the_half_cycle_and_only_if_it_is_newer() {
        let mut active = ActiveLookup::default();
        assert_eq!(active.accept(version(5)), (Outcome::Ok, 0));
        assert_eq!(active.version, 0);
        assert_eq!(active.accept(version(6)), (Outcome::Busy, 0));
        assert_eq!(active.activate(), Some(5));
        assert_eq!((active.version, active.changes()), (5, 1));
        assert_eq!(active.activate(), None);
        assert_eq!(active.accept(version(5)), (Outcome::LookupStale, 5));
        let highest = 5 + LOOKUP_VERSION_STEP;
        let beyond = active.accept(version(highest + 1));
        assert_eq!(beyond, (Outcome::LookupStep, highest));
        assert_eq!(active.accept(version(highest)), (Outcome::Ok, 0));
    }

    /// Each change is written to flash, whose pages bear ten thousand.
    #[test]
    fn a_reset_that_is_repeated_changes_nothing() {
        let mut active = ActiveLookup::default();
        active.restore(version(9));
        for _ in 0..100 {
            assert_eq!(active.replace(prior()), (Outcome::Ok, 0));
            assert_eq!(active.activate(), Some(0));
        }
        assert_eq!(active.changes(), 1);
    }

    #[test]
    fn a_kept_lookup_of_version_zero_leaves_the_prior() {
        let mut active = ActiveLookup::default();
        active.restore(version(0));
        assert_eq!((active.version, active.changes()), (0, 0));
        active.restore(version(9));
        assert_eq!((active.version, active.is_intact()), (9, true));
    }
}
