//! A training run: all that needs the network.

mod device;
mod error;
mod gate;
mod network;
mod observations;
mod point;
mod progress;
mod run;
mod source;
mod store;

pub use self::device::TruthSource;
pub use self::error::TrainerError;
pub use self::gate::{GateVerdict, judge};
pub use self::point::Point;
pub use self::progress::Progress;
pub use self::run::{Report, Settings, run};
pub use self::source::{OperatingPoint, Recorded, Source};
pub use ihd_pinn::Config as NetworkConfig;
