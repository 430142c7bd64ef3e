//! Recursive least squares with forgetting and an excitation gate.
//!
//! The regression is eq. (1) averaged over two neighbouring blocks with a triangle, in which
//! differentiating the current is exact: the slope of the doubly averaged current is the difference
//! of its block means. Nothing is differentiated sample by sample.

use std::time::Instant;

use ihd_signal::Segment;
use ihd_signal::correlation::mean_impedance;
use serde::{Deserialize, Serialize};

use super::ekf::waveforms::finite;
use super::{Estimate, IdentifyError, IdentifyOptions, Method};

/// Options of the recursion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RlsSettings {
    /// Time in which a sample's weight falls to 1/e, in seconds.
    pub memory_s: f64,
    /// Length of a block in switching periods.
    pub block_periods: f64,
    /// Share of the mean squared current over the segment below which the recursion pauses; the squared current is smoothed over
    /// a period.
    pub gate: f64,
}

impl Default for RlsSettings {
    fn default() -> Self {
        Self {
            memory_s: 0.15e-3,
            block_periods: 1.0 / 12.0,
            gate: 1e-3,
        }
    }
}

/// Doubly averaged signals at the boundary between two blocks.
struct Row {
    /// Index of the boundary in samples.
    at: f64,
    v: f64,
    i: f64,
    /// Change of i per radian of the switching frequency.
    di: f64,
}

/// Σ x, and both halves of the triangle over a block: rising and falling weights.
fn moments(x: &[f64]) -> [f64; 3] {
    let m = x.len() as f64;
    let mut sums = [0.0; 2];
    for (n, x) in x.iter().enumerate() {
        sums[0] += x;
        sums[1] += x * (n as f64 + 0.5);
    }
    [
        sums[0] / m,
        sums[1] / (m * m),
        (sums[0] * m - sums[1]) / (m * m),
    ]
}

fn rows(segment: &Segment, block: usize) -> Vec<Row> {
    let per_radian = 1.0 / (std::f64::consts::TAU * segment.f_sw_hz * segment.dt_s * block as f64);
    let of = |x: &[f64]| x.chunks_exact(block).map(moments).collect::<Vec<_>>();
    let (v, i) = (of(&segment.v_v), of(&segment.i_a));
    let pairs = v.windows(2).zip(i.windows(2)).enumerate();
    pairs
        .map(|(k, (v, i))| Row {
            at: ((k + 1) * block) as f64 - 0.5,
            v: v[0][1] + v[1][2],
            i: i[0][1] + i[1][2],
            di: (i[1][0] - i[0][0]) * per_radian,
        })
        .collect()
}

/// Information matrix and vector of θ = (R, ωL), with exponential weights.
#[derive(Default)]
struct Recursion {
    a: [f64; 3],
    b: [f64; 2],
    square: f64,
    weight: f64,
    /// Σ i²·t, t in samples: an estimate belongs to the mean time of its data.
    time: f64,
}

impl Recursion {
    fn add(&mut self, row: &Row, keep: f64) {
        for x in self.a.iter_mut().chain(&mut self.b) {
            *x *= keep;
        }
        self.square *= keep;
        self.time *= keep;
        self.weight = self.weight * keep + 1.0;
        self.time += (row.i * row.i + row.di * row.di) * row.at;
        self.a[0] += row.i * row.i;
        self.a[1] += row.i * row.di;
        self.a[2] += row.di * row.di;
        self.b[0] += row.i * row.v;
        self.b[1] += row.di * row.v;
        self.square += row.v * row.v;
    }

    /// θ and the variances of its parts, from the residual; `None` if there is too little information.
    fn solve(&self) -> Option<([f64; 2], [f64; 2])> {
        let [a, b, c] = self.a;
        let determinant = a * c - b * b;
        if determinant.is_nan() || determinant <= 1e-9 * a * c {
            return None;
        }
        let theta = [
            (c * self.b[0] - b * self.b[1]) / determinant,
            (a * self.b[1] - b * self.b[0]) / determinant,
        ];
        let residual = (self.square - theta[0] * self.b[0] - theta[1] * self.b[1]).max(0.0);
        let variance = residual / self.weight;
        Some((
            theta,
            [variance * c / determinant, variance * a / determinant],
        ))
    }
}

/// Runs the recursion over the segment; one estimate per switching period.
///
/// # Errors
/// [`IdentifyError::Diverged`] if an estimate is not finite.
pub fn identify(segment: &Segment, settings: &IdentifyOptions) -> Result<Estimate, IdentifyError> {
    let started = Instant::now();
    let rls = &settings.rls;
    let omega = std::f64::consts::TAU * segment.f_sw_hz;
    let per_period = segment.samples_per_period();
    let block = ((rls.block_periods * per_period).round() as usize).max(1);
    let rows = rows(segment, block);
    let block_s = block as f64 * segment.dt_s;
    let keep = libm::exp(-block_s / rls.memory_s);
    let smooth = libm::exp(-block_s * segment.f_sw_hz);
    let gate = rls.gate * rows.iter().map(|r| r.i * r.i).sum::<f64>() / rows.len().max(1) as f64;
    let z = mean_impedance(segment);
    let (r0, x0) = settings.start.map_or((z.re, z.im), |(r, l)| (r, omega * l));
    let (mut theta, mut variance) = ([r0, x0], [z.norm_sqr(); 2]);
    let mut recursion = Recursion::default();
    let mut level = 0.0;
    let mut estimate = Estimate::new(Method::Rls, segment.f_sw_hz);
    let mut next = 1.0;
    for row in &rows {
        level = smooth * level + (1.0 - smooth) * row.i * row.i;
        if level >= gate {
            recursion.add(row, keep);
            if let Some((found, spread)) = recursion.solve() {
                (theta, variance) = (found, spread);
            }
        }
        let at = recursion.time / (recursion.a[0] + recursion.a[2]);
        if row.at >= next * per_period && level >= gate && at.is_finite() {
            next = (row.at / per_period).floor() + 1.0;
            let sigma = variance.map(f64::sqrt);
            estimate.push(
                segment.t0_s + at * segment.dt_s,
                (theta[0], theta[1] / omega),
                (sigma[0], sigma[1] / omega),
            );
        }
    }
    finite(&estimate, segment)?;
    estimate.elapsed = started.elapsed();
    Ok(estimate)
}
