//! What a scenario leaves behind: the names of the JSON.

use serde::{Deserialize, Serialize};

/// One half-cycle of the true mains.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HalfCycle {
    /// Its start, in seconds.
    pub t_s: f64,
    /// Power asked for by the host at its end, in watt.
    pub asked_w: f64,
    /// Power into the load over it, by the true wattmeter, in watt.
    pub power_w: f64,
    /// Power of the firmware's last summary, in watt.
    pub measured_w: f64,
    /// Switching frequency at its end in hertz, 0 with the bridge off.
    pub f_sw_hz: f64,
    /// The firmware's state at its end.
    pub state: String,
    /// The firmware's fault at its end, `None` without.
    pub fault: String,
    /// What the firmware takes the pot for.
    pub pot: String,
    /// The firmware's estimate at the crest, in ohm.
    pub r_ohm: f64,
    /// The firmware's estimate at the crest, in microhenry.
    pub l_uh: f64,
    /// Largest coil current, in ampere.
    pub i_peak_a: f64,
    /// Largest coil voltage, in volt.
    pub v_coil_peak_v: f64,
    /// Smallest current at turn-off in the direction that commutates, in ampere; null without an edge.
    pub i_turn_off_min_a: Option<f64>,
    /// Switches that closed onto more than 30 V.
    pub hard_edges: u32,
    /// Whether the bridge was switching at any time.
    pub bridge_on: bool,
}

/// A fault of the device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FaultRecord {
    /// When it became active, in seconds.
    pub t_s: f64,
    /// Its name.
    pub name: String,
    /// From the injection that is behind it, or else from the fault, until both switches were open, in
    /// seconds; null if they never were.
    pub off_after_s: Option<f64>,
}

/// What came of one power step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// When it was asked for, in seconds.
    pub at_s: f64,
    /// What was asked for, in watt.
    pub power_w: f64,
    /// As in [`Summary::settled_after_s`].
    pub settled_after_s: Option<f64>,
    /// How far the power went beyond what was asked for, in percent of it; null for a step down.
    pub overshoot_pct: Option<f64>,
    /// Deviation of the mean power of its last 0.2 s, in percent of what was asked for; null for 0 W.
    pub error_pct: Option<f64>,
}

/// A mains or pot event that is over, and what it took to get back.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Recovery {
    /// When it was over, in seconds.
    pub at_s: f64,
    /// Time until the power stays within 5 % of what is asked for; null if never.
    pub after_s: Option<f64>,
}

/// The scenario in numbers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// One per power step: time until the power stays within 5 % (5 W below 100 W) of what was asked for, until
    /// the next event; null if never.
    pub settled_after_s: Vec<Option<f64>>,
    /// Largest of all steps upwards, in percent.
    pub overshoot_pct: f64,
    /// Largest of all steps, in percent.
    pub error_pct: f64,
    /// Whether power is still asked for at the end, and the device is in its safe state.
    pub latched: bool,
    /// Energy into the load, in joule.
    pub energy_j: f64,
    /// The power steps.
    pub steps: Vec<Step>,
    /// Mains and pot events.
    pub recoveries: Vec<Recovery>,
    /// How often the watchdog would have reset the controller.
    pub watchdog_bites: u32,
}

/// Everything.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Half-cycles in order of time.
    pub half_cycles: Vec<HalfCycle>,
    /// Faults in order of time.
    pub faults: Vec<FaultRecord>,
    /// The numbers.
    pub summary: Summary,
}
