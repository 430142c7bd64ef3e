//! A window of samples as a scope shows it.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Which window, and how much of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WindowWanted {
    /// Boot and number of the window; the newest with samples where none.
    pub which: Option<(u32, u32)>,
    /// Where the view begins, in seconds after the window's first pair.
    pub from_s: f64,
    /// Where the view ends; infinite for the whole.
    pub to_s: f64,
    /// Most columns.
    pub columns: usize,
}

/// A window that the store has.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct WindowSummary {
    /// Boot of the device.
    pub boot: u32,
    /// Its number since that boot.
    pub seq: u32,
    /// When it was stored, in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Switching frequency in hertz.
    pub f_sw_hz: u32,
    /// Half-cycle since the boot.
    pub half_cycle: u32,
    /// Whether its samples were kept.
    pub samples: bool,
}

/// R and L over a half-cycle. All lists that are not empty are equally long.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Trajectory {
    /// Seconds after the window's first pair.
    pub t_s: Vec<f64>,
    /// R in ohm.
    pub r_ohm: Vec<f64>,
    /// L in henry.
    pub l_h: Vec<f64>,
    /// Standard deviation of R in ohm; empty where nobody tells.
    pub r_sigma_ohm: Vec<f64>,
    /// Standard deviation of L in henry; empty where nobody tells.
    pub l_sigma_h: Vec<f64>,
}

/// What a scope would measure between the two ends of a view, over whole switching periods.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Measured {
    /// Switching periods that were measured over; 0 where the view holds none, and then nothing else is known.
    pub periods: u32,
    /// Rms of the coil's voltage, in volt.
    pub v_rms_v: Option<f64>,
    /// Rms of the current, in ampere.
    pub i_rms_a: Option<f64>,
    /// Largest magnitude of the voltage, in volt.
    pub v_peak_v: Option<f64>,
    /// Largest magnitude of the current, in ampere.
    pub i_peak_a: Option<f64>,
    /// Mean power, in watt.
    pub power_w: Option<f64>,
    /// Power over rms voltage times rms current.
    pub power_factor: Option<f64>,
    /// Phase of the coil voltage's fundamental before that of the current, in degree.
    pub phase_deg: Option<f64>,
    /// Total harmonic distortion of the voltage up to half the sampling rate, in percent of the fundamental.
    pub thd_v_pct: Option<f64>,
    /// The same of the current.
    pub thd_i_pct: Option<f64>,
}

/// A window, decimated to the columns of a display.
///
/// Where the view holds no more pairs than columns, each pair is a column and `min` equals `max`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Scope {
    /// Boot of the device.
    pub boot: u32,
    /// Number of the window since that boot.
    pub seq: u32,
    /// When it was stored, in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Half-cycle since the boot.
    pub half_cycle: u32,
    /// Switching frequency in hertz.
    pub f_sw_hz: u32,
    /// Sampling rate in hertz.
    pub sample_rate_hz: f64,
    /// Length of the window in seconds.
    pub duration_s: f64,
    /// Pairs of the window.
    pub pairs: u32,
    /// Of which at the end of the range.
    pub saturated: u32,
    /// Where the view begins, in seconds after the first pair.
    pub from_s: f64,
    /// Where it ends.
    pub to_s: f64,
    /// Whether columns hold more than one pair.
    pub decimated: bool,
    /// Middle of each column, in seconds after the first pair.
    pub t_s: Vec<f64>,
    /// Least voltage of each column, in volt.
    pub v_min_v: Vec<f64>,
    /// Largest voltage of each column, in volt.
    pub v_max_v: Vec<f64>,
    /// Least current of each column, in ampere.
    pub i_min_a: Vec<f64>,
    /// Largest current of each column, in ampere.
    pub i_max_a: Vec<f64>,
    /// What a scope would measure in the view.
    pub measured: Measured,
    /// The device's own Kalman filter.
    pub ekf: Trajectory,
    /// The network's R(t) and L(t); none before it has looked at the window, or where they were not kept.
    pub network: Option<Trajectory>,
    /// Whether the gate let the network's result pass; none before it has looked at it.
    pub pass: Option<bool>,
    /// Why not; empty where it did.
    pub why: String,
    /// The truth, where the device is simulated in the daemon itself.
    pub truth: Option<Trajectory>,
    /// Means of the network's R weighted with the squared current, in ohm, and of its truth.
    pub r_mean_ohm: Option<f64>,
    /// The same of L, in henry.
    pub l_mean_h: Option<f64>,
    /// The same mean of the truth's R, in ohm.
    pub r_true_mean_ohm: Option<f64>,
    /// The same mean of the truth's L, in henry.
    pub l_true_mean_h: Option<f64>,
}
