//! Removal of other hobs' tones from a capture, before its sensors are calibrated: a tone would look like a fault of a sensor.

use std::borrow::Cow;

use ihd_identify::{IdentifyOptions, Method, run};
use ihd_signal::{Capture, Remark, Segment, Severity};
use ihd_survey::{Finding, Hints, Survey, SurveyError};

use crate::interference::{self, Interference, Tone};

/// Capture without the tones of other hobs.
#[derive(Clone, Debug)]
pub struct WithoutNeighbours {
    /// Capture with the tones subtracted from its voltage.
    pub capture: Capture,
    /// Remarks on what was removed: beginning and end of the stretch in seconds, and the remark.
    pub remarks: Vec<(f64, f64, Remark)>,
}

impl WithoutNeighbours {
    /// Returns `true` if what is left of the tones may look like a fault of the sensors: they cost more than is mentioned only.
    pub fn hide_sensors(&self) -> bool {
        self.remarks.iter().any(|r| r.2.severity > Severity::Info)
    }

    /// Remarks that concern a segment.
    pub fn remarks_on(&self, segment: &Segment) -> impl Iterator<Item = &Remark> {
        let (from_s, to_s) = (segment.t0_s, segment.t_s(segment.len()));
        let concerned = self
            .remarks
            .iter()
            .filter(move |r| r.0 < to_s && r.1 > from_s);
        concerned.map(|r| &r.2)
    }
}

/// Interference in each span of a survey, or the capture without it.
#[derive(Clone, Debug)]
pub enum Neighbours {
    /// No tone that costs anything: the capture stays as it is. One entry a span.
    Absent(Vec<Interference>),
    /// Tones were removed.
    Removed(Box<WithoutNeighbours>),
}

/// Removes the tones of other hobs from a surveyed capture.
///
/// # Errors
/// [`SurveyError`] if the capture holds nothing that can be identified without them.
pub fn remove(
    capture: &mut Cow<'_, Capture>,
    survey: &Survey,
    hints: &Hints,
) -> Result<Neighbours, SurveyError> {
    // Exchanged channels have no impedance, a dead one no tone.
    let unfit = |f: &Finding| matches!(f, Finding::Swapped { .. } | Finding::Dead { .. });
    if survey.findings.iter().any(unfit) {
        return Ok(Neighbours::Absent(Vec::new()));
    }
    let removed = match remove_from(capture, survey) {
        Neighbours::Removed(removed) => removed,
        absent => return Ok(absent),
    };
    // A tone may have looked like a step of the frequency; without it the stretches are longer, and show it better.
    let again = Survey::from_capture(&removed.capture, hints)?;
    if again.spans.len() == survey.spans.len() {
        return Ok(Neighbours::Removed(removed));
    }
    Ok(match remove_from(capture, &again) {
        Neighbours::Absent(_) => Neighbours::Removed(removed),
        removed_again => removed_again,
    })
}

/// Removes the tones that the spans of a survey show.
fn remove_from(capture: &mut Cow<'_, Capture>, survey: &Survey) -> Neighbours {
    let settings = IdentifyOptions::default();
    let mut all = Vec::with_capacity(survey.spans.len());
    let mut costly = Vec::new();
    // Clipping makes tones of its own, and without them its plateau is gone.
    let clipping = |f: &Finding| matches!(f, Finding::Clipping { .. });
    let clips = survey.findings.iter().any(clipping);
    survey.for_segments(capture, |index, segment| {
        let found = interference::find(segment, survey.noise_on(index, segment));
        let tones: Vec<Tone> = found.neighbours().cloned().collect();
        all.push(found);
        if tones.is_empty() || clips {
            return;
        }
        let clean = interference::remove_tones(segment, &tones);
        let by = |segment: &Segment| run(Method::LeastSquares, segment, &settings).ok();
        let remark = by(segment).zip(by(&clean)).and_then(|(with, without)| {
            // Tones would hide a step of the load, which no tone makes.
            let steps = with.remarks.iter().any(|r| r.code == "load_step");
            let remark = || interference::remark(segment, &tones, &with, &without, true);
            (!steps).then(remark).flatten()
        });
        // A tone that costs nothing stays.
        costly.extend(remark.map(|remark| (&survey.spans[index], tones, remark)));
    });
    if costly.is_empty() {
        return Neighbours::Absent(all);
    }
    let mut out = WithoutNeighbours {
        capture: Capture::clone(capture),
        remarks: Vec::new(),
    };
    for (span, tones, remark) in costly {
        let v_v = out
            .capture
            .v_v
            .get_mut(span.first..span.first + span.samples);
        let v_v = v_v.unwrap_or_default();
        for tone in &tones {
            tone.each((span.f_sw_hz, span.dt_s), v_v.len(), |k, v| {
                v_v[k] -= v as f32
            });
        }
        out.remarks.push((span.t0_s, span.end_s(), remark));
    }
    Neighbours::Removed(Box::new(out))
}
