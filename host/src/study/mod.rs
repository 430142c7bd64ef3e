//! Studies: many captures with truth, many estimators, one table.

pub mod trial;
