//! Readings of ideal instruments on the power stage: a wattmeter, crest meters, and edge statistics.

/// Readings of one half-cycle of the true mains; without mains the half-cycles continue at the last frequency.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MeterReading {
    /// Its start since the simulation's, in seconds.
    pub t_s: f64,
    /// Its duration in seconds.
    pub duration_s: f64,
    /// Energy into the load, the winding included, in joule: ∫ v i dt over the integration steps.
    pub energy_j: f64,
    /// Largest coil current, in ampere.
    pub i_peak_a: f64,
    /// Mean of the coil current's magnitude, in ampere.
    pub i_mean_a: f64,
    /// Mean of its square, in ampere squared.
    pub i_square_a2: f64,
    /// Largest coil voltage, in volt.
    pub v_coil_peak_v: f64,
    /// Number of switches that closed onto more than [`crate::inverter::node::HARD_EDGE_V`].
    pub hard_edges: u32,
    /// Smallest current when a switch opened, in ampere, negative in the wrong direction; `None` without
    /// an edge.
    pub i_turn_off_min_a: Option<f64>,
    /// Time for which the bridge was switching, in seconds.
    pub switching_s: f64,
}

/// Share of a half-cycle up to which switching is ignored: a bridge that ends with the zero crossing detected by the firmware does
/// so up to a block later, 88 µs at 34 kHz.
const ON_FROM_SHARE: f64 = 0.02;

impl MeterReading {
    /// Returns `true` if the bridge was switching for more than a block.
    pub fn bridge_on(&self) -> bool {
        self.switching_s > ON_FROM_SHARE * self.duration_s
    }

    /// Mean power in watt.
    pub fn power_w(&self) -> f64 {
        self.energy_j / self.duration_s
    }
}
