//! Fit of harmonic phasors: x(t) = Σ_h Re{X_h(t)·e^(jhωt)}, each X_h a cubic B-spline in slow time, by linear least squares
//! over all samples of voltage and current.
//!
//! Within a block of samples the splines are taken as constant: a sample then costs four multiply-adds per order, and all else
//! is done once per block. A block of one sample is exact. With 16 blocks per period the splines' steps are a sawtooth at 16 ω,
//! which is none of the usual orders. Products of two harmonics are sums at h ± h'; these few complex sums per pair of splines
//! make the normal equations of an interval.

use std::f64::consts::TAU;

use ihd_signal::correlation::Correlator;
use nalgebra::Complex;

use crate::single_samples::{Samples, Sums};
use crate::{Banded, CubicSpline, SingularMatrix};

type Phasor = Complex<f64>;

/// Pairs among the four splines that are non-zero at a time.
const PAIRS: usize = 10;

/// Fewest periods of the fundamental in an interval of the spline: fewer cannot distinguish the harmonics.
pub const MIN_INTERVAL_PERIODS: f64 = 3.0;

/// Orders that are summed in one pass over a block.
const ORDERS_PER_PASS: usize = 4;

/// Problem to fit: splines, orders and the positions of samples.
#[derive(Clone, Copy, Debug)]
pub struct HarmonicFit<'a> {
    /// Basis in slow time, in seconds after the first sample.
    pub spline: &'a CubicSpline,
    /// Orders of the fundamental, ascending.
    pub orders: &'a [u32],
    /// Factor with which each order appears in the samples: 1, or less if samples are means of others.
    pub gains: &'a [f64],
    /// Periods of the fundamental from one sample to the next.
    pub periods_per_sample: f64,
    /// Time from one sample to the next in seconds.
    pub dt_s: f64,
    /// Samples per block, at least one. A last block that is not full is left out.
    pub block: usize,
    /// Position in a block at which its splines are evaluated, in samples after its first.
    pub centre: f64,
}

/// Normal equations of voltage and current. They share the matrix, because times and functions are the same.
///
/// Order of the unknowns: by spline function, and within each a cosine and a sine of each order.
#[derive(Clone, Debug)]
pub struct NormalEquations {
    /// Matrix of both.
    pub gram: Banded,
    /// Right-hand side of the voltage.
    pub v: Vec<f64>,
    /// Right-hand side of the current.
    pub i: Vec<f64>,
}

impl NormalEquations {
    /// Solves for the coefficients of voltage and of current.
    ///
    /// # Errors
    /// [`SingularMatrix`] if the samples cannot distinguish the orders.
    pub fn solve(self) -> Result<[Vec<f64>; 2], SingularMatrix> {
        let mut solved = [self.v, self.i];
        self.gram.solve(&mut solved)?;
        Ok(solved)
    }
}

/// Phasor of the order at index `index` of `orders`, from a signal's coefficients; `weights` are values or slopes of the splines
/// from `first` on at a time.
pub fn phasor(
    coefficients: &[f64],
    orders: usize,
    index: usize,
    first: usize,
    weights: &[f64; 4],
) -> Phasor {
    // a cos + b sin = Re{(a − jb)·e^(jθ)}.
    (0..4).fold(Complex::new(0.0, 0.0), |sum, m| {
        let at = 2 * ((first + m) * orders + index);
        sum + Complex::new(coefficients[at], -coefficients[at + 1]) * weights[m]
    })
}

impl HarmonicFit<'_> {
    /// Sums the normal equations over all blocks of the samples of voltage and current.
    pub fn normal_equations(&self, v: &[f64], i: &[f64]) -> NormalEquations {
        let turns = Turns::new(self);
        if self.block == 1 {
            return self.of_single_samples(&turns, v, i);
        }
        let correlators: Vec<Correlator<ORDERS_PER_PASS>> = self
            .orders
            .chunks(ORDERS_PER_PASS)
            .map(|orders| {
                let order = |k| orders.get(k).map_or(0.0, |h: &u32| f64::from(*h));
                let all = std::array::from_fn(order);
                Correlator::with_rate(self.periods_per_sample, self.block, all)
            })
            .collect();
        let mut equations = self.no_equations();
        let mut interval = Interval::new(self.orders.len(), turns.count());
        let mut powers = Vec::new();
        let blocks = v.chunks_exact(self.block).zip(i.chunks_exact(self.block));
        for (b, (v, i)) in blocks.enumerate() {
            let first = b * self.block;
            let tau_s = (first as f64 + self.centre) * self.dt_s;
            let (function, values) = self.spline.values_at(tau_s);
            if function != interval.first {
                self.add(&interval, &turns, &mut equations);
                interval.clear(function);
            }
            turns.powers(first, &mut powers);
            for (group, correlator) in correlators.iter().enumerate() {
                let orders = &self.orders[group * ORDERS_PER_PASS..];
                let turn = |k| {
                    orders
                        .get(k)
                        .map_or(powers[0], |h: &u32| powers[*h as usize])
                };
                let sums = correlator.block_turned(&std::array::from_fn(turn), v, i);
                for k in 0..orders.len().min(ORDERS_PER_PASS) {
                    interval.add_signals(
                        group * ORDERS_PER_PASS + k,
                        &values,
                        sums.v[k],
                        sums.i[k],
                    );
                }
            }
            interval.add_products(&values, &turns, &powers);
        }
        self.add(&interval, &turns, &mut equations);
        equations
    }

    fn no_equations(&self) -> NormalEquations {
        NormalEquations {
            gram: Banded::zeros(self.unknowns(), 8 * self.orders.len() - 1),
            v: vec![0.0; self.unknowns()],
            i: vec![0.0; self.unknowns()],
        }
    }

    fn of_single_samples(&self, turns: &Turns, v: &[f64], i: &[f64]) -> NormalEquations {
        let samples = Samples {
            spline: self.spline,
            periods_per_sample: self.periods_per_sample,
            dt_s: self.dt_s,
            centre: self.centre,
            v: &v[..v.len().min(i.len())],
            i,
        };
        let multiples = (0..turns.count() as u32).map(|k| k * turns.stride);
        let mut sums = Sums::new(multiples.collect(), self.orders, self.periods_per_sample);
        let mut equations = self.no_equations();
        let mut interval = Interval::new(self.orders.len(), turns.count());
        let mut from = 0;
        while from < samples.v.len() {
            sums.clear(self.spline, samples.interval(from));
            from = sums.add(&samples, from);
            interval.first = sums.first;
            interval.products = sums.products();
            (interval.v, interval.i) = (sums.v(), sums.i());
            self.add(&interval, turns, &mut equations);
        }
        equations
    }

    /// Number of unknowns of one signal.
    pub fn unknowns(&self) -> usize {
        2 * self.orders.len() * self.spline.functions()
    }

    /// Adds the sums of an interval to the equations.
    fn add(&self, part: &Interval, turns: &Turns, equations: &mut NormalEquations) {
        let orders = self.orders.len();
        let mut pair = 0;
        for m in 0..4 {
            let row = 2 * (part.first + m) * orders;
            for (h, gain) in self.gains.iter().enumerate() {
                // Re{(a − jb)·e^(jθ)} = a cos θ + b sin θ, and the sums hold e^(−jθ).
                for (x, sums) in [(&mut equations.v, &part.v), (&mut equations.i, &part.i)] {
                    x[row + 2 * h] += gain * sums[m * orders + h].re;
                    x[row + 2 * h + 1] -= gain * sums[m * orders + h].im;
                }
            }
            for before in 0..=m {
                let column = 2 * (part.first + before) * orders;
                let sums = &part.products[pair * turns.count()..];
                self.add_pair((row, column), sums, turns.stride, &mut equations.gram);
                pair += 1;
            }
        }
    }

    /// Adds products by cos a cos b = ½(cos(a−b) + cos(a+b)) and so on; `sums[k]` is Σ e^(−j·k·stride·ωt).
    fn add_pair(
        &self,
        (row, column): (usize, usize),
        sums: &[Phasor],
        stride: u32,
        gram: &mut Banded,
    ) {
        let sum = |multiple: u32| sums[(multiple / stride) as usize];
        for (a, (&h, gain)) in self.orders.iter().zip(self.gains).enumerate() {
            for (b, (&other, other_gain)) in self.orders.iter().zip(self.gains).enumerate() {
                let (plus, minus) = (sum(h + other), sum(h.abs_diff(other)));
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
                        gram.add(r, c, 0.5 * gain * other_gain * value);
                    }
                }
            }
        }
    }
}

/// Multiples of the fundamental that occur in products of two orders.
struct Turns {
    periods_per_sample: f64,
    /// 2 if all orders are odd, because their sums and differences are then even; else 1.
    stride: u32,
    /// Σ e^(−j·k·stride·ωt) over a block from its first sample, which is at angle 0.
    within: Vec<Phasor>,
}

impl Turns {
    fn new(fit: &HarmonicFit<'_>) -> Self {
        let odd = fit.orders.iter().all(|h| h % 2 == 1);
        let stride = if odd { 2 } else { 1 };
        let highest = 2 * fit.orders.last().copied().unwrap_or(0);
        let sum = |multiple: u32| {
            let turns = f64::from(multiple) * fit.periods_per_sample;
            (0..fit.block)
                .map(|n| Complex::from_polar(1.0, -TAU * turns * n as f64))
                .sum()
        };
        Self {
            periods_per_sample: fit.periods_per_sample,
            stride,
            within: (0..=highest).step_by(stride as usize).map(sum).collect(),
        }
    }

    fn count(&self) -> usize {
        self.within.len()
    }

    /// e^(−jkωt) at a sample for every k up to the highest multiple, as powers of one sine and cosine.
    fn powers(&self, sample: usize, powers: &mut Vec<Phasor>) {
        let (sin, cos) = libm::sincos(TAU * (sample as f64 * self.periods_per_sample).fract());
        let turn = Complex::new(cos, -sin);
        let count = (self.count() - 1) * self.stride as usize + 1;
        let mut power = Complex::new(1.0, 0.0);
        powers.clear();
        powers.extend((0..count).map(|_| {
            let this = power;
            power *= turn;
            this
        }));
    }
}

/// Sums over one interval of the spline.
struct Interval {
    first: usize,
    orders: usize,
    multiples: usize,
    products: Vec<Phasor>,
    v: Vec<Phasor>,
    i: Vec<Phasor>,
    /// Σ e^(−j·k·stride·ωt) of the present block.
    turned: Vec<Phasor>,
}

impl Interval {
    fn new(orders: usize, multiples: usize) -> Self {
        let zeros = |n| vec![Complex::new(0.0, 0.0); n];
        Self {
            first: 0,
            orders,
            multiples,
            products: zeros(PAIRS * multiples),
            v: zeros(4 * orders),
            i: zeros(4 * orders),
            turned: Vec::with_capacity(multiples),
        }
    }

    fn clear(&mut self, first: usize) {
        self.first = first;
        for sums in [&mut self.products, &mut self.v, &mut self.i] {
            sums.fill(Complex::new(0.0, 0.0));
        }
    }

    fn add_signals(&mut self, order: usize, values: &[f64; 4], v: Phasor, i: Phasor) {
        for (m, &value) in values.iter().enumerate() {
            self.v[m * self.orders + order] += v * value;
            self.i[m * self.orders + order] += i * value;
        }
    }

    fn add_products(&mut self, values: &[f64; 4], turns: &Turns, powers: &[Phasor]) {
        let of_block = turns.within.iter();
        let turned = of_block.zip(powers.iter().step_by(turns.stride as usize));
        self.turned.clear();
        self.turned
            .extend(turned.map(|(within, power)| within * power));
        let mut pair = 0;
        for (m, value) in values.iter().enumerate() {
            for other in &values[..=m] {
                let weight = value * other;
                let sums = &mut self.products[pair * self.multiples..][..self.multiples];
                for (sum, turned) in sums.iter_mut().zip(&self.turned) {
                    *sum += turned * weight;
                }
                pair += 1;
            }
        }
    }
}

#[cfg(test)]
mod tests;
