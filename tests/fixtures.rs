//! Fixtures: recorded half-cycles with known truth, and the f64 oracles that tests compare with.

pub mod circuit_oracle;
pub mod desk_hob;
pub mod faulty_link;
pub mod half_cycle;
pub mod oracle;
pub mod regression_captures;
pub mod simulated_hob;
