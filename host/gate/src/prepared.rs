//! Capture made ready for the methods: repaired, without its neighbours' tones, and with its sensors corrected.

use std::borrow::Cow;

use ihd_identify::pooled::SharedSigma;
use ihd_signal::{Capture, Remark, Segment};
use ihd_survey::calibration::blind::{BlindOptions, CalibrationMode};
use ihd_survey::calibration::sigma_of;
use ihd_survey::{Hints, Survey, SurveyError};

use crate::interference::Interference;
use crate::neighbours::{self, Neighbours, WithoutNeighbours};
use crate::remarks;
use crate::repair;
use crate::sensors::{CorrectionUncertainty, calibrate, correct_gain};

/// Least relative deviation of R and of L: splines and 12 bit resolve no more. The methods differ by this much on captures
/// without noise.
const RESOLUTION: f64 = 5e-5;

/// Capture as the methods get it, and the remarks and deviations that its preparation causes.
pub struct PreparedCapture<'a> {
    pub capture: Cow<'a, Capture>,
    /// Survey after all corrections.
    pub survey: Survey,
    /// Remarks on the sensors.
    pub sensors: Vec<Remark>,
    removed: Option<Box<WithoutNeighbours>>,
    uncertainty: Option<CorrectionUncertainty>,
    /// Interference of each span; empty unless it is known already.
    interference: Vec<Interference>,
    /// Relative deviations of R and of L by restored samples.
    restored: [f64; 2],
    /// Deviations of the user's calibration: delay in seconds and relative gain.
    calibration_sigma: Option<[f64; 2]>,
}

impl<'a> PreparedCapture<'a> {
    /// Repairs and corrects a capture.
    ///
    /// # Errors
    /// [`SurveyError`] if the capture holds nothing that can be identified.
    pub fn prepare(
        capture: Cow<'a, Capture>,
        hints: &Hints,
        sensors: BlindOptions,
    ) -> Result<Self, SurveyError> {
        let repaired = repair::repair(capture, hints)?;
        let mut capture = repaired.capture;
        let mut survey = repaired.survey;
        let (mut removed, mut interference) = (None, Vec::new());
        match neighbours::remove(&mut capture, &survey, hints)? {
            Neighbours::Absent(of_spans) => interference = of_spans,
            Neighbours::Removed(mut without) => {
                capture = Cow::Owned(std::mem::take(&mut without.capture));
                survey = Survey::from_capture(&capture, hints)?;
                removed = Some(without);
            }
        }
        // What is left of a tone would be taken for a fault of the sensors, and restored samples have no edges of their own.
        let hidden = removed.as_ref().is_some_and(|r| r.hide_sensors());
        let mode = match hidden || repaired.shares != [0.0; 2] {
            true => CalibrationMode::Off,
            false => sensors.mode,
        };
        let options = BlindOptions { mode, ..sensors };
        let mut calibrated = calibrate(&capture, survey, hints, options)?;
        let mut sensors = calibrated.remarks();
        let gain = (mode == CalibrationMode::Auto)
            .then(|| correct_gain(&mut calibrated))
            .flatten();
        let uncertainty = CorrectionUncertainty::from_self_calibration(&calibrated, gain.is_some());
        if let Some(gain) = gain {
            calibrated.survey = Survey::from_capture(&calibrated.capture, hints)?;
            sensors.retain(|r| r.code != gain.code);
            sensors.push(gain);
        }
        sensors.extend(repaired.remarks);
        let survey = calibrated.survey;
        if let Cow::Owned(corrected) = calibrated.capture {
            // Corrected samples have another residual.
            interference.clear();
            capture = Cow::Owned(corrected);
        }
        Ok(Self {
            calibration_sigma: sigma_of(&capture),
            capture,
            survey,
            sensors,
            removed,
            uncertainty,
            interference,
            restored: repaired.shares,
        })
    }

    /// Returns the segments; an owned capture's samples move to them.
    pub fn take_segments(&mut self) -> Vec<Segment> {
        match &mut self.capture {
            Cow::Owned(capture) => self.survey.take_segments(capture),
            Cow::Borrowed(capture) => self.survey.segments(capture),
        }
    }

    /// Returns the remarks of survey and preparation on a segment.
    pub fn remarks_on(&self, index: usize, segment: &Segment) -> Vec<Remark> {
        let mut remarks = remarks::from_survey(&self.survey, segment);
        remarks.extend(self.sensors.iter().cloned());
        let load = self.survey.spans.get(index).and_then(|span| span.load);
        remarks.extend(self.uncertainty.and_then(|u| u.remark(segment, load)));
        let removed = self.removed.iter().flat_map(|r| r.remarks_on(segment));
        remarks.extend(removed.cloned());
        remarks
    }

    /// Takes the interference of a segment out; `None` if it is not known yet.
    pub fn take_interference(&mut self, index: usize) -> Option<Interference> {
        self.interference.get_mut(index).map(std::mem::take)
    }

    /// Deviations that preparation and sampling leave to all phasors alike, at a switching frequency in hertz.
    pub fn shared_sigma(&self, f_sw_hz: f64) -> SharedSigma {
        let of = |shares: [f64; 2]| SharedSigma {
            shares,
            delay_s: 0.0,
        };
        let sensors = self.uncertainty.map(|u| u.shared_sigma(f_sw_hz));
        let calibration = self.calibration_sigma.map(|[delay_s, gain]| SharedSigma {
            shares: [gain; 2],
            delay_s,
        });
        let aliasing = self.survey.aliasing.as_ref();
        let aliasing = aliasing.map(|a| of([0.01 * a.r_pct, 0.01 * a.l_pct]));
        of(self.restored.map(|share| RESOLUTION.hypot(share)))
            .hypot(sensors.unwrap_or_default())
            .hypot(calibration.unwrap_or_default())
            .hypot(aliasing.unwrap_or_default())
    }
}
