//! Estimate: resistance and inductance of the loaded coil from its phasors, and the resonant tank that they form.
//!
//! | module | input | output | pace |
//! |---|---|---|---|
//! | [`ekf`] | phasors of coil voltage and current | R, L | once a block |
//! | [`tank`] | R, L and a switching frequency | reactances, impedance, phase, distance from resonance | where it is needed |

pub mod ekf;
pub mod tank;
