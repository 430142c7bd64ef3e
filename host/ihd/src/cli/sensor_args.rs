//! Treatment of a capture's sensors.

use clap::{Args, ValueEnum};
use ihd_survey::calibration::blind::{BlindOptions, CalibrationMode};

use super::input_options::InputOptions;

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
}

impl SensorArgs {
    /// Converts the arguments for the survey.
    pub fn options(&self, input: &InputOptions) -> BlindOptions {
        BlindOptions {
            mode: match self.self_calibrate {
                ModeWord::Auto => CalibrationMode::Auto,
                ModeWord::Report => CalibrationMode::Report,
                ModeWord::Off => CalibrationMode::Off,
            },
            capacitance_f: input.capacitance_f(),
        }
    }
}
