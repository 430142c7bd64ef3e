//! Results of a scenario, with the names of the JSON.

use serde::{Deserialize, Serialize};

/// One half-cycle of the true mains.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TrueHalfCycle {
    /// Its start, in seconds.
    pub t_s: f64,
    /// Power requested by the host at its end, in watt.
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
    /// Class of the pot determined by the firmware.
    pub pot: String,
    /// Reason for which the hob has switched itself off, at its end.
    pub off_reason: String,
    /// Limit that holds the firmware's power below the request, at its end.
    pub limit: String,
    /// Temperature of the pot's base in °C, at its end; null if it does not warm up.
    pub base_c: Option<f64>,
    /// Temperature of the pot's contents in °C, at its end; null without any.
    pub contents_c: Option<f64>,
    /// `true` if the firmware shows the glass as hot, at its end.
    pub glass_hot: bool,
    /// The firmware's estimate at the crest, in ohm.
    pub r_ohm: f64,
    /// The firmware's estimate at the crest, in microhenry.
    pub l_uh: f64,
    /// Largest coil current, in ampere.
    pub i_peak_a: f64,
    /// Largest coil voltage, in volt.
    pub v_coil_peak_v: f64,
    /// Smallest commutating current at turn-off, in ampere; null without an edge.
    pub i_turn_off_min_a: Option<f64>,
    /// Number of switches that closed onto more than 30 V.
    pub hard_edges: u32,
    /// `true` if the bridge was switching at any time.
    pub bridge_on: bool,
}

/// Fault of the device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FaultRecord {
    /// Time at which it became active, in seconds.
    pub t_s: f64,
    /// Name.
    pub name: String,
    /// Time from the injection that caused it, or else from the fault, until both switches were open, in seconds; null if they
    /// never were.
    pub off_after_s: Option<f64>,
}

/// Result of one power step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PowerStep {
    /// Time of the request, in seconds.
    pub at_s: f64,
    /// Power requested, in watt.
    pub power_w: f64,
    /// Settling time; see [`Summary::settled_after_s`].
    pub settled_after_s: Option<f64>,
    /// Overshoot in percent of the requested power; null for a step down.
    pub overshoot_pct: Option<f64>,
    /// Deviation of the mean power of its last 0.2 s, in percent of the requested power; null for 0 W.
    pub error_pct: Option<f64>,
}

/// Recovery after a mains or pot event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Recovery {
    /// End of the event, in seconds.
    pub at_s: f64,
    /// Time until the power stays within 5 % of the requested one; null if never.
    pub after_s: Option<f64>,
}

/// Figures of a scenario.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// For each power step, the time until the power stays within 5 % (5 W below 100 W) of the requested one, until the next event;
    /// null if never.
    pub settled_after_s: Vec<Option<f64>>,
    /// Largest of all steps upwards, in percent.
    pub overshoot_pct: f64,
    /// Largest of all steps, in percent.
    pub error_pct: f64,
    /// `true` if power is still requested at the end and the device is in its safe state.
    pub latched: bool,
    /// Energy into the load, in joule.
    pub energy_j: f64,
    /// The power steps.
    pub steps: Vec<PowerStep>,
    /// Recoveries after mains and pot events.
    pub recoveries: Vec<Recovery>,
    /// Number of times that the watchdog has reset the controller.
    pub watchdog_bites: u32,
}

/// Record of a scenario.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Half-cycles in order of time.
    pub half_cycles: Vec<TrueHalfCycle>,
    /// Faults in order of time.
    pub faults: Vec<FaultRecord>,
    /// Figures.
    pub summary: Summary,
}
