//! Estimators of R(t) and L(t) of the coil from its voltage and current: those of the paper and
//! others for comparison, all from a [`Segment`] to an [`Estimate`].
//!
//! ```text
//! capture ─► survey ─► Segment ─► run(Method) ─► Estimate ─► accuracy, reconstruction
//! ```
//!
//! [`run`] does the same for every method:
//!
//! 1. check the segment and remove its offsets;
//! 2. follow a moving carrier and warp time to a constant frequency;
//! 3. cut the segment at steps of the load;
//! 4. run the method on each piece;
//! 5. compare its standard deviations with least squares.

pub mod accuracy;
pub mod carrier_inputs;
mod centred_harmonics;
pub mod ekf;
pub mod firmware;
pub mod kf;
pub mod least_squares;
pub mod lockin;
mod model_residual;
#[cfg(feature = "pinn")]
pub mod network;
pub mod pinn;
pub mod pooled;
pub mod reconstruction;
mod reference;
pub mod rls;
mod steps;
mod sweep;
pub mod trajectory;

use std::ops::RangeInclusive;
use std::time::Duration;

use ihd_signal::carrier::{Carrier, HannFrames};
use ihd_signal::noise::WhiteNoise;
use ihd_signal::truth::Truth;
use ihd_signal::{Remark, Segment, SegmentError};
use serde::{Deserialize, Serialize};

/// Estimator of R(t) and L(t).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Linear Kalman filter with an external derivative, paper eq. (10)-(14).
    Kf,
    /// The paper's four-state EKF, repaired (docs/identification.md).
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
    /// The firmware's fixed-point chain, fed with the samples that its ADC would take.
    Firmware,
    /// The hybrid-timescale PINN.
    Pinn,
}

impl Method {
    /// All methods, in the order of tables.
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

    /// Name of the method on the command line and in files.
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

/// Result of an estimator. All vectors over time have the same length.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// Estimator that was used.
    pub method: Method,
    /// Switching frequency in hertz.
    pub f_sw_hz: f64,
    /// Times in seconds on the capture's clock, ascending.
    pub t_s: Vec<f64>,
    /// R at these times in ohm.
    pub r_ohm: Vec<f64>,
    /// L at these times in henry.
    pub l_h: Vec<f64>,
    /// Standard deviation of R in ohm as the estimator states it; empty if it states none.
    pub r_sigma_ohm: Vec<f64>,
    /// Standard deviation of L in henry as the estimator states it; empty if it states none.
    pub l_sigma_h: Vec<f64>,
    /// P/I_rms² in ohm over all harmonics that the estimator covers, beside R of the fundamental; empty if it does not
    /// separate them.
    pub r_power_ohm: Vec<f64>,
    /// Reconstructed coil voltage in volt, one value per sample of the segment; empty if there is none.
    pub v_hat_v: Vec<f32>,
    /// Reconstructed coil current in ampere, one value per sample of the segment; empty if there is none.
    pub i_hat_a: Vec<f32>,
    /// Σ(v̂ − v)²/Σv² in percent against the samples given (paper, section V).
    pub nmse_v_pct: Option<f64>,
    /// Σ(î − i)²/Σi² of the current in percent.
    pub nmse_i_pct: Option<f64>,
    /// Wall-clock time of the estimator alone.
    pub elapsed: Duration,
    /// Notes for the reader of the estimate: limits that were reached, parts that failed.
    pub notes: Vec<String>,
    /// Remarks for the gate.
    pub remarks: Vec<Remark>,
}

/// Options of the estimators. The default suits every capture of a hob.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct IdentifyOptions {
    /// Start values of R in ohm and L in henry; `None` for those of the segment's mean phasors.
    pub start: Option<(f64, f64)>,
    /// Options of the linear Kalman filter.
    pub kf: kf::KfSettings,
    /// Options of the repaired EKF and its smoother.
    pub ekf: ekf::EkfTuning,
    /// Options of the lock-in.
    pub lockin: lockin::LockinSettings,
    /// Options of the least squares.
    pub least_squares: least_squares::LeastSquaresSettings,
    /// Options of the recursive least squares.
    pub rls: rls::RlsSettings,
    /// Options of the PINN.
    pub pinn: pinn::PinnSettings,
}

impl IdentifyOptions {
    /// Ranges of start values: R in ohm and L in henry, far beyond those of a hob.
    const START: [RangeInclusive<f64>; 2] = [0.01..=100.0, 1e-6..=10e-3];

    /// Checks the start values.
    ///
    /// # Errors
    /// [`IdentifyError::Start`] for a value out of range, as one in another unit is.
    pub fn check_start(&self) -> Result<(), IdentifyError> {
        let Some((r_ohm, l_h)) = self.start else {
            return Ok(());
        };
        let [r_range, l_range] = Self::START;
        for (name, value, range) in [("R", r_ohm, r_range), ("L", l_h, l_range)] {
            if !range.contains(&value) {
                return Err(IdentifyError::Start { name, value, range });
            }
        }
        Ok(())
    }
}

/// Receiver of an estimator's progress.
pub struct ProgressSink<'a> {
    /// Truth on the capture's clock; if given, the progress includes the errors of R and L.
    pub truth: Option<&'a Truth>,
    /// Receives steps and losses as text.
    pub report: &'a mut dyn FnMut(String),
}

/// Identifies R(t) and L(t) of a segment.
///
/// # Errors
/// [`IdentifyError`] if the segment cannot be used ([`Segment::check`]), or the method fails on
/// it; every R, L and standard deviation of an estimate is finite.
pub fn run(
    method: Method,
    segment: &Segment,
    settings: &IdentifyOptions,
) -> Result<Estimate, IdentifyError> {
    let (truth, report) = (None, &mut |_| {});
    let mut sink = ProgressSink { truth, report };
    run_on(method, segment, None, Known::default(), settings, &mut sink)
}

/// Preprocessing of a segment that all methods share: its check, its carrier, the load's steps and the noise. It takes as long as
/// least squares, so that several methods on one segment should share it.
#[derive(Clone, Debug)]
pub struct Preprocessing {
    /// Carrier of the segment; `None` if its frequency is constant.
    carrier: Option<Carrier>,
    steps: steps::Steps,
    noise: WhiteNoise,
}

impl Preprocessing {
    /// Preprocesses a segment.
    ///
    /// # Errors
    /// [`SegmentError`] as [`Segment::check`].
    pub fn new(segment: &Segment) -> Result<Self, SegmentError> {
        Self::with_noise(segment, None)
    }

    /// Preprocesses a segment whose noise may be known.
    ///
    /// # Errors
    /// Errors of [`Preprocessing::new`].
    pub fn with_noise(segment: &Segment, known: Option<WhiteNoise>) -> Result<Self, SegmentError> {
        segment.check()?;
        let frames = HannFrames::compute(segment);
        Ok(Self {
            carrier: frames.as_ref().and_then(sweep::moving),
            steps: steps::Steps::detect(segment, frames.as_ref()),
            noise: known.unwrap_or_else(|| WhiteNoise::measure(segment)),
        })
    }

    /// White noise of the segment.
    pub fn noise(&self) -> WhiteNoise {
        self.noise
    }

    /// Returns `true` if the segment is identified as a whole: at one frequency, without steps.
    fn is_whole(&self) -> bool {
        self.carrier.is_none() && self.steps.is_empty()
    }
}

/// Identifies as [`run`] does, with the preprocessing of the same segment. `least_squares`: its result by least squares with the same
/// settings, if it is known; a method that is compared with it need not repeat it. Only the PINN trains long enough to report progress.
///
/// # Errors
/// Errors of [`run`].
pub fn run_preprocessed(
    method: Method,
    segment: &Segment,
    preprocessing: &Preprocessing,
    least_squares: Option<&Estimate>,
    settings: &IdentifyOptions,
    sink: &mut ProgressSink<'_>,
) -> Result<Estimate, IdentifyError> {
    let known = match preprocessing.is_whole() {
        true => Known {
            least_squares,
            noise: Some(preprocessing.noise),
            is_independent: false,
        },
        false => Known::default(),
    };
    run_on(method, segment, Some(preprocessing), known, settings, sink)
}

/// Identifies with the standard deviations that the method states by itself: a difference from least squares raises none, so that
/// both can be compared. `preprocessing` is the segment's if it is known.
///
/// # Errors
/// Errors of [`run`].
pub fn run_independently(
    method: Method,
    segment: &Segment,
    preprocessing: Option<&Preprocessing>,
    settings: &IdentifyOptions,
) -> Result<Estimate, IdentifyError> {
    let (truth, report) = (None, &mut |_| {});
    let mut sink = ProgressSink { truth, report };
    let whole = preprocessing.filter(|preprocessing| preprocessing.is_whole());
    let known = Known {
        least_squares: None,
        noise: whole.map(Preprocessing::noise),
        is_independent: true,
    };
    run_on(method, segment, preprocessing, known, settings, &mut sink)
}

/// Facts on a segment that need not be computed again.
#[derive(Clone, Copy, Default)]
struct Known<'a> {
    /// Its result by least squares with the same settings.
    least_squares: Option<&'a Estimate>,
    noise: Option<WhiteNoise>,
    /// `true` if no difference from least squares raises the standard deviations.
    is_independent: bool,
}

fn run_on(
    method: Method,
    segment: &Segment,
    preprocessing: Option<&Preprocessing>,
    known: Known<'_>,
    settings: &IdentifyOptions,
    sink: &mut ProgressSink<'_>,
) -> Result<Estimate, IdentifyError> {
    let mut estimate = run_on_parts(method, segment, preprocessing, known, settings, sink)?;
    estimate.drop_partial_lists();
    Ok(estimate)
}

/// Runs a method on the parts of a segment that have one frequency and no step of the load, and joins them.
fn run_on_parts(
    method: Method,
    segment: &Segment,
    preprocessing: Option<&Preprocessing>,
    known: Known<'_>,
    settings: &IdentifyOptions,
    sink: &mut ProgressSink<'_>,
) -> Result<Estimate, IdentifyError> {
    if preprocessing.is_none() {
        segment.check()?;
    }
    let centred = needs_offsets_removed(method).then(|| segment.without_offsets());
    let segment = centred.as_ref().unwrap_or(segment);
    let carrier = match preprocessing {
        Some(preprocessing) if sweep::takes_constant(method) => preprocessing.carrier.clone(),
        _ => sweep::detect(method, segment),
    };
    let of_whole =
        || preprocessing.map_or_else(|| WhiteNoise::measure(segment), Preprocessing::noise);
    let Some(carrier) = carrier else {
        return steps::identify(
            method,
            segment,
            preprocessing.map(|preprocessing| &preprocessing.steps),
            settings,
            &|t_s| t_s,
            |segment, settings| at_constant_load(method, segment, known, &of_whole, settings, sink),
        );
    };
    let of_part = Known {
        is_independent: known.is_independent,
        ..Known::default()
    };
    sweep::identify(
        method,
        segment,
        &carrier,
        settings,
        |warped, settings, clock| {
            // The truth belongs to another clock than the warped samples.
            let (truth, report) = (None, &mut *sink.report);
            let mut sink = ProgressSink { truth, report };
            let of_warped = || WhiteNoise::measure(warped).or_else(of_whole);
            steps::identify(method, warped, None, settings, clock, |piece, settings| {
                at_constant_load(method, piece, of_part, &of_warped, settings, &mut sink)
            })
        },
    )
}

/// Returns `true` if offsets of the channels bias the method, so that they must be removed. The boxcars of the lock-in suppress
/// them; the firmware gets the samples that its ADC would take, and `ekf-paper` is as printed.
fn needs_offsets_removed(method: Method) -> bool {
    !matches!(method, Method::Lockin | Method::Firmware | Method::EkfPaper)
}

/// Runs a method on a segment of one frequency without steps of the load. `known`: the segment's result of least squares, if it is known;
/// `of_whole`: the noise of all that the segment is a piece of, for a piece that is too short to show its own.
fn at_constant_load(
    method: Method,
    segment: &Segment,
    known: Known<'_>,
    of_whole: &dyn Fn() -> WhiteNoise,
    settings: &IdentifyOptions,
    sink: &mut ProgressSink<'_>,
) -> Result<Estimate, IdentifyError> {
    let measured = || WhiteNoise::measure(segment).or_else(of_whole);
    let noise = || known.noise.unwrap_or_else(measured);
    let mut estimate = match method {
        Method::Kf => kf::identify(segment, settings),
        Method::Ekf => ekf::identify(segment, settings),
        Method::EkfPaper => ekf::literal::identify(segment),
        Method::Rts => ekf::identify_smoothed(segment, settings),
        Method::Lockin => lockin::identify(segment, noise(), &settings.lockin),
        Method::LeastSquares => least_squares::identify(segment, noise(), &settings.least_squares),
        Method::Rls => rls::identify(segment, settings),
        Method::Firmware => firmware::identify(segment, settings),
        Method::Pinn => pinn::identify(segment, settings, sink),
    }?;
    if !known.is_independent && !matches!(method, Method::LeastSquares | Method::Pinn) {
        let known = known.least_squares;
        reference::raise_sigmas(&mut estimate, segment, known, of_whole, settings);
    }
    estimate.check_finite()?;
    Ok(estimate)
}

/// Reason why a segment could not be identified.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum IdentifyError {
    /// The segment cannot be used by any estimator.
    #[error(transparent)]
    Segment(#[from] SegmentError),
    /// The method is not part of this build.
    #[error("`{method}` is not part of this build: build ihd with the feature `{feature}`")]
    NotInThisBuild {
        /// Method that was requested.
        method: Method,
        /// Feature that contains it.
        feature: &'static str,
    },
    /// The estimator's arithmetic failed.
    #[error("{method}: {what} at {t_s:.6} s; {advice}")]
    Diverged {
        /// Method that failed.
        method: Method,
        /// Description of the failure.
        what: String,
        /// Time of the failure in seconds on the capture's clock.
        t_s: f64,
        /// Action that the user can take.
        advice: &'static str,
    },
    /// A start value is out of range.
    #[error(
        "start: {name} is {value:e}, but must be {:e} to {:e}: write ohm and henry, as in start = [2.5, 20e-6]",
        range.start(),
        range.end()
    )]
    Start {
        /// Quantity, R or L.
        name: &'static str,
        /// Value given.
        value: f64,
        /// Valid values.
        range: RangeInclusive<f64>,
    },
    /// The method cannot work on this segment.
    #[error("{method}: {why}")]
    Unfit {
        /// Method that failed.
        method: Method,
        /// Reason, and action that the user can take.
        why: String,
    },
}

impl Estimate {
    /// Creates an empty estimate.
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

    /// Empties the lists that some half-cycle or piece has no values for: the others' would stand at other points.
    fn drop_partial_lists(&mut self) {
        let points = self.t_s.len();
        let lists = [
            &mut self.r_sigma_ohm,
            &mut self.l_sigma_h,
            &mut self.r_power_ohm,
        ];
        let mut is_partial = false;
        for list in lists {
            if list.len() != points {
                is_partial |= !list.is_empty();
                list.clear();
            }
        }
        if is_partial {
            let note = "a part of the segment lacks standard deviations or P/I_rms², so that none are stated";
            self.notes.push(note.to_owned());
        }
    }

    /// Checks that every R, L and standard deviation is finite: comparisons with a limit are false for NaN, and would pass it.
    fn check_finite(&self) -> Result<(), IdentifyError> {
        let all = [
            ("R", &self.r_ohm),
            ("L", &self.l_h),
            ("the deviation of R", &self.r_sigma_ohm),
            ("the deviation of L", &self.l_sigma_h),
        ];
        for (name, values) in all {
            let bad = self.t_s.iter().zip(values).find(|(_, x)| !x.is_finite());
            if let Some((t_s, _)) = bad {
                return Err(IdentifyError::Diverged {
                    method: self.method,
                    what: format!("{name} is not finite"),
                    t_s: *t_s,
                    advice: "capture longer, or take another method",
                });
            }
        }
        Ok(())
    }

    /// Latest R in ohm and L in henry; `None` if there are no points.
    pub fn last(&self) -> Option<(f64, f64)> {
        Some((*self.r_ohm.last()?, *self.l_h.last()?))
    }

    /// Points as (time in seconds, R in ohm, L in henry).
    pub fn points(&self) -> impl Iterator<Item = (f64, f64, f64)> {
        let values = self.r_ohm.iter().zip(&self.l_h);
        self.t_s.iter().zip(values).map(|(&t, (&r, &l))| (t, r, l))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A training whose normal matrix is singular has no deviations; those of the next half-cycle are not its own.
    #[test]
    fn deviations_of_a_part_of_the_points_are_none() {
        let mut estimate = Estimate::new(Method::Pinn, 45e3);
        estimate.push(0.25, (3.0, 18e-6), (0.01, 1e-7));
        let whole = estimate.clone();
        estimate.drop_partial_lists();
        assert_eq!(estimate, whole);
        estimate.t_s.insert(0, 0.125);
        estimate.r_ohm.insert(0, 4.0);
        estimate.l_h.insert(0, 17e-6);
        estimate.drop_partial_lists();
        assert!(estimate.r_sigma_ohm.is_empty() && estimate.l_sigma_h.is_empty());
        assert_eq!((estimate.t_s.len(), estimate.notes.len()), (2, 1));
    }

    /// A deviation that is no number would pass every limit.
    #[test]
    fn an_estimate_with_a_number_that_is_not_finite_is_refused() {
        let mut estimate = Estimate::new(Method::Lockin, 45e3);
        estimate.push(0.25, (3.0, 18e-6), (0.01, 1e-7));
        assert_eq!(estimate.check_finite(), Ok(()));
        estimate.push(0.5, (3.0, 18e-6), (0.01, f64::NAN));
        let why = estimate.check_finite().unwrap_err();
        assert!(
            matches!(&why, IdentifyError::Diverged { t_s, .. } if *t_s == 0.5),
            "{why}"
        );
    }

    /// 20 µH as 20, and 2.5 ohm as milliohm.
    #[test]
    fn a_start_in_another_unit_is_refused() {
        let check = |start| {
            let options = IdentifyOptions {
                start,
                ..IdentifyOptions::default()
            };
            options.check_start()
        };
        assert!(check(None).is_ok() && check(Some((2.5, 20e-6))).is_ok());
        for start in [
            (2.5, 20.0),
            (2500.0, 20e-6),
            (0.0, 20e-6),
            (f64::NAN, 20e-6),
        ] {
            let why = check(Some(start)).unwrap_err().to_string();
            assert!(why.contains("henry"), "{why}");
        }
    }
}
