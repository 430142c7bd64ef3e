//! Pots prepared for a load model.

use super::settings::LoadKind;
use crate::behavioural;
use crate::behavioural::PotKind;
use crate::inverter::InverterError;
use crate::inverter::load::{AmplitudeLaw, LoadState};
use crate::pot::{PotBase, SimulatedPot};
use crate::surrogate::SurrogatePot;
use ihd_field::FieldModel;
use ihd_field::geometry::Geometry;
use ihd_field::model::FieldSettings;

/// Pot prepared for one kind of load model, at any frequency.
#[derive(Clone, Debug)]
pub enum PreparedLoad {
    /// Field models with their weights.
    Field(Vec<(f64, FieldModel)>),
    /// Table.
    Surrogate(Box<SurrogatePot>),
    /// Formulas.
    Behavioural(PotKind),
}

impl PreparedLoad {
    /// Prepares a pot: some 10 ms for the field, 200 ms for the table.
    pub fn new(
        kind: LoadKind,
        pot: &SimulatedPot,
        winding_r_ohm: f64,
    ) -> Result<Self, InverterError> {
        if kind == LoadKind::Behavioural {
            return Ok(Self::Behavioural(behavioural_kind(pot)));
        }
        let models = field_models(pot, winding_r_ohm)?;
        Ok(if kind == LoadKind::Field && pot.base.is_some() {
            Self::Field(models)
        } else {
            Self::Surrogate(Box::new(SurrogatePot::new(&models)?))
        })
    }

    /// Returns the load at rest for a switching frequency, or continuing from `before`.
    pub fn start(
        &self,
        f_sw_hz: f64,
        steps: usize,
        before: Option<&LoadState>,
    ) -> Result<LoadState, InverterError> {
        let law = match self {
            Self::Field(models) => return LoadState::field(models, 1.0 / (f_sw_hz * steps as f64)),
            Self::Surrogate(pot) => surrogate_law(pot, f_sw_hz),
            Self::Behavioural(kind) => behavioural_law(*kind, f_sw_hz),
        };
        Ok(match before {
            Some(state) => state.with_law(law, steps),
            None => LoadState::law(law, steps),
        })
    }

    /// The law at a switching frequency in hertz; `None` for the field model.
    pub fn law(&self, f_sw_hz: f64) -> Option<AmplitudeLaw> {
        match self {
            Self::Field(_) => None,
            Self::Surrogate(pot) => Some(surrogate_law(pot, f_sw_hz)),
            Self::Behavioural(kind) => Some(behavioural_law(*kind, f_sw_hz)),
        }
    }
}

fn surrogate_law(pot: &SurrogatePot, f_sw_hz: f64) -> AmplitudeLaw {
    AmplitudeLaw::Surrogate(Box::new(pot.at(f_sw_hz)))
}

fn behavioural_law(kind: PotKind, f_sw_hz: f64) -> AmplitudeLaw {
    AmplitudeLaw::Behavioural(behavioural::BehaviouralLoad::new(kind, f_sw_hz))
}

/// Field models of a pot with their weights; without a pot the coil's.
pub fn field_models(
    pot: &SimulatedPot,
    winding_r_ohm: f64,
) -> Result<Vec<(f64, FieldModel)>, InverterError> {
    let mut models = Vec::new();
    if pot.base.is_none() {
        let settings = FieldSettings {
            geometry: Geometry::of_board(),
            winding_r_ohm,
            ..FieldSettings::paper()
        };
        models.push((1.0, FieldModel::bare_coil(&settings)?));
    }
    for (weight, settings) in pot.field_settings(winding_r_ohm)? {
        models.push((weight, FieldModel::new(&settings)?));
    }
    Ok(models)
}

/// Table of a pot, or of the coil alone.
pub fn surrogate_pot(
    pot: &SimulatedPot,
    winding_r_ohm: f64,
) -> Result<SurrogatePot, InverterError> {
    Ok(SurrogatePot::new(&field_models(pot, winding_r_ohm)?)?)
}

/// Load of the formulas for a pot: there are five; sizes go to the nearer of the two ferromagnetic ones.
fn behavioural_kind(pot: &SimulatedPot) -> PotKind {
    match pot.base {
        None | Some(PotBase::Spoon) => PotKind::None,
        Some(PotBase::Stainless | PotBase::Lid | PotBase::Ring) => PotKind::Stainless,
        Some(PotBase::Aluminium | PotBase::Foil) => PotKind::Aluminium,
        Some(PotBase::Ferritic | PotBase::CastIron | PotBase::Clad) if pot.diameter_m < 0.15 => {
            PotKind::Small
        }
        Some(PotBase::Ferritic | PotBase::CastIron | PotBase::Clad) => PotKind::Ferromagnetic,
    }
}
