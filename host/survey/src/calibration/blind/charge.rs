//! Charge that flowed in a stretch, by the trapezoidal rule, which is accurate enough to find edges.

use std::ops::Range;

use ihd_signal::vectorised::{dot, sum, vectorised};

use super::samples::StretchSamples;

/// Computes the charge in coulomb at samples of the current in ampere, up to a constant.
pub(super) fn charge_c(i_a: &[f64], dt_s: f64, q_c: &mut Vec<f64>) {
    q_c.resize(i_a.len(), 0.0);
    let (fours, rest) = i_a.as_chunks::<4>();
    let (q_fours, q_rest) = q_c.as_chunks_mut::<4>();
    let mut before = 0.0;
    // The sum waits for one addition in four.
    for (q, [a, b, c, d]) in q_fours.iter_mut().zip(fours) {
        let two = a + b;
        let sums = [0.5 * a, a + 0.5 * b, two + 0.5 * c, two + (c + 0.5 * d)];
        *q = sums.map(|sum| dt_s * (before + sum));
        before += two + (c + d);
    }
    for (q, i) in q_rest.iter_mut().zip(rest) {
        *q = dt_s * (before + 0.5 * i);
        before += i;
    }
}

/// Samples of a block, and samples that are converted at a time.
const BLOCK: usize = 64;
const CONVERTED: usize = 64 * BLOCK;

/// Sums from which those up to any sample follow: what lies before a block's first sample, and a sum over the block.
#[derive(Clone, Copy, Debug)]
struct BlockSums {
    /// Sum of the current before it.
    current: f64,
    /// Sum of the charge before it.
    charge: f64,
    /// Sum over the block's samples of the charge's sum before each.
    within: f64,
}

impl BlockSums {
    /// Sums of charge and, over the samples, of its sums, up to a sample of the block; and the current's, before it.
    fn up_to(&self, i_a: &[f64]) -> [f64; 3] {
        let [all, first, second] = vectorised(
            #[inline(always)]
            || [sum(i_a), dot(&POSITIONS[0], i_a), dot(&POSITIONS[1], i_a)],
        );
        let n = i_a.len() as f64;
        let squares = (n - 1.0) * (n - 1.0) * all - 2.0 * (n - 1.0) * first + second;
        [
            self.charge + n * self.current + (n - 0.5) * all - first,
            n * self.charge + 0.5 * n * (n - 1.0) * self.current + 0.5 * squares,
            self.current + all,
        ]
    }
}

/// Positions in a block, and their squares.
const POSITIONS: [[f64; BLOCK]; 2] = {
    let mut positions = [[0.0; BLOCK]; 2];
    let mut k = 0;
    while k < BLOCK {
        positions[0][k] = k as f64;
        positions[1][k] = (k * k) as f64;
        k += 1;
    }
    positions
};

/// Charge of a stretch.
#[derive(Clone, Debug)]
pub(super) struct Charge {
    /// Sums of the charge over the sampling interval, block by block; the last block may have no sample.
    blocks: Vec<BlockSums>,
    dt_s: f64,
    /// Samples of one and a half periods.
    half: usize,
}

impl Charge {
    /// Sums a current in ampere with so many samples a period, `dt_s` seconds apart.
    pub fn compute(i_a: &StretchSamples<'_>, dt_s: f64, per_period: f64) -> Self {
        let mut blocks = Vec::with_capacity(i_a.len() / BLOCK + 1);
        let mut next = BlockSums {
            current: 0.0,
            charge: 0.0,
            within: 0.0,
        };
        let (whole, mut buffer) = (i_a.len() / BLOCK * BLOCK, Vec::new());
        for first in (0..whole).step_by(CONVERTED) {
            let samples = first..whole.min(first + CONVERTED);
            for i_a in i_a.block(samples, &mut buffer).chunks_exact(BLOCK) {
                let [charge, within, current] = next.up_to(i_a);
                blocks.push(BlockSums { within, ..next });
                (next.charge, next.current) = (charge, current);
            }
        }
        blocks.push(next);
        Self {
            blocks,
            dt_s,
            half: ((1.5 * per_period).round() as usize).max(1),
        }
    }

    /// Sums before sample `k` of the charge, and from the block's first sample on of those sums.
    fn before(&self, i_a: &StretchSamples<'_>, k: usize) -> [f64; 2] {
        let block = k / BLOCK;
        let mut buffer = Vec::new();
        let [charge, within, _] =
            self.blocks[block].up_to(i_a.block(block * BLOCK..k, &mut buffer));
        [charge, within]
    }

    /// Sum over a range of samples of the charge's sum before each.
    fn sum_of_sums(&self, i_a: &StretchSamples<'_>, samples: Range<usize>) -> f64 {
        let whole = &self.blocks[samples.start / BLOCK..samples.end / BLOCK];
        let whole: f64 = whole.iter().map(|block| block.within).sum();
        let of = |k: usize| self.before(i_a, k)[1];
        whole + of(samples.end) - of(samples.start)
    }

    /// Mean charge in coulomb at the carrier's frequency over a range of samples: at each less the mean over three periods.
    pub fn swinging_c(&self, i_a: &StretchSamples<'_>, samples: Range<usize>) -> f64 {
        let (half, last) = (self.half, i_a.len());
        let before = |k: usize| self.before(i_a, k)[0];
        let all = before(samples.end) - before(samples.start);
        let means = if samples.start >= half && samples.end + half <= last {
            let after = self.sum_of_sums(i_a, samples.start + half..samples.end + half);
            let first = self.sum_of_sums(i_a, samples.start - half..samples.end - half);
            (after - first) / (2 * half) as f64
        } else {
            let mean = |k: usize| {
                let (a, b) = (k.saturating_sub(half), (k + half).min(last));
                (before(b) - before(a)) / (b - a).max(1) as f64
            };
            samples.clone().map(mean).sum()
        };
        self.dt_s * (all - means) / samples.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against sums sample by sample, in the middle and at both ends.
    #[test]
    fn blocks_give_the_sums_of_their_samples() {
        let (dt_s, per_period) = (0.5, 40.0);
        let i_a: Vec<f64> = (0..700)
            .map(|k| (f64::from(k) * 0.157).sin() + 0.1)
            .collect();
        let mut q_c = Vec::new();
        charge_c(&i_a, dt_s, &mut q_c);
        let rise = 0.5 * dt_s * (i_a[299] + i_a[300]);
        assert!((q_c[300] - q_c[299] - rise).abs() < 1e-12);
        let samples = StretchSamples::Doubles(i_a);
        let charge = Charge::compute(&samples, dt_s, per_period);
        for range in [0..20, 10..29, 100..118, 128..192, 333..350, 640..700] {
            let swinging = |k: usize| {
                let (a, b) = (k.saturating_sub(60), (k + 60).min(700));
                q_c[k] - q_c[a..b].iter().sum::<f64>() / (b - a) as f64
            };
            let mean = range.clone().map(swinging).sum::<f64>() / range.len() as f64;
            let found = charge.swinging_c(&samples, range.clone());
            assert!((found - mean).abs() < 1e-10, "{range:?}: {found} {mean}");
        }
    }
}
