//! Correlation of sampled voltage and current with harmonics of f_sw, block by block.
//!
//! A block's table of (cos, −sin) is computed once; each block costs one sine and cosine of its
//! start and per sample four multiply-adds an order. The phase counts from the segment's first
//! sample: x(t) = Re{X·e^(jhω(t − t0))}, X = 2/n · Σ x·e^(−jhω(t − t0)).

use std::f64::consts::TAU;

use nalgebra::Complex;

use super::Segment;
use super::vectorised::vectorised;

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
        let [v_sums, i_sums] = vectorised(
            #[inline(always)]
            || [self.sums(v_v), self.sums(i_a)],
        );
        let sums = [v_sums[0], v_sums[1], i_sums[0], i_sums[1]];
        let phasor = |re: &[f64; ORDERS], im: &[f64; ORDERS]| {
            std::array::from_fn(|h| Complex::new(re[h], im[h]) * turn[h])
        };
        HarmonicSums {
            v: phasor(&sums[0], &sums[1]),
            i: phasor(&sums[2], &sums[3]),
        }
    }
}

impl<const ORDERS: usize> Correlator<ORDERS> {
    /// Sums of one channel over a block that begins with sample `first` of the segment, in its unit.
    pub fn channel(&self, first: usize, x: &[f64]) -> [Complex<f64>; ORDERS] {
        let [re, im] = vectorised(
            #[inline(always)]
            || self.sums(x),
        );
        let turn = self.turn(first);
        std::array::from_fn(|h| Complex::new(re[h], im[h]) * turn[h])
    }

    /// Σ x·cos and −Σ x·sin of each order, the angle counted from the first sample: four samples at a time.
    #[inline(always)]
    fn sums(&self, x: &[f64]) -> [[f64; ORDERS]; 2] {
        let mut sums = [[[0.0; ORDERS]; 4]; 2];
        let tables = self.cos.chunks(4).zip(self.minus_sin.chunks(4));
        for (x, (cos, sin)) in x.chunks(4).zip(tables) {
            let samples = x.iter().zip(cos.iter().zip(sin));
            for (lane, (x, (cos, sin))) in samples.enumerate() {
                for h in 0..ORDERS {
                    sums[0][lane][h] += x * cos[h];
                    sums[1][lane][h] += x * sin[h];
                }
            }
        }
        sums.map(|[a, b, c, d]| std::array::from_fn(|h| (a[h] + b[h]) + (c[h] + d[h])))
    }

    /// Writes Σ Re{X_h·e^(jhωt)}, in the phasors' unit, to samples from `first` of the segment on, at most a block.
    pub fn synthesise(&self, first: usize, phasors: &[Complex<f64>; ORDERS], out: &mut [f32]) {
        let turn = self.turn(first);
        let at: [Complex<f64>; ORDERS] = std::array::from_fn(|h| phasors[h] * turn[h].conj());
        vectorised(
            #[inline(always)]
            || {
                for (out, (cos, sin)) in out.iter_mut().zip(self.cos.iter().zip(&self.minus_sin)) {
                    // Four partial sums, which the compiler can vectorise.
                    let mut sums = [0.0; 4];
                    for h in 0..ORDERS {
                        sums[h % 4] += at[h].re * cos[h] + at[h].im * sin[h];
                    }
                    *out = ((sums[0] + sums[1]) + (sums[2] + sums[3])) as f32;
                }
            },
        );
    }
}

/// Σ x·w of each of two weights, in eight sums each.
pub fn weighted_sums<T: Copy + Into<f64>>(x: &[T], weights: [&[f64]; 2]) -> [f64; 2] {
    vectorised(
        #[inline(always)]
        || {
            let mut sums = [[0.0; 8]; 2];
            let blocks = weights[0].chunks(8).zip(weights[1].chunks(8));
            for (x, (a, b)) in x.chunks(8).zip(blocks) {
                for (k, (x, (a, b))) in x.iter().zip(a.iter().zip(b)).enumerate() {
                    let x: f64 = (*x).into();
                    sums[0][k] += x * a;
                    sums[1][k] += x * b;
                }
            }
            sums.map(|lanes| lanes.iter().sum())
        },
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
