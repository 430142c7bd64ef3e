//! Load library of the simulated hob: each pot is prepared when it is first put on the coil.

use ihd_shared::hob::WINDING_R_OHM;

use super::behavioural::PotKind;
use super::inverter::InverterError;
use super::inverter::load::{AmplitudeLaw, LoadState};
use super::pot::{PotBase, SimulatedPot};
use super::recording::prepared::PreparedLoad;
use super::recording::settings::LoadKind;

/// Pots of one load model, prepared for the coil.
#[derive(Clone, Debug)]
pub(super) struct LoadLibrary {
    kind: LoadKind,
    ready: Vec<(SimulatedPot, PreparedLoad)>,
}

impl LoadLibrary {
    /// Creates an empty library for a load model.
    pub(super) fn new(kind: LoadKind) -> Self {
        Self {
            kind,
            ready: Vec::new(),
        }
    }

    /// The load model.
    pub(super) fn kind(&self) -> LoadKind {
        self.kind
    }

    /// Prepares a pot unless that is done: some 10 ms for the field, 200 ms for the table, four times that off centre.
    ///
    /// If there is no model of that pot.
    pub(super) fn prepare(&mut self, pot: &SimulatedPot) -> Result<&PreparedLoad, InverterError> {
        let known = self.ready.iter().position(|(ready, _)| ready == pot);
        let at = match known {
            Some(at) => at,
            None => {
                // The formulas accept any number.
                pot.field_settings(WINDING_R_OHM)?;
                let prepared = PreparedLoad::new(self.kind, pot, WINDING_R_OHM)?;
                self.ready.push((*pot, prepared));
                self.ready.len() - 1
            }
        };
        Ok(&self.ready[at].1)
    }

    /// Returns a pot's load at a switching frequency, with `steps` integration steps a period, to replace `before`.
    pub(super) fn take(
        &mut self,
        pot: &SimulatedPot,
        f_sw_hz: f64,
        steps: usize,
        before: Option<&LoadState>,
    ) -> Result<LoadState, InverterError> {
        self.prepare(pot)?.start(f_sw_hz, steps, before)
    }

    /// Law of a pot at a frequency in hertz; `None` if it is not prepared or has no law.
    pub(super) fn law(&self, pot: &SimulatedPot, f_hz: f64) -> Option<AmplitudeLaw> {
        let (_, prepared) = self.ready.iter().find(|(ready, _)| ready == pot)?;
        prepared.law(f_hz)
    }

    /// Winding resistance in ohm included in the loads' R; 0 for the formulas.
    pub(super) fn winding_r_ohm(&self) -> f64 {
        match self.kind {
            LoadKind::Behavioural => 0.0,
            LoadKind::Field | LoadKind::Surrogate => WINDING_R_OHM,
        }
    }
}

/// Converts the formulas' loads to pots.
impl From<PotKind> for SimulatedPot {
    fn from(kind: PotKind) -> Self {
        match kind {
            PotKind::Ferromagnetic => Self::new(PotBase::Ferritic, 0.21),
            PotKind::Small => Self::new(PotBase::Ferritic, 0.12),
            PotKind::Aluminium => Self::new(PotBase::Aluminium, 0.21),
            PotKind::Stainless => Self::new(PotBase::Stainless, 0.21),
            PotKind::None => Self::NONE,
        }
    }
}
