//! What to do about the sensors of a capture.

use clap::{Args, ValueEnum};
use ihd_survey::calibration::blind::{Ask, Mode};

use super::simulate::quantity::quantity;

/// What to do about the sensors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum ModeWord {
    /// Correct skew, bandwidth and droop where the capture shows them
    #[default]
    Auto,
    /// Tell of them and correct nothing
    Report,
    /// Do not look
    Off,
}

/// Sensors: judged by the capture itself, without a reference.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Sensors")]
pub struct SensorArgs {
    /// Self-calibration by the plateaus between the bridge's edges
    #[arg(long, value_name = "HOW", value_enum, default_value = "auto")]
    self_calibrate: ModeWord,
    /// Value of the resonance capacitor in F (1080n): the gains are checked against it
    #[arg(long, value_name = "F", value_parser = quantity)]
    resonance_capacitance: Option<f64>,
}

impl SensorArgs {
    /// As the survey takes it.
    ///
    /// # Errors
    /// [`Usage`](super::usage::Usage): a capacitance that is none.
    pub fn ask(&self) -> anyhow::Result<Ask> {
        if let Some(c_f) = self.resonance_capacitance {
            ensure_usage!(
                c_f.is_finite() && c_f > 0.0,
                "--resonance-capacitance is {c_f}, but a capacitance is positive, as in 1080n"
            );
        }
        Ok(Ask {
            mode: match self.self_calibrate {
                ModeWord::Auto => Mode::Auto,
                ModeWord::Report => Mode::Report,
                ModeWord::Off => Mode::Off,
            },
            capacitance_f: self.resonance_capacitance,
        })
    }
}
