//! Learning in two halves, for whoever has the window identified elsewhere: what a window shows by itself ([`study`]), which any
//! machine finds alike, and what that means for its device ([`Learning::take`]).

use ihd_link::Window;
use ihd_map::{Curve, Seen};
use ihd_pinn::{Config, Identified};
use ihd_signal::{Remark, Segment};
use ihd_survey::calibration::blind::Correction;

use super::sensors::{Evidence, corrected};
use super::{Learning, Taught, judge, network, time_s};

/// By how many seconds of the device a window may be behind the newest that was learned: what waits for a worker or comes out of order.
/// An older one may be of a pot that is gone.
const LATEST_S: f64 = 30.0;

/// What a window shows by itself.
#[derive(Clone, Debug)]
pub struct Alone {
    /// What the network found; none where it came to no end.
    pub identified: Option<Box<Identified>>,
    /// What is to be said of it, worst first.
    pub findings: Vec<Remark>,
    /// R and L over current, or why the window may not teach.
    pub verdict: Result<Curve, String>,
    /// What it says of its device's sensors.
    pub evidence: Evidence,
}

/// What a curve that was found elsewhere meant for its device.
#[derive(Clone, Debug)]
pub enum Taken {
    /// It was learned from.
    Learned(Seen, Taught),
    /// It is too old: what came after it counts.
    Late,
    /// There is no curve: the gate refused the window.
    Unfit,
}

/// Identifies a window and judges it, from nothing but it, what is to be taken out of its samples, and the network's settings: the
/// same on every machine.
pub fn study(
    window: &Window,
    correction: Option<&Correction>,
    config: Config,
    on_step: &mut dyn FnMut(&ihd_pinn::Progress),
) -> Alone {
    let raw = window.segment();
    let evidence = Evidence::of(&raw);
    let said = evidence.remarks.clone();
    let segment = corrected(&raw, correction);
    let (identified, findings, verdict) = alone(window, &segment, config, said, on_step);
    Alone {
        identified,
        findings,
        verdict,
        evidence,
    }
}

/// Identifies what was corrected, and judges it; `said` is of the sensors.
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
        false => Ok(network::curve(segment, &identified, time_s(window))),
    };
    (Some(identified), judgement.findings, verdict)
}

impl Learning {
    /// What is to be taken out of the device's next window before it is identified.
    pub fn correction(&self) -> Option<Correction> {
        self.sensors.correction()
    }

    /// Learns from what [`study`] found in a window of this boot of the device; what is to be said of its sensors beside. Windows of one
    /// boot may come in any order.
    pub fn take(
        &mut self,
        boot: u32,
        curve: Option<Curve>,
        evidence: &Evidence,
    ) -> (Taken, Vec<Remark>) {
        let said = self.hear(evidence);
        let Some(mut curve) = curve else {
            return (Taken::Unfit, said);
        };
        let newest_s = self.map.newest_s();
        if self.boot == Some(boot) && newest_s.is_finite() {
            if curve.t_s < newest_s - LATEST_S {
                return (Taken::Late, said);
            }
            curve.t_s = curve.t_s.max(newest_s);
        }
        self.boot = Some(boot);
        let (seen, taught) = self.learn(curve, false);
        (Taken::Learned(seen, taught), said)
    }

    /// What a window says of the sensors counts; where that begins or ends a correction, the map begins anew.
    pub(super) fn hear(&mut self, evidence: &Evidence) -> Vec<Remark> {
        let before = self.sensors.correction().is_some();
        let said = self.sensors.count(evidence);
        if before != self.sensors.correction().is_some() {
            // What was known was seen through other sensors.
            self.map = self.map.forgotten();
        }
        said
    }
}
