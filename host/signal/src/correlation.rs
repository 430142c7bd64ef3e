//! Correlation of sampled voltage and current with harmonics of f_sw, block by block.
//!
//! A block's table of (cos, −sin) is computed once; each block costs one sine and cosine of its
//! start and per sample four multiply-adds an order. The phase counts from the segment's first
//! sample: x(t) = Re{X·e^(jhω(t − t0))}, X = 2/n · Σ x·e^(−jhω(t − t0)).

use std::f64::consts::TAU;

use nalgebra::Complex;

use super::Segment;
use super::vectorised::{dot, vectorised};

/// Blocks after which [`BlockTurns`] computes the phase anew.
const RENEWAL_BLOCKS: usize = 64;

/// e^(−jωt) at the first sample of one block after another: turned on, and computed anew from time to time.
#[derive(Clone, Debug)]
pub struct BlockTurns {
    next: Complex<f64>,
    of_block: Complex<f64>,
    given: usize,
}

impl BlockTurns {
    /// Begins with the block at the segment's first sample.
    pub fn new(correlator: &Correlator<1>) -> Self {
        let [of_block] = correlator.turn(correlator.length());
        Self {
            next: Complex::new(1.0, 0.0),
            of_block,
            given: 0,
        }
    }

    /// Returns the turn of the correlator's next block.
    pub fn next(&mut self, correlator: &Correlator<1>) -> [Complex<f64>; 1] {
        if self.given.is_multiple_of(RENEWAL_BLOCKS) {
            [self.next] = correlator.turn(self.given * correlator.length());
        }
        let turn = self.next;
        self.next *= self.of_block;
        self.given += 1;
        [turn]
    }
}

/// Sums of one block, Σ x·e^(−jhωt), one per order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HarmonicSums<const ORDERS: usize> {
    /// Sums of the voltage in volt; 2/n of a sum is the amplitude.
    pub v: [Complex<f64>; ORDERS],
    /// Sums of the current in ampere.
    pub i: [Complex<f64>; ORDERS],
}

/// Correlates blocks of `length` samples with `ORDERS` multiples of f_sw, whole or not.
#[derive(Clone, Debug)]
pub struct Correlator<const ORDERS: usize> {
    orders: [f64; ORDERS],
    /// Periods of f_sw from one sample to the next.
    periods_per_sample: f64,
    cos: Vec<[f64; ORDERS]>,
    minus_sin: Vec<[f64; ORDERS]>,
}

impl<const ORDERS: usize> Correlator<ORDERS> {
    /// Creates a correlator for a segment's sampling, blocks of `length` samples and these orders in multiples of f_sw.
    pub fn new(segment: &Segment, length: usize, orders: [f64; ORDERS]) -> Self {
        Self::with_rate(segment.f_sw_hz * segment.dt_s, length, orders)
    }

    /// Creates a correlator for samples that are this share of a period of f_sw apart.
    pub fn with_rate(periods_per_sample: f64, length: usize, orders: [f64; ORDERS]) -> Self {
        let table = |value: fn(f64) -> f64| {
            let at =
                |n: usize| orders.map(|h| value(TAU * (h * n as f64 * periods_per_sample).fract()));
            (0..length).map(at).collect()
        };
        Self {
            orders,
            periods_per_sample,
            cos: table(libm::cos),
            minus_sin: table(|x| -libm::sin(x)),
        }
    }

    /// Samples of a block.
    pub fn length(&self) -> usize {
        self.cos.len()
    }

    /// e^(−jhωt) at sample `n` of the segment, one per order.
    pub fn turn(&self, n: usize) -> [Complex<f64>; ORDERS] {
        self.orders.map(|h| {
            let (s, c) = libm::sincos(TAU * (h * n as f64 * self.periods_per_sample).fract());
            Complex::new(c, -s)
        })
    }

    /// Sums over a block that begins with sample `first` of the segment; the block may be shorter than the table.
    pub fn block(&self, first: usize, v_v: &[f64], i_a: &[f64]) -> HarmonicSums<ORDERS> {
        self.block_turned(&self.turn(first), v_v, i_a)
    }

    /// Sums over a block, given e^(−jhωt) of its first sample.
    pub fn block_turned(
        &self,
        turn: &[Complex<f64>; ORDERS],
        v_v: &[f64],
        i_a: &[f64],
    ) -> HarmonicSums<ORDERS> {
        let (cos, sin) = (&self.cos, &self.minus_sin);
        let sums = if v_v.len().max(i_a.len()) <= FEW {
            [few(v_v, cos), few(v_v, sin), few(i_a, cos), few(i_a, sin)]
        } else {
            vectorised(
                #[inline(always)]
                || {
                    [
                        sums_of(v_v, cos),
                        sums_of(v_v, sin),
                        sums_of(i_a, cos),
                        sums_of(i_a, sin),
                    ]
                },
            )
        };
        let phasor = |re: &[f64; ORDERS], im: &[f64; ORDERS]| {
            std::array::from_fn(|h| Complex::new(re[h], im[h]) * turn[h])
        };
        HarmonicSums {
            v: phasor(&sums[0], &sums[1]),
            i: phasor(&sums[2], &sums[3]),
        }
    }
}

/// Samples that no long vector makes faster: the device's blocks have one.
const FEW: usize = 4;

/// Σ x·w of each order over few samples.
fn few<const ORDERS: usize>(x: &[f64], weights: &[[f64; ORDERS]]) -> [f64; ORDERS] {
    let mut sums = [0.0; ORDERS];
    for (x, weights) in x.iter().zip(weights) {
        for h in 0..ORDERS {
            sums[h] += x * weights[h];
        }
    }
    sums
}

/// Σ x·w of each order: one sample's orders after the other in `weights`.
#[inline(always)]
fn sums_of<const ORDERS: usize>(x: &[f64], weights: &[[f64; ORDERS]]) -> [f64; ORDERS] {
    if ORDERS == 1 {
        return [dot(weights.as_flattened(), x); ORDERS];
    }
    // Four samples at a time: with fewer, each addition would wait for the one before.
    let x = &x[..x.len().min(weights.len())];
    let (fours, last) = x.as_chunks::<4>();
    let (weight_fours, _) = weights.as_chunks::<4>();
    let mut sums = [[0.0; ORDERS]; 4];
    for (x, weights) in fours.iter().zip(weight_fours) {
        for lane in 0..4 {
            for h in 0..ORDERS {
                sums[lane][h] += x[lane] * weights[lane][h];
            }
        }
    }
    for (x, weights) in last.iter().zip(&weights[4 * fours.len()..]) {
        for h in 0..ORDERS {
            sums[0][h] += x * weights[h];
        }
    }
    std::array::from_fn(|h| (sums[0][h] + sums[1][h]) + (sums[2][h] + sums[3][h]))
}

/// Σ x·w of each of two weights.
pub fn weighted_sums<T: Copy + Into<f64>>(x: &[T], weights: [&[f64]; 2]) -> [f64; 2] {
    // An array's `map` would not be inlined.
    vectorised(
        #[inline(always)]
        || [dot(weights[0], x), dot(weights[1], x)],
    )
}

/// Mean impedance of the segment's fundamental in ohm, the start of every estimator:
/// Σ V·I* / Σ |I|² over blocks of one switching period, so that a drift of the phase does not
/// cancel. Not finite if there is no current.
pub fn mean_impedance(segment: &Segment) -> Complex<f64> {
    let length = (segment.samples_per_period().round() as usize).max(1);
    let correlator = Correlator::new(segment, length, [1.0]);
    let (mut v_buffer, mut i_buffer) = (Vec::new(), Vec::new());
    let (mut cross, mut square) = (Complex::new(0.0, 0.0), 0.0);
    for k in 0..segment.len().min(segment.i_a.len()) / length {
        let range = k * length..(k + 1) * length;
        let v = segment.v_v.block(range.clone(), &mut v_buffer);
        let i = segment.i_a.block(range, &mut i_buffer);
        let sums = correlator.block(k * length, v, i);
        cross += sums.v[0] * sums.i[0].conj();
        square += sums.i[0].norm_sqr();
    }
    cross / square
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_order_gives_its_own_phasor_in_every_block() {
        let w = TAU * 45e3;
        let dt_s = 1.0 / (45e3 * 100.0);
        let t = |n: usize| n as f64 * dt_s;
        let segment = Segment {
            f_sw_hz: 45e3,
            mains_hz: 50.0,
            zero_crossing_s: 0.0,
            t0_s: 0.0,
            dt_s,
            v_v: (0..1000)
                .map(|n| 5.0 * (w * t(n) + 0.3).cos() + 2.0 * (3.0 * w * t(n) - 1.0).cos())
                .collect(),
            i_a: (0..1000).map(|n| 0.5 * (w * t(n) - 0.6).cos()).collect(),
        };
        let correlator = Correlator::new(&segment, 100, [1.0, 3.0]);
        for first in [0, 100, 417, 900] {
            let (v, i) = (&segment.v_v[first..], &segment.i_a[first..]);
            let sums = correlator.block(first, v, i);
            let v1 = sums.v[0] * 0.02;
            let v3 = sums.v[1] * 0.02;
            assert!((v1 - Complex::from_polar(5.0, 0.3)).norm() < 1e-9);
            assert!((v3 - Complex::from_polar(2.0, -1.0)).norm() < 1e-9);
            assert!((sums.i[0] * 0.02 - Complex::from_polar(0.5, -0.6)).norm() < 1e-9);
        }
        let z = mean_impedance(&segment);
        assert!((z - Complex::from_polar(10.0, 0.9)).norm() < 1e-9);
    }
}
