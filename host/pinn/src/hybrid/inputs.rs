//! Inputs of all passes.

use crate::PinnConfig;
use crate::impedance_law::HarmonicLaw;
use crate::vi_system::DataSystem;
use crate::waveform::NormalisedWaveform;

/// Inputs that all passes share.
pub(super) struct Inputs<'a> {
    pub(super) samples: &'a NormalisedWaveform,
    pub(super) config: &'a PinnConfig,
    pub(super) system: &'a DataSystem,
    /// Exponent n of the impedance law Z(s) = s L_0 + K s^n.
    pub(super) order: f64,
    /// Impedance law at each physics harmonic.
    pub(super) laws: Vec<HarmonicLaw>,
}
