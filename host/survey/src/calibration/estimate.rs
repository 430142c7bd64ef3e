//! Calibration from a capture of a reference.

use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2, TAU};

use ihd_signal::{Capture, ORDERS};
use nalgebra::Complex;

use super::{CONTRADICTION_SIGMAS, Calibration, ReferenceLoad, WELL_KNOWN_S};
use crate::aliasing::Aliasing;
use crate::impedance::{Wiring, load_of_order};
use crate::track::{Track, track};
use crate::{Finding, Severity, Survey, SurveyError};

/// Reason why a capture gives no calibration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrateError {
    /// The capture cannot be surveyed.
    #[error(transparent)]
    Survey(#[from] SurveyError),
    /// A fault of the capture would falsify the calibration.
    #[error("{name}: {finding}")]
    Unfit {
        /// Name of the capture.
        name: String,
        /// Finding that prevents it.
        finding: Finding,
    },
    /// R and skew cannot be separated.
    #[error(
        "{name}: only {khz:.2} kHz is seen, where R of the empty coil and a skew look alike: give its R \
         (no-pot,r=0.1), or capture several switching frequencies"
    )]
    OneFrequency {
        /// Name of the capture.
        name: String,
        /// Only frequency in the capture, in kilohertz.
        khz: f64,
    },
    /// The capture cannot come from the reference.
    #[error("{name}: {what}: is this the reference, and are the probe ratios right?")]
    NotTheReference {
        /// Name of the capture.
        name: String,
        /// Contradiction to the reference, as text.
        what: String,
    },
}

/// A measured impedance at one frequency.
#[derive(Clone, Copy, Debug)]
struct Point {
    omega: f64,
    z: Complex<f64>,
    /// Standard deviation of its phase in radian, and of ln |z|: white noise gives both the same.
    sigma: f64,
    /// `true` for the fundamental.
    first: bool,
}

/// Phase noise above which a harmonic is left out, in radian.
const MAX_PHASE_NOISE_RAD: f64 = 0.02;

/// Least angle of the impedance's phase from 0 or 90° at which one of R and L determines it.
const MIN_PHASE_ANGLE_RAD: f64 = 0.15;

/// Estimates the calibration of the channels from a capture of `reference`.
///
/// # Errors
/// [`CalibrateError`]: a capture without switching, clipped or wrongly connected; too little data to separate skew from the
/// load; a load that cannot be the reference.
pub fn estimate(
    capture: &Capture,
    survey: &Survey,
    reference: ReferenceLoad,
) -> Result<Calibration, CalibrateError> {
    // A negative R is no obstacle, because a skew causes it; every other finding of this severity is.
    let unfit = |f: &&Finding| {
        f.severity() == Severity::Error && !matches!(f, Finding::NegativeResistance { .. })
    };
    if let Some(finding) = survey.findings.iter().find(unfit) {
        return Err(CalibrateError::Unfit {
            name: survey.name.clone(),
            finding: finding.clone(),
        });
    }
    let points = points(capture, survey);
    let mut assumed = vec!["no direct current in the coil (offsets)".to_owned()];
    let result = match reference {
        ReferenceLoad::NoPot { r_ohm, l_h } => no_pot(survey, &points, r_ohm, l_h, &mut assumed)?,
        ReferenceLoad::Load { r_ohm, l_h } => load(survey, &points, r_ohm, l_h, &mut assumed)?,
    };
    let varies = variation(capture, survey);
    let calibration = Calibration {
        skew_s: result.skew.0,
        skew_sigma_s: result.skew.1.hypot(varies.skew_s).hypot(aliased_s(survey)),
        gain_ratio: result.gain.0,
        // 0 stands for an assumed ratio.
        gain_ratio_sigma: match result.gain.1 {
            0.0 => 0.0,
            sigma => sigma.hypot(varies.ln_gain * result.gain.0),
        },
        v_offset_v: survey.voltage.mean,
        i_offset_a: survey.current.mean,
        response: super::Correction::default(),
        reference: reference.to_string(),
        assumed,
        capture: survey.name.clone(),
        contradictions: result.contradiction.into_iter().collect(),
    };
    match varies.text {
        // Numbers that no chain has name their own cause.
        Some(what) if calibration.check().is_ok() => Err(CalibrateError::NotTheReference {
            name: survey.name.clone(),
            what,
        }),
        _ => Ok(calibration),
    }
}

/// Standard deviation of the skew in seconds by edges that the rate folds onto the fundamental: they turn the voltage.
fn aliased_s(survey: &Survey) -> f64 {
    let f_sw_hz = survey
        .spans
        .iter()
        .map(|s| s.f_sw_hz)
        .fold(f64::INFINITY, f64::min);
    let turn = |a: &Aliasing| FRAC_1_SQRT_2 * 0.01 * a.v_pct;
    survey.aliasing.as_ref().map_or(0.0, turn) / (TAU * f_sw_hz)
}

/// Change of the impedance with the current, which a reference does not have.
#[derive(Clone, Debug, Default)]
struct Variation {
    /// Half of the change of the impedance's phase, as a delay in seconds.
    skew_s: f64,
    /// Half of the change of ln |Z|.
    ln_gain: f64,
    /// The change as text, where it is more than a reference's; `None` else.
    text: Option<String>,
}

/// Shares of the largest current whose impedances are compared.
const SMALL: std::ops::Range<f64> = 0.25..0.5;
const LARGE: std::ops::Range<f64> = 0.8..1.1;

/// Change of ln Z beyond which a load is no reference: a pot's is above 0.1.
const MAX_CHANGE: f64 = 0.03;

/// Largest variation of the spans' fundamentals; none where the current is constant.
fn variation(capture: &Capture, survey: &Survey) -> Variation {
    let mut worst = Variation::default();
    let mut most = 0.0;
    for span in &survey.spans {
        let track = track(capture, &span.run(), span.f_sw_hz);
        let (Some(small), Some(large)) = (impedance(&track, SMALL), impedance(&track, LARGE))
        else {
            continue;
        };
        let change = (large / small).ln();
        if change.norm() <= most {
            continue;
        }
        most = change.norm();
        let text = (most > MAX_CHANGE).then(|| {
            format!(
                "R is {:.2} ohm at small and {:.2} ohm at large current, ωL {:.2} and {:.2} ohm, where a reference has one of each",
                small.re, large.re, small.im, large.im
            )
        });
        worst = Variation {
            skew_s: 0.5 * change.im.abs() / (TAU * span.f_sw_hz),
            ln_gain: 0.5 * change.re.abs(),
            text,
        };
    }
    worst
}

/// Fewest frames of an impedance.
const MIN_FRAMES: usize = 8;

/// Impedance of the fundamental where the current is such a share of the largest one.
fn impedance(track: &Track, share: std::ops::Range<f64>) -> Option<Complex<f64>> {
    let (v, i) = (track.v_v.first()?, track.i_a.first()?);
    let most = i.iter().map(|i| i.norm()).fold(0.0, f64::max);
    let (mut power, mut square, mut frames) = (Complex::new(0.0, 0.0), 0.0, 0);
    for (v, i) in v.iter().zip(i) {
        if share.contains(&(i.norm() / most)) {
            power += v * i.conj();
            square += i.norm_sqr();
            frames += 1;
        }
    }
    (frames >= MIN_FRAMES).then(|| power / square)
}

/// Skew in seconds and gain ratio, each with its standard deviation.
struct SkewGain {
    skew: (f64, f64),
    gain: (f64, f64),
    /// Contradiction between the capture's own frequencies, as text; `None` if there is none.
    contradiction: Option<String>,
}

/// Impedances of every span at every harmonic that exceeds the noise.
fn points(capture: &Capture, survey: &Survey) -> Vec<Point> {
    let noise = [survey.voltage.noise, survey.current.noise].map(|n| n.unwrap_or(0.0));
    let mut out = Vec::new();
    for span in &survey.spans {
        let run = span.run();
        let track = track(capture, &run, span.f_sw_hz);
        for (order, h) in ORDERS.into_iter().enumerate() {
            let Some(z) = load_of_order(&track, order, Wiring::default()) else {
                continue;
            };
            let omega = TAU * span.f_sw_hz * f64::from(h);
            let sigma = phase_sigma(&track, order, noise);
            if order == 0 || sigma < MAX_PHASE_NOISE_RAD {
                out.push(Point {
                    omega,
                    z: Complex::new(z.r_ohm, omega * z.l_h),
                    sigma: sigma.max(1e-9),
                    first: order == 0,
                });
            }
        }
    }
    out
}

/// Standard deviation of an impedance's phase. For a sine of amplitude A in N samples of noise σ the phase has the variance
/// σ²/(N A²/2) (Cramér-Rao bound); both channels add.
fn phase_sigma(track: &Track, order: usize, noise: [f64; 2]) -> f64 {
    let hop = (track.frame / 2) as f64;
    let energy = |x: Option<&Vec<Complex<f64>>>| -> f64 {
        x.map_or(0.0, |x| {
            0.5 * hop * x.iter().map(|x| x.norm_sqr()).sum::<f64>()
        })
    };
    let channels = [track.v_v.get(order), track.i_a.get(order)];
    let variance: f64 = channels
        .into_iter()
        .zip(noise)
        .map(|(x, sigma)| sigma * sigma / energy(x))
        .sum();
    variance.sqrt()
}

/// Exponents of R ∝ f^p that a winding may have, from direct current to a full skin effect.
const SKIN: [f64; 2] = [0.0, 0.5];

/// Skew from the empty coil: phase = 90° − (R/L)(ω/ω₁)^p/ω − ω·skew.
fn no_pot(
    survey: &Survey,
    points: &[Point],
    r_ohm: Option<f64>,
    l_h: Option<f64>,
    assumed: &mut Vec<String>,
) -> Result<SkewGain, CalibrateError> {
    let least = points.iter().map(|p| p.omega).fold(f64::INFINITY, f64::min);
    let most = points.iter().map(|p| p.omega).fold(0.0, f64::max);
    let firsts = || points.iter().filter(|p| p.first);
    if r_ohm.is_none() && most < 1.25 * least {
        return Err(CalibrateError::OneFrequency {
            name: survey.name.clone(),
            khz: least / TAU * 1e-3,
        });
    }
    if let Some(p) = firsts().find(|p| p.z.im.atan2(p.z.re) < 1.2) {
        let (r, x) = (p.z.re, p.z.im);
        return Err(CalibrateError::NotTheReference {
            name: survey.name.clone(),
            what: format!("R of {r:.2} ohm beside {x:.2} ohm of reactance is no empty coil"),
        });
    }
    let gain = match l_h {
        Some(l_h) => weighted(firsts().map(|p| (p.z.norm() / (p.omega * l_h), p.sigma))),
        None => {
            assumed.push("right gains".to_owned());
            (1.0, 0.0)
        }
    };
    let l_own_h = weighted(firsts().map(|p| (p.z.norm() / p.omega, p.sigma))).0 / gain.0;
    assumed.push("constant L of the empty coil".to_owned());
    assumed.push("R of the empty coil growing as f^0 to f^0.5".to_owned());
    let fits = SKIN.map(|p| {
        // Difference of each point's phase from 90° in radian: a·ρ + ω·skew, a = (ω/ω₁)^p/ω.
        let rows = points.iter().map(|point| {
            let a = (point.omega / least).powf(p) / point.omega;
            let missing = FRAC_PI_2 - point.z.im.atan2(point.z.re);
            (a, point.omega, missing, point.sigma)
        });
        match r_ohm {
            Some(r_ohm) => weighted(rows.map(|(a, omega, missing, sigma)| {
                ((missing - a * r_ohm / l_own_h) / omega, sigma / omega)
            })),
            None => two_parameters(rows),
        }
    });
    let [(a, sigma_a), (b, sigma_b)] = fits;
    let systematic = 0.5 * (a - b).abs();
    let skew = (0.5 * (a + b), sigma_a.max(sigma_b).hypot(systematic));
    let known = r_ohm.map(|r_ohm| r_ohm / l_own_h);
    Ok(SkewGain {
        skew,
        gain,
        contradiction: contradiction(points, least, skew, known),
    })
}

/// Checks whether one skew and one R/L explain all frequencies; returns the contradiction as text if not. A channel with a
/// narrow band delays each harmonic differently, and turns R negative: no single number corrects that.
///
/// `known` is R over L at the lowest frequency, in 1/s; if `None`, the value that explains most is used.
fn contradiction(
    points: &[Point],
    least: f64,
    (skew_s, sigma_s): (f64, f64),
    known: Option<f64>,
) -> Option<String> {
    let missing = |p: &Point| FRAC_PI_2 - p.z.im.atan2(p.z.re);
    let rho_of = |exponent: f64| {
        known.unwrap_or_else(|| {
            weighted(points.iter().map(|p| {
                let a = (p.omega / least).powf(exponent) / p.omega;
                ((missing(p) - p.omega * skew_s) / a, p.sigma / a)
            }))
            .0
        })
    };
    let off = |p: &Point, exponent: f64, rho: f64| {
        (missing(p) - (p.omega / least).powf(exponent) / p.omega * rho) / p.omega - skew_s
    };
    // The exponent with the smaller residual.
    let worst = |exponent: f64| {
        let rho = rho_of(exponent);
        let each = points.iter().map(|p| {
            let allowed_s =
                CONTRADICTION_SIGMAS * (p.sigma / p.omega).hypot(sigma_s).max(WELL_KNOWN_S);
            (
                off(p, exponent, rho) / allowed_s,
                off(p, exponent, rho),
                p.omega,
            )
        });
        let worst = each.max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()));
        (worst.unwrap_or((0.0, 0.0, least)), rho)
    };
    let ends = SKIN.map(worst);
    let (worst, rho) = if ends[0].0.0.abs() <= ends[1].0.0.abs() {
        ends[0]
    } else {
        ends[1]
    };
    if worst.0.abs() > 1.0 {
        return Some(format!(
            "at {:.1} kHz the current lags by {:.1} ns, over all by {:.1} ns: a delay that changes with frequency is no \
             skew but a probe with too little bandwidth; use another one",
            worst.2 / TAU * 1e-3,
            (skew_s + worst.1) * 1e9,
            skew_s * 1e9
        ));
    }
    // Far below zero, or larger than an empty coil's.
    (known.is_none() && !(-0.01 * least..0.2 * least).contains(&rho)).then(|| {
        format!(
            "with a skew of {:.1} ns the empty coil would have R of {:.3} times its reactance: that is no skew of \
             sampling but a channel's bandwidth; use another probe",
            skew_s * 1e9,
            rho / least
        )
    })
}

/// Weighted least squares of y = a ρ + b s; returns s and its standard deviation.
fn two_parameters(rows: impl Iterator<Item = (f64, f64, f64, f64)>) -> (f64, f64) {
    let (mut aa, mut ab, mut bb, mut ay, mut by) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (a, b, y, sigma) in rows {
        let w = 1.0 / (sigma * sigma);
        aa += w * a * a;
        ab += w * a * b;
        bb += w * b * b;
        ay += w * a * y;
        by += w * b * y;
    }
    let determinant = aa * bb - ab * ab;
    ((aa * by - ab * ay) / determinant, (aa / determinant).sqrt())
}

/// Weighted mean and its standard deviation.
fn weighted(values: impl Iterator<Item = (f64, f64)>) -> (f64, f64) {
    let (sum, weight) = values.fold((0.0, 0.0), |(s, w), (x, sigma)| {
        let own = 1.0 / (sigma * sigma);
        (s + own * x, w + own)
    });
    (sum / weight, 1.0 / weight.sqrt())
}

/// Phase of a known load at |Z|, in radian, and its dependence dθ/d ln|Z|; `None` where |Z| does not give it.
fn phase_of_load(
    omega: f64,
    magnitude_ohm: f64,
    r_ohm: Option<f64>,
    l_h: Option<f64>,
) -> Option<(f64, f64)> {
    match (r_ohm, l_h) {
        (Some(r), Some(l)) => Some(((omega * l).atan2(r), 0.0)),
        (Some(r), None) => {
            let theta = (r / magnitude_ohm).clamp(-1.0, 1.0).acos();
            (theta >= MIN_PHASE_ANGLE_RAD).then(|| (theta, 1.0 / theta.tan()))
        }
        (None, l) => {
            let x_ohm = omega * l.unwrap_or(0.0);
            let theta = (x_ohm / magnitude_ohm).clamp(-1.0, 1.0).asin();
            (FRAC_PI_2 - theta >= MIN_PHASE_ANGLE_RAD).then(|| (theta, theta.tan()))
        }
    }
}

/// Skew from a load whose R, L or both are known, by the fundamental alone.
fn load(
    survey: &Survey,
    points: &[Point],
    r_ohm: Option<f64>,
    l_h: Option<f64>,
    assumed: &mut Vec<String>,
) -> Result<SkewGain, CalibrateError> {
    let wrong = |what: String| CalibrateError::NotTheReference {
        name: survey.name.clone(),
        what,
    };
    let mut skews = Vec::new();
    let mut gains = Vec::new();
    for p in points.iter().filter(|p| p.first) {
        let magnitude = p.z.norm();
        let Some((theta, steep)) = phase_of_load(p.omega, magnitude, r_ohm, l_h) else {
            return Err(wrong(format!(
                "|Z| of {magnitude:.3} ohm at {:.2} kHz does not give the phase: give R and L",
                p.omega / TAU * 1e-3
            )));
        };
        if let (Some(r), Some(l)) = (r_ohm, l_h) {
            let of_load = r.hypot(p.omega * l);
            gains.push((magnitude / of_load, p.sigma * magnitude / of_load));
        }
        let sigma = p.sigma * 1f64.hypot(steep) / p.omega;
        skews.push(((theta - p.z.im.atan2(p.z.re)) / p.omega, sigma));
    }
    if r_ohm.is_none() || l_h.is_none() {
        assumed.push("right gains".to_owned());
    }
    assumed.push("R and L of the reference independent of frequency and current".to_owned());
    let gain = if gains.is_empty() {
        (1.0, 0.0)
    } else {
        weighted(gains.into_iter())
    };
    let skew = weighted(skews.iter().copied());
    if skew.0.is_nan() || skew.0.abs() > super::MAX_SKEW_S {
        return Err(wrong(format!(
            "it would take a skew of {:.1} µs",
            skew.0 * 1e6
        )));
    }
    // The fundamentals of several frequencies must agree.
    let off = |s: &(f64, f64)| (s.0 - skew.0).abs() / s.1.hypot(skew.1).max(WELL_KNOWN_S);
    let worst = skews.iter().max_by(|a, b| off(a).total_cmp(&off(b)));
    let contradiction = worst.filter(|s| off(s) > CONTRADICTION_SIGMAS).map(|s| {
        format!(
            "one switching frequency shows a skew of {:.1} ns, all together {:.1} ns: is the reference the same at all \
             of them?",
            s.0 * 1e9,
            skew.0 * 1e9
        )
    });
    Ok(SkewGain {
        skew,
        gain,
        contradiction,
    })
}
