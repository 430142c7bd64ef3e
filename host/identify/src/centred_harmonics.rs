//! Harmonics of windows of one length, about the middle of each: cosines see the even part of the samples, sines the odd one, so that two
//! samples cost as much as one.

use std::f64::consts::TAU;

use ihd_signal::vectorised::vectorised;
use nalgebra::Complex;

/// Pairs of samples that are computed together.
const LANES: usize = 8;

/// Values of all orders at the second samples of [`LANES`] pairs.
type Table<const ORDERS: usize> = [[f64; LANES]; ORDERS];

/// Windows of `length` samples and `ORDERS` multiples of a fundamental.
pub struct CentredHarmonics<const ORDERS: usize> {
    orders: [f64; ORDERS],
    /// Periods of the fundamental from one sample to the next.
    periods_per_sample: f64,
    length: usize,
    cos: Vec<Table<ORDERS>>,
    sin: Vec<Table<ORDERS>>,
}

impl<const ORDERS: usize> CentredHarmonics<ORDERS> {
    /// Creates the tables.
    pub fn new(periods_per_sample: f64, length: usize, orders: [f64; ORDERS]) -> Self {
        // The pair that is nearest to the middle is half a sample from it, or a whole one.
        let nearest = if length.is_multiple_of(2) { 0.5 } else { 1.0 };
        let table = |value: fn(f64) -> f64| {
            let at = |h: f64, pair: usize| {
                let turns = h * (pair as f64 + nearest) * periods_per_sample;
                value(TAU * turns.fract())
            };
            let of = |first: usize| orders.map(|h| std::array::from_fn(|k| at(h, first + k)));
            (0..length / 2).step_by(LANES).map(of).collect()
        };
        Self {
            orders,
            periods_per_sample,
            length,
            cos: table(libm::cos),
            sin: table(libm::sin),
        }
    }

    /// e^(−jhωt) in the middle of the window that begins with sample `first`, one per order.
    fn turn(&self, first: usize) -> [Complex<f64>; ORDERS] {
        let middle = first as f64 + 0.5 * (self.length as f64 - 1.0);
        self.orders.map(|h| {
            let (sin, cos) = libm::sincos(TAU * (h * middle * self.periods_per_sample).fract());
            Complex::new(cos, -sin)
        })
    }

    /// Σ x·e^(−jhωt) of the window that begins with sample `first`, one per order; the time counts from sample 0.
    pub fn sums(&self, first: usize, x: &[f64]) -> [Complex<f64>; ORDERS] {
        let (before, after) = x.split_at(x.len() / 2);
        let (middle, after) = after.split_at(after.len() - before.len());
        let mut parts = vec![[[0.0; LANES]; 2]; self.cos.len()];
        let pairs = after.chunks(LANES).zip(before.rchunks(LANES));
        for ([even, odd], (after, before)) in parts.iter_mut().zip(pairs) {
            for (k, (b, a)) in after.iter().zip(before.iter().rev()).enumerate() {
                (even[k], odd[k]) = (b + a, b - a);
            }
        }
        let mut all = [[[0.0; LANES]; ORDERS]; 2];
        vectorised(
            #[inline(always)]
            || {
                let [re, im] = &mut all;
                weigh(re, parts.iter().map(|part| &part[0]), &self.cos);
                weigh(im, parts.iter().map(|part| &part[1]), &self.sin);
            },
        );
        let [re, im] = &all;
        let (middle, turn) = (middle.iter().sum::<f64>(), self.turn(first));
        let sum = |lanes: &[f64; LANES]| lanes.iter().sum::<f64>();
        std::array::from_fn(|h| Complex::new(middle + sum(&re[h]), -sum(&im[h])) * turn[h])
    }

    /// Writes Σ Re{X_h·e^(jhωt)}, in the phasors' unit, to the window that begins with sample `first`.
    pub fn synthesise(&self, first: usize, phasors: &[Complex<f64>; ORDERS], out: &mut [f32]) {
        let turn = self.turn(first);
        let at: [Complex<f64>; ORDERS] = std::array::from_fn(|h| phasors[h] * turn[h].conj());
        let (re, im) = (at.map(|x| x.re), at.map(|x| x.im));
        let (before, after) = out.split_at_mut(out.len() / 2);
        let (middle, after) = after.split_at_mut(after.len() - before.len());
        middle.fill(re.iter().sum::<f64>() as f32);
        vectorised(
            #[inline(always)]
            || {
                let pairs = after.chunks_mut(LANES).zip(before.rchunks_mut(LANES));
                for ((after, before), (cos, sin)) in pairs.zip(self.cos.iter().zip(&self.sin)) {
                    let (mut even, mut odd) = ([0.0; LANES], [0.0; LANES]);
                    for h in 0..ORDERS {
                        for k in 0..LANES {
                            even[k] += re[h] * cos[h][k];
                        }
                    }
                    for h in 0..ORDERS {
                        for k in 0..LANES {
                            odd[k] += im[h] * sin[h][k];
                        }
                    }
                    for (k, (b, a)) in after.iter_mut().zip(before.iter_mut().rev()).enumerate() {
                        (*b, *a) = ((even[k] - odd[k]) as f32, (even[k] + odd[k]) as f32);
                    }
                }
            },
        );
    }
}

/// Orders that are summed together: as many sums as there are registers for.
const TOGETHER: usize = 4;

/// Adds samples times the table of each order.
#[inline(always)]
fn weigh<'a, const ORDERS: usize>(
    sums: &mut [[f64; LANES]; ORDERS],
    samples: impl Iterator<Item = &'a [f64; LANES]> + Clone,
    tables: &[Table<ORDERS>],
) {
    for (group, sums) in sums.chunks_mut(TOGETHER).enumerate() {
        let mut these = [[0.0; LANES]; TOGETHER];
        for (x, table) in samples.clone().zip(tables) {
            let table = &table[group * TOGETHER..];
            for (sum, table) in these.iter_mut().zip(table) {
                for k in 0..LANES {
                    sum[k] += x[k] * table[k];
                }
            }
        }
        sums.copy_from_slice(&these[..sums.len()]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two harmonics and an offset in a window of whole periods.
    #[test]
    fn harmonics_are_found_and_put_together_again() {
        // Even and odd lengths, three periods each.
        for length in [120, 121] {
            let per_sample = 3.0 / length as f64;
            let parts = [
                Complex::from_polar(5.0, 0.3),
                Complex::from_polar(2.0, -1.0),
            ];
            let wave = |n: usize| -> f64 {
                let angle = TAU * per_sample * n as f64;
                let of =
                    |h: f64, part: Complex<f64>| (part * Complex::from_polar(1.0, h * angle)).re;
                of(1.0, parts[0]) + of(3.0, parts[1])
            };
            let windows = CentredHarmonics::new(per_sample, length, [1.0, 3.0]);
            for first in [0, 17, 1000] {
                let x: Vec<f64> = (first..first + length).map(|n| wave(n) + 7.0).collect();
                let sums = windows.sums(first, &x);
                for (sum, part) in sums.iter().zip(parts) {
                    let found = sum * (2.0 / length as f64);
                    assert!(
                        (found - part).norm() < 1e-9,
                        "{length} {first}: {found} {part}"
                    );
                }
                let mut out = vec![0.0; length];
                windows.synthesise(first, &parts, &mut out);
                for (out, n) in out.iter().zip(first..) {
                    assert!((f64::from(*out) - wave(n)).abs() < 1e-5, "{length} {n}");
                }
            }
        }
    }
}
