//! Cooking time that nobody watches: each level uses up one allowance at its own pace ([`LEVELS`]), whoever requests the power.
//!
//! A touch of the panel gives the allowance back whole, and so does [`REST_MIN`] off without a break. A shorter off gives nothing back, so
//! that a host gains nothing by switching off and on; nothing else that a host sends counts. Once it is used up the hob is off as
//! if switched off at its panel.

use crate::limits::{LEVELS, PowerLevel, REST_MIN};

/// Parts of the allowance that a level with one minute would use in a millisecond: a level's minutes divide them.
const PARTS_PER_MS: u32 = 7_200;

/// The allowance, in such parts.
const ALLOWANCE: u32 = PARTS_PER_MS * 60_000;

/// Time off that gives it back, in milliseconds.
const REST_MS: u32 = REST_MIN as u32 * 60_000;

const _: () = {
    let mut i = 0;
    while i < LEVELS.len() {
        let minutes = LEVELS[i].unattended_min as u32;
        // An hour that is counted at once fits 32 bit.
        assert!(PARTS_PER_MS.is_multiple_of(minutes) && minutes >= 60);
        i += 1;
    }
};

/// Part of the allowance that is used up.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unattended {
    /// Used parts.
    used: u32,
    /// Time off without a break, in milliseconds, up to [`REST_MS`].
    rested_ms: u32,
}

impl Unattended {
    /// Returns the time after a reset, of which as much is used up as before; a rest begins anew.
    pub fn restored(used_share: u8) -> Self {
        Self {
            used: u32::from(used_share) * (ALLOWANCE / 255),
            rested_ms: 0,
        }
    }

    /// Used share of the allowance, of 255, rounded up.
    pub fn used_share(&self) -> u8 {
        u8::try_from(self.used.div_ceil(ALLOWANCE / 255)).unwrap_or(u8::MAX)
    }

    /// Returns `true` once the allowance is used up.
    pub fn is_used_up(&self) -> bool {
        self.used == ALLOWANCE
    }

    /// Counts time at a requested power, an hour at most.
    pub fn count(&mut self, asked_w: u16, elapsed_ms: u32) {
        if let Some(level) = PowerLevel::of_power(asked_w) {
            let per_ms = PARTS_PER_MS / u32::from(level.unattended_min);
            self.used = (self.used + elapsed_ms * per_ms).min(ALLOWANCE);
            self.rested_ms = 0;
        } else {
            self.rested_ms = (self.rested_ms + elapsed_ms).min(REST_MS);
            if self.rested_ms == REST_MS {
                self.used = 0;
            }
        }
    }

    /// Gives the allowance back whole: a person has touched the panel.
    pub fn touched(&mut self) {
        self.used = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MINUTE_MS: u32 = 60_000;

    /// Minutes until the allowance is used up.
    fn minutes_at(unattended: &mut Unattended, asked_w: u16) -> u32 {
        let mut seconds: u32 = 0;
        while !unattended.is_used_up() {
            unattended.count(asked_w, 1_000);
            seconds += 1;
        }
        seconds.div_ceil(60)
    }

    #[test]
    fn each_level_has_its_time() {
        for level in LEVELS {
            let minutes = minutes_at(&mut Unattended::default(), level.power_w);
            assert_eq!(minutes, u32::from(level.unattended_min), "{level:?}");
        }
    }

    /// A millisecond at a time, as the hob counts, is the same as minutes.
    #[test]
    fn no_millisecond_is_lost_or_rounded_up() {
        for level in LEVELS {
            let (mut fine, mut coarse) = (Unattended::default(), Unattended::default());
            for _ in 0..MINUTE_MS {
                fine.count(level.power_w, 1);
            }
            coarse.count(level.power_w, MINUTE_MS);
            assert_eq!(fine.used, coarse.used, "{level:?}");
            assert_eq!(coarse.used * u32::from(level.unattended_min), ALLOWANCE);
        }
    }

    /// A change of the power takes what is left along, as its share.
    #[test]
    fn another_power_begins_no_time_anew() {
        let [first, .., last] = LEVELS;
        let mut unattended = Unattended::default();
        let half_ms = u32::from(last.unattended_min) * MINUTE_MS / 2;
        unattended.count(last.power_w, half_ms);
        let minutes = minutes_at(&mut unattended, first.power_w);
        assert_eq!(minutes, u32::from(first.unattended_min) / 2);
        unattended.touched();
        let minutes = minutes_at(&mut unattended, last.power_w);
        assert_eq!(minutes, u32::from(last.unattended_min));
    }

    /// However a host switches off and on, each level is on for its time and no longer; only an hour off without a break gives it back.
    #[test]
    fn switching_off_and_on_gains_nothing() {
        for level in LEVELS {
            for (on_s, off_s) in [(1, 1), (60, 60), (60, 3_599), (600, 61), (1_800, 1_800)] {
                let mut unattended = Unattended::default();
                let mut on_for_s = 0;
                while !unattended.is_used_up() {
                    assert!(on_for_s <= 36_000, "{level:?}, {on_s} s on, {off_s} s off");
                    unattended.count(level.power_w, on_s * 1_000);
                    unattended.count(0, off_s * 1_000);
                    on_for_s += on_s;
                }
                let whole_s = u32::from(level.unattended_min) * 60;
                assert_eq!(on_for_s, whole_s.next_multiple_of(on_s), "{level:?}");
            }
        }
    }

    #[test]
    fn an_hour_off_without_a_break_gives_the_whole_time_back() {
        let [.., last] = LEVELS;
        let mut unattended = Unattended::default();
        unattended.count(last.power_w, 59 * MINUTE_MS);
        unattended.count(0, REST_MS - 1);
        unattended.count(last.power_w, 1);
        unattended.count(0, REST_MS - 1);
        assert!(unattended.used_share() > 250);
        unattended.count(0, 1);
        assert_eq!(unattended.used_share(), 0);
    }

    #[test]
    fn a_reset_gives_nothing_back() {
        for used in [0, 1, ALLOWANCE / 3, ALLOWANCE - 1, ALLOWANCE] {
            let after = Unattended::restored(Unattended { used, rested_ms: 0 }.used_share());
            assert!(after.used >= used.min(ALLOWANCE / 255 * 255));
            assert!(after.used - used.min(after.used) <= ALLOWANCE / 255);
        }
        assert_eq!(Unattended::default().used_share(), 0);
    }

    #[test]
    fn the_longest_time_that_is_counted_at_once_fits() {
        let [first, .., last] = LEVELS;
        let mut unattended = Unattended::default();
        unattended.count(first.power_w, 60 * MINUTE_MS);
        assert_eq!(unattended.used, ALLOWANCE / 10);
        unattended.count(last.power_w, 60 * MINUTE_MS);
        assert!(unattended.is_used_up());
        unattended.count(0, 60 * MINUTE_MS);
        assert_eq!(unattended.used, 0);
    }
}
