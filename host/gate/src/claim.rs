//! Check of R(t) and L(t) that another machine states for a segment against the segment's samples: v = R·i + L·di/dt
//! (paper eq. 1) in one pass, without a fit.
//!
//! The claim is refuted if the samples differ from it by more than their noise and the check's own error allow. It is
//! never corrected.

use std::f64::consts::TAU;

use ihd_identify::lockin::{Boxcar, LockInPhasors, demodulate};
use ihd_signal::interpolation::linear;
use ihd_signal::noise::WhiteNoise;
use ihd_signal::{Segment, SegmentError};
use nalgebra::Complex;

use crate::limits::plausible_ranges;

/// Switching periods of each of the lock-in's two boxcars: with 61/3 samples a period, whole samples fill three.
const BOXCAR_PERIODS: std::ops::RangeInclusive<usize> = 3..=5;

/// Part of the half-cycle that is checked, from its zero crossing: nearer to it the current is too small.
const CHECKED_PART: std::ops::Range<f64> = 0.05..0.95;

/// Stretches of equal length into which the checked part is divided: a claim that is right on average and wrong at the
/// crest is refuted there.
const STRETCHES: usize = 9;

/// Fewest phasors of a stretch.
const MIN_PHASORS: usize = 8;

/// Limit over one stretch. Its share in percent is the check's own error: R and L change within the lock-in's boxcars.
/// An honest claim follows the same samples and shares most of their noise, so twice its standard deviation is added.
const OWN_ERROR: Limit = Limit {
    pct: [0.1, 0.1],
    sigmas: 2.0,
};

/// Limit over all stretches together, where the errors on rising and falling flank cancel.
const OWN_MEAN_ERROR: Limit = Limit {
    pct: [0.03, 0.02],
    sigmas: 1.0,
};

/// Share of the voltage in percent that R and L may leave beside noise; a tone beside the switching frequency or a moving
/// frequency leaves more.
const MAX_LEFT_PCT: f64 = 1.0;

/// Largest difference that is not refuted: a share of R and of L in percent, and standard deviations of noise.
#[derive(Clone, Copy, Debug)]
struct Limit {
    pct: [f64; 2],
    sigmas: f64,
}

/// R(t) and L(t) as stated by the other machine.
#[derive(Clone, Copy, Debug)]
pub struct ClaimedResult<'a> {
    /// Times in seconds after the segment's zero crossing, rising.
    pub t_s: &'a [f64],
    /// R at these times, in ohm.
    pub r_ohm: &'a [f64],
    /// L at these times, in henry.
    pub l_h: &'a [f64],
}

/// Result of a check that the claim passed, with figures of the segment at the claim's times.
#[derive(Clone, Debug, PartialEq)]
pub struct Confirmation {
    /// Amplitude of the current's fundamental in ampere.
    pub i_amplitude_a: Vec<f64>,
    /// Residual χ² of the voltage against white noise; infinite outside the checked part.
    pub chi2: Vec<f64>,
    /// R and L of the samples less the stated ones, in percent.
    pub differs_pct: [f64; 2],
    /// Standard deviations of these differences by white noise, in percent.
    pub sigma_pct: [f64; 2],
}

/// Reason for which a claim is refuted.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ClaimError {
    /// Lists of different length, too few points, or times that do not rise.
    #[error("its lists of time, R and L do not belong together")]
    Lists,
    /// A value that no hob's load has.
    #[error("it states R = {r_ohm:.4} Ω and L = {:.3} µH, which no load has", l_h * 1e6)]
    NoLoad {
        /// R in ohm.
        r_ohm: f64,
        /// L in henry.
        l_h: f64,
    },
    /// A part of the half-cycle is missing.
    #[error("it goes from {from_ms:.2} to {to_ms:.2} ms and leaves a part of the half-cycle out")]
    NotCovered {
        /// First time in milliseconds after the zero crossing.
        from_ms: f64,
        /// Last time in milliseconds after the zero crossing.
        to_ms: f64,
    },
    /// The samples show another R or L.
    #[error(
        "from {from_ms:.1} to {to_ms:.1} ms the samples differ from it by {r_pct:+.2} % of R and {l_pct:+.2} % of L; {r_limit_pct:.2} % and {l_limit_pct:.2} % are allowed"
    )]
    Differs {
        /// Beginning of the stretch in milliseconds after the zero crossing.
        from_ms: f64,
        /// End of the stretch in milliseconds after the zero crossing.
        to_ms: f64,
        /// R of the samples over the stated, less one, in percent.
        r_pct: f64,
        /// L of the samples over the stated, less one, in percent.
        l_pct: f64,
        /// Largest difference of R that noise and the check's own error explain, in percent.
        r_limit_pct: f64,
        /// Largest difference of L that noise and the check's own error explain, in percent.
        l_limit_pct: f64,
    },
    /// R and L leave more of the voltage than noise explains.
    #[error("it leaves {left_pct:.2} % of the voltage unexplained; {MAX_LEFT_PCT} % is allowed")]
    Unexplained {
        /// Root-mean-square of the unexplained voltage, in percent of the voltage.
        left_pct: f64,
    },
    /// The segment is too short for the check.
    #[error("the window cannot be held against it: {0}")]
    Segment(#[from] SegmentError),
}

/// Checks a claim against the samples of one half-cycle. Costs two boxcars per channel and one pass over the phasors.
///
/// # Errors
/// [`ClaimError`] names the first thing that is wrong.
pub fn confirm(segment: &Segment, claim: &ClaimedResult<'_>) -> Result<Confirmation, ClaimError> {
    claim.check(segment)?;
    let points = residuals(segment, claim)?;
    let noise = WhiteNoise::measure(segment);
    let seen = |p: &&Residual| CHECKED_PART.contains(&p.phase);
    let all: Vec<&Residual> = points.iter().filter(seen).collect();
    let per_phasor = segment.samples_per_period();
    // Two boxcars make a triangle, of whose samples two thirds count.
    let kernel = 1.5 * boxcar(per_phasor).samples() as f64;
    let look = |of: &[&Residual], own: Limit| {
        let samples = of.len() as f64 * per_phasor;
        Difference::fit(of, samples, noise).check(of, own)
    };
    let mut chi2 = [1.0; STRETCHES];
    for (k, chi2) in chi2.iter_mut().enumerate() {
        let within = |p: &&&Residual| stretch(p.phase) == Some(k);
        let of: Vec<&Residual> = all.iter().filter(within).copied().collect();
        if of.len() >= MIN_PHASORS {
            look(&of, OWN_ERROR)?;
            let sum: f64 = of.iter().map(|p| p.chi2(noise, kernel)).sum();
            *chi2 = (sum / of.len() as f64).max(1.0);
        }
    }
    let mean = look(&all, OWN_MEAN_ERROR)?;
    check_residual(&all, noise, kernel)?;
    Ok(Confirmation {
        i_amplitude_a: interpolated_at(claim.t_s, &points, |p| p.i.norm()),
        chi2: {
            let half_s = segment.half_cycle_s();
            let of = |t_s: &f64| stretch(t_s / half_s).map_or(f64::INFINITY, |k| chi2[k]);
            claim.t_s.iter().map(of).collect()
        },
        differs_pct: mean.pct,
        sigma_pct: mean.sigma_pct,
    })
}

/// Index of the stretch at a phase of the half-cycle; `None` outside [`CHECKED_PART`].
fn stretch(phase: f64) -> Option<usize> {
    let at =
        (phase - CHECKED_PART.start) / (CHECKED_PART.end - CHECKED_PART.start) * STRETCHES as f64;
    (0.0..STRETCHES as f64).contains(&at).then_some(at as usize)
}

impl ClaimedResult<'_> {
    fn check(&self, segment: &Segment) -> Result<(), ClaimError> {
        let n = self.t_s.len();
        let rises = self.t_s.windows(2).all(|w| w[1] > w[0]);
        if n < STRETCHES || self.r_ohm.len() != n || self.l_h.len() != n || !rises {
            return Err(ClaimError::Lists);
        }
        let [r_range, l_range] = plausible_ranges();
        let is_load = |r: f64, l: f64| {
            (r_range.0..=r_range.1).contains(&r) && (l_range.0..=l_range.1).contains(&l)
        };
        for (&r_ohm, &l_h) in self.r_ohm.iter().zip(self.l_h) {
            if !is_load(r_ohm, l_h) {
                return Err(ClaimError::NoLoad { r_ohm, l_h });
            }
        }
        let half_s = segment.half_cycle_s();
        let from_s = (segment.t0_s - segment.zero_crossing_s).max(CHECKED_PART.start * half_s);
        let end_s = segment.t_s(segment.len()) - segment.zero_crossing_s;
        let to_s = end_s.min(CHECKED_PART.end * half_s);
        let step_s = (to_s - from_s) / STRETCHES as f64;
        let (first, last) = (self.t_s[0], self.t_s[n - 1]);
        let gap = self.t_s.windows(2).any(|w| w[1] - w[0] > step_s);
        // NaN fails both comparisons.
        let covers = first <= from_s + 0.1 * step_s && last >= to_s - 0.1 * step_s;
        if !covers || gap {
            let (from_ms, to_ms) = (first * 1e3, last * 1e3);
            return Err(ClaimError::NotCovered { from_ms, to_ms });
        }
        Ok(())
    }

    /// R and L at a time, linear between the points.
    fn at(&self, t_s: f64) -> (f64, f64) {
        let at = |values: &[f64]| linear(self.t_s, values, t_s).unwrap_or(f64::NAN);
        (at(self.r_ohm), at(self.l_h))
    }
}

/// One phasor, and the voltage that the stated R and L leave of it.
struct Residual {
    /// Time in seconds after the zero crossing.
    t_s: f64,
    /// Time as a share of the half-cycle.
    phase: f64,
    v: Complex<f64>,
    /// Coil current in ampere; `d` is its derivative in ampere per second.
    i: Complex<f64>,
    d: Complex<f64>,
    /// Stated R in ohm and L in henry.
    r_ohm: f64,
    l_h: f64,
    /// Voltage that the stated R and L leave unexplained, in volt.
    left: Complex<f64>,
}

impl Residual {
    /// Variance that white noise alone causes in a sample of the unexplained voltage, in V².
    fn variance(&self, noise: WhiteNoise) -> f64 {
        let z2 = (self.v.norm_sqr() / self.i.norm_sqr().max(f64::MIN_POSITIVE)).min(1e6);
        noise.v_v * noise.v_v + z2 * noise.i_a * noise.i_a
    }

    /// Mean square that white noise alone leaves, in V²: an amplitude is twice a mean over so many samples.
    fn expected(&self, noise: WhiteNoise, samples: f64) -> f64 {
        4.0 * self.variance(noise) / samples
    }

    fn chi2(&self, noise: WhiteNoise, samples: f64) -> f64 {
        let expected = self.expected(noise, samples);
        match expected > 0.0 {
            true => self.left.norm_sqr() / expected,
            false => 1.0,
        }
    }
}

/// Shortest pair of boxcars that whole samples nearly fill. Its blocks are single samples, so that there is a second boxcar:
/// a single one would let the image at −f_sw pass wherever the amplitude moves.
fn boxcar(samples_per_period: f64) -> Boxcar {
    let left = |periods: &usize| {
        let samples = *periods as f64 * samples_per_period;
        (samples - samples.round()).abs()
    };
    let periods = BOXCAR_PERIODS.min_by(|a, b| left(a).total_cmp(&left(b)));
    let samples = periods.unwrap_or(*BOXCAR_PERIODS.start()) as f64 * samples_per_period;
    Boxcar {
        block: 1,
        blocks: samples.round() as usize,
    }
}

fn residuals(segment: &Segment, claim: &ClaimedResult<'_>) -> Result<Vec<Residual>, ClaimError> {
    let per_period = segment.samples_per_period();
    let phasors = demodulate(segment, boxcar(per_period));
    let least = STRETCHES * MIN_PHASORS;
    if phasors.len() < least {
        let needed = (least + 4 * BOXCAR_PERIODS.end()) as f64;
        return Err(ClaimError::Segment(segment.too_short(needed)));
    }
    let omega = TAU * segment.f_sw_hz;
    let half_s = segment.half_cycle_s();
    let residual = |w: &[LockInPhasors]| {
        let t_s = segment.t0_s + w[1].centre * segment.dt_s - segment.zero_crossing_s;
        let step_s = (w[2].centre - w[0].centre) * segment.dt_s;
        let (v, i) = (w[1].v, w[1].i);
        let d = i * Complex::new(0.0, omega) + (w[2].i - w[0].i) / step_s;
        let (r_ohm, l_h) = claim.at(t_s);
        Residual {
            t_s,
            phase: t_s / half_s,
            v,
            i,
            d,
            r_ohm,
            l_h,
            left: v - i * r_ohm - d * l_h,
        }
    };
    Ok(phasors.windows(3).map(residual).collect())
}

/// R and L of the samples less the stated ones, over a stretch.
struct Difference {
    pct: [f64; 2],
    /// Standard deviations by white noise, in percent.
    sigma_pct: [f64; 2],
}

impl Difference {
    /// Fits the unexplained voltage as ΔR·I + ΔL·D by least squares.
    fn fit(stretch: &[&Residual], samples: f64, noise: WhiteNoise) -> Self {
        let (mut ii, mut id, mut dd, mut ie, mut de) = (0.0, 0.0, 0.0, 0.0, 0.0);
        let (mut r, mut l, mut variance) = (0.0, 0.0, 0.0);
        for p in stretch {
            ii += p.i.norm_sqr();
            id += (p.i.conj() * p.d).re;
            dd += p.d.norm_sqr();
            ie += (p.i.conj() * p.left).re;
            de += (p.d.conj() * p.left).re;
            r += p.i.norm_sqr() * p.r_ohm;
            l += p.d.norm_sqr() * p.l_h;
            variance += p.variance(noise) * p.i.norm_sqr();
        }
        let determinant = ii * dd - id * id;
        let pct = |x: f64, of: f64| 100.0 * x / of;
        let n = stretch.len() as f64;
        let (r, l) = (r / ii, l / dd);
        // The mean square of the samples is half the amplitude squared.
        let sigma_v = (2.0 * variance / ii / samples).sqrt();
        Self {
            pct: [
                pct((ie * dd - de * id) / determinant, r),
                pct((de * ii - ie * id) / determinant, l),
            ],
            sigma_pct: [
                pct(sigma_v / (ii / n).sqrt(), r),
                pct(sigma_v / (dd / n).sqrt(), l),
            ],
        }
    }

    fn check(self, stretch: &[&Residual], own: Limit) -> Result<Self, ClaimError> {
        let limit = |k: usize| own.pct[k].hypot(own.sigmas * self.sigma_pct[k]);
        let within = |k: usize| self.pct[k].abs() <= limit(k);
        if within(0) && within(1) {
            return Ok(self);
        }
        let ms = |p: Option<&&Residual>| p.map_or(0.0, |p| 1e3 * p.t_s);
        Err(ClaimError::Differs {
            from_ms: ms(stretch.first()),
            to_ms: ms(stretch.last()),
            r_pct: self.pct[0],
            l_pct: self.pct[1],
            r_limit_pct: limit(0),
            l_limit_pct: limit(1),
        })
    }
}

/// Checks that little more than noise is left of the voltage.
fn check_residual(all: &[&Residual], noise: WhiteNoise, samples: f64) -> Result<(), ClaimError> {
    let (mut power, mut white, mut whole) = (0.0, 0.0, 0.0);
    for p in all {
        power += p.left.norm_sqr();
        white += p.expected(noise, samples);
        whole += p.v.norm_sqr();
    }
    let left_pct = 100.0 * ((power - 2.0 * white).max(0.0) / whole).sqrt();
    match left_pct <= MAX_LEFT_PCT {
        true => Ok(()),
        false => Err(ClaimError::Unexplained { left_pct }),
    }
}

/// Returns a quantity of the residuals, interpolated at other times.
fn interpolated_at(
    t_s: &[f64],
    points: &[Residual],
    quantity: impl Fn(&Residual) -> f64,
) -> Vec<f64> {
    let own_s: Vec<f64> = points.iter().map(|p| p.t_s).collect();
    let values: Vec<f64> = points.iter().map(quantity).collect();
    let at = |t_s: &f64| linear(&own_s, &values, *t_s).unwrap_or(f64::NAN);
    t_s.iter().map(at).collect()
}
