//! The simulated hob: loads with known truth, the power stage, the sensing chain.

pub mod field;
