//! The whole way from a capture to judged estimates: what `ihd identify` and the studies share.

use ihd_identify::{
    Estimate, IdentifyError, Method, Settings, Watch, accuracy, reconstruction, run_watched,
};
use ihd_signal::{Capture, Remark, Segment};
use ihd_survey::calibration::blind::Ask;
use ihd_survey::{Hints, Survey, SurveyError};

use crate::judge::{Evidence, failed, judge};
use crate::remarks;
use crate::sensors::{Applied, look};
use crate::verdict::Judgement;
use crate::witness::Witness;

/// Share of R and of L to which splines and 12 bit resolve them where neither noise nor the model's residual is more: what the
/// methods differ by on captures without noise.
const RESOLUTION: f64 = 5e-5;

/// What is asked for.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    /// What the user knows of the capture.
    pub hints: Hints,
    /// Who shall estimate.
    pub methods: &'a [Method],
    /// What to do about the sensors.
    pub sensors: Ask,
    /// Settings of the methods.
    pub settings: &'a Settings,
    /// What to make of R(t) and L(t) of methods that do not reconstruct the waveforms themselves.
    pub reconstruct: Reconstruct,
}

/// What is made of the waveforms that R(t) and L(t) imply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reconstruct {
    /// Nothing.
    No,
    /// Their errors.
    Errors,
    /// Their errors, and they are kept: as many numbers as the stretch has samples.
    Waveforms,
}

/// What a method made of a stretch.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Who.
    pub method: Method,
    /// Index of the stretch among [`Examined::segments`].
    pub segment: usize,
    /// The estimate, or why there is none.
    pub result: Result<Estimate, IdentifyError>,
    /// What is to be said of it.
    pub judgement: Judgement,
}

/// A capture, examined.
#[derive(Clone, Debug)]
pub struct Examined {
    /// What is in the capture.
    pub survey: Survey,
    /// What is to be said of the sensors.
    pub sensors: Vec<Remark>,
    /// The stretches that were identified, in order of time.
    pub segments: Vec<Segment>,
    /// Stretch by stretch, method by method in the order asked for.
    pub outcomes: Vec<Outcome>,
}

/// Hears who works, in words, and after each result how many there are of how many.
pub type OnProgress<'a> = dyn FnMut(&str, usize, usize) + 'a;

/// Surveys a capture, identifies every stretch by every method, and judges each result.
///
/// # Errors
/// [`SurveyError`] where there is nothing to work on. A method that fails on a stretch is an [`Outcome`].
pub fn examine(
    capture: &Capture,
    request: &Request<'_>,
    progress: &mut OnProgress<'_>,
) -> Result<Examined, SurveyError> {
    let looked = look(capture, &request.hints, request.sensors)?;
    let sensors = looked.remarks();
    let applied = match (&looked.correction, &looked.sensors) {
        (Some(_), Some(Ok(found))) => Some(Applied::of(found)),
        _ => None,
    };
    let segments = looked.survey.segments(&looked.capture);
    let survey = looked.survey;
    let truth = (!capture.truth.is_empty()).then(|| accuracy::fundamental(&capture.truth));
    let total = segments.len() * request.methods.len();
    let mut outcomes = Vec::with_capacity(total);
    for (index, segment) in segments.iter().enumerate() {
        progress("reference", outcomes.len(), total);
        let mut remarks = remarks::of_survey(&survey, segment);
        remarks.extend(sensors.iter().cloned());
        let load = survey.spans.get(index).and_then(|span| span.load);
        remarks.extend(applied.and_then(|applied| applied.remark(segment, load)));
        let witness = Witness::of(segment);
        for &method in request.methods {
            let done = outcomes.len();
            progress(method.name(), done, total);
            let mut watch = Watch {
                truth: truth.as_ref(),
                report: &mut |text| progress(&format!("{method}: {text}"), done, total),
            };
            let mut result = match witness.result_of(method, request.settings) {
                Some(known) => known,
                None => run_watched(method, segment, request.settings, &mut watch),
            };
            if let Ok(estimate) = &mut result {
                match request.reconstruct {
                    Reconstruct::No => {}
                    Reconstruct::Errors => reconstruction::errors(segment, estimate),
                    Reconstruct::Waveforms => reconstruction::complete(segment, estimate),
                }
            }
            let judgement = judged(&remarks, segment, &witness, method, &result);
            // After the judgement: what all methods share is no noise between them.
            if let Ok(estimate) = &mut result {
                if let Some(applied) = applied {
                    applied.widen(estimate);
                }
                widen(estimate, RESOLUTION, RESOLUTION);
                if let Some(aliasing) = &survey.aliasing {
                    widen(estimate, 0.01 * aliasing.r_pct, 0.01 * aliasing.l_pct);
                }
            }
            outcomes.push(Outcome {
                method,
                segment: index,
                result,
                judgement,
            });
        }
    }
    progress("", total, total);
    Ok(Examined {
        survey,
        sensors,
        segments,
        outcomes,
    })
}

/// Adds to the deviations what edges that the sampling folds onto the fundamental may cost, as shares of R and of L.
fn widen(estimate: &mut Estimate, r_share: f64, l_share: f64) {
    let add = |sigma: &mut [f64], values: &[f64], share: f64| {
        for (sigma, value) in sigma.iter_mut().zip(values) {
            *sigma = sigma.hypot(share * value);
        }
    };
    add(&mut estimate.r_sigma_ohm, &estimate.r_ohm, r_share);
    add(&mut estimate.l_sigma_h, &estimate.l_h, l_share);
}

fn judged(
    remarks: &[Remark],
    segment: &Segment,
    witness: &Witness,
    method: Method,
    result: &Result<Estimate, IdentifyError>,
) -> Judgement {
    match result {
        Ok(estimate) => judge(&Evidence {
            remarks,
            segment,
            estimate,
            witness,
        }),
        Err(error) => failed(remarks, method, &error.to_string()),
    }
}
