//! Studies: many captures with truth, many estimators, one table.

pub mod estimators;
pub mod hostile;
#[cfg(feature = "pinn")]
pub mod paper;
pub mod parallel;
