//! Times of cooking: without a touch of the panel, of the boost, and of the timer.
//!
//! Each millisecond counts for the request that stands in it. Counted once a second, a host that is off in that moment alone would
//! use nothing up.

use ihd_shared::wire::messages::OffReason;

use crate::control::unattended::Unattended;
use crate::limits::{BOOST_MIN, LEVELS};

/// Longest time that is counted at once, which keeps products within 32 bit.
pub const COUNTED_AT_ONCE_MS: u32 = 3_600_000;

/// Power of the level below the highest, in watt: what is left of a boost that is over.
pub const BELOW_BOOST_W: u16 = LEVELS[LEVELS.len() - 2].power_w;

/// The times, and the clock's count up to which they are counted.
#[derive(Clone, Copy, Debug, Default)]
pub struct CookingTimes {
    counted_ms: u32,
    /// Time without a touch of the panel.
    pub unattended: Unattended,
    /// Time above the second-highest level.
    pub boost: Boost,
    /// The timer.
    pub timer: Timer,
}

impl CookingTimes {
    /// Times after a reset, of which a share of the unattended one is used up; a boost may have been, too.
    pub fn restored(unattended_share: u8, now_ms: u32) -> Self {
        let was_on = unattended_share > 0;
        Self {
            counted_ms: now_ms,
            unattended: Unattended::restored(unattended_share),
            boost: if was_on {
                Boost::USED_UP
            } else {
                Boost::default()
            },
            timer: Timer::default(),
        }
    }

    /// Takes the clock after each block; returns the time to be counted, in milliseconds, mostly 0.
    pub fn elapsed_ms(&mut self, now_ms: u32) -> u32 {
        let elapsed_ms = now_ms.wrapping_sub(self.counted_ms);
        self.counted_ms = now_ms;
        elapsed_ms.min(COUNTED_AT_ONCE_MS)
    }

    /// Counts time at a requested power, with a pot that is heated or not; returns the reason to switch off, if there is one.
    pub fn count(&mut self, asked_w: u16, heats: bool, elapsed_ms: u32) -> OffReason {
        self.unattended.count(asked_w, elapsed_ms);
        self.boost.count(asked_w, heats, elapsed_ms);
        let timer_ends = self.timer.ends(elapsed_ms);
        if timer_ends {
            OffReason::Timer
        } else if asked_w > 0 && self.unattended.is_used_up() {
            OffReason::Unattended
        } else {
            OffReason::None
        }
    }
}

/// Time above the second-highest level: [`BOOST_MIN`] at most, and as long below it until the next whole one.
#[derive(Clone, Copy, Debug, Default)]
pub struct Boost {
    used_ms: u32,
    over: bool,
}

impl Boost {
    const WHOLE_MS: u32 = BOOST_MIN as u32 * 60_000;

    const USED_UP: Self = Self {
        used_ms: Self::WHOLE_MS,
        over: true,
    };

    fn count(&mut self, asked_w: u16, heats: bool, elapsed_ms: u32) {
        let asks = asked_w > BELOW_BOOST_W;
        if asks && heats && !self.over {
            self.used_ms = (self.used_ms + elapsed_ms).min(Self::WHOLE_MS);
            self.over = self.used_ms == Self::WHOLE_MS;
        } else {
            self.used_ms = self.used_ms.saturating_sub(elapsed_ms);
            // A request that stands is not boosted anew.
            self.over &= asks || self.used_ms > 0;
        }
    }

    /// Returns `true` if no more than [`BELOW_BOOST_W`] is given.
    pub fn is_over(&self) -> bool {
        self.over
    }
}

/// Timer that switches off.
#[derive(Clone, Copy, Debug, Default)]
pub struct Timer {
    /// Time left, in milliseconds; 0 without a timer.
    left_ms: u32,
}

impl Timer {
    /// Sets it; 0 for none.
    pub fn set(&mut self, minutes: u8) {
        self.left_ms = u32::from(minutes) * 60_000;
    }

    /// Time left in minutes, rounded up; 0 without a timer.
    pub fn left_min(&self) -> u8 {
        self.left_ms.div_ceil(60_000) as u8
    }

    /// Counts, with or without power, as a host may be off for a second; returns `true` if it ends.
    fn ends(&mut self, elapsed_ms: u32) -> bool {
        let ran = self.left_ms > 0;
        self.left_ms = self.left_ms.saturating_sub(elapsed_ms);
        ran && self.left_ms == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ihd_shared::hob::RATED_POWER_W;

    const WHOLE_S: u32 = Boost::WHOLE_MS / 1_000;

    /// Seconds of so many that were boosted.
    fn boosted_s(boost: &mut Boost, asked_w: u16, seconds: u32) -> u32 {
        let mut boosted = 0;
        for _ in 0..seconds {
            boost.count(asked_w, true, 1_000);
            boosted += u32::from(!boost.is_over());
        }
        boosted
    }

    #[test]
    fn a_boost_lasts_its_time_and_comes_back_when_asked_anew() {
        let mut boost = Boost::default();
        let standing = boosted_s(&mut boost, RATED_POWER_W, 10 * WHOLE_S);
        assert_eq!(standing, WHOLE_S - 1);
        boosted_s(&mut boost, BELOW_BOOST_W, 1);
        assert_eq!(boosted_s(&mut boost, RATED_POWER_W, 60), 60);
    }

    /// However it is asked for, never more than half of the time.
    #[test]
    fn toggling_gives_no_more_boost_than_rest() {
        for (on_s, off_s) in [(1, 1), (59, 1), (600, 1), (600, 600), (30, 60)] {
            let mut boost = Boost::default();
            let (mut boosted, mut all) = (0, 0);
            while all < 20 * WHOLE_S {
                boosted += boosted_s(&mut boost, BELOW_BOOST_W + 1, on_s);
                boosted_s(&mut boost, 0, off_s);
                all += on_s + off_s;
            }
            let most = all / 2 + WHOLE_S;
            assert!(boosted <= most, "{on_s} {off_s}: {boosted} of {all} s");
        }
    }

    #[test]
    fn a_reset_gives_no_new_boost() {
        let mut times = CookingTimes::default();
        for seconds in 0..WHOLE_S {
            assert!(!times.boost.is_over(), "{seconds} s");
            times.count(RATED_POWER_W, true, 1_000);
            let after = CookingTimes::restored(times.unattended.used_share(), 0);
            assert!(after.boost.is_over(), "{seconds} s");
        }
        assert!(!CookingTimes::restored(0, 0).boost.is_over());
    }

    #[test]
    fn waiting_for_a_pot_is_no_boost() {
        let mut boost = Boost::default();
        boost.count(RATED_POWER_W, false, 2 * WHOLE_S * 1_000);
        assert!(!boost.is_over());
    }

    #[test]
    fn the_timer_ends_once_with_or_without_power() {
        let mut timer = Timer::default();
        assert!(!timer.ends(1_000));
        timer.set(2);
        assert!(!timer.ends(119_000));
        assert_eq!(timer.left_min(), 1);
        assert!(timer.ends(5_000));
        assert!(!timer.ends(5_000));
        timer.set(u8::MAX);
        assert_eq!(timer.left_min(), u8::MAX);
        assert!(!timer.ends(3_600_000));
        assert_eq!(timer.left_min(), 195);
    }

    /// The clock wraps after 49 days.
    #[test]
    fn each_millisecond_is_counted_once() {
        let mut times = CookingTimes::restored(0, u32::MAX - 1_500);
        let mut counted = 0;
        for ms in (0..10_000_u32).step_by(7).flat_map(|ms| [ms, ms]) {
            counted += times.elapsed_ms((u32::MAX - 1_500).wrapping_add(ms));
        }
        assert_eq!(counted, 9_996);
        assert_eq!(times.elapsed_ms(u32::MAX / 2), COUNTED_AT_ONCE_MS);
    }
}
