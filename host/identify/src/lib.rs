//! Identification of R(t) and L(t) of the coil from its voltage and current: the paper's estimators
//! and the baselines beside them, all from a [`Segment`] to an [`Estimate`].
//!
//! ```text
//! capture ─► survey ─► Segment ─► run(Method) ─► Estimate ─► accuracy, reconstruction
//! ```

pub mod accuracy;
pub mod ekf;
pub mod firmware;
pub mod kf;
pub mod least_squares;
pub mod lockin;
mod model_residual;
#[cfg(feature = "pinn")]
pub mod network;
pub mod pinn;
pub mod reconstruction;
mod reference;
pub mod rls;
mod steps;
mod sweep;
pub mod trajectory;

use std::time::Duration;

use ihd_signal::carrier::Carrier;
use ihd_signal::truth::Truth;
use ihd_signal::{Remark, Segment, SegmentError};
use serde::{Deserialize, Serialize};

/// Who estimates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Linear Kalman filter with an external derivative, paper eq. (10)-(14).
    Kf,
    /// The paper's four-state EKF, repaired (docs/estimators.md).
    Ekf,
    /// The paper's four-state EKF literally as eq. (15)-(19) are written.
    EkfPaper,
    /// Forward-backward (Rauch-Tung-Striebel) smoother on the repaired EKF.
    Rts,
    /// Lock-in demodulator: heterodyne at f_sw and two boxcars.
    Lockin,
    /// Banded least squares on harmonic phasors, B-splines in slow time.
    LeastSquares,
    /// Recursive least squares with forgetting and an excitation gate.
    Rls,
    /// The firmware's fixed-point chain, fed with what its ADC would see.
    Firmware,
    /// The hybrid-timescale PINN.
    Pinn,
}

impl Method {
    /// Every method, in the order of tables.
    pub const ALL: [Self; 9] = [
        Self::Kf,
        Self::Ekf,
        Self::EkfPaper,
        Self::Rts,
        Self::Lockin,
        Self::LeastSquares,
        Self::Rls,
        Self::Firmware,
        Self::Pinn,
    ];

    /// The name used on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Kf => "kf",
            Self::Ekf => "ekf",
            Self::EkfPaper => "ekf-paper",
            Self::Rts => "rts",
            Self::Lockin => "lockin",
            Self::LeastSquares => "least-squares",
            Self::Rls => "rls",
            Self::Firmware => "firmware",
            Self::Pinn => "pinn",
        }
    }
}

impl std::fmt::Display for Method {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}

/// What an estimator found. The vectors over time have one length.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// Who found it.
    pub method: Method,
    /// Switching frequency in hertz.
    pub f_sw_hz: f64,
    /// Times in seconds on the capture's clock, ascending.
    pub t_s: Vec<f64>,
    /// R at these times in ohm.
    pub r_ohm: Vec<f64>,
    /// L at these times in henry.
    pub l_h: Vec<f64>,
    /// Standard deviation of R in ohm as the estimator sees it; empty where it has none.
    pub r_sigma_ohm: Vec<f64>,
    /// Standard deviation of L in henry likewise.
    pub l_sigma_h: Vec<f64>,
    /// P/I_rms² in ohm over all harmonics that the estimator sees, beside R of the fundamental; empty
    /// where it does not separate them.
    pub r_power_ohm: Vec<f64>,
    /// Reconstructed coil voltage in volt, one a sample of the segment; empty where there is none.
    pub v_hat_v: Vec<f32>,
    /// Reconstructed coil current in ampere likewise.
    pub i_hat_a: Vec<f32>,
    /// Σ(v̂ − v)²/Σv² in percent against the samples given (paper, section V).
    pub nmse_v_pct: Option<f64>,
    /// The same of the current in percent.
    pub nmse_i_pct: Option<f64>,
    /// Wall-clock time of the estimator alone.
    pub elapsed: Duration,
    /// What the reader of the estimate has to know: limits met, what failed on the way.
    pub notes: Vec<String>,
    /// What programs have to know of it, for the gate.
    pub remarks: Vec<Remark>,
}

/// What the estimators may be given. The default fits every capture of a hob.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// R in ohm and L in henry to start from; otherwise those of the segment's mean phasors.
    pub start: Option<(f64, f64)>,
    /// Of the linear Kalman filter.
    pub kf: kf::KfSettings,
    /// Of the repaired EKF and its smoother.
    pub ekf: ekf::Tuning,
    /// Of the lock-in.
    pub lockin: lockin::LockinSettings,
    /// Of the least squares.
    pub least_squares: least_squares::LeastSquaresSettings,
    /// Of the recursive least squares.
    pub rls: rls::RlsSettings,
    /// Of the PINN.
    pub pinn: pinn::PinnSettings,
}

/// Someone who waits for an estimator that takes its time.
pub struct Watch<'a> {
    /// Truth on the capture's clock; with it the progress includes the errors of R and L.
    pub truth: Option<&'a Truth>,
    /// Receives steps and losses as text.
    pub report: &'a mut dyn FnMut(String),
}

/// Identifies R(t) and L(t) of a segment.
///
/// # Errors
/// [`IdentifyError`] when the segment cannot be used ([`Segment::check`]), or the method fails on
/// it; every number of an estimate is finite.
pub fn run(
    method: Method,
    segment: &Segment,
    settings: &Settings,
) -> Result<Estimate, IdentifyError> {
    let (truth, report) = (None, &mut |_| {});
    run_watched(method, segment, settings, &mut Watch { truth, report })
}

/// As [`run`], with reports of progress: of the methods here only the PINN trains long enough to
/// send any.
///
/// # Errors
/// As [`run`].
pub fn run_watched(
    method: Method,
    segment: &Segment,
    settings: &Settings,
    watch: &mut Watch<'_>,
) -> Result<Estimate, IdentifyError> {
    run_looked_at(method, segment, None, settings, watch)
}

/// What of a segment every method asks for first: whether it can be used, its carrier and the load's steps. It takes as
/// long as least squares, so who runs several methods on a segment looks once.
#[derive(Clone, Debug)]
pub struct LookedAt {
    /// Where the carrier moves.
    carrier: Option<Carrier>,
    steps: steps::Steps,
}

impl LookedAt {
    /// Looks at a segment.
    ///
    /// # Errors
    /// [`SegmentError`] as [`Segment::check`].
    pub fn of(segment: &Segment) -> Result<Self, SegmentError> {
        segment.check()?;
        Ok(Self {
            carrier: sweep::moving(segment),
            steps: steps::Steps::of(segment),
        })
    }
}

/// As [`run`] on a segment that `looked_at` is of.
///
/// # Errors
/// As [`run`].
pub fn run_again(
    method: Method,
    segment: &Segment,
    looked_at: &LookedAt,
    settings: &Settings,
) -> Result<Estimate, IdentifyError> {
    let (truth, report) = (None, &mut |_| {});
    let mut watch = Watch { truth, report };
    run_looked_at(method, segment, Some(looked_at), settings, &mut watch)
}

fn run_looked_at(
    method: Method,
    segment: &Segment,
    looked_at: Option<&LookedAt>,
    settings: &Settings,
    watch: &mut Watch<'_>,
) -> Result<Estimate, IdentifyError> {
    if looked_at.is_none() {
        segment.check()?;
    }
    let centred = wants_no_mean(method).then(|| segment.without_offsets());
    let segment = centred.as_ref().unwrap_or(segment);
    let carrier = match looked_at {
        Some(looked_at) if sweep::takes_constant(method) => looked_at.carrier.clone(),
        _ => sweep::of(method, segment),
    };
    let Some(carrier) = carrier else {
        return steps::identify(
            method,
            segment,
            looked_at.map(|looked_at| &looked_at.steps),
            settings,
            &|t_s| t_s,
            |segment, settings| at_constant_load(method, segment, settings, watch),
        );
    };
    sweep::identify(
        method,
        segment,
        &carrier,
        settings,
        |warped, settings, clock| {
            // Its truth would be that of another clock.
            let (truth, report) = (None, &mut *watch.report);
            let mut watch = Watch { truth, report };
            steps::identify(method, warped, None, settings, clock, |warped, settings| {
                at_constant_load(method, warped, settings, &mut watch)
            })
        },
    )
}

/// Whether a mean of the samples, which neither the coil's voltage nor its current has, would bend what the method finds.
/// The boxcars of the lock-in do not see it; the firmware is given what its ADC sees, and `ekf-paper` is as printed.
fn wants_no_mean(method: Method) -> bool {
    !matches!(method, Method::Lockin | Method::Firmware | Method::EkfPaper)
}

/// The method on a segment of one frequency, in which the load does not step.
fn at_constant_load(
    method: Method,
    segment: &Segment,
    settings: &Settings,
    watch: &mut Watch<'_>,
) -> Result<Estimate, IdentifyError> {
    let mut estimate = match method {
        Method::Kf => kf::identify(segment, settings),
        Method::Ekf => ekf::identify(segment, settings),
        Method::EkfPaper => ekf::literal::identify(segment),
        Method::Rts => ekf::identify_smoothed(segment, settings),
        Method::Lockin => lockin::identify(segment, &settings.lockin),
        Method::LeastSquares => least_squares::identify(segment, &settings.least_squares),
        Method::Rls => rls::identify(segment, settings),
        Method::Firmware => firmware::identify(segment, settings),
        Method::Pinn => pinn::identify(segment, settings, watch),
    }?;
    if !matches!(method, Method::LeastSquares | Method::Pinn) {
        reference::hold_against(&mut estimate, segment, settings);
    }
    Ok(estimate)
}

/// Why a segment could not be identified.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum IdentifyError {
    /// The segment is none that an estimator can work on.
    #[error(transparent)]
    Segment(#[from] SegmentError),
    /// A method that this build leaves out.
    #[error("`{method}` is not part of this build: build ihd with the feature `{feature}`")]
    NotInThisBuild {
        /// Which method.
        method: Method,
        /// The feature that brings it.
        feature: &'static str,
    },
    /// The estimator's own arithmetic gave out.
    #[error("{method}: {what} at {t_s:.6} s; {advice}")]
    Diverged {
        /// Which method.
        method: Method,
        /// What happened.
        what: String,
        /// When, in seconds on the capture's clock.
        t_s: f64,
        /// What to do.
        advice: &'static str,
    },
    /// The method cannot work on this segment.
    #[error("{method}: {why}")]
    Unfit {
        /// Which method.
        method: Method,
        /// Why, and what to do.
        why: String,
    },
}

impl Estimate {
    /// An empty estimate.
    pub fn new(method: Method, f_sw_hz: f64) -> Self {
        Self {
            method,
            f_sw_hz,
            t_s: Vec::new(),
            r_ohm: Vec::new(),
            l_h: Vec::new(),
            r_sigma_ohm: Vec::new(),
            l_sigma_h: Vec::new(),
            r_power_ohm: Vec::new(),
            v_hat_v: Vec::new(),
            i_hat_a: Vec::new(),
            nmse_v_pct: None,
            nmse_i_pct: None,
            elapsed: Duration::ZERO,
            notes: Vec::new(),
            remarks: Vec::new(),
        }
    }

    /// Appends R in ohm and L in henry with their standard deviations.
    pub(crate) fn push(&mut self, t_s: f64, (r, l): (f64, f64), (r_sigma, l_sigma): (f64, f64)) {
        self.t_s.push(t_s);
        self.r_ohm.push(r);
        self.l_h.push(l);
        self.r_sigma_ohm.push(r_sigma);
        self.l_sigma_h.push(l_sigma);
    }

    /// The latest R in ohm and L in henry.
    pub fn last(&self) -> Option<(f64, f64)> {
        Some((*self.r_ohm.last()?, *self.l_h.last()?))
    }

    /// (time in seconds, R in ohm, L in henry), point by point.
    pub fn points(&self) -> impl Iterator<Item = (f64, f64, f64)> {
        let values = self.r_ohm.iter().zip(&self.l_h);
        self.t_s.iter().zip(values).map(|(&t, (&r, &l))| (t, r, l))
    }
}
