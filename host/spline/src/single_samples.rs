//! Sums over single samples, each with its own splines: exact, and fast enough for some ten thousand samples.
//!
//! e^(−jkωt) of a sample is that of a stretch's first sample times a table entry. All multiples of the fundamental are adjacent
//! in memory, so that the sums fill whole registers.

use std::f64::consts::TAU;

use ihd_signal::vectorised::vectorised;
use nalgebra::Complex;

use crate::CubicSpline;

/// Samples per stretch; a stretch computes one sine and cosine per multiple.
const STRETCH: usize = 64;

/// The number of multiples is padded to a multiple of this.
const LANES: usize = 4;

/// Pairs among the four splines that are non-zero at a time.
const PAIRS: usize = 10;

/// Four splines of voltage and of current.
const SIGNALS: usize = 8;

/// Array of complex numbers with real and imaginary parts apart.
#[derive(Clone, Debug)]
struct Parts {
    re: Vec<[f64; LANES]>,
    im: Vec<[f64; LANES]>,
}

impl Parts {
    fn zeros(numbers: usize) -> Self {
        let zeros = vec![[0.0; LANES]; numbers.div_ceil(LANES)];
        Self {
            re: zeros.clone(),
            im: zeros,
        }
    }

    /// e^(−j·multiple·2π·turns) of each multiple.
    fn turned(multiples: &[u32], turns: f64) -> Self {
        let mut parts = Self::zeros(multiples.len());
        for (k, multiple) in multiples.iter().enumerate() {
            let (sin, cos) = libm::sincos(TAU * (f64::from(*multiple) * turns).fract());
            parts.re[k / LANES][k % LANES] = cos;
            parts.im[k / LANES][k % LANES] = -sin;
        }
        parts
    }

    fn clear(&mut self) {
        self.re.fill([0.0; LANES]);
        self.im.fill([0.0; LANES]);
    }

    fn get(&self, k: usize) -> Complex<f64> {
        Complex::new(self.re[k / LANES][k % LANES], self.im[k / LANES][k % LANES])
    }
}

/// Real and imaginary parts of [`LANES`] numbers.
type Lanes = [[f64; LANES]; 2];

/// Sets `out` to the products of the numbers of one lane group of `base` and `table`, entry by entry of the table.
#[inline(always)]
fn turn(out: &mut [Lanes], base: &Parts, table: &[Parts], group: usize) {
    let (a_re, a_im) = (base.re[group], base.im[group]);
    for (out, entry) in out.iter_mut().zip(table) {
        let (b_re, b_im) = (entry.re[group], entry.im[group]);
        for k in 0..LANES {
            out[0][k] = a_re[k] * b_re[k] - a_im[k] * b_im[k];
            out[1][k] = a_re[k] * b_im[k] + a_im[k] * b_re[k];
        }
    }
}

/// Adds weight times number to the sums of `N` rows of weights, sample by sample: all sums of a lane group stay in registers.
#[inline(always)]
fn add_products<const N: usize>(
    sums: &mut [Parts],
    weights: &[[f64; STRETCH]],
    turned: &[Lanes],
    group: usize,
) {
    let (sums, rows) = (&mut sums[..N], &weights[..N]);
    let mut totals: [Lanes; N] = std::array::from_fn(|r| [sums[r].re[group], sums[r].im[group]]);
    for (n, x) in turned.iter().enumerate().take(STRETCH) {
        for r in 0..N {
            for part in 0..2 {
                for k in 0..LANES {
                    totals[r][part][k] = rows[r][n].mul_add(x[part][k], totals[r][part][k]);
                }
            }
        }
    }
    for (sums, [re, im]) in sums.iter_mut().zip(totals) {
        (sums.re[group], sums.im[group]) = (re, im);
    }
}

/// Adds the products of all rows of weights, `N` at a time.
#[inline(always)]
fn add_all<const N: usize>(
    sums: &mut [Parts],
    weights: &[[f64; STRETCH]],
    turned: &[Lanes],
    group: usize,
) {
    for (sums, weights) in sums.chunks_exact_mut(N).zip(weights.chunks_exact(N)) {
        add_products::<N>(sums, weights, turned, group);
    }
}

/// Samples of voltage and current with their positions.
pub(crate) struct Samples<'a> {
    pub spline: &'a CubicSpline,
    pub periods_per_sample: f64,
    pub dt_s: f64,
    /// Position within a sample at which its splines are evaluated.
    pub centre: f64,
    pub v: &'a [f64],
    pub i: &'a [f64],
}

impl Samples<'_> {
    /// Interval of the spline in which a sample lies.
    pub fn interval(&self, n: usize) -> usize {
        self.spline.interval(self.position(n))
    }

    #[inline(always)]
    fn position(&self, n: usize) -> f64 {
        self.spline.position((n as f64 + self.centre) * self.dt_s)
    }
}

/// Sums over one interval of the spline.
pub(crate) struct Sums {
    /// Index of the interval, and of its first spline.
    pub first: usize,
    /// Polynomials of the interval's four splines.
    splines: [[f64; 4]; 4],
    multiples: Vec<u32>,
    orders: Vec<u32>,
    /// Rotation of each multiple, for each sample of a stretch.
    multiple_table: Vec<Parts>,
    order_table: Vec<Parts>,
    /// Sums of each multiple, by pair of splines.
    products: Vec<Parts>,
    /// Sums of each order, by spline: of the voltage, then of the current.
    signals: Vec<Parts>,
}

impl Sums {
    /// Creates sums for products with these multiples of the fundamental, and signals of these orders.
    pub fn new(multiples: Vec<u32>, orders: &[u32], periods_per_sample: f64) -> Self {
        let table = |of: &[u32]| -> Vec<Parts> {
            let at = |n: usize| Parts::turned(of, n as f64 * periods_per_sample);
            (0..STRETCH).map(at).collect()
        };
        Self {
            first: 0,
            splines: [[0.0; 4]; 4],
            multiple_table: table(&multiples),
            order_table: table(orders),
            products: vec![Parts::zeros(multiples.len()); PAIRS],
            signals: vec![Parts::zeros(orders.len()); SIGNALS],
            multiples,
            orders: orders.to_vec(),
        }
    }

    /// Begins another interval of a spline.
    pub fn clear(&mut self, spline: &CubicSpline, interval: usize) {
        self.first = interval;
        self.splines = spline.polynomials(interval);
        let all = self.products.iter_mut().chain(&mut self.signals);
        all.for_each(Parts::clear);
    }

    /// Adds samples from index `from` to the end of the interval; returns the index after the last one.
    pub fn add(&mut self, samples: &Samples<'_>, from: usize) -> usize {
        let mut at = from;
        while at < samples.v.len() {
            let stretch = at - at % STRETCH;
            let turns = stretch as f64 * samples.periods_per_sample;
            let bases = [
                Parts::turned(&self.multiples, turns),
                Parts::turned(&self.orders, turns),
            ];
            let end = (stretch + STRETCH).min(samples.v.len());
            let reached = vectorised(
                #[inline(always)]
                || self.add_stretch(samples, &bases, stretch, at..end),
            );
            at = reached;
            if reached < end {
                break;
            }
        }
        at
    }

    #[inline(always)]
    fn add_stretch(
        &mut self,
        samples: &Samples<'_>,
        bases: &[Parts; 2],
        stretch: usize,
        range: std::ops::Range<usize>,
    ) -> usize {
        // Samples beyond the interval's or the stretch's end are computed too, and not summed. Loops, because functions of arrays
        // are not inlined.
        let mut x = [0.0; STRETCH];
        for (n, x) in x.iter_mut().enumerate() {
            *x = samples.position(range.start + n);
        }
        let mut count = 0;
        while count < range.len() && samples.spline.interval(x[count]) == self.first {
            count += 1;
        }
        let mut values = [[0.0; STRETCH]; 4];
        for (values, [a, b, c, d]) in values.iter_mut().zip(self.splines) {
            for (value, x) in values.iter_mut().zip(&x) {
                let x = x - self.first as f64;
                *value = d.mul_add(x, c).mul_add(x, b).mul_add(x, a);
            }
        }
        let of_stretch = |x: &[f64]| {
            let mut block = [0.0; STRETCH];
            block[..count].copy_from_slice(&x[range.start..range.start + count]);
            block
        };
        let (v, i) = (of_stretch(samples.v), of_stretch(samples.i));
        let mut pairs = [[0.0; STRETCH]; PAIRS];
        let mut signals = [[0.0; STRETCH]; SIGNALS];
        let mut pair = 0;
        for m in 0..4 {
            for n in 0..STRETCH {
                signals[m][n] = values[m][n] * v[n];
                signals[4 + m][n] = values[m][n] * i[n];
            }
            for other in 0..=m {
                for n in 0..STRETCH {
                    pairs[pair][n] = values[m][n] * values[other][n];
                }
                pair += 1;
            }
        }
        let from = range.start - stretch;
        let mut turned = [[[0.0; LANES]; 2]; STRETCH];
        let turned = &mut turned[..count];
        for group in 0..bases[0].re.len() {
            turn(turned, &bases[0], &self.multiple_table[from..], group);
            add_all::<{ PAIRS / 2 }>(&mut self.products, &pairs, turned, group);
        }
        for group in 0..bases[1].re.len() {
            turn(turned, &bases[1], &self.order_table[from..], group);
            add_all::<{ SIGNALS / 2 }>(&mut self.signals, &signals, turned, group);
        }
        range.start + count
    }

    /// Σ b·b'·e^(−jkωt) of each multiple, by pair of splines.
    pub fn products(&self) -> Vec<Complex<f64>> {
        listed(&self.products, self.multiples.len())
    }

    /// Σ b·v·e^(−jhωt) of each order, by spline.
    pub fn v(&self) -> Vec<Complex<f64>> {
        listed(&self.signals[..4], self.orders.len())
    }

    /// Σ b·i·e^(−jhωt) of each order, by spline.
    pub fn i(&self) -> Vec<Complex<f64>> {
        listed(&self.signals[4..], self.orders.len())
    }
}

fn listed(parts: &[Parts], count: usize) -> Vec<Complex<f64>> {
    let all = parts.iter();
    all.flat_map(|parts| (0..count).map(|k| parts.get(k)))
        .collect()
}
