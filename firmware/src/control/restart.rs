//! The one restart policy: when the bridge may be started, and after what it may not.
//!
//! | class of fault (ihd_shared::fault) | what follows |
//! |---|---|
//! | mains, or a condition that passes | a short pause, then again, as often as it takes |
//! | trip | a short pause, then a second that doubles each time, [`TRIES`] tries in all, then lock-out |
//! | the controller itself | lock-out at once |
//!
//! Every start passes [`RestartPolicy::permits`], from panel and host alike. A lock-out ends when a person switches off
//! and on at the panel, or takes the mains away; nothing that comes over the link ends it, brings a
//! try back or makes a pause shorter, a reset included ([`crate::retained::control`]). Ten seconds of power in one run give a try back:
//! off, a trip or a pot that goes begin it anew.

use ihd_shared::fault::{Fault, RestartClass};

use crate::limits::{
    GOOD_RUN_HALF_CYCLES, MAINS_PAUSE_MS, QUICK_PAUSE_MS, QUICK_PROBE_MS, SECOND_PAUSE_MS, TRIES,
};

/// Consequence of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RestartVerdict {
    /// Try again, once [`RestartPolicy::permits`] does.
    Pause,
    /// Only a person can go on.
    LockOut,
}

/// Tries used up, and pauses under way.
#[derive(Clone, Debug, Default)]
pub struct RestartPolicy {
    tries_used: u8,
    locked_out: bool,
    /// End of the pause under way, in milliseconds; `None` without one.
    not_before_ms: Option<u32>,
    /// Half-cycles with power since a trip, or since a try came back.
    good_half_cycles: u16,
}

impl RestartPolicy {
    /// The policy after a reset: as many tries are used up, and the last one's pause begins anew.
    pub fn restored(tries_used: u8, locked_out: bool, now_ms: u32) -> Self {
        let mut restored = Self {
            tries_used: tries_used.min(TRIES),
            locked_out,
            ..Self::default()
        };
        if let Some(last_try) = restored.tries_used.checked_sub(1) {
            restored.not_before(now_ms, pause_ms(last_try));
        }
        restored
    }

    /// Ends a pause that is over; to be called once a second or more often, as the clock's wrap would begin it again.
    pub fn pass_time(&mut self, now_ms: u32) {
        if self.not_before_ms.is_some_and(|at| is_reached(now_ms, at)) {
            self.not_before_ms = None;
        }
    }

    /// Returns `true` if the bridge may be started now.
    pub fn permits(&mut self, now_ms: u32) -> bool {
        self.pass_time(now_ms);
        !self.locked_out && self.not_before_ms.is_none()
    }

    /// Counts a start of the bridge to look for a pot: whatever becomes of it, the next one is not sooner than the next quick look.
    pub fn started(&mut self, now_ms: u32) {
        self.not_before(now_ms, QUICK_PROBE_MS);
    }

    /// Counts a fault.
    pub fn tripped(&mut self, fault: Fault, now_ms: u32) -> RestartVerdict {
        self.stopped();
        match fault.class() {
            RestartClass::Passing => self.not_before(now_ms, MAINS_PAUSE_MS),
            RestartClass::Trip if self.tries_used < TRIES => {
                self.not_before(now_ms, pause_ms(self.tries_used));
                self.tries_used += 1;
            }
            RestartClass::Trip | RestartClass::Standing => self.locked_out = true,
        }
        if self.locked_out {
            RestartVerdict::LockOut
        } else {
            RestartVerdict::Pause
        }
    }

    /// Counts a half-cycle in which a pot took power.
    pub fn heated(&mut self) {
        self.good_half_cycles += 1;
        if self.good_half_cycles >= GOOD_RUN_HALF_CYCLES {
            self.tries_used = self.tries_used.saturating_sub(1);
            self.stopped();
        }
    }

    /// Begins the run of good half-cycles anew: heating ended.
    pub fn stopped(&mut self) {
        self.good_half_cycles = 0;
    }

    /// Forgets tries and lock-out: a person switched off and on.
    pub fn forgive(&mut self) {
        *self = Self::default();
    }

    /// Returns `true` if only a person at the panel can end it.
    pub fn is_locked_out(&self) -> bool {
        self.locked_out
    }

    /// Starts after trips that are used up.
    pub fn tries_used(&self) -> u8 {
        self.tries_used
    }

    /// Starts after trips that are left.
    pub fn tries_left(&self) -> u8 {
        if self.locked_out {
            0
        } else {
            TRIES - self.tries_used
        }
    }

    /// Pauses for so long, or until the end of the pause under way if that is later.
    fn not_before(&mut self, now_ms: u32, pause_ms: u32) {
        let at = now_ms.wrapping_add(pause_ms);
        if self
            .not_before_ms
            .is_none_or(|before| is_reached(at, before))
        {
            self.not_before_ms = Some(at);
        }
    }
}

/// Pause before a try, the first being 0.
fn pause_ms(tries_used: u8) -> u32 {
    match tries_used.checked_sub(1) {
        None => QUICK_PAUSE_MS,
        Some(later) => SECOND_PAUSE_MS << later,
    }
}

/// Returns `true` if a time has come; the clock wraps after 49 days.
pub(crate) fn is_reached(now_ms: u32, at_ms: u32) -> bool {
    now_ms.wrapping_sub(at_ms) < 1 << 31
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Milliseconds from `from_ms` on until the bridge may be started.
    fn permitted_after(restart: &mut RestartPolicy, from_ms: u32) -> u32 {
        (0..)
            .find(|&ms| restart.permits(from_ms.wrapping_add(ms)))
            .expect("a pause ends")
    }

    #[test]
    fn four_tries_with_growing_pauses_then_nothing() {
        let mut restart = RestartPolicy::default();
        let mut now_ms = u32::MAX - 1_500;
        for pause_ms in [100, 1_000, 2_000, 4_000] {
            assert_eq!(
                restart.tripped(Fault::OVER_CURRENT, now_ms),
                RestartVerdict::Pause
            );
            assert_eq!(permitted_after(&mut restart, now_ms), pause_ms);
            now_ms = now_ms.wrapping_add(pause_ms);
        }
        assert_eq!(
            restart.tripped(Fault::OVER_CURRENT, now_ms),
            RestartVerdict::LockOut
        );
        assert!(!restart.permits(now_ms.wrapping_add(1_000_000)));
        restart.forgive();
        assert!(restart.permits(now_ms) && restart.tries_left() == TRIES);
    }

    #[test]
    fn each_good_run_gives_a_try_back_and_a_short_one_does_not() {
        let mut restart = RestartPolicy::default();
        restart.tripped(Fault::OVER_CURRENT, 0);
        restart.tripped(Fault::OVER_CURRENT, 500);
        for _ in 1..GOOD_RUN_HALF_CYCLES {
            restart.heated();
        }
        assert_eq!(restart.tries_left(), TRIES - 2);
        restart.heated();
        assert_eq!(restart.tries_left(), TRIES - 1);
        for _ in 1..GOOD_RUN_HALF_CYCLES {
            restart.heated();
        }
        assert_eq!(restart.tries_left(), TRIES - 1);
        restart.heated();
        assert_eq!(restart.tries_left(), TRIES);
    }

    /// A sensor that is wrong for a moment every eleven seconds never locks out, and is never waited for.
    #[test]
    fn rare_trips_cost_a_tenth_of_a_second_each() {
        let mut restart = RestartPolicy::default();
        for k in 0..1_000 {
            let now_ms = k * 11_000;
            let verdict = restart.tripped(Fault::SENSOR_OFFSET, now_ms);
            assert_eq!(verdict, RestartVerdict::Pause);
            assert_eq!(permitted_after(&mut restart, now_ms), QUICK_PAUSE_MS);
            for _ in 0..GOOD_RUN_HALF_CYCLES {
                restart.heated();
            }
        }
    }

    #[test]
    fn what_passes_counts_no_try_and_the_controllers_own_faults_have_none() {
        let mut restart = RestartPolicy::default();
        for k in 0..100 {
            let now_ms = k * 1_000;
            assert_eq!(
                restart.tripped(Fault::MAINS_LOST, now_ms),
                RestartVerdict::Pause
            );
            assert_eq!(permitted_after(&mut restart, now_ms), MAINS_PAUSE_MS);
        }
        assert_eq!(restart.tries_left(), TRIES);
        for fault in [
            Fault::OPTION_BYTES,
            Fault::FLASH_CRC,
            Fault::COMPARATOR_TEST,
        ] {
            let mut restart = RestartPolicy::default();
            assert_eq!(restart.tripped(fault, 100_000), RestartVerdict::LockOut);
        }
    }

    #[test]
    fn a_start_never_shortens_a_pause() {
        let mut restart = RestartPolicy::default();
        restart.tripped(Fault::OVER_CURRENT, 0);
        restart.started(10);
        assert_eq!(permitted_after(&mut restart, 0), 10 + QUICK_PROBE_MS);
        restart.tripped(Fault::OVER_CURRENT, 1_000);
        restart.started(1_010);
        assert_eq!(permitted_after(&mut restart, 1_000), SECOND_PAUSE_MS);
    }

    #[test]
    fn heating_that_stopped_between_is_no_good_run() {
        let mut restart = RestartPolicy::default();
        restart.tripped(Fault::OVER_CURRENT, 0);
        restart.heated();
        restart.stopped();
        for _ in 1..GOOD_RUN_HALF_CYCLES {
            restart.heated();
        }
        assert_eq!(restart.tries_left(), TRIES - 1);
        restart.heated();
        assert_eq!(restart.tries_left(), TRIES);
    }

    #[test]
    fn only_the_last_try_locks_out() {
        let mut restart = RestartPolicy::default();
        for k in 0..TRIES {
            assert!(!restart.is_locked_out());
            restart.tripped(Fault::OVER_CURRENT, 100_000 * u32::from(k));
        }
        assert!(!restart.is_locked_out());
        restart.tripped(Fault::OVER_CURRENT, 1_000_000);
        assert!(restart.is_locked_out() && restart.tries_left() == 0);
    }

    #[test]
    fn half_of_the_clock_lies_ahead() {
        assert!(is_reached(5, 5) && is_reached(4 + (1 << 31), 5));
        assert!(!is_reached(4, 5) && !is_reached(5 + (1 << 31), 5));
    }
}
