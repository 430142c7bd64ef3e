//! Cooking time that nobody watches: each level uses up one allowance at its own pace ([`LEVELS`]), whoever requests the power.
//!
//! A touch of the panel gives the allowance back whole. Off gives it back in [`REST_MIN`], so that a host gains nothing by switching
//! off and on; nothing else that a host sends counts. Once it is used up the hob is off as if switched off at its panel.

use crate::limits::{LEVELS, PowerLevel, REST_MIN};

/// The allowance, in milliseconds of level 1.
const ALLOWANCE: u32 = LEVELS[0].unattended_min as u32 * 60_000;

/// Part of the allowance that is used up.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unattended {
    /// Used time, in milliseconds of level 1.
    used: u32,
}

impl Unattended {
    /// Returns the time after a reset, of which as much is used up as before.
    pub fn restored(used_share: u8) -> Self {
        Self {
            used: u32::from(used_share) * (ALLOWANCE / 255),
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
    pub fn count(&mut self, asked_w: u16, elapsed_s: u32) {
        let of_whole = |minutes: u16| (elapsed_s * (ALLOWANCE / 60)).div_ceil(u32::from(minutes));
        self.used = match PowerLevel::of_power(asked_w) {
            Some(level) => self.used.saturating_add(of_whole(level.unattended_min)),
            None => self.used.saturating_sub(of_whole(REST_MIN)),
        }
        .min(ALLOWANCE);
    }

    /// A person touched the panel.
    pub fn touched(&mut self) {
        self.used = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Minutes until the allowance is used up.
    fn minutes_at(unattended: &mut Unattended, asked_w: u16) -> u32 {
        let mut seconds: u32 = 0;
        while !unattended.is_used_up() {
            unattended.count(asked_w, 1);
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

    /// A change of the power takes what is left along, as its share.
    #[test]
    fn another_power_begins_no_time_anew() {
        let [first, .., last] = LEVELS;
        let mut unattended = Unattended::default();
        unattended.count(last.power_w, u32::from(last.unattended_min) * 30);
        let minutes = minutes_at(&mut unattended, first.power_w);
        assert_eq!(minutes, u32::from(first.unattended_min) / 2);
        unattended.touched();
        let minutes = minutes_at(&mut unattended, last.power_w);
        assert_eq!(minutes, u32::from(last.unattended_min));
    }

    /// Off for a second now and then gives seconds back.
    #[test]
    fn toggling_gains_no_more_than_the_time_off() {
        let [.., last] = LEVELS;
        let mut unattended = Unattended::default();
        let whole_s = u32::from(last.unattended_min) * 60;
        let (mut on_s, mut off_s) = (60, 0);
        unattended.count(last.power_w, 60);
        while on_s < 2 * whole_s && !unattended.is_used_up() {
            unattended.count(0, 1);
            unattended.count(last.power_w, 60);
            (on_s, off_s) = (on_s + 60, off_s + 1);
        }
        assert!((whole_s..whole_s + 60).contains(&(on_s - off_s)), "{on_s}");
    }

    #[test]
    fn a_reset_gives_nothing_back() {
        for used in [0, 1, ALLOWANCE / 3, ALLOWANCE - 1, ALLOWANCE] {
            let after = Unattended::restored(Unattended { used }.used_share());
            assert!(after.used >= used.min(ALLOWANCE / 255 * 255));
            assert!(after.used - used.min(after.used) <= ALLOWANCE / 255);
        }
        assert_eq!(Unattended::default().used_share(), 0);
    }

    #[test]
    fn the_longest_time_that_is_counted_at_once_fits() {
        let [first, .., last] = LEVELS;
        let mut unattended = Unattended::default();
        unattended.count(first.power_w, 3_600);
        assert_eq!(unattended.used, ALLOWANCE / 10);
        unattended.count(last.power_w, 3_600);
        assert!(unattended.is_used_up());
        unattended.count(0, 3_600);
        assert_eq!(unattended.used, 0);
    }
}
