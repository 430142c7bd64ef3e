//! A training run: from a connected device, or a capture, to a report.

mod device;
mod error;
mod follow;
mod point;
mod progress;
mod run;
mod source;
mod store;

pub use self::device::{SETTLE_WITHIN, SETTLED_AFTER, TruthSource, WINDOWS_EVERY};
pub use self::error::{Failed, TrainerError};
pub use self::point::Point;
pub use self::progress::Progress;
pub use self::run::{Report, Settings, run};
pub use self::source::{OperatingPoint, Recorded, Source};
pub use ihd_pinn::Config as NetworkConfig;
