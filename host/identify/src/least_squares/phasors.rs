//! Phasors of the switching harmonics as B-splines, by least squares over all samples.
//!
//! x(t) = Σ_h Re{X_h(t)·e^(jhωt)}, X_h a cubic B-spline. Within a block of a sixteenth of a period
//! the splines are taken as constant (their steps are a sawtooth at 16 f_sw, which is none of the
//! fitted frequencies), so that a sample costs four multiply-adds an order and the rest is done once
//! a block. Products of two harmonics are sums at h ± h', 0 to 14: eight complex sums a pair of
//! splines make the normal equations of an interval.

use std::ops::Range;

use ihd_signal::Segment;
use ihd_signal::correlation::Correlator;
use ihd_spline::{Banded, CubicSpline};
use nalgebra::Complex;

use super::{LeastSquaresSettings, intervals};
use crate::{IdentifyError, Method};

/// Harmonics that are fitted. R and L come from the first; the others are there because their
/// modulation reaches over to it.
const ORDERS: [usize; 4] = [1, 3, 5, 7];

// The turns of the harmonics are odd powers of the fundamental's.
const _: () = assert!(ORDERS[1] == 3 && ORDERS[2] == 5 && ORDERS[3] == 7);

/// Sums and differences of two orders, halved: 0, 2, … 14.
const PRODUCTS: usize = 8;

/// Blocks of a switching period.
const BLOCKS_PER_PERIOD: f64 = 16.0;

/// Pairs of the four splines that are not zero at a time.
const PAIRS: usize = 10;

type Phasor = Complex<f64>;

/// The fitted fundamental of a stretch.
pub struct Fit {
    /// The splines' basis, in seconds after the first sample.
    pub spline: CubicSpline,
    /// Samples of one interval.
    pub samples_per_interval: f64,
    /// Time of the stretch's first sample in seconds.
    pub t0_s: f64,
    /// Duration of the stretch in seconds.
    pub duration_s: f64,
    v: Vec<Phasor>,
    i: Vec<Phasor>,
}

/// Phasors of the fundamental at one time.
pub struct Fundamental {
    /// Coil voltage in volt.
    pub v: Phasor,
    /// Coil current in ampere.
    pub i: Phasor,
    /// Its slope without the rotation, in ampere per second.
    pub i_slope: Phasor,
}

/// Normal equations of one interval, before they go into the band.
struct Interval {
    first: usize,
    products: [[Phasor; PRODUCTS]; PAIRS],
    v: [[Phasor; ORDERS.len()]; 4],
    i: [[Phasor; ORDERS.len()]; 4],
}

impl Interval {
    fn empty(first: usize) -> Self {
        let zero = Complex::new(0.0, 0.0);
        Self {
            first,
            products: [[zero; PRODUCTS]; PAIRS],
            v: [[zero; ORDERS.len()]; 4],
            i: [[zero; ORDERS.len()]; 4],
        }
    }
}

impl Fit {
    /// Fits a range of samples within one mains half-cycle.
    pub fn new(
        segment: &Segment,
        range: Range<usize>,
        settings: &LeastSquaresSettings,
    ) -> Result<Self, IdentifyError> {
        let per_period = segment.samples_per_period();
        let (v_v, i_a) = (&segment.v_v[range.clone()], &segment.i_a[range.clone()]);
        let used = ORDERS
            .iter()
            .filter(|&&h| 2.0 * h as f64 + 1.0 < per_period)
            .count();
        let duration_s = v_v.len() as f64 * segment.dt_s;
        let count = intervals(settings.phasor_intervals, duration_s, segment);
        let spline = CubicSpline::new(count, duration_s);
        let block = ((per_period / BLOCKS_PER_PERIOD).round() as usize).max(1);
        let correlator = Correlator::new(segment, block, ORDERS.map(|h| h as f64));
        let fundamental = Correlator::new(segment, 0, [1.0]);
        // Σ e^(−j2kωt) over a block from its first sample, which is at angle 0.
        let within: [Phasor; PRODUCTS] = std::array::from_fn(|k| {
            let turns = 2.0 * k as f64 / per_period;
            (0..block)
                .map(|n| Complex::from_polar(1.0, -std::f64::consts::TAU * turns * n as f64))
                .sum()
        });
        let mut normal = Normal::new(&spline, used.max(1));
        let mut interval = Interval::empty(0);
        let blocks = v_v.chunks_exact(block).zip(i_a.chunks_exact(block));
        for (b, (v, i)) in blocks.enumerate() {
            let first = b * block;
            let centre_s = (first as f64 + 0.5 * block as f64) * segment.dt_s;
            let local = spline.at(centre_s);
            if local.first != interval.first {
                normal.add(&interval);
                interval = Interval::empty(local.first);
            }
            let turn = fundamental.turn(first)[0];
            let sums = correlator.block_turned(&odd_powers(turn), v, i);
            let products = turned(&within, turn);
            let mut pair = 0;
            for (m, &value) in local.values.iter().enumerate() {
                for h in 0..ORDERS.len() {
                    interval.v[m][h] += sums.v[h] * value;
                    interval.i[m][h] += sums.i[h] * value;
                }
                for &other in &local.values[..=m] {
                    let weight = value * other;
                    for (sum, product) in interval.products[pair].iter_mut().zip(&products) {
                        *sum += product * weight;
                    }
                    pair += 1;
                }
            }
        }
        normal.add(&interval);
        let (v, i) = normal.solve()?;
        Ok(Self {
            samples_per_interval: v_v.len() as f64 / count as f64,
            t0_s: segment.t_s(range.start),
            duration_s,
            spline,
            v,
            i,
        })
    }

    /// The fundamental at `tau_s` seconds after the stretch's first sample.
    pub fn at(&self, tau_s: f64) -> Fundamental {
        let local = self.spline.at(tau_s);
        let sum = |x: &[Phasor], weights: &[f64; 4]| {
            let near = x[local.first..].iter().zip(weights);
            near.map(|(x, w)| x * *w).sum()
        };
        Fundamental {
            v: sum(&self.v, &local.values),
            i: sum(&self.i, &local.values),
            i_slope: sum(&self.i, &local.slopes_per_s),
        }
    }
}

/// e^(−jhωt) of [`ORDERS`], given that of the fundamental: one sine a block instead of four.
fn odd_powers(turn: Phasor) -> [Phasor; ORDERS.len()] {
    let square = turn * turn;
    let mut power = turn;
    std::array::from_fn(|k| {
        if k > 0 {
            power *= square;
        }
        power
    })
}

/// The block's sums Σ e^(−j2kωt), given e^(−jωt) of its first sample.
fn turned(within: &[Phasor; PRODUCTS], turn: Phasor) -> [Phasor; PRODUCTS] {
    let square = turn * turn;
    let mut power = Complex::new(1.0, 0.0);
    within.map(|w| {
        let product = w * power;
        power *= square;
        product
    })
}

/// The normal equations: (cos, sin) of each order of each spline.
struct Normal {
    orders: usize,
    gram: Banded,
    v: Vec<f64>,
    i: Vec<f64>,
}

impl Normal {
    fn new(spline: &CubicSpline, orders: usize) -> Self {
        let size = 2 * orders * spline.functions();
        Self {
            orders,
            gram: Banded::zeros(size, 8 * orders - 1),
            v: vec![0.0; size],
            i: vec![0.0; size],
        }
    }

    fn add(&mut self, part: &Interval) {
        let width = 2 * self.orders;
        let mut pair = 0;
        for m in 0..4 {
            let row = (part.first + m) * width;
            for h in 0..self.orders {
                // Re{(a − jb)·e^(jθ)} = a cos θ + b sin θ, and the sums hold e^(−jθ).
                for (x, sums) in [(&mut self.v, &part.v), (&mut self.i, &part.i)] {
                    x[row + 2 * h] += sums[m][h].re;
                    x[row + 2 * h + 1] -= sums[m][h].im;
                }
            }
            for before in 0..=m {
                let column = (part.first + before) * width;
                self.add_pair(row, column, &part.products[pair]);
                pair += 1;
            }
        }
    }

    /// cos a cos b = ½(cos(a−b) + cos(a+b)) and so on; `sums[k]` is Σ e^(−j2kωt).
    fn add_pair(&mut self, row: usize, column: usize, sums: &[Phasor; PRODUCTS]) {
        for a in 0..self.orders {
            for b in 0..self.orders {
                let (plus, minus) = (sums[a + b + 1], sums[a.abs_diff(b)]);
                // sin of (a − b): the sum's imaginary part is −sin of |a − b|.
                let sine = if a >= b { -minus.im } else { minus.im };
                let entries = [
                    (0, 0, minus.re + plus.re),
                    (0, 1, -plus.im - sine),
                    (1, 0, -plus.im + sine),
                    (1, 1, minus.re - plus.re),
                ];
                for (p, q, value) in entries {
                    let (r, c) = (row + 2 * a + p, column + 2 * b + q);
                    if c <= r {
                        self.gram.add(r, c, 0.5 * value);
                    }
                }
            }
        }
    }

    /// Phasors of the fundamental, spline by spline: voltage, current.
    fn solve(self) -> Result<(Vec<Phasor>, Vec<Phasor>), IdentifyError> {
        let width = 2 * self.orders;
        let mut solved = [self.v, self.i];
        self.gram.solve(&mut solved).map_err(|singular| {
            let why = format!(
                "the sampling cannot tell the harmonics of f_sw apart ({singular}): sample faster, or \
                 not at a small multiple of f_sw"
            );
            IdentifyError::Unfit {
                method: Method::LeastSquares,
                why,
            }
        })?;
        let phasors = |x: &[f64]| {
            let splines = x.chunks_exact(width);
            splines.map(|c| Complex::new(c[0], -c[1])).collect()
        };
        Ok((phasors(&solved[0]), phasors(&solved[1])))
    }
}
