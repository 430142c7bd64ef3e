//! Path from a capture to judged estimates; `ihd identify` and the studies share it.

use std::borrow::Cow;

use ihd_identify::pooled::{self, PoolPhasors, PooledLaw, SharedSigma};
use ihd_identify::{
    Estimate, IdentifyError, IdentifyOptions, Method, Preprocessing, ProgressSink, accuracy,
    reconstruction, run_preprocessed,
};
use ihd_signal::{Capture, Remark, Segment, SegmentError, Severity};
use ihd_survey::calibration::blind::BlindOptions;
use ihd_survey::{Hints, Survey, SurveyError};

use crate::comparison;
use crate::judge::{Evidence, judge, judge_failure};
use crate::prepared::PreparedCapture;
use crate::reference::ReferenceResults;
use crate::verdict::Judgement;

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
    /// One law of each segment from all of its half-cycles; `None` where there are fewer than two, where R and L are not functions of
    /// the current alone, or least squares is refused for more than noise.
    pub pooled: Vec<Option<PooledLaw>>,
    /// Phasors of the segments that have such a law, to be pooled with those of other captures.
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
/// Errors of [`examine`].
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
    capture: Cow<'_, Capture>,
    request: &ExamineOptions<'_>,
    progress: &mut OnProgress<'_>,
) -> Result<Examination, SurveyError> {
    let mut prepared = PreparedCapture::prepare(capture, &request.hints, request.sensors)?;
    let segments = prepared.take_segments();
    let truth = &prepared.capture.truth;
    let truth = (!truth.is_empty()).then(|| accuracy::fundamental(truth));
    let total = segments.len() * request.methods.len();
    let mut outcomes = Vec::with_capacity(total);
    let (mut pooled, mut phasors) = (Vec::with_capacity(segments.len()), Vec::new());
    for (index, segment) in segments.iter().enumerate() {
        progress("reference", outcomes.len(), total);
        let mut examined = ExaminedSegment::new(&mut prepared, index, segment, request);
        let of_segment = examined.take_phasors();
        pooled.push(of_segment.as_ref().and_then(|p| pooled_law(segment, p)));
        phasors.extend(of_segment);
        for &method in request.methods {
            let done = outcomes.len();
            progress(method.name(), done, total);
            let mut sink = ProgressSink {
                truth: truth.as_ref(),
                report: &mut |text| progress(&format!("{method}: {text}"), done, total),
            };
            outcomes.push(examined.result_of(method, &mut sink));
        }
    }
    progress("", total, total);
    Ok(Examination {
        survey: prepared.survey,
        sensors: prepared.sensors,
        segments,
        pooled,
        phasors,
        outcomes,
    })
}

/// Segment with what every method's result is judged by.
struct ExaminedSegment<'a> {
    request: &'a ExamineOptions<'a>,
    index: usize,
    segment: &'a Segment,
    remarks: Vec<Remark>,
    preprocessing: Result<Preprocessing, SegmentError>,
    reference: ReferenceResults,
    /// Standard deviations by the sensors.
    shared: SharedSigma,
    /// Judgement of least squares with its default options, once it was asked for.
    of_least_squares: Option<Judgement>,
}

impl<'a> ExaminedSegment<'a> {
    fn new(
        prepared: &mut PreparedCapture<'_>,
        index: usize,
        segment: &'a Segment,
        request: &'a ExamineOptions<'a>,
    ) -> Self {
        let known = prepared.take_interference(index);
        let noise = prepared.survey.noise_on(index, segment);
        let preprocessing = Preprocessing::with_noise(segment, Some(noise));
        Self {
            request,
            index,
            segment,
            remarks: prepared.remarks_on(index, segment),
            reference: ReferenceResults::compute(segment, &preprocessing, known),
            preprocessing,
            shared: prepared.shared_sigma(segment.f_sw_hz),
            of_least_squares: None,
        }
    }

    fn judge(&self, estimate: &Estimate) -> Judgement {
        judge(&Evidence {
            remarks: &self.remarks,
            segment: self.segment,
            estimate,
            reference: &self.reference,
            shared: self.shared,
        })
    }

    /// Takes the phasors to be pooled; `None` where least squares is refused for more than noise, or there is no law R(I), L(I).
    fn take_phasors(&mut self) -> Option<PoolPhasors> {
        let noise = self.preprocessing.as_ref().ok()?.noise();
        let least_squares = self.reference.least_squares.as_ref().ok()?;
        let judgement = self.judge(least_squares);
        let is_lawful = is_law(&judgement);
        self.of_least_squares = Some(judgement);
        let phasors = is_lawful.then(|| self.reference.take_phasors(self.segment, noise));
        phasors.map(|phasors| phasors.with_shared(self.shared))
    }

    /// Runs a method, and judges its result.
    fn result_of(&self, method: Method, sink: &mut ProgressSink<'_>) -> MethodResult {
        let mut result = self.identify(method, sink);
        let judgement = match &result {
            Ok(estimate) => {
                // Reconstructed waveforms are not judged, so that the judgement of the reference holds for its copy.
                let known = self.of_least_squares.as_ref();
                let known = known.filter(|_| self.reference.knows(method, self.request.settings));
                known.map_or_else(|| self.judge(estimate), Judgement::clone)
            }
            Err(error) => judge_failure(&self.remarks, method, &error.to_string()),
        };
        if let Ok(estimate) = &mut result {
            if self.request.reconstruct != Reconstruct::Waveforms {
                (estimate.v_hat_v, estimate.i_hat_a) = (Vec::new(), Vec::new());
            }
            // Only after the judgement: a deviation that all methods share explains no difference between them.
            self.shared.widen(estimate);
        }
        MethodResult {
            method,
            segment: self.index,
            result,
            judgement,
        }
    }

    /// Runs a method unless the reference has its result, and reconstructs the waveforms as far as requested.
    fn identify(
        &self,
        method: Method,
        sink: &mut ProgressSink<'_>,
    ) -> Result<Estimate, IdentifyError> {
        let (segment, settings) = (self.segment, self.request.settings);
        let mut estimate = match self.reference.result_of(method, settings) {
            Some(known) => known,
            None => {
                let preprocessing = self.preprocessing.as_ref().map_err(Clone::clone)?;
                let known = self.reference.least_squares_of(settings);
                run_preprocessed(method, segment, preprocessing, known, settings, sink)
            }
        }?;
        match self.request.reconstruct {
            Reconstruct::No => {}
            Reconstruct::Errors => reconstruction::errors(segment, &mut estimate),
            Reconstruct::Waveforms => reconstruction::complete(segment, &mut estimate),
        }
        Ok(estimate)
    }
}

/// Findings of a load that is no function of the current alone.
const NO_LAW: [&str; 2] = ["load_moves", "load_step"];

/// Finding that pooling reduces.
const NOISE: &str = "uncertain";

/// Returns `true` if nothing in the judgement of least squares but noise speaks against a law R(I), L(I).
fn is_law(least_squares: &Judgement) -> bool {
    let is_error = |r: &Remark| r.severity == Severity::Error && r.code != NOISE;
    let contradicts = |r: &Remark| NO_LAW.contains(&r.code) || is_error(r);
    !least_squares.findings.iter().any(contradicts)
}

fn pooled_law(segment: &Segment, phasors: &PoolPhasors) -> Option<PooledLaw> {
    let judged = comparison::judged(segment);
    let whole = judged.iter().filter(|h| h.is_whole()).count();
    (whole >= 2)
        .then(|| pooled::pool_phasors(phasors))
        .flatten()
}
