//! Mains zero crossings, from a converter that takes mains and bus in turn, one with each pair.

use ihd_shared::board::{ANTI_ALIAS_HZ, MAINS_POLE_HZ, SLOW_PIN_POLE_HZ};
use ihd_shared::sampling::ADC_LOCK_P;

use crate::sense::bus::SLOW_CODES;

/// The voltage must have been this far from zero, in codes, before a change of its sign counts: a
/// twelfth of the crest of 230 V on the range of [`MAINS_FULL_SCALE_MV`].
const ARMING_CODES: i32 = 140;

pub use ihd_shared::board::MAINS_FULL_SCALE_MV;

/// Half the input range of the mains voltage's channel, in volt.
pub const MAINS_FULL_SCALE_V: f64 = MAINS_FULL_SCALE_MV as f64 / 1e3;

/// Delay of the mains voltage behind the coil's channels by its filters, in nanoseconds: amplifier and pin, less the anti-alias filter.
pub const MAINS_DELAY_NS: u32 =
    delay_ns(MAINS_POLE_HZ) + delay_ns(SLOW_PIN_POLE_HZ) - delay_ns(ANTI_ALIAS_HZ);

/// Delay by a pole far above 50 Hz: 1/(2π f).
const fn delay_ns(pole_hz: u32) -> u32 {
    159_154_943 / pole_hz
}

/// Place of the newest mains code among the [`SLOW_CODES`], after half 0 or 1.
pub fn mains_place(half: usize) -> usize {
    if half == 0 {
        SLOW_CODES / 4 * 2 - 1
    } else {
        SLOW_CODES - 1
    }
}

/// Finds the zero crossings.
#[derive(Clone, Copy, Debug, Default)]
pub struct ZeroCrossingDetector {
    last: i32,
    /// Sign of the half-cycle that is going on, 0 before the first.
    sign: i32,
}

impl ZeroCrossingDetector {
    /// Takes a block's newest mains code, signed; returns the block's pair next to a zero crossing, if one fell into it. The voltage
    /// is late by [`MAINS_DELAY_NS`].
    ///
    /// A crossing is where a straight line through the last two codes crosses zero. A half-cycle
    /// that has not risen to `ARMING_CODES` cannot end: noise around zero gives one crossing.
    pub fn on_block(&mut self, code: i32) -> Option<u8> {
        let before = self.last;
        self.last = code;
        let armed = self.sign != 0;
        let crossed = armed && code.signum() * self.sign < 0;
        if crossed {
            self.sign = 0;
        } else if !armed && code.abs() >= ARMING_CODES {
            self.sign = code.signum();
        }
        if !crossed {
            return None;
        }
        let (from, span) = (before.abs(), before.abs() + code.abs());
        // |code| ≥ 1, so the span is. The codes were taken with pair 59 or 60 of a block ([`mains_place`]): the line begins 1½ pairs
        // before this block. Half a pair is added to round.
        let at = from * ADC_LOCK_P as i32 / span.max(1) - 1;
        Some(at.max(0) as u8)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// Crossings of a noisy 50 Hz sine, as times in blocks of 42.9 µs.
    fn crossings(noise: i32) -> Vec<f64> {
        let mut z = ZeroCrossingDetector::default();
        let mut found = Vec::new();
        let mut random = 1u32;
        for block in 0..2_400u32 {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let jitter = (random >> 16) as i32 % (2 * noise + 1) - noise;
            let t = f64::from(block + 1) * 42.857e-6;
            let code = 1_664.0 * (core::f64::consts::TAU * 50.0 * t + 0.3).sin();
            if let Some(at) = z.on_block(code as i32 + jitter) {
                found.push(f64::from(block) + f64::from(at) / 61.0);
            }
        }
        found
    }

    #[test]
    fn each_half_cycle_has_one_crossing_at_its_time() {
        for (noise, tolerance) in [(0, 0.05), (20, 1.5)] {
            let found = crossings(noise);
            assert_eq!(found.len(), 10, "noise {noise}: {found:?}");
            for pair in found.windows(2) {
                let distance = pair[1] - pair[0];
                assert!((distance - 233.33).abs() < tolerance, "{distance}");
            }
        }
    }

    /// Even places are the bus's, odd ones the mains's; none is of the other half.
    #[test]
    fn the_newest_code_of_a_half_is_its_own() {
        assert_eq!([0, 1].map(mains_place), [59, 121]);
    }

    #[test]
    fn noise_without_mains_is_no_crossing() {
        let mut z = ZeroCrossingDetector::default();
        for k in 0..1_000 {
            assert_eq!(z.on_block(if k % 2 == 0 { 100 } else { -100 }), None);
        }
    }
}
