//! Survey of a capture with self-calibrated sensors, the first stage of every command that works on one.

use std::borrow::Cow;

use ihd_signal::{Capture, Remark};

use super::correction::Correction;
use super::error::BlindError;
use super::estimate::estimate;
use super::self_calibration::SelfCalibration;
use super::straighten::{Saturation, straighten};
use crate::{Hints, Survey, SurveyError};

/// Extent of the self-calibration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CalibrationMode {
    /// Estimate, and correct if the result is significant and sound.
    #[default]
    Auto,
    /// Estimate and report, without correction.
    Report,
    /// No self-calibration.
    Off,
}

/// Options of the self-calibration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BlindOptions {
    /// Extent of the self-calibration.
    pub mode: CalibrationMode,
    /// Capacitance of the resonance capacitor in farad, to a percent; `None` if unknown.
    pub capacitance_f: Option<f64>,
}

/// Surveyed capture, and the self-calibration of its sensors.
#[derive(Clone, Debug)]
pub struct CalibratedCapture<'a> {
    /// Capture, corrected if a correction was applied.
    pub capture: Cow<'a, Capture>,
    /// Survey of `capture`.
    pub survey: Survey,
    /// Result of the self-calibration; `None` with [`CalibrationMode::Off`].
    pub sensors: Option<Result<SelfCalibration, BlindError>>,
    /// Correction that was applied; `None` if there was none.
    pub correction: Option<Correction>,
    /// Saturation of the current's sensor that was corrected before all else; `None` if there was none.
    pub saturation: Option<Saturation>,
}

impl CalibratedCapture<'_> {
    /// Remarks on the sensors.
    pub fn remarks(&self) -> Vec<Remark> {
        match &self.sensors {
            None => Vec::new(),
            Some(Ok(sensors)) => {
                let straightened = self.saturation.map(|s| s.remark());
                let of_sensors = sensors.remarks(self.correction.is_some());
                straightened.into_iter().chain(of_sensors).collect()
            }
            Some(Err(why)) => vec![why.remark()],
        }
    }
}

/// Surveys a capture and calibrates its sensors; surveys it again after a correction.
///
/// # Errors
/// [`SurveyError`] if the capture holds nothing that can be identified.
pub fn calibrate<'a>(
    capture: &'a Capture,
    hints: &Hints,
    options: BlindOptions,
) -> Result<CalibratedCapture<'a>, SurveyError> {
    calibrate_surveyed(
        capture,
        Survey::from_capture(capture, hints)?,
        hints,
        options,
    )
}

/// Calibrates as [`calibrate`] does a capture that was surveyed with these hints.
///
/// # Errors
/// Errors of [`calibrate`].
pub fn calibrate_surveyed<'a>(
    capture: &'a Capture,
    survey: Survey,
    hints: &Hints,
    options: BlindOptions,
) -> Result<CalibratedCapture<'a>, SurveyError> {
    let mut sensors = (options.mode != CalibrationMode::Off)
        .then(|| estimate(capture, &survey, options.capacitance_f));
    let auto = options.mode == CalibrationMode::Auto;
    let mut changed: Option<Capture> = None;
    let mut saturation = None;
    if let (true, Some(Ok(bent))) = (auto, &sensors)
        && bent.is_bent()
        && let Some((straight, again, found)) = straighten(capture, &survey, bent)
    {
        changed = Some(straight);
        sensors = Some(Ok(again));
        saturation = Some(found);
    }
    let correction = match &sensors {
        Some(Ok(sensors)) if auto => sensors.correction(),
        _ => None,
    };
    if let Some(correction) = &correction {
        correction.apply(changed.get_or_insert_with(|| capture.clone()));
    }
    let survey = match &changed {
        Some(changed) => Survey::from_capture(changed, hints)?,
        None => survey,
    };
    Ok(CalibratedCapture {
        capture: changed.map_or(Cow::Borrowed(capture), Cow::Owned),
        survey,
        sensors,
        correction,
        saturation,
    })
}
