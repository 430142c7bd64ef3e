//! One law R(Î), L(Î) from all half-cycles of a segment: Gaussian processes of the current's amplitude, pooled over time.
//!
//! Phasors of some .1 ms give linear equations, V = R(Î)·I + X(Î)·D with D = jI + İ/ω and X = ωL. R and X are Gaussian processes
//! over u = ln(1 + Î/4 A) with a Matérn covariance of order 3/2, beside a drift in proportion to time. Values at knots of u are the
//! unknowns, so that the cost does not grow with the length; length scale and widths have the largest evidence.

use std::f64::consts::{PI, TAU};

use ihd_signal::Segment;
use ihd_signal::noise::WhiteNoise;
use nalgebra::{Cholesky, Complex, DMatrix, DVector, Dyn};

use crate::Estimate;
use crate::lockin::{Boxcar, LockInPhasors, demodulate};

/// Current in ampere at which u begins to grow with the logarithm.
const BEND_A: f64 = 4.0;

/// Knots of u: linear interpolation between them costs some hundredths of a percent of R where it bends most.
const KNOTS: usize = 48;

/// Switching periods of a boxcar, and length of a mean in seconds.
const BOXCAR_PERIODS: f64 = 3.0;
const MEAN_S: f64 = 0.1e-3;

/// Part of the half-cycle that is used, from its zero crossing: nearer to it the kinks of R and L count.
const PART: std::ops::Range<f64> = 0.06..0.94;

/// Share of the voltage that the model leaves at best.
const MODEL: f64 = 1e-4;

/// Length scales in u, and widths of R and X as shares of their means, from which the evidence chooses.
const LENGTHS: [f64; 3] = [0.7, 1.5, 3.0];
const WIDTHS: [f64; 4] = [0.01, 0.05, 0.2, 0.8];

/// Standard deviations of mean and drift, as shares of the mean.
const MEAN_WIDTH: f64 = 2.0;
const DRIFT_WIDTH: f64 = 0.05;

/// Fewest means.
const MIN_MEANS: usize = 60;

/// R and L over the current's amplitude, with standard deviations. All vectors have one length.
#[derive(Clone, Debug, PartialEq)]
pub struct PooledLaw {
    /// Amplitudes of the current's fundamental in ampere, ascending.
    pub i_a: Vec<f64>,
    /// R in ohm, in the middle of the segment's time.
    pub r_ohm: Vec<f64>,
    /// Standard deviations of R in ohm.
    pub r_sigma_ohm: Vec<f64>,
    /// L in henry, in the middle of the segment's time.
    pub l_h: Vec<f64>,
    /// Standard deviations of L in henry.
    pub l_sigma_h: Vec<f64>,
    /// Change of R from beginning to end in ohm, and its standard deviation.
    pub r_drift_ohm: (f64, f64),
    /// Squared residual over what noise leaves.
    pub chi2: f64,
}

impl PooledLaw {
    /// R in ohm and L in henry with their standard deviations at an amplitude in ampere, linear in u; constant beyond the ends.
    pub fn at(&self, i_a: f64) -> [(f64, f64); 2] {
        let last = self.i_a.len() - 1;
        let above = self.i_a.partition_point(|x| *x < i_a).clamp(1, last);
        let (low, high) = (u(self.i_a[above - 1]), u(self.i_a[above]));
        let share = ((u(i_a) - low) / (high - low)).clamp(0.0, 1.0);
        let of = |x: &[f64]| x[above - 1] + share * (x[above] - x[above - 1]);
        [
            (of(&self.r_ohm), of(&self.r_sigma_ohm)),
            (of(&self.l_h), of(&self.l_sigma_h)),
        ]
    }
}

fn u(i_a: f64) -> f64 {
    (i_a / BEND_A).ln_1p()
}

/// Boxcar behind which the phasors of a segment are pooled: of three switching periods, as of two and four, there is one that whole
/// samples nearly fill, also at 61/3 samples a period, so that the harmonics lie on its zeros.
pub fn boxcar(segment: &Segment) -> Boxcar {
    Boxcar::of_periods(segment, BOXCAR_PERIODS)
}

/// Mean of phasors.
#[derive(Clone, Debug, PartialEq)]
struct Mean {
    /// Middle in seconds, on the capture's clock.
    t_s: f64,
    v: Complex<f64>,
    i: Complex<f64>,
    d: Complex<f64>,
    /// Time from −1 at the segment's beginning to 1 at its end.
    at: f64,
    /// Variance of either part of the unexplained voltage in V².
    variance: f64,
}

fn means(segment: &Segment, noise: WhiteNoise, phasors: &[LockInPhasors]) -> Vec<Mean> {
    let f_sw_hz = segment.f_sw_hz;
    if phasors.len() < 3 {
        return Vec::new();
    }
    let stride = phasors[1].centre - phasors[0].centre;
    let step_s = stride * segment.dt_s;
    let omega = TAU * f_sw_hz;
    let group = ((MEAN_S / step_s).round() as usize).max(1);
    let samples = group as f64 * stride;
    let half_s = segment.half_cycle_s();
    let mut out = Vec::new();
    let mut from = 1;
    while from + group < phasors.len() {
        let n = group as f64;
        let sum = |of: &dyn Fn(usize) -> Complex<f64>| {
            (from..from + group).map(of).sum::<Complex<f64>>() / n
        };
        let v = sum(&|k| phasors[k].v);
        let i = sum(&|k| phasors[k].i);
        let slope = (phasors[from + group].i + phasors[from + group - 1].i
            - phasors[from].i
            - phasors[from - 1].i)
            / (2.0 * n * step_s);
        let centre = phasors[from].centre + 0.5 * (n - 1.0) * stride;
        let t_s = segment.t0_s + centre * segment.dt_s;
        let phase = segment.since_crossing_s(t_s) / half_s;
        let z2 = v.norm_sqr() / i.norm_sqr().max(f64::MIN_POSITIVE);
        let white = 2.0 * (noise.v_v * noise.v_v + z2 * noise.i_a * noise.i_a) / samples;
        // Where the amplitude changes fast, kinks and ripple of the load count more.
        let model = MODEL * v.norm() / (PI * phase).sin().max(0.05);
        if PART.contains(&phase) {
            out.push(Mean {
                t_s,
                v,
                i,
                d: i * Complex::new(0.0, 1.0) + slope / omega,
                at: 2.0 * centre / segment.len() as f64 - 1.0,
                variance: white + model * model,
            });
        }
        from += group;
    }
    out
}

/// Equations of the unknowns: R at the knots, its drift, then those of X.
struct Equations {
    normal: DMatrix<f64>,
    right: DVector<f64>,
    /// Σ |V|² over its variance.
    whole: f64,
    numbers: usize,
}

/// Unknowns of either quantity: the knots and the drift.
const EACH: usize = KNOTS + 1;

impl Equations {
    fn assemble(means: &[Mean], from_u: f64, spacing: f64) -> Self {
        let mut all = Self {
            normal: DMatrix::zeros(2 * EACH, 2 * EACH),
            right: DVector::zeros(2 * EACH),
            whole: 0.0,
            numbers: 2 * means.len(),
        };
        for m in means {
            let place = ((u(m.i.norm()) - from_u) / spacing).clamp(0.0, (KNOTS - 1) as f64);
            let k = (place as usize).min(KNOTS - 2);
            let share = place - k as f64;
            let row = [
                (k, m.i * (1.0 - share)),
                (k + 1, m.i * share),
                (KNOTS, m.i * m.at),
                (EACH + k, m.d * (1.0 - share)),
                (EACH + k + 1, m.d * share),
                (EACH + KNOTS, m.d * m.at),
            ];
            for (a, x) in row {
                all.right[a] += (x.conj() * m.v).re / m.variance;
                for (b, y) in row {
                    all.normal[(a, b)] += (x.conj() * y).re / m.variance;
                }
            }
            all.whole += m.v.norm_sqr() / m.variance;
        }
        all
    }
}

/// Prior covariance of one quantity of this mean, as a lower triangle's factor.
fn prior(mean: f64, width: f64, length: f64, spacing: f64) -> Option<DMatrix<f64>> {
    let matern = |a: usize, b: usize| {
        let x = 3f64.sqrt() * a.abs_diff(b) as f64 * spacing / length;
        (1.0 + x) * (-x).exp()
    };
    let covariance = DMatrix::from_fn(EACH, EACH, |a, b| match (a, b) {
        (KNOTS, KNOTS) => DRIFT_WIDTH * DRIFT_WIDTH,
        (KNOTS, _) | (_, KNOTS) => 0.0,
        _ => {
            let jitter = if a == b { 1e-10 } else { 0.0 };
            MEAN_WIDTH * MEAN_WIDTH + width * width * (matern(a, b) + jitter)
        }
    });
    let factor = covariance.cholesky()?.unpack();
    Some(factor * mean.abs())
}

/// Equations of one quantity's unknowns in those of a prior, which are independent and have a width of one.
struct Whitened {
    factor: DMatrix<f64>,
    normal: DMatrix<f64>,
    right: DVector<f64>,
    /// Products with the unknowns of R, which keep their own.
    with_r: DMatrix<f64>,
}

impl Whitened {
    /// Takes the unknowns from `first` on, with the factor of their prior.
    fn new(equations: &Equations, first: usize, factor: DMatrix<f64>) -> Self {
        let part = |column: usize| equations.normal.view((first, column), (EACH, EACH));
        Self {
            normal: factor.tr_mul(&(part(first) * &factor)),
            right: factor.tr_mul(&equations.right.rows(first, EACH)),
            with_r: factor.tr_mul(&part(0)),
            factor,
        }
    }
}

/// Posterior of one choice of the prior.
struct Posterior {
    evidence: f64,
    inner: Cholesky<f64, Dyn>,
    z: DVector<f64>,
    factors: [DMatrix<f64>; 2],
}

impl Posterior {
    fn compute(r: &Whitened, x: &Whitened) -> Option<Self> {
        let mut inner = DMatrix::identity(2 * EACH, 2 * EACH);
        let mut right = DVector::zeros(2 * EACH);
        for (first, of) in [(0, r), (EACH, x)] {
            let mut part = inner.view_mut((first, first), (EACH, EACH));
            part += &of.normal;
            right.rows_mut(first, EACH).copy_from(&of.right);
        }
        // Only the lower triangle is read.
        let mut across = inner.view_mut((EACH, 0), (EACH, EACH));
        across.copy_from(&(&x.with_r * &r.factor));
        let inner = inner.cholesky()?;
        let z = inner.solve(&right);
        let log_determinant: f64 = inner.l_dirty().diagonal().iter().map(|d| d.ln()).sum();
        Some(Self {
            evidence: 0.5 * right.dot(&z) - log_determinant,
            inner,
            z,
            factors: [r.factor.clone(), x.factor.clone()],
        })
    }

    /// Factors of both quantities as one.
    fn factor(&self) -> DMatrix<f64> {
        let mut factor = DMatrix::zeros(2 * EACH, 2 * EACH);
        for (first, of) in [0, EACH].into_iter().zip(&self.factors) {
            factor.view_mut((first, first), (EACH, EACH)).copy_from(of);
        }
        factor
    }
}

/// Standard deviations that all phasors share, so that no number of them averages them out.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SharedSigma {
    /// Relative ones of R and of L.
    pub shares: [f64; 2],
    /// Delay between the channels in seconds: it turns the impedance.
    pub delay_s: f64,
}

impl SharedSigma {
    /// Root of the sum of squares of both.
    pub fn hypot(self, other: Self) -> Self {
        let [r, l] = self.shares;
        Self {
            shares: [r.hypot(other.shares[0]), l.hypot(other.shares[1])],
            delay_s: self.delay_s.hypot(other.delay_s),
        }
    }

    /// Adds these to the standard deviations of an estimate, if it states any.
    pub fn widen(&self, estimate: &mut Estimate) {
        let omega = TAU * estimate.f_sw_hz;
        let loads = estimate.r_ohm.iter().zip(&estimate.l_h);
        let added: Vec<_> = loads.map(|(r, l)| self.of([*r, *l], omega)).collect();
        for (sigma, [r, _]) in estimate.r_sigma_ohm.iter_mut().zip(&added) {
            *sigma = sigma.hypot(*r);
        }
        for (sigma, [_, l]) in estimate.l_sigma_h.iter_mut().zip(&added) {
            *sigma = sigma.hypot(*l);
        }
    }

    /// Deviations of R in ohm and of L in henry, of a load of R in ohm and L in henry at ω in radian per second.
    pub fn of(&self, [r_ohm, l_h]: [f64; 2], omega: f64) -> [f64; 2] {
        [
            (self.shares[0] * r_ohm).hypot(omega * omega * l_h * self.delay_s),
            (self.shares[1] * l_h).hypot(r_ohm * self.delay_s),
        ]
    }
}

/// Phasors of a segment as they are pooled, 6.4 kB for each 10 ms: those of many segments can be kept.
#[derive(Clone, Debug, PartialEq)]
pub struct PoolPhasors {
    means: Vec<Mean>,
    shared: SharedSigma,
    f_sw_hz: f64,
    /// Beginning and end in seconds, on the capture's clock.
    span_s: (f64, f64),
}

impl PoolPhasors {
    /// Demodulates a segment; `noise` is its.
    pub fn demodulate(segment: &Segment, noise: WhiteNoise) -> Self {
        Self::from_phasors(segment, noise, &demodulate(segment, boxcar(segment)))
    }

    /// Takes phasors of a segment behind its [`boxcar`]; `noise` is its.
    pub fn from_phasors(segment: &Segment, noise: WhiteNoise, phasors: &[LockInPhasors]) -> Self {
        Self {
            means: means(segment, noise, phasors),
            shared: SharedSigma::default(),
            f_sw_hz: segment.f_sw_hz,
            span_s: (segment.t0_s, segment.t_s(segment.len())),
        }
    }

    /// Returns the same phasors with deviations that all of them share.
    pub fn with_shared(self, shared: SharedSigma) -> Self {
        Self { shared, ..self }
    }

    /// Switching frequency in hertz.
    pub fn f_sw_hz(&self) -> f64 {
        self.f_sw_hz
    }

    /// Beginning and end in seconds, on the capture's clock.
    pub fn span_s(&self) -> (f64, f64) {
        self.span_s
    }

    /// Joins those of segments in order of time, whose frequencies differ by little: R and L are those at the mean frequency.
    /// `None` without any.
    pub fn joined(all: &[Self]) -> Option<Self> {
        let (first, last) = (all.first()?, all.last()?);
        let span_s = (first.span_s.0, last.span_s.1);
        let f_sw_hz = all.iter().map(|p| p.f_sw_hz).sum::<f64>() / all.len() as f64;
        let of = |part: &Self| {
            let scale = part.f_sw_hz / f_sw_hz;
            let each = part.means.iter().map(move |m| Mean {
                // ωL of the part, as that of the mean frequency.
                d: m.d * scale,
                at: 2.0 * (m.t_s - span_s.0) / (span_s.1 - span_s.0) - 1.0,
                ..*m
            });
            each.collect::<Vec<_>>()
        };
        let most = |of: &dyn Fn(&SharedSigma) -> f64| {
            all.iter().map(|p| of(&p.shared)).fold(0.0, f64::max)
        };
        Some(Self {
            means: all.iter().flat_map(of).collect(),
            shared: SharedSigma {
                shares: [most(&|s| s.shares[0]), most(&|s| s.shares[1])],
                delay_s: most(&|s| s.delay_s),
            },
            f_sw_hz,
            span_s,
        })
    }
}

/// Pools the half-cycles of a segment, or of several; `None` if there are too few phasors, or no load.
pub fn pool_phasors(phasors: &PoolPhasors) -> Option<PooledLaw> {
    let means = &phasors.means;
    if means.len() < MIN_MEANS {
        return None;
    }
    let power = |of: &dyn Fn(&Mean) -> Complex<f64>| {
        means.iter().map(|m| (of(m).conj() * m.v).re).sum::<f64>()
            / means.iter().map(|m| of(m).norm_sqr()).sum::<f64>()
    };
    let (r_mean, x_mean) = (power(&|m| m.i), power(&|m| m.d));
    let amplitudes = || means.iter().map(|m| u(m.i.norm()));
    let (from_u, to_u) =
        amplitudes().fold((f64::INFINITY, 0.0f64), |(a, b), x| (a.min(x), b.max(x)));
    let spacing = (to_u - from_u).max(1e-3) / (KNOTS - 1) as f64;
    let equations = Equations::assemble(means, from_u, spacing);
    let mut best: Option<Posterior> = None;
    for length in LENGTHS {
        let of = |mean: f64, first: usize| -> Option<Vec<Whitened>> {
            let each = WIDTHS.iter().map(|w| prior(mean, *w, length, spacing));
            each.map(|factor| Some(Whitened::new(&equations, first, factor?)))
                .collect()
        };
        let (r, x) = (of(r_mean, 0)?, of(x_mean, EACH)?);
        for r in &r {
            for x in &x {
                let Some(now) = Posterior::compute(r, x) else {
                    continue;
                };
                if best.as_ref().is_none_or(|b| now.evidence > b.evidence) {
                    best = Some(now);
                }
            }
        }
    }
    let best = best?;
    let factor = best.factor();
    let fitted = &(&factor * &best.z);
    let left = equations.whole - 2.0 * equations.right.dot(fitted)
        + fitted.dot(&(&equations.normal * fitted));
    let chi2 = left.max(0.0) / equations.numbers as f64;
    // The covariance is F·M⁻¹·Fᵀ; noise that was not white widens it.
    let half = best.inner.l().solve_lower_triangular(&factor.transpose())?;
    let widened = chi2.max(1.0).sqrt();
    let sigma = |k: usize| widened * half.column(k).norm();
    let omega = TAU * phasors.f_sw_hz;
    let mut law = PooledLaw {
        i_a: (0..KNOTS)
            .map(|k| BEND_A * (from_u + k as f64 * spacing).exp_m1())
            .collect(),
        r_ohm: (0..KNOTS).map(|k| fitted[k]).collect(),
        r_sigma_ohm: (0..KNOTS).map(sigma).collect(),
        l_h: (0..KNOTS).map(|k| fitted[EACH + k] / omega).collect(),
        l_sigma_h: (0..KNOTS).map(|k| sigma(EACH + k) / omega).collect(),
        r_drift_ohm: (2.0 * fitted[KNOTS], 2.0 * sigma(KNOTS)),
        chi2,
    };
    for k in 0..KNOTS {
        let [r, l] = phasors.shared.of([law.r_ohm[k], law.l_h[k]], omega);
        law.r_sigma_ohm[k] = law.r_sigma_ohm[k].hypot(r);
        law.l_sigma_h[k] = law.l_sigma_h[k].hypot(l);
    }
    Some(law)
}
