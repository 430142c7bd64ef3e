//! A capture with its sensors looked at first: what every command does that works on one.

use std::borrow::Cow;

use ihd_signal::{Capture, Remark};

use super::{BlindError, Correction, SelfCalibration, estimate};
use crate::{Hints, Survey, SurveyError};

/// What to do about the sensors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// Look, and correct where that is significant and sound.
    #[default]
    Auto,
    /// Look and tell.
    Report,
    /// Nothing.
    Off,
}

/// What is asked about the sensors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ask {
    /// What to do.
    pub mode: Mode,
    /// The resonance capacitor's value in farad, where known to a percent.
    pub capacitance_f: Option<f64>,
}

/// A capture, surveyed, and what is known of its sensors.
#[derive(Clone, Debug)]
pub struct Looked<'a> {
    /// The capture, corrected where it was.
    pub capture: Cow<'a, Capture>,
    /// Its survey.
    pub survey: Survey,
    /// What the sensors are; `None` where nobody looked.
    pub sensors: Option<Result<SelfCalibration, BlindError>>,
    /// What was taken out.
    pub correction: Option<Correction>,
}

impl Looked<'_> {
    /// What is to be said of the sensors.
    pub fn remarks(&self) -> Vec<Remark> {
        match &self.sensors {
            None => Vec::new(),
            Some(Ok(found)) => found.remarks(self.correction.is_some()),
            Some(Err(why)) => vec![why.remark()],
        }
    }
}

/// Surveys a capture and looks at its sensors; what is corrected is surveyed again.
///
/// # Errors
/// [`SurveyError`] where there is nothing to work on.
pub fn look<'a>(capture: &'a Capture, hints: &Hints, ask: Ask) -> Result<Looked<'a>, SurveyError> {
    let survey = Survey::of(capture, hints)?;
    let sensors = (ask.mode != Mode::Off).then(|| estimate(capture, &survey, ask.capacitance_f));
    let correction = match &sensors {
        Some(Ok(found)) if ask.mode == Mode::Auto => found.correction(),
        _ => None,
    };
    let Some(correction) = correction else {
        return Ok(Looked {
            capture: Cow::Borrowed(capture),
            survey,
            sensors,
            correction: None,
        });
    };
    let mut corrected = capture.clone();
    correction.apply(&mut corrected);
    let survey = Survey::of(&corrected, hints)?;
    Ok(Looked {
        capture: Cow::Owned(corrected),
        survey,
        sensors,
        correction: Some(correction),
    })
}
