//! Calibration without a reference: what a capture of any load shows of its own sensors.
//!
//! Between two edges the bridge's voltage does not move, so the coil's voltage and the resonance capacitor's add up to a
//! plateau: v = level − (1/C) ∫i dt. A current that is sampled late, or goes through a slow probe, leaves a term of i beside
//! that of ∫i; one with droop a term of ∬i. One regression gives 1/C and these terms with their standard deviations; which
//! kind of sensor they mean is decided by what is left, and whether the model holds at all, too.
//!
//! ```text
//! capture ─► stretch ─► phase of the bridge, edges ─► plateaus as polynomials ─► fit of each model ─► the best ─► correction
//!                       edges.rs                      plateau.rs, basis.rs       fit.rs               choose.rs   correction.rs
//! ```
//!
//! What it cannot tell: the gains and C from one another, and a resistance of the bridge r from a lag of r·C.

mod basis;
mod choose;
mod correction;
mod edges;
mod fit;
mod look;
mod plateau;
mod remarks;
mod settle;
#[cfg(test)]
mod tests;

use std::f64::consts::TAU;

use ihd_signal::segment::Segment;
use ihd_signal::{Capture, Load};
use serde::Serialize;

use self::choose::{Chosen, TOLD_APART};
pub use self::correction::Correction;
use self::edges::Stretch;
pub use self::fit::Found;
use self::fit::Model;
pub use self::look::{Ask, Looked, Mode, look};
use self::settle::{Settled, settle};
use crate::{Finding, Severity, Survey};

/// Why a capture shows nothing of its sensors.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BlindError {
    /// Something else is wrong, which comes first.
    #[error("the sensors cannot be judged: {0}")]
    Unfit(Finding),
    /// Nothing switches.
    #[error(
        "the sensors cannot be judged: no edges of a bridge stand out in the voltage, as of a sine or at too low a rate"
    )]
    NoEdges,
    /// Too little between the edges.
    #[error(
        "the sensors cannot be judged: {plateaus} stretches between edges have samples enough; capture longer or at a higher \
         rate"
    )]
    TooFew {
        /// Plateaus that could be used.
        plateaus: usize,
    },
    /// The voltage itself is flat between edges.
    #[error(
        "the voltage does not follow the charge between edges: this is the bridge's voltage, not the coil's, and R and L \
         would contain the resonance capacitor; connect the probe across the coil"
    )]
    BridgeVoltage,
    /// Noise hides it.
    #[error(
        "the sensors cannot be judged: noise hides the capacitor's voltage ({per_farad:.0} ± {sigma:.0} 1/F)"
    )]
    TooNoisy {
        /// 1/C that was found, in 1/farad.
        per_farad: f64,
        /// Its standard deviation.
        sigma: f64,
    },
}

/// What the sensors do to the signals.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Response {
    /// Both channels alike.
    Right,
    /// The current is sampled later by so many seconds; or both channels have different delays for whatever reason.
    Skew {
        /// In seconds; negative where the current is earlier.
        skew_s: f64,
    },
    /// The current goes through a first-order low-pass.
    SlowCurrent {
        /// Its time constant in seconds.
        tau_s: f64,
    },
    /// The voltage goes through a first-order low-pass.
    SlowVoltage {
        /// Its time constant in seconds.
        tau_s: f64,
    },
    /// The current goes through a first-order high-pass.
    Droop {
        /// Its corner in hertz.
        corner_hz: f64,
        /// And is sampled later by so many seconds.
        skew_s: f64,
        /// And goes through a first-order low-pass of this time constant in seconds.
        tau_s: f64,
    },
}

/// Tests of the model behind it all.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Tests {
    /// Root mean square of what is left with the same shape in every plateau, as a share of the capacitor's voltage.
    pub misfit: f64,
    /// Whether that is more than noise makes, and than is allowed.
    pub flat: bool,
    /// Change of the current sensor's gain at the largest current, as a share: a saturating sensor has a positive one.
    pub bend: Found,
    /// Whether the sides of the bridge show the same; else the one that stands on ground was taken.
    pub sides_agree: bool,
}

/// What a capture shows of its own sensors.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SelfCalibration {
    /// Series capacitance in farad, times gain of the current over gain of the voltage.
    pub capacitance_f: Found,
    /// How far the current is behind the voltage by the sensors, in seconds, to first order at the switching
    /// frequency: time constant of a slow current, a skew's negative; and the bridge's resistance times C.
    pub lag_s: Found,
    /// Skew in seconds if it were nothing else: later is positive. Better known than what a choice of models leaves.
    pub as_skew_s: Found,
    /// What that comes from.
    pub response: Response,
    /// Whether the capture tells that response from a mere skew of the same lag.
    pub told_apart: bool,
    /// Tests of the model.
    pub tests: Tests,
    /// The capacitance that was told, in farad.
    pub known_capacitance_f: Option<f64>,
    /// What an uncorrected lag costs, in percent of R and of L; `None` without a load.
    pub cost_pct: Option<(f64, f64)>,
    /// Plateaus that were used.
    pub plateaus: usize,
    /// Samples of one in the mean.
    pub samples: f64,
    /// Largest amplitude of the current in ampere.
    pub i_a: f64,
}

/// Largest resistance of a bridge that is taken for possible, in ohm: IGBTs drop 1.5 V at 40 A.
const BRIDGE_R_OHM: f64 = 0.05;

/// Lag in seconds below which there is nothing to correct.
const LEAST_LAG_S: f64 = 0.5e-9;

/// Lag beside droop, in seconds, from which a bridge's resistance may be what is seen.
const LEAST_BESIDE_DROOP_S: f64 = 3e-9;

/// Lag in seconds that cables and samplers do not make.
const LONG_S: f64 = 100e-9;

/// Standard deviations from which a lag counts.
const SIGNIFICANT: f64 = 3.0;

/// Change of the current's gain from which the sensor is not linear, and in standard deviations.
const BENT: f64 = 4e-3;
const BENT_SIGMAS: f64 = 5.0;

/// Longest stretch that is looked at, in samples: 20 ms at 125 MS/s.
const LONGEST: usize = 2_500_000;

/// What a capture shows of its sensors.
///
/// # Errors
/// [`BlindError`]: no inverter with a series capacitor is seen, or too little of it.
pub fn estimate(
    capture: &Capture,
    survey: &Survey,
    known_capacitance_f: Option<f64>,
) -> Result<SelfCalibration, BlindError> {
    // A negative R is what a lag looks like.
    let unfit = |f: &&Finding| {
        matches!(f, Finding::Swapped { .. } | Finding::Dead { .. })
            || (f.severity() == Severity::Error && matches!(f, Finding::Clipping { .. }))
    };
    if let Some(finding) = survey.findings.iter().find(unfit) {
        return Err(BlindError::Unfit(finding.clone()));
    }
    let sign = if survey.wiring.inverted { -1.0 } else { 1.0 };
    let mut room = LONGEST;
    let mut stretches = Vec::new();
    // The longest first, should there be more than is looked at.
    let mut spans: Vec<_> = survey.spans.iter().collect();
    spans.sort_by_key(|s| std::cmp::Reverse(s.samples));
    for span in &spans {
        let taken = span.samples.min(room);
        room -= taken;
        let range = span.first..span.first + taken;
        let (Some(v), Some(i)) = (capture.v_v.get(range.clone()), capture.i_a.get(range)) else {
            continue;
        };
        let wide = |x: &[f32], sign: f64| x.iter().map(|x| sign * f64::from(*x)).collect();
        stretches.push(stretch(
            wide(v, 1.0),
            wide(i, sign),
            span.dt_s,
            span.f_sw_hz,
        ));
    }
    let strongest = spans.first();
    let f_sw_hz = strongest.map_or(45e3, |s| s.f_sw_hz);
    let load = strongest.and_then(|s| s.load);
    judged(&stretches, f_sw_hz, load, known_capacitance_f, None)
}

/// The same of a segment, as of a device's window. `settling_s`: time constant of a filter that both channels share, in
/// seconds.
///
/// # Errors
/// As [`estimate`].
pub fn of_segment(
    segment: &Segment,
    load: Option<Load>,
    known_capacitance_f: Option<f64>,
    settling_s: Option<f64>,
) -> Result<SelfCalibration, BlindError> {
    let n = segment.v_v.len().min(segment.i_a.len()).min(LONGEST);
    let (v_v, i_a) = (segment.v_v[..n].to_vec(), segment.i_a[..n].to_vec());
    let one = [stretch(v_v, i_a, segment.dt_s, segment.f_sw_hz)];
    judged(&one, segment.f_sw_hz, load, known_capacitance_f, settling_s)
}

fn stretch(v_v: Vec<f64>, i_a: Vec<f64>, dt_s: f64, f_sw_hz: f64) -> Stretch {
    let less_mean = |x: Vec<f64>| {
        let mean = x.iter().sum::<f64>() / x.len().max(1) as f64;
        x.into_iter().map(|x| x - mean).collect()
    };
    Stretch {
        v_v: less_mean(v_v),
        i_a: less_mean(i_a),
        dt_s,
        f_sw_hz,
    }
}

fn judged(
    stretches: &[Stretch],
    f_sw_hz: f64,
    load: Option<Load>,
    known_capacitance_f: Option<f64>,
    settling_s: Option<f64>,
) -> Result<SelfCalibration, BlindError> {
    let settled = settle(stretches, settling_s)?;
    let (chosen, v_tau_s) = (&settled.chosen, settled.v_tau_s);
    let e = chosen.fit.elastance;
    let omega = TAU * f_sw_hz;
    if e.value < SIGNIFICANT * e.sigma || e.value <= 0.0 {
        // Whether a capacitor would have been seen: its voltage against the bridge's.
        let hidden_v = SIGNIFICANT * e.sigma.max(e.value.abs()) * chosen.i_a / omega;
        return Err(match hidden_v < HIDDEN_V {
            true => BlindError::BridgeVoltage,
            false => BlindError::TooNoisy {
                per_farad: e.value,
                sigma: e.sigma,
            },
        });
    }
    let response = response(&settled);
    let mut lag_s = lag(chosen, omega);
    lag_s.value -= v_tau_s + settled.skew_s;
    let cost_pct = load.map(|z| {
        let angle = omega * lag_s.value.abs();
        let (r, x) = (z.r_ohm.abs(), omega * z.l_h);
        (100.0 * angle * x / r, 100.0 * angle * r / x)
    });
    Ok(SelfCalibration {
        capacitance_f: Found {
            value: 1.0 / e.value,
            sigma: e.sigma / (e.value * e.value),
        },
        lag_s,
        as_skew_s: Found {
            value: chosen.skew_s.value + v_tau_s + settled.skew_s,
            sigma: chosen.skew_s.sigma,
        },
        response,
        told_apart: v_tau_s > 0.0 || chosen.beyond_skew > TOLD_APART,
        tests: Tests {
            misfit: chosen.fit.misfit.share,
            flat: chosen.is_flat(),
            bend: chosen.bend,
            sides_agree: chosen.side.is_none(),
        },
        known_capacitance_f,
        cost_pct,
        plateaus: chosen.plateaus,
        samples: chosen.samples,
        i_a: chosen.i_a,
    })
}

/// Amplitude of a capacitor's voltage in volt that would have been seen.
const HIDDEN_V: f64 = 10.0;

fn response(settled: &Settled) -> Response {
    let (chosen, v_tau_s, before_s) = (&settled.chosen, settled.v_tau_s, settled.skew_s);
    if v_tau_s > 0.0 {
        return Response::SlowVoltage { tau_s: v_tau_s };
    }
    let (t_s, corner_hz) = (chosen.fit.time_s.value, chosen.fit.droop.value / TAU);
    let droop = |skew_s, tau_s| Response::Droop {
        corner_hz,
        skew_s: before_s + skew_s,
        tau_s,
    };
    let skew = |skew_s| Response::Skew {
        skew_s: before_s + skew_s,
    };
    match chosen.fit.model {
        Model::Right if before_s == 0.0 => Response::Right,
        Model::Right => skew(0.0),
        Model::Skew => skew(t_s),
        // A lag that long is a probe's rather than a delay, unless the delay explains more.
        Model::SlowCurrent
            if before_s == 0.0 && (chosen.beyond_skew > TOLD_APART || t_s > LONG_S) =>
        {
            Response::SlowCurrent { tau_s: t_s }
        }
        // As good a skew, which needs no filter.
        Model::SlowCurrent => skew(-t_s),
        Model::Droop => droop(0.0, 0.0),
        Model::SkewAndDroop => droop(t_s, 0.0),
        Model::SlowCurrentAndDroop => droop(0.0, t_s),
    }
}

fn lag(chosen: &Chosen, omega: f64) -> Found {
    let (time, skew) = (chosen.fit.time_s, chosen.skew_s);
    let droop_s = chosen.fit.droop.value / (omega * omega);
    let value = match chosen.fit.model {
        Model::Right | Model::Skew => -skew.value,
        Model::SlowCurrent => time.value,
        Model::SlowCurrentAndDroop => time.value - droop_s,
        Model::Droop | Model::SkewAndDroop => -time.value - droop_s,
    };
    // Time and corner are found together: their sum is known as well as a skew.
    Found {
        value,
        sigma: skew.sigma,
    }
}

impl SelfCalibration {
    /// Whether the plateaus are what the model says, so that its numbers mean something.
    pub fn is_sound(&self) -> bool {
        self.tests.flat && !self.is_bent()
    }

    /// Whether the current's sensor is not linear.
    pub fn is_bent(&self) -> bool {
        let bend = self.tests.bend;
        bend.value.abs() > BENT && bend.value.abs() > BENT_SIGMAS * bend.sigma
    }

    /// Whether the channels differ by more than noise.
    pub fn is_significant(&self) -> bool {
        let lag = self.lag_s;
        self.response != Response::Right
            && lag.value.abs() > (SIGNIFICANT * lag.sigma).max(LEAST_LAG_S)
    }

    /// Whether a resistance of the bridge could be all of it, droop aside: a current that seems late, as by no more than a
    /// bridge's resistance makes, in a way that no sensor shows.
    pub fn may_be_the_bridge(&self) -> bool {
        let least_s = match self.response {
            Response::Skew { .. } => 0.0,
            // Found together with the corner, it is known less well.
            Response::Droop { .. } => LEAST_BESIDE_DROOP_S,
            _ => return false,
        };
        (least_s..BRIDGE_R_OHM * self.capacitance_f.value).contains(&self.beside_droop_s())
    }

    /// The bridge's resistance that would show as this lag, droop aside, in ohm.
    pub fn bridge_r_ohm(&self) -> f64 {
        self.beside_droop_s() / self.capacitance_f.value
    }

    /// How far the current is behind but for droop, in seconds.
    fn beside_droop_s(&self) -> f64 {
        match self.response {
            Response::Droop { skew_s, tau_s, .. } => tau_s - skew_s,
            _ => self.lag_s.value,
        }
    }

    /// What makes the channels alike; `None` where that is not significant, not sound, or could be the bridge's resistance.
    pub fn correction(&self) -> Option<Correction> {
        (self.is_significant() && self.is_sound() && !self.may_be_the_bridge())
            .then(|| self.alike())
    }

    /// What would make the channels alike if all of it came from the sensors.
    pub fn alike(&self) -> Correction {
        let none = Correction::default();
        match self.response {
            Response::Right => none,
            Response::Skew { skew_s } => Correction { skew_s, ..none },
            Response::SlowCurrent { tau_s } => Correction {
                i_tau_s: tau_s,
                ..none
            },
            Response::SlowVoltage { tau_s } => Correction {
                v_tau_s: tau_s,
                ..none
            },
            Response::Droop {
                corner_hz,
                skew_s,
                tau_s,
            } => Correction {
                skew_s,
                i_tau_s: tau_s,
                i_droop_hz: corner_hz,
                ..none
            },
        }
    }
}
