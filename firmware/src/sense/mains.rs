//! Mains zero crossings and bus voltage, from a converter that takes the two in turn, one with each pair.

use core::array;

use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q};

/// The voltage must have been this far from zero, in codes, before a change of its sign counts: a
/// twelfth of the crest of 230 V on the range of [`MAINS_FULL_SCALE_MV`].
const ARMING_CODES: i32 = 140;

pub use ihd_shared::board::{BUS_FULL_SCALE_DV as BUS_DV_FULL_SCALE, MAINS_FULL_SCALE_MV};

/// Half the input range of the mains voltage's channel, in volt.
pub const MAINS_FULL_SCALE_V: f64 = MAINS_FULL_SCALE_MV as f64 / 1e3;

/// Codes of the bus, and of the mains, in turn: those of two blocks, since a block has an odd number of pairs.
pub const SLOW_CODES: usize = 2 * ADC_LOCK_P;

/// Codes of the bus in a mean; four pairs apart they cover a switching period to 2 %, so that its ripple cancels.
pub const BUS_MEAN: usize = 5;
const BUS_STEP: usize = 4;
const _: () = assert!(BUS_MEAN * BUS_STEP == ADC_LOCK_P / ADC_LOCK_Q as usize);

/// Places of the last period's bus codes among the [`SLOW_CODES`], after half 0 or 1; the last one is the newest.
pub fn bus_places(half: usize) -> [usize; BUS_MEAN] {
    let newest = (SLOW_CODES / 2 * (half + 1) - 1) & !1;
    array::from_fn(|k| newest - (BUS_MEAN - 1 - k) * BUS_STEP)
}

/// Place of the newest mains code among the [`SLOW_CODES`], after half 0 or 1.
pub fn mains_place(half: usize) -> usize {
    (SLOW_CODES / 2 * (half + 1)) / 2 * 2 - 1
}

/// Mean of a period's bus codes, rounded.
pub fn mean_bus_code(codes: [u16; BUS_MEAN]) -> u16 {
    let sum: u32 = codes.into_iter().map(u32::from).sum();
    ((sum + BUS_MEAN as u32 / 2) / BUS_MEAN as u32) as u16
}

/// Bus voltage of a code, in decivolt.
pub fn bus_dv(code: u16) -> u16 {
    (u32::from(code) * BUS_DV_FULL_SCALE / 4_096) as u16
}

/// Finds the zero crossings.
#[derive(Clone, Copy, Debug, Default)]
pub struct ZeroCrossingDetector {
    last: i32,
    /// Sign of the half-cycle that is going on, 0 before the first.
    sign: i32,
}

impl ZeroCrossingDetector {
    /// Takes the mains voltage at the end of a block, as a signed code; the index of the block's
    /// first pair after a zero crossing, if one fell into it.
    ///
    /// A crossing is where a straight line through the last two samples crosses zero. A half-cycle
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
        // |code| ≥ 1, so the span is; before may be zero, when it crossed at the block's beginning.
        let pairs = ADC_LOCK_P as i32;
        let at = (from * pairs + span - 1) / span.max(1);
        Some(at.min(pairs - 1) as u8)
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
    fn the_newest_codes_of_a_half_are_its_own() {
        assert_eq!(bus_places(0), [44, 48, 52, 56, 60]);
        assert_eq!(bus_places(1), [104, 108, 112, 116, 120]);
        assert_eq!([0, 1].map(mains_place), [59, 121]);
    }

    /// A ripple of the switching frequency, 61/3 pairs long, of 100 codes at any phase: a single code errs by all of it. Five
    /// equal steps over .984 of a period leave sin(.984 π) / (5 sin(.984 π/5)) of it, 1.8 %, and half a code of rounding.
    #[test]
    fn the_ripple_of_the_switching_frequency_cancels() {
        for half in [0, 1] {
            for phase in 0..24 {
                let codes = bus_places(half).map(|place| {
                    let periods = place as f64 * 3.0 / 61.0 + f64::from(phase) / 24.0;
                    (2_000.0 + 100.0 * (core::f64::consts::TAU * periods).sin()).round() as u16
                });
                let error = i32::from(mean_bus_code(codes)) - 2_000;
                assert!(error.abs() <= 3, "{half} {phase}: {error}");
            }
        }
    }

    #[test]
    fn noise_without_mains_is_no_crossing() {
        let mut z = ZeroCrossingDetector::default();
        for k in 0..1_000 {
            assert_eq!(z.on_block(if k % 2 == 0 { 100 } else { -100 }), None);
        }
    }
}
