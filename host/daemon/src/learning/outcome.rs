//! A window to learn from, and what was found.

use std::sync::Arc;
use std::time::Duration;

use ihd_link::Window;
use ihd_pinn::{Identified, Progress};
use ihd_shared::lookup::RlLookup;
use ihd_signal::Remark;
use ihd_signal::truth::Truth;
use ihd_store::{Confidence, Curve, DeviceId, MAX_POINTS, NewResult, SessionId};
use ihd_train::lookup::Built;
use serde::{Deserialize, Serialize};
use tokio::sync::oneshot;

use super::answer::Answer;
use crate::model::{FitRemark, FitStep};
use crate::printable::printable;

/// What there is to learn from.
#[derive(Debug)]
pub enum Work {
    /// A window.
    Window(Box<Window>),
    /// A window, and a worker's answer to it.
    Answered(Box<Window>, Box<Answer>),
}

impl Work {
    /// The window's number since its device's boot.
    pub fn seq(&self) -> u32 {
        match self {
            Self::Window(window) | Self::Answered(window, _) => window.seq,
        }
    }
}

/// Something to learn from.
#[derive(Debug)]
pub struct Task {
    /// The device's name.
    pub device: String,
    /// Its number in the store.
    pub device_id: DeviceId,
    /// The connection that the window came over.
    pub session: SessionId,
    /// The device's boot.
    pub boot: u32,
    /// The window, with what is known of it already.
    pub work: Work,
    /// Mean power of its half-cycle in watt, where telemetry told it.
    pub power_w: Option<f64>,
    /// What R and L truly were, where the device is simulated in the daemon.
    pub truth: Option<Arc<Truth>>,
    /// Whom to tell once what was found is stored.
    pub stored: Option<oneshot::Sender<()>>,
}

/// A lookup to push.
#[derive(Clone, Debug)]
pub struct Lookup {
    /// The lookup.
    pub lookup: RlLookup,
    /// How well its cells are founded, where that is known.
    pub confidence: Option<Confidence>,
}

impl Lookup {
    /// A lookup of which nobody knows how well its cells are founded.
    pub fn unfounded(lookup: RlLookup) -> Self {
        let confidence = None;
        Self { lookup, confidence }
    }
}

/// How the network came to what it says of a window.
#[derive(Clone, Debug, Default)]
pub struct Course {
    /// Steps of the optimiser, thinned where they are many.
    pub steps: Vec<FitStep>,
    /// What was remarked on the window and the result.
    pub remarks: Vec<FitRemark>,
    /// R(t) and L(t); none where there is no result.
    pub curve: Option<Curve>,
    /// Error of the mean R against the truth in percent, where that is known.
    pub r_error_pct: Option<f64>,
    /// The same of L.
    pub l_error_pct: Option<f64>,
}

/// Most steps of a fit that are kept.
const MAX_STEPS: usize = 256;

impl Course {
    /// Of what became of a window.
    pub fn of(identified: Option<&Identified>, findings: &[Remark], truth: Option<&Truth>) -> Self {
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

/// A remark as the API has it.
pub(super) fn fit_remark(finding: &Remark) -> FitRemark {
    FitRemark {
        code: finding.code.to_owned(),
        severity: finding.severity.to_string(),
        text: printable(&finding.text),
    }
}

fn steps(history: &[Progress]) -> Vec<FitStep> {
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

fn curve(identified: &Identified) -> Curve {
    let curve = Curve {
        t_s: identified.t_s.clone(),
        r_ohm: identified.r_ohm.clone(),
        l_h: identified.l_h.clone(),
        i_a: identified.i_amplitude_a.clone(),
        r_sigma_ohm: identified.r_sigma_ohm.clone(),
        l_sigma_h: identified.l_sigma_h.clone(),
    };
    curve.thinned()
}

/// Errors of the means of R and L against the truth at the same times, weighted with the squared current, in percent.
fn errors_pct(identified: &Identified, truth: &Truth) -> Option<(f64, f64)> {
    let (mut r, mut l, mut all) = (0.0, 0.0, 0.0);
    for (t_s, i_a) in identified.t_s.iter().zip(&identified.i_amplitude_a) {
        let (r_ohm, l_h) = truth.at(*t_s)?;
        r += i_a * i_a * r_ohm;
        l += i_a * i_a * l_h;
        all += i_a * i_a;
    }
    let numbers = Numbers::of(identified);
    let error = |x: f64, sum: f64| 100.0 * (x / (sum / all) - 1.0);
    let (r, l) = (error(numbers.r_ohm, r), error(numbers.l_h, l));
    (r.is_finite() && l.is_finite()).then_some((r, l))
}

/// The truth over the pairs of a window.
pub fn curve_of(truth: &Truth, window: &Window) -> Curve {
    let last = window.pairs.len().saturating_sub(1);
    let mut curve = Curve::default();
    for k in 0..MAX_POINTS {
        let t_s = window.pair_time_s(0)
            + last as f64 * window.dt_s() * k as f64 / (MAX_POINTS - 1) as f64;
        let Some((r_ohm, l_h)) = truth.at(t_s) else {
            return Curve::default();
        };
        curve.t_s.push(t_s);
        curve.r_ohm.push(r_ohm);
        curve.l_h.push(l_h);
        curve.i_a.push(current_at(truth, t_s));
    }
    curve
}

/// The true current's amplitude at a time, linear between the points.
fn current_at(truth: &Truth, t_s: f64) -> f64 {
    let last = truth.t_s.len().saturating_sub(1);
    let above = truth.t_s.partition_point(|t| *t < t_s);
    let (a, b) = (above.saturating_sub(1), above.min(last));
    let at = |k: usize| truth.i_a.get(k).copied().unwrap_or(0.0);
    let width = truth.t_s[b] - truth.t_s[a];
    match width > 0.0 {
        true => at(a) + (at(b) - at(a)) * ((t_s - truth.t_s[a]) / width).clamp(0.0, 1.0),
        false => at(b),
    }
}

/// What became of a window.
#[derive(Debug)]
pub struct Learned {
    /// The device's name.
    pub device: String,
    /// Its number in the store.
    pub device_id: DeviceId,
    /// The device's boot.
    pub boot: u32,
    /// What the store keeps: the numbers, the gate's verdict and why.
    pub result: NewResult,
    /// A lookup to push.
    pub news: Option<Box<Built>>,
    /// Why the window gives no lookup that a device would take; learning goes on.
    pub no_lookup: Option<String>,
    /// All that was learned of the device, to be stored with the result; only from time to time, but
    /// always with a new lookup and with a frequency that was not seen before.
    pub state: Option<Vec<u8>>,
    /// Time that it took.
    pub busy: Duration,
    /// How the network came to it.
    pub course: Box<Course>,
    /// Whom to tell once it is stored.
    pub stored: Option<oneshot::Sender<()>>,
}

/// What the network says in a few numbers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Numbers {
    /// Largest amplitude of the current's fundamental, in ampere.
    pub i_crest_a: f64,
    /// Mean of R weighted with the squared current, in ohm.
    pub r_ohm: f64,
    /// The same of L, in henry.
    pub l_h: f64,
    /// Standard deviation of R, in percent.
    pub sigma_r_pct: f64,
    /// Standard deviation of L, in percent.
    pub sigma_l_pct: f64,
    /// Steps of the optimiser.
    pub iterations: u32,
}

impl Numbers {
    /// Where there is no result.
    pub const NONE: Self = Self {
        i_crest_a: f64::NAN,
        r_ohm: f64::NAN,
        l_h: f64::NAN,
        sigma_r_pct: f64::NAN,
        sigma_l_pct: f64::NAN,
        iterations: 0,
    };

    /// Of a result.
    pub fn of(identified: &Identified) -> Self {
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

/// Mean of a figure weighted with the squared current.
pub(super) fn weighted_mean(i_a: &[f64], x: &[f64]) -> f64 {
    let weights = || i_a.iter().map(|i| i * i);
    weights().zip(x).map(|(w, x)| w * x).sum::<f64>() / weights().sum::<f64>()
}
