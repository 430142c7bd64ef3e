//! The load as the circuit sees it: a law for R and L, or the field model.

use super::InverterError;
use super::envelope::Envelope;
use crate::sim::behavioural;
use crate::sim::field::{FieldLoad, FieldModel};
use crate::sim::reduced::ReducedLoad;

/// Rings of the time-domain field model.
pub const RINGS: usize = crate::sim::field::model::RINGS;

/// Steps for which a law's R and L are held: 0.3 µs at 20 ns, in which the envelope of the mains
/// moves by 1e-4 at most.
const LAW_STEPS: u32 = 16;

/// Flux linkage over one step: change = `change0_wb` + `l_h` · i(new), and the resistance beside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FluxStep {
    /// Part of the change that does not depend on the new current, in weber.
    pub change0_wb: f64,
    /// Part that does, in henry.
    pub l_h: f64,
    /// Series resistance in ohm.
    pub r_ohm: f64,
}

/// R and L as functions of the current's amplitude, at one switching frequency.
#[derive(Clone, Debug)]
pub enum Law {
    /// Closed formulas.
    Behavioural(behavioural::Load),
    /// A table fitted to the field model.
    Reduced(ReducedLoad),
}

impl Law {
    /// R in ohm, L in henry at an amplitude in ampere.
    pub fn r_l(&self, i_a: f64) -> (f64, f64) {
        match self {
            Self::Behavioural(load) => load.r_l(i_a),
            Self::Reduced(load) => load.r_l(i_a),
        }
    }
}

/// A load in operation.
#[derive(Clone, Debug)]
pub enum LoadState {
    /// v = R i + L di/dt with R and L from a law of the envelope.
    Law {
        /// The law.
        law: Law,
        /// The envelope it follows.
        envelope: Envelope,
        /// R in ohm and L in henry, as last asked for.
        held: (f64, f64),
        /// Steps until the law is asked again.
        hold: u32,
    },
    /// The field model; several for a pot off centre.
    Field {
        /// Weight and state of each sector.
        sectors: Vec<(f64, FieldLoad<RINGS>)>,
        /// Winding resistance in ohm.
        winding_r_ohm: f64,
        /// Flux linkage now, in weber; `None` before the first step.
        lambda_wb: Option<f64>,
    },
}

impl LoadState {
    /// A law at rest; `steps` integration steps a period.
    pub fn law(law: Law, steps: usize) -> Self {
        Self::following(law, Envelope::new(steps))
    }

    fn following(law: Law, envelope: Envelope) -> Self {
        Self::Law {
            law,
            envelope,
            held: (0.0, 0.0),
            hold: 0,
        }
    }

    /// Unmagnetised field models with their weights; the winding is the first one's. A current that
    /// already flows goes on flowing: the pot is put on within one step.
    pub fn field(models: &[(f64, FieldModel)], dt_s: f64) -> Result<Self, InverterError> {
        let mut sectors = Vec::with_capacity(models.len());
        for (weight, model) in models {
            sectors.push((*weight, FieldLoad::new(model, dt_s)?));
        }
        let winding_r_ohm = models.first().map_or(0.0, |(_, m)| m.winding_r_ohm);
        Ok(Self::Field {
            sectors,
            winding_r_ohm,
            lambda_wb: None,
        })
    }

    /// Another law under the same envelope, in a period of `steps` steps.
    pub fn with_law(&self, law: Law, steps: usize) -> Self {
        match self {
            Self::Law { envelope, .. } => Self::following(law, envelope.resized(steps)),
            Self::Field { .. } => Self::law(law, steps),
        }
    }

    /// Whether this is the field model.
    pub fn is_field(&self) -> bool {
        matches!(self, Self::Field { .. })
    }

    /// R in ohm, L in henry and the amplitude in ampere that give them; `None` for the field model,
    /// which has no such numbers.
    pub fn law_point(&self) -> Option<(f64, f64, f64)> {
        let Self::Law { law, envelope, .. } = self else {
            return None;
        };
        let i_a = envelope.amplitude_a();
        let (r_ohm, l_h) = law.r_l(i_a);
        Some((r_ohm, l_h, i_a))
    }

    /// Changes the time step of the field model and keeps its state; `false` for a law, which has
    /// none but knows its frequency.
    pub fn set_dt(&mut self, dt_s: f64) -> Result<bool, InverterError> {
        let Self::Field { sectors, .. } = self else {
            return Ok(false);
        };
        for (_, load) in sectors {
            load.set_dt(dt_s)?;
        }
        Ok(true)
    }

    /// Before a step: what the circuit needs, with `i_a` the current now.
    pub fn predict(&mut self, i_a: f64) -> FluxStep {
        match self {
            Self::Law {
                law,
                envelope,
                held,
                hold,
            } => {
                if *hold == 0 {
                    (*held, *hold) = (law.r_l(envelope.amplitude_a()), LAW_STEPS);
                }
                *hold -= 1;
                let (r_ohm, l_h) = *held;
                FluxStep {
                    change0_wb: -l_h * i_a,
                    l_h,
                    r_ohm,
                }
            }
            Self::Field {
                sectors,
                winding_r_ohm,
                lambda_wb,
            } => {
                let (mut lambda0, mut l_h) = (0.0, 0.0);
                for (weight, load) in sectors {
                    let line = load.predict();
                    lambda0 += *weight * line.lambda0_wb;
                    l_h += *weight * line.l_h;
                }
                let now = *lambda_wb.get_or_insert(lambda0 + l_h * i_a);
                FluxStep {
                    change0_wb: lambda0 - now,
                    l_h,
                    r_ohm: *winding_r_ohm,
                }
            }
        }
    }

    /// After the step whose prediction was `step`: the new current at boundary `n` of the period.
    pub fn commit(&mut self, step: &FluxStep, n: usize, i_a: f64) {
        match self {
            Self::Law { envelope, .. } => envelope.push(n, i_a),
            Self::Field {
                sectors, lambda_wb, ..
            } => {
                *lambda_wb = lambda_wb.map(|now| now + step.change0_wb + step.l_h * i_a);
                sectors.iter_mut().for_each(|(_, load)| load.commit(i_a));
            }
        }
    }
}
