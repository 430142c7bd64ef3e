//! Fit of a window: its summary, and its trace for store and API.

use ihd_link::Window;
use ihd_model::{FitRemark, FitStep};
use ihd_pinn::{Identification, TrainingProgress};
use ihd_signal::Remark;
use ihd_signal::interpolation::linear;
use ihd_signal::truth::Truth;
use ihd_store::{MAX_POINTS, StoredCurve};
use serde::{Deserialize, Serialize};

use crate::printable::printable;

/// Trace of a fit: steps, remarks, curve, errors.
#[derive(Clone, Debug, Default)]
pub struct FitTrace {
    /// Steps of the optimiser, thinned if they are many.
    pub steps: Vec<FitStep>,
    /// Remarks on the window and the result.
    pub remarks: Vec<FitRemark>,
    /// R(t) and L(t); `None` without a result.
    pub curve: Option<StoredCurve>,
    /// Error of the mean R against the truth in percent; `None` if the truth is not known.
    pub r_error_pct: Option<f64>,
    /// Error of the mean L against the truth in percent; `None` if the truth is not known.
    pub l_error_pct: Option<f64>,
}

/// Most steps in a trace.
const MAX_STEPS: usize = 256;

impl FitTrace {
    /// Builds the trace of a window.
    pub fn new(
        identified: Option<&Identification>,
        findings: &[Remark],
        truth: Option<&Truth>,
    ) -> Self {
        let remarks = findings.iter().map(fit_remark).collect();
        let Some(identified) = identified else {
            return Self {
                remarks,
                ..Self::default()
            };
        };
        let errors = truth.and_then(|truth| errors_pct(identified, truth));
        Self {
            steps: steps(&identified.history),
            remarks,
            curve: Some(curve(identified)),
            r_error_pct: errors.map(|(r, _)| r),
            l_error_pct: errors.map(|(_, l)| l),
        }
    }
}

/// Converts a remark for the API.
pub(super) fn fit_remark(finding: &Remark) -> FitRemark {
    FitRemark {
        code: finding.code.to_owned(),
        severity: finding.severity.to_string(),
        text: printable(&finding.text),
    }
}

fn steps(history: &[TrainingProgress]) -> Vec<FitStep> {
    let every = history.len().div_ceil(MAX_STEPS).max(1);
    let last = history.len().saturating_sub(1);
    let chosen = history.iter().enumerate();
    let chosen = chosen.filter(|(k, _)| k % every == 0 || *k == last);
    chosen
        .map(|(_, step)| FitStep {
            step: u32::try_from(step.iteration).unwrap_or(u32::MAX),
            loss: step.loss,
            change: step.change.is_finite().then_some(step.change),
        })
        .filter(|step| step.loss.is_finite())
        .collect()
}

fn curve(identified: &Identification) -> StoredCurve {
    let curve = StoredCurve {
        t_s: identified.t_s.clone(),
        r_ohm: identified.r_ohm.clone(),
        l_h: identified.l_h.clone(),
        i_a: identified.i_amplitude_a.clone(),
        r_sigma_ohm: identified.r_sigma_ohm.clone(),
        l_sigma_h: identified.l_sigma_h.clone(),
    };
    curve.thinned()
}

/// Returns the errors of the means of R and L, weighted with the squared current, against the truth at the same times, in percent.
fn errors_pct(identified: &Identification, truth: &Truth) -> Option<(f64, f64)> {
    let (mut r, mut l, mut all) = (0.0, 0.0, 0.0);
    for (t_s, i_a) in identified.t_s.iter().zip(&identified.i_amplitude_a) {
        let (r_ohm, l_h) = truth.at(*t_s)?;
        r += i_a * i_a * r_ohm;
        l += i_a * i_a * l_h;
        all += i_a * i_a;
    }
    let summary = FitSummary::from_identified(identified);
    let error = |x: f64, sum: f64| 100.0 * (x / (sum / all) - 1.0);
    let (r, l) = (error(summary.r_ohm, r), error(summary.l_h, l));
    (r.is_finite() && l.is_finite()).then_some((r, l))
}

/// Returns the truth over the pairs of a window.
pub fn truth_curve(truth: &Truth, window: &Window) -> StoredCurve {
    let last = window.pairs.len().saturating_sub(1);
    let mut curve = StoredCurve::default();
    for k in 0..MAX_POINTS {
        let t_s = window.pair_time_s(0)
            + last as f64 * window.dt_s() * k as f64 / (MAX_POINTS - 1) as f64;
        let Some((r_ohm, l_h)) = truth.at(t_s) else {
            return StoredCurve::default();
        };
        curve.t_s.push(t_s);
        curve.r_ohm.push(r_ohm);
        curve.l_h.push(l_h);
        curve
            .i_a
            .push(linear(&truth.t_s, &truth.i_a, t_s).unwrap_or(0.0));
    }
    curve
}

/// Summary of a fit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FitSummary {
    /// Largest amplitude of the current's fundamental, in ampere.
    pub i_crest_a: f64,
    /// Mean of R weighted with the squared current, in ohm.
    pub r_ohm: f64,
    /// Mean of L weighted with the squared current, in henry.
    pub l_h: f64,
    /// Standard deviation of R, in percent.
    pub sigma_r_pct: f64,
    /// Standard deviation of L, in percent.
    pub sigma_l_pct: f64,
    /// Number of optimiser steps.
    pub iterations: u32,
}

impl FitSummary {
    /// Summary without a result.
    pub const NONE: Self = Self {
        i_crest_a: f64::NAN,
        r_ohm: f64::NAN,
        l_h: f64::NAN,
        sigma_r_pct: f64::NAN,
        sigma_l_pct: f64::NAN,
        iterations: 0,
    };

    /// Summarises a result.
    pub fn from_identified(identified: &Identification) -> Self {
        let i_a = &identified.i_amplitude_a;
        let (sigma_r_pct, sigma_l_pct) = identified
            .relative_sigma_pct()
            .unwrap_or((f64::NAN, f64::NAN));
        Self {
            i_crest_a: i_a.iter().copied().fold(0.0, f64::max),
            r_ohm: weighted_mean(i_a, &identified.r_ohm),
            l_h: weighted_mean(i_a, &identified.l_h),
            sigma_r_pct,
            sigma_l_pct,
            iterations: u32::try_from(identified.iterations).unwrap_or(u32::MAX),
        }
    }
}

/// Returns the mean of `x` weighted with the squared current.
pub(super) fn weighted_mean(i_a: &[f64], x: &[f64]) -> f64 {
    let weights = || i_a.iter().map(|i| i * i);
    weights().zip(x).map(|(w, x)| w * x).sum::<f64>() / weights().sum::<f64>()
}
