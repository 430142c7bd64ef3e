//! Load as seen by the circuit: a law for R and L, or the field model.

use super::InverterError;
use super::envelope::FourierEnvelope;
use crate::behavioural;
use crate::pot::{PotBase, SimulatedPot};
use crate::surrogate::SurrogateLoad;
use ihd_field::{FieldLoad, FieldModel};

/// Number of rings of the time-domain field model.
pub const RINGS: usize = ihd_field::model::RINGS;

/// Number of steps for which a law's R and L are held: 1.5 µs at 91 ns, in which the envelope of the mains moves by 5e-4 of its crest at most.
pub(super) const LAW_STEPS: u32 = 16;

/// Change of the flux linkage over one step, `change0_wb` + `l_h` · i(new), and the resistance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FluxStep {
    /// Part of the change that does not depend on the new current, in weber.
    pub change0_wb: f64,
    /// Part of the change proportional to the new current, in henry.
    pub l_h: f64,
    /// Series resistance in ohm.
    pub r_ohm: f64,
}

/// R and L as functions of the current's amplitude, at one switching frequency.
#[derive(Clone, Debug)]
pub enum AmplitudeLaw {
    /// Closed formulas.
    Behavioural(behavioural::BehaviouralLoad),
    /// A table fitted to the field model.
    Surrogate(Box<SurrogateLoad>),
}

impl AmplitudeLaw {
    /// R in ohm, L in henry at an amplitude in ampere.
    pub fn r_l(&self, i_a: f64) -> (f64, f64) {
        match self {
            Self::Behavioural(load) => load.r_l(i_a),
            Self::Surrogate(load) => load.r_l(i_a),
        }
    }
}

/// Effect of heat on R and L of a law: a hot load is the cold one at a lower frequency, with R and X of the load larger by the
/// ratio of both ([`PotBase::heat_factor`]). The winding has a temperature of its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Warmth {
    factor: f64,
    winding_r_ohm: f64,
    /// Rise of the winding's resistance by its own heat, in ohm.
    winding_rise_ohm: f64,
}

impl Default for Warmth {
    fn default() -> Self {
        Self {
            factor: 1.0,
            winding_r_ohm: 0.0,
            winding_rise_ohm: 0.0,
        }
    }
}

impl Warmth {
    /// Creates one with a heat factor, for a law that includes `winding_r_ohm`.
    pub fn new(factor: f64, winding_r_ohm: f64) -> Self {
        Self {
            factor,
            winding_r_ohm,
            winding_rise_ohm: 0.0,
        }
    }

    /// Creates one for a law of a metal at the first of two temperatures in °C, heated to the second.
    pub fn from_temperatures(
        base: PotBase,
        (law_c, hot_c): (f64, f64),
        winding_r_ohm: f64,
    ) -> Self {
        let factor = base.heat_factor(hot_c) / base.heat_factor(law_c);
        Self::new(factor, winding_r_ohm)
    }

    /// Frequency in hertz at which the cold law is evaluated, for a switching frequency in hertz.
    pub fn law_hz(&self, f_sw_hz: f64) -> f64 {
        f_sw_hz / self.factor
    }

    /// R in ohm and L in henry of the hot load from those of the cold one.
    pub fn bend(&self, (r_ohm, l_h): (f64, f64)) -> (f64, f64) {
        let of_load_ohm = r_ohm - self.winding_r_ohm;
        let of_winding_ohm = self.winding_r_ohm + self.winding_rise_ohm;
        (of_winding_ohm + self.factor * of_load_ohm, l_h)
    }
}

/// Law in operation, evaluated every `LAW_STEPS` steps.
#[derive(Clone, Debug)]
pub struct FollowedLaw {
    law: AmplitudeLaw,
    /// Envelope that it follows.
    envelope: FourierEnvelope,
    /// R in ohm and L in henry at the last evaluation.
    held: (f64, f64),
    /// Number of steps until the next evaluation.
    hold: u32,
    /// Effect of the load's temperature on the law.
    warmth: Warmth,
    /// Factors of R and L on the law's.
    factors: (f64, f64),
}

impl FollowedLaw {
    fn new(law: AmplitudeLaw, envelope: FourierEnvelope) -> Self {
        Self {
            law,
            envelope,
            held: (0.0, 0.0),
            hold: 0,
            warmth: Warmth::default(),
            factors: (1.0, 1.0),
        }
    }

    /// R in ohm and L in henry over the next `steps` steps, at most [`LAW_STEPS`].
    fn hold(&mut self, steps: u32) -> (f64, f64) {
        if self.hold < steps {
            let at_a = self.envelope.amplitude_a();
            (self.held, self.hold) = (self.warmth.bend(self.law.r_l(at_a)), LAW_STEPS);
        }
        self.hold -= steps.min(self.hold);
        (self.factors.0 * self.held.0, self.factors.1 * self.held.1)
    }
}

/// Load in operation.
#[derive(Clone, Debug)]
pub enum LoadState {
    /// v = R i + L di/dt with R and L from a law of the envelope.
    Law(FollowedLaw),
    /// Field model; several for a pot off centre.
    Field {
        /// Weight and state of each sector.
        sectors: Vec<(f64, FieldLoad<RINGS>)>,
        /// Resistance of winding and shield in ohm, the winding cold.
        series_r_ohm: f64,
        /// Rise of the winding's resistance by its heat, in ohm.
        winding_rise_ohm: f64,
        /// Present flux linkage, in weber; `None` before the first step.
        lambda_wb: Option<f64>,
    },
}

impl LoadState {
    /// Creates a law at rest; `steps` integration steps a period.
    pub fn law(law: AmplitudeLaw, steps: usize) -> Self {
        Self::following(law, FourierEnvelope::new(steps))
    }

    fn following(law: AmplitudeLaw, envelope: FourierEnvelope) -> Self {
        Self::Law(FollowedLaw::new(law, envelope))
    }

    /// Creates unmagnetised field models with their weights; the winding is the first one's. A current that already flows
    /// continues: the pot is put on within one step.
    pub fn field(models: &[(f64, FieldModel)], dt_s: f64) -> Result<Self, InverterError> {
        let mut sectors = Vec::with_capacity(models.len());
        for (weight, model) in models {
            sectors.push((*weight, FieldLoad::new(model, dt_s)?));
        }
        let winding_r_ohm = models.first().map_or(0.0, |(_, m)| m.winding_r_ohm);
        let shield_r_ohm = sectors.iter().map(|(w, s)| w * s.shield_r_ohm());
        let series_r_ohm = winding_r_ohm + shield_r_ohm.sum::<f64>();
        Ok(Self::Field {
            sectors,
            series_r_ohm,
            winding_rise_ohm: 0.0,
            lambda_wb: None,
        })
    }

    /// Returns another law with the same envelope and factors, in a period of `steps` steps.
    pub fn with_law(&self, law: AmplitudeLaw, steps: usize) -> Self {
        match self {
            Self::Law(before) => {
                let mut new = Self::following(law, before.envelope.resized(steps));
                new.scale(before.factors.0, before.factors.1);
                new
            }
            Self::Field { .. } => Self::law(law, steps),
        }
    }

    /// Replaces a law by that of another frequency, in a period of as many steps; no effect on the field.
    pub fn set_law(&mut self, new: AmplitudeLaw) {
        if let Self::Law(followed) = self {
            (followed.law, followed.hold) = (new, 0);
        }
    }

    /// Sets the factors of R and L on the law's; no effect on the field model.
    pub fn scale(&mut self, r_factor: f64, l_factor: f64) {
        if let Self::Law(followed) = self {
            (followed.factors, followed.hold) = ((r_factor, l_factor), 0);
        }
    }

    /// Heats a law: from now on it is `new`, that of [`Warmth::law_hz`], bent; no effect on the field.
    pub fn set_hot_law(&mut self, new: AmplitudeLaw, by: Warmth) {
        if let Self::Law(followed) = self {
            followed.warmth = by;
            self.set_law(new);
        }
    }

    /// Sets the field's temperature in °C; no effect on a law, which uses [`LoadState::set_hot_law`].
    ///
    /// # Errors
    /// For a temperature that no metal has.
    pub fn set_temperature(
        &mut self,
        pot: &SimulatedPot,
        temperature_c: f64,
    ) -> Result<(), InverterError> {
        let Some(metals) = pot.metals_at(temperature_c) else {
            return Ok(());
        };
        if let Self::Field { sectors, .. } = self {
            for (_, load) in sectors {
                load.set_metals(&metals)?;
            }
        }
        Ok(())
    }

    /// Sets the rise of the winding's resistance by its heat, in ohm.
    pub fn set_winding_rise(&mut self, ohm: f64) {
        match self {
            Self::Law(followed) => (followed.warmth.winding_rise_ohm, followed.hold) = (ohm, 0),
            Self::Field {
                winding_rise_ohm, ..
            } => *winding_rise_ohm = ohm,
        }
    }

    /// Returns `true` for the field model.
    pub fn is_field(&self) -> bool {
        matches!(self, Self::Field { .. })
    }

    /// Returns `true` if no current has flowed for a period; `false` for the field model.
    pub fn is_at_rest(&self) -> bool {
        matches!(self, Self::Law(followed) if followed.envelope.is_empty())
    }

    /// R in ohm, L in henry and the amplitude in ampere that give them; `None` for the field model,
    /// which has no such numbers.
    pub fn law_point(&self) -> Option<(f64, f64, f64)> {
        let Self::Law(followed) = self else {
            return None;
        };
        let i_a = followed.envelope.amplitude_a();
        let (r_ohm, l_h) = self.law_at(i_a)?;
        Some((r_ohm, l_h, i_a))
    }

    /// R in ohm and L in henry that a law gives at an amplitude in ampere, as warm as it is; `None` for the
    /// field model.
    pub fn law_at(&self, i_a: f64) -> Option<(f64, f64)> {
        let Self::Law(followed) = self else {
            return None;
        };
        let (r_ohm, l_h) = followed.warmth.bend(followed.law.r_l(i_a));
        Some((followed.factors.0 * r_ohm, followed.factors.1 * l_h))
    }

    /// Changes the time step of the field model and keeps its state; returns `false` for a law, which depends on the frequency
    /// instead.
    pub fn set_dt(&mut self, dt_s: f64) -> Result<bool, InverterError> {
        let Self::Field { sectors, .. } = self else {
            return Ok(false);
        };
        for (_, load) in sectors {
            load.set_dt(dt_s)?;
        }
        Ok(true)
    }

    /// Inputs of the circuit for the next step, with `i_a` the present current.
    pub fn predict(&mut self, i_a: f64) -> FluxStep {
        match self {
            Self::Law(followed) => {
                let (r_ohm, l_h) = followed.hold(1);
                FluxStep {
                    change0_wb: -l_h * i_a,
                    l_h,
                    r_ohm,
                }
            }
            Self::Field {
                sectors,
                series_r_ohm,
                winding_rise_ohm,
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
                    r_ohm: *series_r_ohm + *winding_rise_ohm,
                }
            }
        }
    }

    /// R in ohm and L in henry of a law over the next `steps` steps, at most [`LAW_STEPS`]; `None` for the field model.
    pub(super) fn hold(&mut self, steps: usize) -> Option<(f64, f64)> {
        match self {
            Self::Law(followed) => Some(followed.hold(steps as u32)),
            Self::Field { .. } => None,
        }
    }

    /// Envelope of a law, which the caller moves meanwhile; `None` for the field model.
    pub(super) fn envelope(&mut self) -> Option<&mut FourierEnvelope> {
        match self {
            Self::Law(followed) => Some(&mut followed.envelope),
            Self::Field { .. } => None,
        }
    }

    /// Completes the step whose prediction was `step`, with the new current at boundary `n` of the period.
    pub fn commit(&mut self, step: &FluxStep, n: usize, i_a: f64) {
        match self {
            Self::Law(followed) => followed.envelope.push(n, i_a),
            Self::Field {
                sectors, lambda_wb, ..
            } => {
                *lambda_wb = lambda_wb.map(|now| now + step.change0_wb + step.l_h * i_a);
                sectors.iter_mut().for_each(|(_, load)| load.commit(i_a));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surrogate::SurrogatePot;
    use ihd_field::harmonic;

    #[test]
    fn the_bent_law_follows_the_hot_field_model() {
        for base in PotBase::ALL {
            let model = |temperature_c| {
                let pot = SimulatedPot {
                    temperature_c,
                    ..SimulatedPot::new(base, 0.21)
                };
                let mut settings = pot.field_settings(0.1).unwrap().remove(0).1;
                // The shield stays cold.
                settings.geometry.shield_thickness_m = 0.0;
                FieldModel::new(&settings).unwrap()
            };
            let pot = SurrogatePot::new(&[(1.0, model(20.0))]).unwrap();
            for hot_c in [60.0, 150.0, 350.0] {
                let warmth = Warmth::new(base.heat_factor(hot_c), 0.1);
                for (f_hz, i_a) in [(36e3, 1.0), (45e3, 30.0), (70e3, 60.0)] {
                    if warmth.law_hz(f_hz) < 20e3 {
                        // Aluminium beyond 250 °C: the table ends at 19 kHz.
                        continue;
                    }
                    let hot = harmonic::impedance(&model(hot_c), f_hz, i_a).unwrap();
                    let (r, l) = warmth.bend(pot.at(warmth.law_hz(f_hz)).r_l(i_a));
                    let (r, l) = (r / hot.r_ohm - 1.0, l / hot.l_h - 1.0);
                    println!("{base:?} {hot_c} °C {f_hz} Hz {i_a} A: {r:.1e} {l:.1e}");
                    // A linear metal's grid is made for its skin depth.
                    let allowed = match base {
                        PotBase::Ferritic | PotBase::CastIron | PotBase::Spoon => 2e-4,
                        PotBase::Stainless
                        | PotBase::Aluminium
                        | PotBase::Clad
                        | PotBase::Foil
                        | PotBase::Lid
                        | PotBase::Ring => 1e-2,
                    };
                    assert!(
                        r.abs() < allowed && l.abs() < allowed,
                        "{base:?} {hot_c} {i_a} A"
                    );
                }
            }
        }
    }
}
