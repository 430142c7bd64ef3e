//! Demodulator: sample pairs in, phasors of the fundamental out, one per block.
//!
//! Each block of p = 61 pairs spans exactly q = 3 switching periods, so multiplying by a 61-entry
//! table of e^(−jθ) and summing gives the block's fundamental with every other harmonic at a zero
//! of the sum. Two boxcars over N blocks (0.2 ms each) follow; their kernel is a triangle whose
//! centre lies N − 1 blocks back. V and I pass the same kernel, so that V = (R + jωL) I + L dI/dt
//! survives it.
//!
//! Budget: correlating one pair costs five multiply-accumulates; per block the boxcars add eight
//! 64-bit additions and four scalings. Sums are exact integers: nothing drifts.

use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q, CODE_MAX, CODE_MIN, Pair};

use crate::fixed::{Complex, narrow, saturate};

/// One ampere unit of the estimator is 16 A, one volt unit 32 V, one ohm unit 2 ohm; all states
/// are mantissas of 26 fractional bits in these units, so ±512 A, ±1024 V, ±64 ohm.
pub const STATE_BITS: u32 = 26;

/// Ampere per estimator unit of current.
pub const AMPERE_PER_UNIT: f64 = 16.0;

/// Volt per estimator unit of voltage.
pub const VOLT_PER_UNIT: f64 = 32.0;

/// Ohm per estimator unit of impedance.
pub const OHM_PER_UNIT: f64 = VOLT_PER_UNIT / AMPERE_PER_UNIT;

/// Fractional bits of the heterodyne table. 14, because 61 · 2^11 · 2^14 still fits an i32.
const TABLE_BITS: u32 = 14;

/// Fractional bits of the scaling mantissas: with N ≥ 1 the largest, 50/61, stays below 2^26.
const GAIN_BITS: u32 = 26;

/// Most blocks of a boxcar: 0.2 ms at 80 kHz are 5.3.
pub const MAX_BOXCAR: usize = 6;

/// cos and −sin of 2π·q·k/p.
static TABLE: [(i16, i16); ADC_LOCK_P] = table();

/// Sine of 2π·n/d for 0 ≤ n < d, by its Taylor series after folding to ±π/2, at compile time.
const fn sine_of_turns(n: u32, d: u32) -> f64 {
    let mut turns = n as f64 / d as f64;
    if turns > 0.75 {
        turns -= 1.0;
    } else if turns > 0.25 {
        turns = 0.5 - turns;
    }
    let x = turns * 2.0 * core::f64::consts::PI;
    let mut term = x;
    let mut sum = x;
    let mut k = 1.0;
    while k < 12.0 {
        term *= -x * x / ((2.0 * k) * (2.0 * k + 1.0));
        sum += term;
        k += 1.0;
    }
    sum
}

const fn rounded_q14(x: f64) -> i16 {
    let scaled = x * (1 << TABLE_BITS) as f64;
    (if scaled >= 0.0 {
        scaled + 0.5
    } else {
        scaled - 0.5
    }) as i16
}

const fn table() -> [(i16, i16); ADC_LOCK_P] {
    let p = ADC_LOCK_P as u32;
    let mut t = [(0, 0); ADC_LOCK_P];
    let mut k = 0;
    while k < ADC_LOCK_P {
        // cos x = sin(x + π/2): work in quarters of 1/p turns.
        let quarter_turns = 4 * (ADC_LOCK_Q * k as u32 % p);
        t[k].0 = rounded_q14(sine_of_turns((quarter_turns + p) % (4 * p), 4 * p));
        t[k].1 = rounded_q14(-sine_of_turns(quarter_turns, 4 * p));
        k += 1;
    }
    t
}

/// What one pass over a block's pairs gives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BlockSums {
    /// Σ v·e^(−jθ), codes in 14 fractional bits.
    pub v: Complex,
    /// Σ i·e^(−jθ), codes in 14 fractional bits.
    pub i: Complex,
    /// Σ v·i in codes squared: mean power times pairs, all harmonics included.
    pub vi: i64,
    /// Largest magnitude of a current code.
    pub i_peak: u16,
    /// Pairs at the end of either channel's range.
    pub saturated: u16,
}

/// Correlates one block with the fundamental. The only loop that runs per sample.
pub fn correlate(pairs: &[Pair; ADC_LOCK_P]) -> BlockSums {
    let mut s = BlockSums::default();
    for (pair, &(cos, minus_sin)) in pairs.iter().zip(&TABLE) {
        let (v, i) = (i32::from(pair.v), i32::from(pair.i));
        let (cos, minus_sin) = (i32::from(cos), i32::from(minus_sin));
        s.v.re = s.v.re.wrapping_add(v * cos);
        s.v.im = s.v.im.wrapping_add(v * minus_sin);
        s.i.re = s.i.re.wrapping_add(i * cos);
        s.i.im = s.i.im.wrapping_add(i * minus_sin);
        s.vi += i64::from(v * i);
        s.i_peak = s.i_peak.max(pair.i.unsigned_abs());
        s.saturated += u16::from(pair.is_saturated());
    }
    s
}

// The sums above cannot wrap: 61 codes of 12 bit times 14-bit table entries stay below 2^31.
const _: () = assert!(
    (ADC_LOCK_P as i64) * -(CODE_MIN as i64) * (1 << TABLE_BITS) <= i32::MAX as i64
        && CODE_MAX < -CODE_MIN
);

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
    /// An empty demodulator for a switching frequency.
    pub fn new(f_sw_hz: u32) -> Self {
        // 0.2 ms in blocks of q/f_sw, to nearest: f · 0.2e-3 / 3 = f / 15 000.
        let length = ((f_sw_hz + 7_500) / (5_000 * ADC_LOCK_Q)).clamp(1, MAX_BOXCAR as u32);
        // Amplitude = 2/p · mean over N² sums; units per code are 25/4096 (v) and 5/2048 (i), and
        // the table's 14 bits fall short of the state's 26 by 12: gains 50/(p·N²) and 20/(p·N²).
        let divisor = u64::from(ADC_LOCK_P as u32 * length * length);
        let gain = |numerator: u64| (((numerator << GAIN_BITS) + divisor / 2) / divisor) as i32;
        Self {
            length: length as usize,
            first: [[0; 4]; MAX_BOXCAR],
            second: [[0; 4]; MAX_BOXCAR],
            first_sum: [0; 4],
            second_sum: [0; 4],
            at: 0,
            filled: 0,
            gain_v: gain(50),
            gain_i: gain(20),
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
        for (k, &new) in new.iter().enumerate() {
            self.first_sum[k] += i64::from(new) - self.first[at][k];
            self.first[at][k] = i64::from(new);
            self.second_sum[k] += self.first_sum[k] - self.second[at][k];
            self.second[at][k] = self.first_sum[k];
        }
        self.at = if at + 1 == self.length { 0 } else { at + 1 };
        // The first sum is complete after N blocks, the second after N more, less the shared one.
        self.filled = (self.filled + 1).min(2 * self.length);
        if self.filled + 1 < 2 * self.length {
            return None;
        }
        let scaled = |k: usize, gain: i32| -> i32 {
            // At most 61·2^25·36 (37 bits) times 26 bits.
            narrow(self.second_sum[k] * i64::from(gain), GAIN_BITS)
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

/// Amplitude in milliampere of a current phasor in estimator units.
pub fn amplitude_ma(i: Complex) -> u32 {
    let mantissa = i.norm_squared().isqrt() as i64;
    saturate((mantissa * 16_000) >> STATE_BITS) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use ihd_shared::sampling::{AMPERE_PER_CODE, VOLT_PER_CODE};
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
            assert!((f64::from(amplitude_ma(p.i)) - 40_000.0).abs() < 10.0);
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
        assert_eq!(s.i_peak, 2048);
        let square: [Pair; ADC_LOCK_P] = core::array::from_fn(|n| {
            let code = if TABLE[n].0 > 0 { CODE_MAX } else { CODE_MIN };
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
