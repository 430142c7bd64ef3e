//! Path from a capture to judged estimates; `ihd identify` and the studies share it.

use std::borrow::Cow;

use ihd_identify::pooled::{self, PoolPhasors, PooledLaw};
use ihd_identify::{
    Estimate, IdentifyError, IdentifyOptions, Method, ProgressSink, accuracy, reconstruction,
    run_with_progress,
};
use ihd_signal::{Capture, Remark, Segment, Severity};
use ihd_survey::calibration::blind::{BlindOptions, CalibrationMode};
use ihd_survey::{Hints, Survey, SurveyError};

use crate::comparison;
use crate::judge::{Evidence, judge, judge_failure};
use crate::neighbours::{self, Neighbours};
use crate::reference::ReferenceResults;
use crate::remarks;
use crate::repair;
use crate::sensors::{CorrectionUncertainty, calibrate, correct_gain};
use crate::verdict::Judgement;

/// Least relative deviation of R and of L: splines and 12 bit resolve no more. The methods differ by this much on captures
/// without noise.
const RESOLUTION: f64 = 5e-5;

/// Options of [`examine`].
#[derive(Clone, Copy, Debug)]
pub struct ExamineOptions<'a> {
    /// Facts that the user states about the capture.
    pub hints: Hints,
    /// Methods to run, in this order.
    pub methods: &'a [Method],
    /// Options of the sensors' self-calibration.
    pub sensors: BlindOptions,
    /// Options of the methods.
    pub settings: &'a IdentifyOptions,
    /// Use of R(t) and L(t) of methods that do not reconstruct the waveforms themselves.
    pub reconstruct: Reconstruct,
}

/// Extent to which the waveforms that R(t) and L(t) imply are reconstructed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reconstruct {
    /// Not at all.
    No,
    /// Errors of the reconstructed waveforms only.
    Errors,
    /// Errors and waveforms; the waveforms have as many values as the segment has samples.
    Waveforms,
}

/// Judged result of one method on one segment.
#[derive(Clone, Debug)]
pub struct MethodResult {
    /// Method that was run.
    pub method: Method,
    /// Index into [`Examination::segments`].
    pub segment: usize,
    /// Estimate, or the error with which the method failed.
    pub result: Result<Estimate, IdentifyError>,
    /// Findings and verdict.
    pub judgement: Judgement,
}

/// Results of all methods on all segments of a capture.
#[derive(Clone, Debug)]
pub struct Examination {
    /// Survey of the capture, after the sensors' correction.
    pub survey: Survey,
    /// Remarks on the sensors.
    pub sensors: Vec<Remark>,
    /// Segments that were identified, in order of time.
    pub segments: Vec<Segment>,
    /// One law of each segment from all of its half-cycles; `None` where there are fewer than two, or where R and L are not
    /// functions of the current alone.
    pub pooled: Vec<Option<PooledLaw>>,
    /// Phasors of the segments whose R and L are functions of the current, to be pooled with those of other captures.
    pub phasors: Vec<PoolPhasors>,
    /// Results, segment by segment, and method by method in the order of the options.
    pub outcomes: Vec<MethodResult>,
}

impl Examination {
    /// Remarks on the sensors that a user must know: warnings, errors, and a correction that was applied.
    pub fn sensors_to_report(&self) -> impl Iterator<Item = &Remark> {
        let reported = |r: &&Remark| r.severity > Severity::Info || r.code == "self_calibrated";
        self.sensors.iter().filter(reported)
    }
}

/// Receives a text on the step that begins, the number of results so far, and their total.
pub type OnProgress<'a> = dyn FnMut(&str, usize, usize) + 'a;

/// Surveys a capture, identifies every segment by every method, and judges each result.
///
/// # Errors
/// [`SurveyError`] if the capture holds nothing that can be identified. A method that fails on a segment is a [`MethodResult`].
pub fn examine(
    capture: &Capture,
    request: &ExamineOptions<'_>,
    progress: &mut OnProgress<'_>,
) -> Result<Examination, SurveyError> {
    examine_samples(Cow::Borrowed(capture), request, progress)
}

/// Examines as [`examine`] does, and moves the samples to the segments: half the memory.
///
/// # Errors
/// As [`examine`].
pub fn examine_taking(
    capture: &mut Capture,
    request: &ExamineOptions<'_>,
    progress: &mut OnProgress<'_>,
) -> Result<Examination, SurveyError> {
    let samples = [&mut capture.v_v, &mut capture.i_a].map(std::mem::take);
    let mut whole = capture.clone();
    [whole.v_v, whole.i_a] = samples;
    examine_samples(Cow::Owned(whole), request, progress)
}

fn examine_samples(
    mut capture: Cow<'_, Capture>,
    request: &ExamineOptions<'_>,
    progress: &mut OnProgress<'_>,
) -> Result<Examination, SurveyError> {
    let repaired = repair::repair(capture, &request.hints)?;
    capture = repaired.capture;
    let [r_restored, l_restored] = repaired.shares;
    let mut survey = repaired.survey;
    let (mut removed, mut interference) = (None, Vec::new());
    match neighbours::remove(&capture, &survey, &request.hints)? {
        Neighbours::Absent(of_spans) => interference = of_spans,
        Neighbours::Removed(mut without) => {
            capture = Cow::Owned(std::mem::take(&mut without.capture));
            survey = Survey::of(&capture, &request.hints)?;
            removed = Some(without);
        }
    }
    // What is left of a tone would be taken for a fault of the sensors, and restored samples have no edges of their own.
    let hidden = removed.as_ref().is_some_and(|r| r.hide_sensors());
    let mode = match hidden || repaired.shares != [0.0; 2] {
        true => CalibrationMode::Off,
        false => request.sensors.mode,
    };
    let sensors = BlindOptions {
        mode,
        ..request.sensors
    };
    let mut calibrated = calibrate(&capture, survey, &request.hints, sensors)?;
    let mut sensors = calibrated.remarks();
    let gain = (mode == CalibrationMode::Auto)
        .then(|| correct_gain(&mut calibrated))
        .flatten();
    let uncertainty = CorrectionUncertainty::of(&calibrated, gain.is_some());
    if let Some(gain) = gain {
        calibrated.survey = Survey::of(&calibrated.capture, &request.hints)?;
        sensors.retain(|r| r.code != gain.code);
        sensors.push(gain);
    }
    sensors.extend(repaired.remarks);
    if uncertainty.is_some() {
        // Corrected samples have another residual.
        interference.clear();
    }
    let survey = calibrated.survey;
    if let Cow::Owned(corrected) = calibrated.capture {
        capture = Cow::Owned(corrected);
    }
    let segments = match &mut capture {
        Cow::Owned(capture) => survey.take_segments(capture),
        Cow::Borrowed(capture) => survey.segments(capture),
    };
    let truth = (!capture.truth.is_empty()).then(|| accuracy::fundamental(&capture.truth));
    let total = segments.len() * request.methods.len();
    let mut outcomes = Vec::with_capacity(total);
    let (mut pooled, mut phasors) = (Vec::with_capacity(segments.len()), Vec::new());
    for (index, segment) in segments.iter().enumerate() {
        progress("reference", outcomes.len(), total);
        let mut remarks = remarks::from_survey(&survey, segment);
        remarks.extend(sensors.iter().cloned());
        let load = survey.spans.get(index).and_then(|span| span.load);
        remarks.extend(uncertainty.and_then(|u| u.remark(segment, load)));
        remarks.extend(removed.iter().flat_map(|r| r.remarks_on(segment)).cloned());
        let known = interference.get_mut(index).map(std::mem::take);
        let reference = ReferenceResults::compute_with(segment, known);
        let of_segment = is_law(&reference).then(|| PoolPhasors::of(segment));
        pooled.push(of_segment.as_ref().and_then(|p| pooled_law(segment, p)));
        phasors.extend(of_segment);
        for &method in request.methods {
            let done = outcomes.len();
            progress(method.name(), done, total);
            let mut sink = ProgressSink {
                truth: truth.as_ref(),
                report: &mut |text| progress(&format!("{method}: {text}"), done, total),
            };
            let mut result = match reference.result_of(method, request.settings) {
                Some(known) => known,
                None => run_with_progress(method, segment, request.settings, &mut sink),
            };
            if let Ok(estimate) = &mut result {
                match request.reconstruct {
                    Reconstruct::No => {}
                    Reconstruct::Errors => reconstruction::errors(segment, estimate),
                    Reconstruct::Waveforms => reconstruction::complete(segment, estimate),
                }
            }
            let judgement = judge_result(&remarks, segment, &reference, method, &result);
            if let (Ok(estimate), true) =
                (&mut result, request.reconstruct != Reconstruct::Waveforms)
            {
                (estimate.v_hat_v, estimate.i_hat_a) = (Vec::new(), Vec::new());
            }
            // Only after the judgement: a deviation that all methods share explains no difference between them.
            if let Ok(estimate) = &mut result {
                if let Some(uncertainty) = uncertainty {
                    uncertainty.widen(estimate);
                }
                widen(
                    estimate,
                    RESOLUTION.hypot(r_restored),
                    RESOLUTION.hypot(l_restored),
                );
                if let Some(aliasing) = &survey.aliasing {
                    widen(estimate, 0.01 * aliasing.r_pct, 0.01 * aliasing.l_pct);
                }
            }
            outcomes.push(MethodResult {
                method,
                segment: index,
                result,
                judgement,
            });
        }
    }
    progress("", total, total);
    Ok(Examination {
        survey,
        sensors,
        segments,
        pooled,
        phasors,
        outcomes,
    })
}

/// Findings of a load that is no function of the current alone.
const NO_LAW: [&str; 2] = ["load_moves", "load_step"];

/// Returns `true` if nothing speaks against a law R(I), L(I).
fn is_law(reference: &ReferenceResults) -> bool {
    let Ok(least_squares) = &reference.least_squares else {
        return false;
    };
    let mut remarks = reference.remarks.iter().chain(&least_squares.remarks);
    !remarks.any(|r| NO_LAW.contains(&r.code))
}

fn pooled_law(segment: &Segment, phasors: &PoolPhasors) -> Option<PooledLaw> {
    let judged = comparison::judged(segment);
    let whole = judged.iter().filter(|h| h.is_whole()).count();
    (whole >= 2)
        .then(|| pooled::pool_phasors(phasors))
        .flatten()
}

/// Adds shares of R and of L to the standard deviations.
fn widen(estimate: &mut Estimate, r_share: f64, l_share: f64) {
    let add = |sigma: &mut [f64], values: &[f64], share: f64| {
        for (sigma, value) in sigma.iter_mut().zip(values) {
            *sigma = sigma.hypot(share * value);
        }
    };
    add(&mut estimate.r_sigma_ohm, &estimate.r_ohm, r_share);
    add(&mut estimate.l_sigma_h, &estimate.l_h, l_share);
}

fn judge_result(
    remarks: &[Remark],
    segment: &Segment,
    reference: &ReferenceResults,
    method: Method,
    result: &Result<Estimate, IdentifyError>,
) -> Judgement {
    match result {
        Ok(estimate) => judge(&Evidence {
            remarks,
            segment,
            estimate,
            reference,
        }),
        Err(error) => judge_failure(remarks, method, &error.to_string()),
    }
}
