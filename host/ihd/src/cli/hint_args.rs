//! Switching and mains frequency of a capture as given by the user.

use clap::Args;
use ihd_survey::Hints;

use super::simulate::quantity::quantity;

/// Overrides what the capture states or shows.
#[derive(Clone, Debug, Args)]
pub struct HintArgs {
    /// Switching frequency in Hz, instead of the capture's
    #[arg(long, value_parser = quantity)]
    fsw: Option<f64>,
    /// Mains frequency in Hz, instead of the capture's
    #[arg(long, value_parser = quantity)]
    mains: Option<f64>,
    /// Time of a mains zero crossing in s, instead of the capture's
    #[arg(long, value_name = "S", value_parser = quantity, allow_negative_numbers = true)]
    zero_crossing: Option<f64>,
}

impl HintArgs {
    /// Converts the arguments for the survey.
    pub fn hints(&self) -> Hints {
        Hints {
            f_sw_hz: self.fsw,
            mains_hz: self.mains,
            zero_crossing_s: self.zero_crossing,
            ..Hints::default()
        }
    }
}
