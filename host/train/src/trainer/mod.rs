//! A training run: from a connected device, or a capture, to a report.

#[cfg(test)]
mod deviations;
mod device;
mod error;
mod follow;
mod point;
mod progress;
mod run;
mod source;
mod steadiness;
mod store;

pub use self::device::{TruthSource, WINDOWS_EVERY};
pub use self::error::{RunFailure, TrainerError};
pub use self::point::PointReport;
pub use self::progress::RunProgress;
pub use self::run::{RunOptions, RunReport, run};
pub use self::source::{OperatingPoint, RecordedHalfCycle, TrainingSource};
pub use self::steadiness::{SETTLE_WITHIN, Steadiness};
pub use ihd_pinn::PinnConfig as NetworkConfig;
