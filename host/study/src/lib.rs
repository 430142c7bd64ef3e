//! Studies: many captures with truth, many estimators, one table each. `ihd-study` runs them; docs/ holds their tables.

pub mod cli;
pub mod document;
pub mod estimators;
pub mod hostile;
mod load_name;
pub mod map;
pub mod paper;
pub mod parallel;
pub mod pots;
pub mod temperature;
