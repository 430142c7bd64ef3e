//! The main clock against the low-speed oscillator, which is one of its own and the watchdog's.

use crate::drive::pwm::CORE_HZ;

/// Frequency of the timer that captures, in hertz.
pub const COUNTS_PER_S: u32 = CORE_HZ / 4;

/// Periods of the low-speed oscillator from one capture to the next.
pub const PERIODS: u32 = 8;

/// Nominal frequency of the low-speed oscillator, in hertz (DS12288: 31.04 to 32.96 kHz at 30 °C).
const LSI_HZ: u32 = 32_000;

const NOMINAL: u32 = COUNTS_PER_S * PERIODS / LSI_HZ;

/// Counts between two captures that two sound oscillators may have: −8 % to +9.8 %. Over all temperatures and supplies the
/// low-speed one is 29.5 to 34 kHz (DS12288, LSI), which is +8.5 to −5.9 % of counts, and HSI16 ±1 % from 0 to 85 °C. Narrow
/// enough to find 10 % of either.
const MIN_COUNTS: u32 = NOMINAL * 920 / 1_000;
const MAX_COUNTS: u32 = NOMINAL * 1_098 / 1_000;

/// Captures that were late in a row, or a measurement that was out of limits, before the verdict: a capture can be
/// overtaken while an interrupt runs.
const MAX_BAD_CAPTURES: u8 = 4;

/// Capture of the timer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockCapture {
    /// Nothing new.
    Nothing,
    /// The counter at an edge.
    At(u16),
    /// An edge, and one before it that was not taken.
    Overtaken,
}

/// Measures intervals between captures, one a call.
#[derive(Clone, Copy, Debug, Default)]
pub struct ClockCheck {
    first: Option<u16>,
    wrong: u8,
    polls: u32,
}

impl ClockCheck {
    /// Takes what the timer shows; once an interval is known, or `patience` polls have passed without one, returns `true` if the
    /// two clocks agree.
    pub fn take(&mut self, captured: ClockCapture, patience: u32) -> Option<bool> {
        self.polls += 1;
        let verdict = match (captured, self.first) {
            (ClockCapture::At(second), Some(first)) => {
                self.first = Some(second);
                Some(agree(second.wrapping_sub(first)))
            }
            (ClockCapture::At(first), None) => {
                self.first = Some(first);
                None
            }
            (ClockCapture::Overtaken, _) => {
                self.first = None;
                None
            }
            (ClockCapture::Nothing, _) => None,
        };
        match verdict {
            Some(true) => {
                *self = Self::default();
                Some(true)
            }
            Some(false) if self.wrong + 1 < MAX_BAD_CAPTURES => {
                self.wrong += 1;
                None
            }
            Some(false) => {
                *self = Self::default();
                Some(false)
            }
            None if self.polls >= patience => {
                *self = Self::default();
                Some(false)
            }
            None => None,
        }
    }
}

fn agree(counts: u16) -> bool {
    (MIN_COUNTS..=MAX_COUNTS).contains(&u32::from(counts))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Captures of an oscillator at `lsi_hz` with a main clock that is `main` times too fast.
    fn verdict(lsi_hz: f64, main: f64) -> Option<bool> {
        let counts = f64::from(COUNTS_PER_S) * main * f64::from(PERIODS) / lsi_hz;
        let mut check = ClockCheck::default();
        (0..20u32).find_map(|k| {
            let at = (60_000.0 + f64::from(k) * counts) as u64 as u16;
            check.take(ClockCapture::At(at), 100)
        })
    }

    #[test]
    fn the_tolerances_of_both_pass_and_ten_percent_of_either_do_not() {
        for lsi_hz in [29_500.0, 31_040.0, 32_000.0, 32_960.0, 34_000.0] {
            for main in [0.99, 1.0, 1.01] {
                assert_eq!(verdict(lsi_hz, main), Some(true), "{lsi_hz} {main}");
            }
        }
        for (lsi_hz, main) in [(28_800.0, 1.0), (35_200.0, 1.0), (32e3, 1.1), (32e3, 0.9)] {
            assert_eq!(verdict(lsi_hz, main), Some(false), "{lsi_hz} {main}");
        }
        // Half and twice do not come round the 16 bits to where they would pass.
        for lsi_hz in [8_000.0, 16_000.0, 64_000.0] {
            assert_eq!(verdict(lsi_hz, 1.0), Some(false), "{lsi_hz}");
        }
    }

    #[test]
    fn an_oscillator_that_stands_still_is_found_and_an_overtaken_capture_is_none() {
        let mut check = ClockCheck::default();
        let polls = (1..).find(|_| check.take(ClockCapture::Nothing, 50).is_some());
        assert_eq!(polls, Some(50));
        let mut check = ClockCheck::default();
        assert_eq!(check.take(ClockCapture::At(0), 50), None);
        assert_eq!(check.take(ClockCapture::Overtaken, 50), None);
        assert_eq!(check.take(ClockCapture::At(30_000), 50), None);
        assert_eq!(check.take(ClockCapture::At(40_625), 50), Some(true));
    }
}
