//! Treatment of a capture's sensors.

use clap::{Args, ValueEnum};
use ihd_survey::calibration::blind::{BlindOptions, CalibrationMode};

use super::simulate::quantity::quantity;

/// Treatment of the sensors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum ModeWord {
    /// Correct skew, bandwidth and droop where the capture shows them
    #[default]
    Auto,
    /// Report them and correct nothing
    Report,
    /// Skip the analysis
    Off,
}

/// Sensors, judged by the capture itself, without a reference.
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
    /// Converts the arguments for the survey.
    ///
    /// # Errors
    /// [`Usage`](super::usage::Usage) for an invalid capacitance.
    pub fn options(&self) -> anyhow::Result<BlindOptions> {
        if let Some(c_f) = self.resonance_capacitance {
            ensure_usage!(
                c_f.is_finite() && c_f > 0.0,
                "--resonance-capacitance is {c_f}, but a capacitance is positive, as in 1080n"
            );
        }
        Ok(BlindOptions {
            mode: match self.self_calibrate {
                ModeWord::Auto => CalibrationMode::Auto,
                ModeWord::Report => CalibrationMode::Report,
                ModeWord::Off => CalibrationMode::Off,
            },
            capacitance_f: self.resonance_capacitance,
        })
    }
}
