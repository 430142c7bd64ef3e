//! Studies: many captures with truth, many estimators, one table.

pub mod estimators;
#[cfg(feature = "pinn")]
pub mod paper;
