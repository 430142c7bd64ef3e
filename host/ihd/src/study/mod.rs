//! Studies: many captures with truth, many estimators, one table.

pub mod document;
pub mod estimators;
pub mod hostile;
#[cfg(feature = "pinn")]
pub mod map;
#[cfg(feature = "pinn")]
pub mod paper;
pub mod parallel;
#[cfg(feature = "pinn")]
pub mod pots;
pub mod temperature;
