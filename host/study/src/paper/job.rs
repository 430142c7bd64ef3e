//! Job of a cell.

use ihd_identify::Method;
use ihd_pinn::Backend;
use ihd_sim::recording::settings::LoadKind;
use serde::{Deserialize, Serialize};

use crate::load_name::load_name;

/// Contender.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Contender {
    /// A preset of the PINN, by its name.
    Pinn(String),
    /// Another estimator.
    Other(Method),
}

impl Contender {
    /// Name in tables and files.
    pub fn name(&self) -> &str {
        match self {
            Self::Pinn(preset) => preset,
            Self::Other(method) => method.name(),
        }
    }
}

/// Job of one cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PaperJob {
    /// Load model of the capture and the truth.
    pub load: LoadKind,
    /// Switching frequency in hertz.
    pub f_sw_hz: f64,
    /// Signal-to-noise ratio in decibel.
    pub snr_db: Option<f64>,
    /// Contender.
    pub contender: Contender,
    /// Seed of the noise and of the network.
    pub seed: u64,
    /// Limit of epochs of presets with a VI-MLP; `None` for the preset's own number.
    pub epochs: Option<usize>,
    /// Backend of presets with a VI-MLP; `None` for the preset's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub backend: Option<Backend>,
}

impl PaperJob {
    /// Name of the cell's file, without the ending.
    pub fn file_stem(&self) -> String {
        let load = load_name(self.load);
        let snr = self.snr_db.map_or("clean".into(), |db| format!("{db}dB"));
        let epochs = self.epochs.map_or(String::new(), |n| format!("-{n}epochs"));
        let backend = self.backend.map_or(String::new(), |b| format!("-{b}"));
        let (khz, name) = (self.f_sw_hz * 1e-3, self.contender.name());
        format!(
            "{load}-{khz}kHz-{snr}-{name}-seed{}{epochs}{backend}",
            self.seed
        )
    }
}
