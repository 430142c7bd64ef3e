//! Inputs of the network for a carrier whose frequency moves.

/// Inputs of the network for a moving carrier, on the segment's clock.
#[derive(Clone, Debug, PartialEq)]
pub struct CarrierInputs {
    /// Time of the first value in seconds.
    pub t0_s: f64,
    /// Time from one value to the next in seconds.
    pub dt_s: f64,
    /// Difference of the frequency from its mean, and its rate of change, each within about -1..=1.
    pub functions: Vec<Vec<f64>>,
    /// Spline intervals of the phasors in a mains half-cycle.
    pub intervals: usize,
}
