//! Demodulator: sample pairs in, phasors of the fundamental out, one per block.
//!
//! The block's correlation ([`crate::sense::correlation`]) passes two boxcars over N blocks (0.2 ms each); their kernel is a
//! triangle whose centre lies N − 1 blocks back. V and I pass the same kernel, so that V = (R + jωL) I + L dI/dt
//! survives it.
//!
//! Budget: per block the boxcars add eight 64-bit
//! additions and four scalings. Sums are exact integers: nothing drifts.

use ihd_shared::sampling::{
    ADC_LOCK_P, ADC_LOCK_Q, CODE_HALF_RANGE, I_FULL_SCALE_MA, V_FULL_SCALE_MV,
};

use crate::fixed::{Complex, narrow_within, saturate};
use crate::sense::correlation::{BlockSums, TABLE_BITS};

/// One ampere unit of the estimator is 16 A, one volt unit 32 V, one ohm unit 2 ohm; all states
/// are mantissas of 26 fractional bits in these units, so ±512 A, ±1024 V, ±64 ohm.
pub const STATE_BITS: u32 = 26;

/// Ampere per estimator unit of current.
pub const AMPERE_PER_UNIT: f64 = 16.0;

/// Volt per estimator unit of voltage.
pub const VOLT_PER_UNIT: f64 = 32.0;

/// Ohm per estimator unit of impedance.
pub const OHM_PER_UNIT: f64 = VOLT_PER_UNIT / AMPERE_PER_UNIT;

/// Fractional bits of the scaling mantissas: the largest, of one block and the largest full scale, stays below 2^28.
const GAIN_BITS: u32 = 26;

/// Sums of p·2^25·N² times a gain of 2^26·128/(p·N²) are 58 bits, whatever N. The ranges of boards/src/values.rs keep it.
const _: () = assert!(V_FULL_SCALE_MV < 1_024_000 && I_FULL_SCALE_MA < 512_000);

/// Most blocks of a boxcar: 0.2 ms at 80 kHz are 5.3.
pub const MAX_BOXCAR: usize = 6;

/// Scale of the sums of V and I behind boxcars of N blocks, N from 1: amplitude = 2/p · mean over N² sums.
/// At compile time, as a crossing with another frequency has no time for divisions of 64 bit.
static GAINS: [(i32, i32); MAX_BOXCAR] = {
    /// Twice the estimator's units per code, times what the table's bits fall short of the state's, over p·N².
    const fn gain(full_scale_milli: u32, per_unit: f64, n: u128) -> i32 {
        let bits = 1 + STATE_BITS - TABLE_BITS + GAIN_BITS;
        let codes = CODE_HALF_RANGE as u128 * per_unit as u128 * 1_000;
        let divisor = codes * ADC_LOCK_P as u128 * n * n;
        ((((full_scale_milli as u128) << bits) + divisor / 2) / divisor) as i32
    }
    let mut gains = [(0, 0); MAX_BOXCAR];
    let mut n = 1;
    while n <= MAX_BOXCAR {
        gains[n - 1] = (
            gain(V_FULL_SCALE_MV, VOLT_PER_UNIT, n as u128),
            gain(I_FULL_SCALE_MA, AMPERE_PER_UNIT, n as u128),
        );
        n += 1;
    }
    gains
};

/// Phasors of the fundamental, amplitude (not rms), in estimator units.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Phasors {
    /// Coil voltage.
    pub v: Complex,
    /// Coil current.
    pub i: Complex,
}

/// Four running integer sums, one per part of the two phasors.
type Sums = [i64; 4];

/// The two boxcars and their scaling.
#[derive(Clone, Debug)]
pub struct Demodulator {
    length: usize,
    first: [Sums; MAX_BOXCAR],
    second: [Sums; MAX_BOXCAR],
    first_sum: Sums,
    second_sum: Sums,
    at: usize,
    filled: usize,
    gain_v: i32,
    gain_i: i32,
}

impl Demodulator {
    /// All bits zero; of use only to be replaced.
    pub(crate) const fn blank() -> Self {
        Self {
            length: 0,
            first: [[0; 4]; MAX_BOXCAR],
            second: [[0; 4]; MAX_BOXCAR],
            first_sum: [0; 4],
            second_sum: [0; 4],
            at: 0,
            filled: 0,
            gain_v: 0,
            gain_i: 0,
        }
    }

    /// An empty demodulator for a switching frequency.
    pub fn new(f_sw_hz: u32) -> Self {
        let mut new = Self::blank();
        new.restart(f_sw_hz);
        new
    }

    /// Empties it, for a switching frequency.
    pub fn restart(&mut self, f_sw_hz: u32) {
        // 0.2 ms in blocks of q/f_sw, to nearest: f · 0.2e-3 / 3 = f / 15 000.
        let length = ((f_sw_hz + 7_500) / (5_000 * ADC_LOCK_Q)).clamp(1, MAX_BOXCAR as u32);
        self.length = length as usize;
        self.first_sum = [0; 4];
        self.second_sum = [0; 4];
        (self.at, self.filled) = (0, 0);
        // There for every length, which the compiler cannot see.
        if let Some(&(gain_v, gain_i)) = GAINS.get(self.length - 1) {
            (self.gain_v, self.gain_i) = (gain_v, gain_i);
        }
    }

    /// Blocks by which the kernel's centre lies behind the block just taken.
    pub fn delay_blocks(&self) -> u32 {
        self.length as u32 - 1
    }

    /// Takes a block's sums; gives phasors once both boxcars are full.
    pub fn push(&mut self, block: &BlockSums) -> Option<Phasors> {
        let new = [block.v.re, block.v.im, block.i.re, block.i.im];
        let at = self.at;
        // `at` is below the length, which the compiler cannot see: no branch to a panic.
        if let (Some(first), Some(second)) = (self.first.get_mut(at), self.second.get_mut(at)) {
            // Until each has its place nothing leaves: what lies there is of the time before, and clearing it at a frequency
            // step would take longer than this.
            if self.filled < self.length {
                (*first, *second) = ([0; 4], [0; 4]);
            }
            for (k, &new) in new.iter().enumerate() {
                self.first_sum[k] += i64::from(new) - first[k];
                first[k] = i64::from(new);
                self.second_sum[k] += self.first_sum[k] - second[k];
                second[k] = self.first_sum[k];
            }
        }
        self.at = if at + 1 == self.length { 0 } else { at + 1 };
        // The first sum is complete after N blocks, the second after N more, less the shared one.
        self.filled = (self.filled + 1).min(2 * self.length);
        if self.filled + 1 < 2 * self.length {
            return None;
        }
        let scaled = |k: usize, gain: i32| -> i32 {
            narrow_within(self.second_sum[k] * i64::from(gain), GAIN_BITS)
        };
        Some(Phasors {
            v: Complex {
                re: scaled(0, self.gain_v),
                im: scaled(1, self.gain_v),
            },
            i: Complex {
                re: scaled(2, self.gain_i),
                im: scaled(3, self.gain_i),
            },
        })
    }
}

/// Amplitude in decivolt of a voltage phasor, from its squared magnitude in estimator units.
pub fn amplitude_dv(norm_squared: u64) -> u32 {
    let mantissa = norm_squared.isqrt() as i64;
    saturate((mantissa * 320) >> STATE_BITS) as u32
}

/// Amplitude in milliampere of a current phasor, from its squared magnitude in estimator units.
pub fn amplitude_ma(norm_squared: u64) -> u32 {
    let mantissa = norm_squared.isqrt() as i64;
    saturate((mantissa * 16_000) >> STATE_BITS) as u32
}

/// Squared magnitude of a current phasor in estimator units, from its amplitude in milliampere.
pub const fn norm_of_ma(i_ma: u32) -> u64 {
    let mantissa = ((i_ma as u64) << STATE_BITS) / 16_000;
    mantissa * mantissa
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sense::correlation::correlate;
    use ihd_shared::sampling::{AMPERE_PER_CODE, VOLT_PER_CODE};
    use ihd_shared::sampling::{CODE_MAX, CODE_MIN, Pair};
    use std::f64::consts::TAU;

    /// Blocks of exact harmonics: (harmonic, volt, ampere, phase) each, unquantised codes rounded.
    fn block(k: usize, parts: &[(f64, f64, f64, f64)]) -> [Pair; ADC_LOCK_P] {
        core::array::from_fn(|n| {
            let turns = (k * ADC_LOCK_P + n) as f64 * f64::from(ADC_LOCK_Q) / ADC_LOCK_P as f64;
            let sum = |amplitude: fn(&(f64, f64, f64, f64)) -> f64| -> f64 {
                parts
                    .iter()
                    .map(|p| amplitude(p) * (TAU * p.0 * turns + p.3).cos())
                    .sum()
            };
            Pair {
                v: (sum(|p| p.1) / VOLT_PER_CODE).round() as i16,
                i: (sum(|p| p.2) / AMPERE_PER_CODE).round() as i16,
            }
        })
    }

    #[test]
    fn an_amplitude_has_its_norm() {
        for i_ma in [1_000, 55_000, 80_000] {
            assert!(amplitude_ma(norm_of_ma(i_ma)).abs_diff(i_ma) <= 1);
        }
    }

    fn steady(f_sw_hz: u32, parts: &[(f64, f64, f64, f64)]) -> Phasors {
        let mut d = Demodulator::new(f_sw_hz);
        let mut last = None;
        for k in 0..2 * MAX_BOXCAR {
            last = d.push(&correlate(&block(k, parts)));
        }
        last.unwrap()
    }

    fn volt(c: Complex) -> (f64, f64) {
        let unit = VOLT_PER_UNIT / f64::from(1u32 << STATE_BITS);
        (f64::from(c.re) * unit, f64::from(c.im) * unit)
    }

    #[test]
    fn a_pure_tone_gives_its_phasor() {
        for f in [34_000, 45_000, 60_000, 80_000] {
            let p = steady(f, &[(1.0, 300.0, 40.0, 0.7)]);
            let (re, im) = volt(p.v);
            // Quantisation of 61·(2N−1) codes leaves a few millivolt.
            assert!((re - 300.0 * 0.7f64.cos()).abs() < 0.03, "{re}");
            assert!((im - 300.0 * 0.7f64.sin()).abs() < 0.03, "{im}");
            assert!((f64::from(amplitude_ma(p.i.norm_squared())) - 40_000.0).abs() < 10.0);
        }
    }

    #[test]
    fn harmonics_below_the_sixtieth_do_not_leak() {
        for h in (3..60).step_by(2) {
            let p = steady(45_000, &[(f64::from(h), 100.0, 20.0, 0.3)]);
            let (re, im) = volt(p.v);
            assert!(re.hypot(im) < 0.05, "harmonic {h}: {re} {im}");
        }
    }

    #[test]
    fn the_sixtieth_harmonic_aliases_as_the_module_says() {
        let p = steady(45_000, &[(60.0, 100.0, 0.0, 0.0)]);
        let (re, im) = volt(p.v);
        assert!((re.hypot(im) - 100.0).abs() < 0.1);
    }

    /// Nothing of the time before a restart is left, whatever the lengths.
    #[test]
    fn a_restart_forgets_all() {
        let loud = correlate(&block(0, &[(1.0, 300.0, 40.0, 0.7)]));
        let after = |mut d: Demodulator, f_sw_hz: u32| -> std::vec::Vec<_> {
            d.restart(f_sw_hz);
            let pushed = |k| d.push(&correlate(&block(k, &[(1.0, 100.0, 9.0, 0.1)])));
            (0..20).map(pushed).collect()
        };
        for (before_hz, f_sw_hz) in [(34_000, 80_000), (80_000, 34_000), (60_000, 60_000)] {
            for pushes in 0..9 {
                let mut d = Demodulator::new(before_hz);
                (0..pushes).for_each(|_| {
                    d.push(&loud);
                });
                assert_eq!(after(d, f_sw_hz), after(Demodulator::blank(), f_sw_hz));
            }
        }
    }

    #[test]
    fn output_starts_when_both_boxcars_are_full_and_is_centred() {
        let mut d = Demodulator::new(60_000); // N = 4
        assert_eq!(d.delay_blocks(), 3);
        let quiet = correlate(&block(0, &[]));
        let loud = correlate(&block(0, &[(1.0, 100.0, 0.0, 0.0)]));
        let outputs: std::vec::Vec<_> = (0..9).map(|_| d.push(&quiet)).collect();
        assert_eq!(outputs.iter().filter(|o| o.is_none()).count(), 6);
        // One loud block: a triangle of 7 outputs whose peak comes 3 blocks later.
        let response: std::vec::Vec<f64> = (0..8)
            .map(|k| volt(d.push(if k == 0 { &loud } else { &quiet }).unwrap().v).0)
            .collect();
        let expected = [1.0, 2.0, 3.0, 4.0, 3.0, 2.0, 1.0, 0.0].map(|w| w * 100.0 / 16.0);
        for (r, e) in response.iter().zip(expected) {
            assert!((r - e).abs() < 0.02, "{response:?}");
        }
    }

    #[test]
    fn full_scale_does_not_overflow() {
        let rails = [Pair {
            v: CODE_MIN,
            i: CODE_MIN,
        }; ADC_LOCK_P];
        let s = correlate(&rails);
        assert_eq!(usize::from(s.saturated), ADC_LOCK_P);
        assert_eq!(usize::from(s.i_beyond), ADC_LOCK_P);
        let square: [Pair; ADC_LOCK_P] = core::array::from_fn(|n| {
            let code = if (ADC_LOCK_Q as f64 * n as f64 / ADC_LOCK_P as f64 * std::f64::consts::TAU)
                .cos()
                > 0.0
            {
                CODE_MAX
            } else {
                CODE_MIN
            };
            Pair { v: code, i: code }
        });
        let mut d = Demodulator::new(80_000);
        for _ in 0..20 {
            d.push(&correlate(&square));
        }
    }

    #[test]
    fn mean_power_is_the_sum_of_products() {
        // 100 V at 10 A in phase: 500 W, whatever the harmonics do elsewhere.
        let b = block(0, &[(1.0, 100.0, 10.0, 0.0), (3.0, 50.0, 0.0, 0.0)]);
        let w = correlate(&b).vi as f64 / ADC_LOCK_P as f64 * VOLT_PER_CODE * AMPERE_PER_CODE;
        assert!((w - 500.0).abs() < 1.0, "{w}");
    }
}
