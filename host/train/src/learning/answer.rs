//! Windows that another machine identifies: its part ([`identify_alone`]), which any machine does alike, and the device's
//! ([`Learning::take`]), which believes nothing that the window's own samples do not confirm.

use ihd_gate::claim::{self, Claim, ClaimError, Confirmed};
use ihd_link::Window;
use ihd_map::{Curve, Seen};
use ihd_pinn::{Config, Identified};
use ihd_signal::{Remark, Segment};
use ihd_survey::calibration::blind::Correction;

use super::sensors::{Evidence, corrected};
use super::{Learning, Taught, judge, network, time_s};

/// Time in seconds of the device by which a window may be older than the newest that was learned: waiting for a worker,
/// coming out of order. An older one may be of a pot that is gone.
const LATEST_S: f64 = 30.0;

/// Windows after a boot that are all asked what they show of the sensors, and of how many later ones one is: that takes five times as long
/// as the rest, and a mean over 200 windows needs no more.
const ALL_ASKED: u32 = 32;
const ONE_ASKED_OF: u32 = 16;

/// Result of one window, from nothing but its samples.
#[derive(Clone, Debug)]
pub struct Alone {
    /// R(t) and L(t); none where the network came to no end.
    pub identified: Option<Box<Identified>>,
    /// Findings, worst first.
    pub findings: Vec<Remark>,
    /// Reason for which the window may not teach; none where it may.
    pub refused: Option<String>,
}

/// An answer that the samples confirm, and its meaning for the device.
#[derive(Clone, Debug)]
pub struct Believed {
    /// Figures of the samples at the times of the answer.
    pub confirmed: Confirmed,
    /// Pot that was seen; none where the window came too late to teach.
    pub seen: Option<Seen>,
    /// Meaning for the lookup.
    pub taught: Taught,
    /// Remarks on the device's sensors.
    pub findings: Vec<Remark>,
}

/// Reason for which an answer is not believed. Nothing was learned from it, nor from its window.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Disbelief {
    /// The samples say otherwise.
    #[error(transparent)]
    Refuted(#[from] ClaimError),
    /// It was found with another correction of the sensors than the device's own.
    #[error("it was found with other corrections of the sensors than are known now")]
    Outdated,
    /// The window's own sensors do not allow an answer.
    #[error("the window shows a fault of its sensors: {0}")]
    Sensors(String),
}

/// Identifies a window and judges it, from nothing but it, the correction of its samples and the network's settings: the
/// same on every machine.
pub fn identify_alone(window: &Window, correction: Option<&Correction>, config: Config) -> Alone {
    let segment = corrected(&window.segment(), correction);
    let (identified, findings, verdict) = alone(window, &segment, config, Vec::new(), &mut |_| ());
    Alone {
        identified,
        findings,
        refused: verdict.err(),
    }
}

/// Identifies a corrected segment and judges it; `said` are the remarks on its sensors.
pub(super) fn alone(
    window: &Window,
    segment: &Segment,
    config: Config,
    said: Vec<Remark>,
    on_step: &mut dyn FnMut(&ihd_pinn::Progress),
) -> (Option<Box<Identified>>, Vec<Remark>, Result<Curve, String>) {
    let identified = match network::identify_window(segment, config, on_step) {
        Ok(identified) => Box::new(identified),
        Err(why) => return (None, said, Err(why.to_string())),
    };
    let judgement = judge(segment, &identified, &said);
    let verdict = match judgement.gate.refuses() {
        true => Err(judgement.gate.why.join("; ")),
        false => Ok(network::curve(
            segment,
            &(&*identified).into(),
            time_s(window),
        )),
    };
    (Some(identified), judgement.findings, verdict)
}

impl Learning {
    /// Correction of the device's next window before it is identified.
    pub fn correction(&self) -> Option<Correction> {
        self.sensors.correction()
    }

    /// Learns from an answer to a window of this boot of the device, if the window's samples confirm it. Windows of one
    /// boot may come in any order.
    ///
    /// # Errors
    /// [`Disbelief`]; the window is then to be identified here ([`Learning::observe`]).
    pub fn take(
        &mut self,
        boot: u32,
        window: &Window,
        claim: &Claim<'_>,
    ) -> Result<Believed, Disbelief> {
        let raw = window.segment();
        let is_asked = window.seq < ALL_ASKED || window.seq.is_multiple_of(ONE_ASKED_OF);
        let evidence = match is_asked {
            true => Evidence::of(&raw),
            false => Evidence::default(),
        };
        if let Some(fault) = evidence.remarks.first() {
            return Err(Disbelief::Sensors(fault.text.clone()));
        }
        let mut sensors = self.sensors;
        let findings = sensors.count(&evidence);
        let before = self.sensors.correction();
        if before.is_some() != sensors.correction().is_some() {
            return Err(Disbelief::Outdated);
        }
        let segment = corrected(&raw, before.as_ref());
        let confirmed = claim::confirm(&segment, claim)?;
        let found = network::Found {
            i_amplitude_a: &confirmed.i_amplitude_a,
            r_ohm: claim.r_ohm,
            l_h: claim.l_h,
            chi2: &confirmed.chi2,
        };
        let mut curve = network::curve(&segment, &found, time_s(window));
        self.sensors = sensors;
        let newest_s = self.map.newest_s();
        if self.boot == Some(boot) && newest_s.is_finite() {
            if curve.t_s < newest_s - LATEST_S {
                return Ok(Believed {
                    confirmed,
                    seen: None,
                    taught: Taught::Known,
                    findings,
                });
            }
            curve.t_s = curve.t_s.max(newest_s);
        }
        self.boot = Some(boot);
        let (seen, taught) = self.learn(curve, false);
        Ok(Believed {
            confirmed,
            seen: Some(seen),
            taught,
            findings,
        })
    }

    /// Counts a window's evidence on the sensors; where that begins or ends a correction, the map begins anew.
    pub(super) fn hear(&mut self, evidence: &Evidence) -> Vec<Remark> {
        let before = self.sensors.correction().is_some();
        let said = self.sensors.count(evidence);
        if before != self.sensors.correction().is_some() {
            // Its curves were seen through other sensors.
            self.map = self.map.forgotten();
        }
        said
    }
}
