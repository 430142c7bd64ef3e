//! The load library of the simulated hob: every pot, ready to be put on its coil.

use super::behavioural::PotKind;
use super::inverter::InverterError;
use super::inverter::load::LoadState;
use super::pot::{Metal, Pot};
use super::recording::prepared::PreparedLoad;
use super::recording::settings::LoadKind;

/// Resistance of the winding in ohm, beside a load from the field model.
const WINDING_R_OHM: f64 = 0.1;

/// Every pot, ready to be put on the coil.
#[derive(Clone, Debug)]
pub(super) struct LoadLibrary(Vec<(PotKind, PreparedLoad)>);

impl LoadLibrary {
    /// Prepares every pot for a load model.
    pub(super) fn new(kind: LoadKind) -> Result<Self, InverterError> {
        let prepare = |pot: PotKind| {
            let prepared = match kind {
                LoadKind::Behavioural => PreparedLoad::Behavioural(pot),
                _ => PreparedLoad::new(kind, &described(pot), WINDING_R_OHM)?,
            };
            Ok((pot, prepared))
        };
        let all: Result<_, InverterError> = PotKind::ALL.into_iter().map(prepare).collect();
        Ok(Self(all?))
    }

    /// A pot at a switching frequency, with `steps` integration steps a period, in place of `before`.
    pub(super) fn take(
        &self,
        pot: PotKind,
        f_sw_hz: f64,
        steps: usize,
        before: Option<&LoadState>,
    ) -> Result<LoadState, InverterError> {
        // `new` prepared every kind.
        let found = self.0.iter().find(|(kind, _)| *kind == pot);
        let (_, prepared) = found.unwrap_or(&self.0[0]);
        prepared.start(f_sw_hz, steps, before)
    }

    /// Winding resistance in ohm within the loads' R; the formulas know none.
    pub(super) fn winding_r_ohm(&self) -> f64 {
        match self.0.first() {
            Some((_, PreparedLoad::Behavioural(_))) => 0.0,
            _ => WINDING_R_OHM,
        }
    }
}

/// The pots of the behavioural model as field models.
pub(super) fn described(pot: PotKind) -> Pot {
    match pot {
        PotKind::Ferromagnetic => Pot::new(Metal::Ferritic, 0.21),
        PotKind::Small => Pot::new(Metal::Ferritic, 0.12),
        PotKind::Aluminium => Pot::new(Metal::Aluminium, 0.21),
        PotKind::Stainless => Pot::new(Metal::Stainless, 0.21),
        PotKind::None => Pot::NONE,
    }
}
