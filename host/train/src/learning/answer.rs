//! Windows that another machine identifies.
//!
//! [`analyse_window`] runs there, with the same result on every machine. [`Learning::learn_from_answer`] runs at the device's daemon and
//! accepts only what the window's own samples confirm.

use ihd_gate::claim::{self, ClaimError, ClaimedResult, Confirmation};
use ihd_identify::Preprocessing;
use ihd_link::Window;
use ihd_map::{CurrentCurve, CurveMatch};
use ihd_pinn::{Identification, PinnConfig};
use ihd_signal::noise::WhiteNoise;
use ihd_signal::{Remark, Segment};
use ihd_survey::calibration::blind::Correction;

use super::sensors::{SensorEvidence, corrected};
use super::{Learning, LookupUpdate, judge, network, time_s};

/// Largest age of a window in seconds of device time, against the newest learned one: answers are late and out of order. An older window
/// may show a pot that has been removed, and one of an earlier boot does so at any age.
const MAX_AGE_S: f64 = 30.0;

/// Identification and verdict of one window, from its samples alone.
#[derive(Clone, Debug)]
pub struct WindowAnalysis {
    /// R(t) and L(t); `None` if the network did not finish.
    pub identified: Option<Box<Identification>>,
    /// Findings, worst first.
    pub findings: Vec<Remark>,
    /// Reason of the gate's refusal; `None` if the window passes.
    pub refused: Option<String>,
}

/// Answer that the window's samples confirm, and its effect on the device's map.
#[derive(Clone, Debug)]
pub struct ConfirmedAnswer {
    /// Current, χ² and least deviations of the samples at the times of the answer.
    pub confirmed: Confirmation,
    /// Comparison with the known pot; `None` if the window came too late to be learned.
    pub seen: Option<CurveMatch>,
    /// Effect on the lookup.
    pub taught: LookupUpdate,
    /// Remarks on the device's sensors.
    pub findings: Vec<Remark>,
}

/// Reason for which an answer is rejected. Nothing was learned from it, nor from its window.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AnswerError {
    /// The window's samples contradict it.
    #[error(transparent)]
    Refuted(#[from] ClaimError),
    /// It was computed with another sensor correction than the device's own.
    #[error("it was found with other corrections of the sensors than are known now")]
    Outdated,
    /// The window shows a sensor fault.
    #[error("the window shows a fault of its sensors: {0}")]
    Sensors(String),
}

/// Identifies a window and judges it. The result depends on the window, the sensor correction and the network's settings only, so that it
/// is the same on every machine.
pub fn analyse_window(
    window: &Window,
    correction: Option<&Correction>,
    config: PinnConfig,
) -> WindowAnalysis {
    let segment = corrected(&window.segment(), correction);
    let (identified, findings, verdict) =
        analyse_segment(window, &segment, config, Vec::new(), &mut |_| ());
    WindowAnalysis {
        identified,
        findings,
        refused: verdict.err(),
    }
}

/// Identifies a corrected segment and judges it; `sensor_remarks` come first in the findings.
pub(super) fn analyse_segment(
    window: &Window,
    segment: &Segment,
    config: PinnConfig,
    sensor_remarks: Vec<Remark>,
    on_step: &mut dyn FnMut(&ihd_pinn::TrainingProgress),
) -> (
    Option<Box<Identification>>,
    Vec<Remark>,
    Result<CurrentCurve, String>,
) {
    let preprocessing = Preprocessing::new(segment);
    let noise = match &preprocessing {
        Ok(preprocessing) => preprocessing.noise(),
        Err(_) => WhiteNoise::measure(segment),
    };
    let config = PinnConfig {
        noise: config.noise.or(noise.measured()),
        ..config
    };
    let identified = match network::fit_window(segment, config, on_step) {
        Ok(identified) => Box::new(identified),
        Err(why) => return (None, sensor_remarks, Err(why.to_string())),
    };
    let judgement = judge(segment, &preprocessing, &identified, &sensor_remarks);
    let verdict = match !judgement.gate.passes() {
        true => Err(judgement.gate.why.join("; ")),
        false => Ok(network::curve(
            segment,
            noise,
            &(&*identified).into(),
            time_s(window),
        )),
    };
    (Some(identified), judgement.findings, verdict)
}

impl Learning {
    /// Returns the sensor correction for the device's next window; `None` if there is none.
    pub fn correction(&self) -> Option<Correction> {
        self.sensors.correction()
    }

    /// Returns `true` if a window of another machine's answer came too late: it is not of the present boot, or much older than the newest
    /// one that was learned.
    pub fn is_late(&self, boot: u32, window: &Window) -> bool {
        match self.boot {
            None => false,
            Some(present) => present != boot || time_s(window) < self.map.newest_s() - MAX_AGE_S,
        }
    }

    /// Checks another machine's answer to a window of a boot, and learns from it if the window's samples confirm it and it is not
    /// [late](Self::is_late). Windows of one boot may come in any order.
    ///
    /// # Errors
    /// [`AnswerError`]; the caller then identifies the window itself ([`Learning::observe`]).
    pub fn learn_from_answer(
        &mut self,
        boot: u32,
        window: &Window,
        claim: &ClaimedResult<'_>,
    ) -> Result<ConfirmedAnswer, AnswerError> {
        let raw = window.segment();
        let evidence = SensorEvidence::of_window(window.seq, &raw);
        if let Some(fault) = evidence.remarks.first() {
            return Err(AnswerError::Sensors(fault.text.clone()));
        }
        let is_late = self.is_late(boot, window);
        let mut sensors = self.sensors;
        let findings = match is_late {
            true => Vec::new(),
            false => sensors.add(&evidence),
        };
        let before = self.sensors.correction();
        if before.is_some() != sensors.correction().is_some() {
            return Err(AnswerError::Outdated);
        }
        let segment = corrected(&raw, before.as_ref());
        let confirmed = claim::confirm(&segment, claim)?;
        let trajectory = network::LoadTrajectory {
            i_amplitude_a: &confirmed.i_amplitude_a,
            r_ohm: claim.r_ohm,
            l_h: claim.l_h,
            chi2: &confirmed.chi2,
        };
        let mut curve = network::curve(
            &segment,
            WhiteNoise::measure(&segment),
            &trajectory,
            time_s(window),
        );
        self.sensors = sensors;
        let (seen, taught) = match is_late {
            true => (None, LookupUpdate::Unchanged),
            false => {
                if self.boot == Some(boot) {
                    curve.t_s = curve.t_s.max(self.map.newest_s());
                }
                self.begin_boot(boot);
                let (seen, taught) = self.learn(curve, false);
                (Some(seen), taught)
            }
        };
        Ok(ConfirmedAnswer {
            confirmed,
            seen,
            taught,
            findings,
        })
    }

    /// Adds a window's evidence on the sensors. If that begins or ends a correction, the map is cleared.
    pub(super) fn count_evidence(&mut self, evidence: &SensorEvidence) -> Vec<Remark> {
        let before = self.sensors.correction().is_some();
        let remarks = self.sensors.add(evidence);
        if before != self.sensors.correction().is_some() {
            // Its curves were measured with another correction.
            self.map = self.map.forgotten();
        }
        remarks
    }
}
