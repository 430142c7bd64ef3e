//! Correlation of a block with the fundamental: three loops over 61 sample pairs.
//!
//! A block spans exactly q = 3 switching periods, so the sum of its pairs times a 61-entry table of e^(−jθ) is the block's
//! fundamental, every other harmonic at a zero of the sum.
//!
//! Budget: on the board two pairs cost nine instructions, five of which multiply twice, and seven to see if they are out of the
//! ordinary. Sums are exact integers.

use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q, CODE_MAX, CODE_MIN, Pair};

use crate::fixed::Complex;
use crate::sense::codes::{SOFT_CURRENT_CODE, SOFT_VOLTAGE_CODE, TRIP_CODE};
use crate::sense::product_sums::{
    Bounds, PairArithmetic, PlainArithmetic, ProductSums, halves, high, low,
};

/// Fractional bits of the heterodyne table. 14, because 61 · 2^11 · 2^14 still fits an i32.
pub const TABLE_BITS: u32 = 14;

/// cos and −sin of 2π·q·k/p: for two k one word with the cosines and one with the sines; cosine and sine of the last k.
static TABLE: [u32; ADC_LOCK_P] = packed(table());

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

/// cos and −sin of the carrier at a pair, counted from the beginning of any block, in 14 fractional bits.
pub(crate) const fn phase(pair: usize) -> (i16, i16) {
    let p = ADC_LOCK_P as u32;
    // cos x = sin(x + π/2): work in quarters of 1/p turns.
    let quarter_turns = 4 * (ADC_LOCK_Q * pair as u32 % p);
    (
        rounded_q14(sine_of_turns((quarter_turns + p) % (4 * p), 4 * p)),
        rounded_q14(-sine_of_turns(quarter_turns, 4 * p)),
    )
}

const fn table() -> [(i16, i16); ADC_LOCK_P] {
    let mut table = [(0, 0); ADC_LOCK_P];
    let mut k = 0;
    while k < ADC_LOCK_P {
        table[k] = phase(k);
        k += 1;
    }
    table
}

const fn packed(table: [(i16, i16); ADC_LOCK_P]) -> [u32; ADC_LOCK_P] {
    let mut words = [0; ADC_LOCK_P];
    let mut k = 0;
    while k + 1 < ADC_LOCK_P {
        words[k] = halves(table[k].0, table[k + 1].0);
        words[k + 1] = halves(table[k].1, table[k + 1].1);
        k += 2;
    }
    words[k] = halves(table[k].0, table[k].1);
    words
}

/// Codes within are ordinary: below the soft limits, which are below any trip level.
const ORDINARY: Bounds = Bounds::new(SOFT_VOLTAGE_CODE - 1, SOFT_CURRENT_CODE - 1);

/// Sums and peaks of a block's pairs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BlockSums {
    /// Σ v·e^(−jθ), codes in 14 fractional bits.
    pub v: Complex,
    /// Σ i·e^(−jθ), codes in 14 fractional bits.
    pub i: Complex,
    /// Σ v·i in codes squared: mean power times pairs, all harmonics included.
    pub vi: i64,
    /// Pairs whose current reaches its soft limit.
    pub i_above: u16,
    /// Pairs whose current reaches its trip level.
    pub i_beyond: u16,
    /// Pairs whose voltage reaches its soft limit.
    pub v_above: u16,
    /// Largest magnitude of a voltage code, where one reaches its soft limit; else 0.
    pub v_peak: u16,
    /// Pairs at the end of either channel's range.
    pub saturated: u16,
}

/// Correlates one block with the fundamental. Two loops run per sample, and a third one for a block that holds a sample out
/// of the ordinary.
pub fn correlate(pairs: &[Pair; ADC_LOCK_P]) -> BlockSums {
    correlate_by::<PlainArithmetic>(pairs)
}

/// Sums of a block by a board's own arithmetic.
#[inline(never)]
pub fn correlate_by<M: PairArithmetic>(pairs: &[Pair; ADC_LOCK_P]) -> BlockSums {
    let words = Pair::words(pairs);
    let sums = correlation::<M>(words);
    let mut s = BlockSums {
        v: Complex {
            re: sums.v_c,
            im: sums.v_s,
        },
        i: Complex {
            re: sums.i_c,
            im: sums.i_s,
        },
        vi: sums.v_i.into(),
        ..BlockSums::default()
    };
    if has_alarm::<M>(words) {
        find_peaks(pairs, &mut s);
    }
    s
}

/// Sums of the pairs times their phases, and of the products of their codes.
fn correlation<M: PairArithmetic>(words: &[u32; ADC_LOCK_P]) -> ProductSums {
    let (twelves, last) = words.as_chunks();
    let (phases, last_phase) = TABLE.as_chunks();
    let mut sums = M::product_sums(twelves, phases);
    if let (&[pair], &[phase]) = (last, last_phase) {
        let (v, i) = (low(pair), high(pair));
        sums.v_c = sums.v_c.wrapping_add(v * low(phase));
        sums.v_s = sums.v_s.wrapping_add(v * high(phase));
        sums.i_c = sums.i_c.wrapping_add(i * low(phase));
        sums.i_s = sums.i_s.wrapping_add(i * high(phase));
        sums.v_i = sums.v_i.wrapping_add(v.wrapping_mul(i));
    }
    sums
}

/// Returns `true` if any pair is out of the ordinary. A loop of its own: one for all would need more registers than there are.
#[inline(never)]
fn has_alarm<M: PairArithmetic>(words: &[u32; ADC_LOCK_P]) -> bool {
    let (twelves, rest) = words.as_chunks();
    M::is_any_beyond(twelves, ORDINARY) | rest.iter().any(|&word| ORDINARY.is_beyond(word))
}

/// Pairs beyond the limits, the voltage's peak and saturated pairs, exactly. Codes that no 12-bit converter gives, which only a replay can
/// hold, come here too: their products may not fit the sum above.
#[cold]
#[inline(never)]
fn find_peaks(pairs: &[Pair; ADC_LOCK_P], s: &mut BlockSums) {
    s.vi = 0;
    for pair in pairs {
        s.vi += i64::from(i32::from(pair.v) * i32::from(pair.i));
        let (v, i) = (pair.v.unsigned_abs(), pair.i.unsigned_abs());
        s.i_above += u16::from(i >= SOFT_CURRENT_CODE);
        s.i_beyond += u16::from(i >= TRIP_CODE);
        if v >= SOFT_VOLTAGE_CODE {
            s.v_above += 1;
            s.v_peak = s.v_peak.max(v);
        }
        s.saturated += u16::from(pair.is_saturated());
    }
}

// The sums above cannot wrap: 61 codes of 12 bit times 14-bit table entries stay below 2^31.
const _: () = assert!(
    (ADC_LOCK_P as i64) * -(CODE_MIN as i64) * (1 << TABLE_BITS) <= i32::MAX as i64
        && CODE_MAX < -CODE_MIN
        // A block's v·i with no half beyond its bounds.
        && (ADC_LOCK_P as i64) * (CODE_MIN as i64) * (CODE_MIN as i64) <= i32::MAX as i64
);

#[cfg(test)]
mod tests {
    use super::*;

    /// Packed halves against the plain definition, over every code of either
    /// channel next to codes of either sign on the other.
    #[test]
    fn no_sample_out_of_the_ordinary_is_missed() {
        for code in i16::MIN..=i16::MAX {
            for other in [-1_000, -1, 0, 1, 1_000] {
                for pair in [Pair { v: code, i: other }, Pair { v: other, i: code }] {
                    let mut pairs = [Pair::default(); ADC_LOCK_P];
                    pairs[17] = pair;
                    let s = correlate(&pairs);
                    assert_eq!(s.saturated, u16::from(pair.is_saturated()), "{pair:?}");
                    let from = |code: i16, limit: u16| {
                        let peak = code.unsigned_abs();
                        if peak >= limit { peak } else { 0 }
                    };
                    let count = |code, limit| u16::from(from(code, limit) > 0);
                    assert_eq!(s.i_above, count(pair.i, SOFT_CURRENT_CODE), "{pair:?}");
                    assert_eq!(s.i_beyond, count(pair.i, TRIP_CODE), "{pair:?}");
                    assert_eq!(s.v_above, count(pair.v, SOFT_VOLTAGE_CODE), "{pair:?}");
                    assert_eq!(s.v_peak, from(pair.v, SOFT_VOLTAGE_CODE), "{pair:?}");
                    assert_eq!(s.vi, i64::from(i32::from(pair.v) * i32::from(pair.i)));
                }
            }
        }
    }
}
