//! Studies: many captures with truth, many estimators, one table.

pub mod estimators;
pub mod trial;
