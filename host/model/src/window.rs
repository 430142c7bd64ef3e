//! Window of samples as a scope shows it.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Request for a window, or part of one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WindowQuery {
    /// Boot and number of the window; `None` for the newest with samples.
    pub which: Option<(u32, u32)>,
    /// Start of the view, in seconds after the window's first pair.
    pub from_s: f64,
    /// End of the view, in seconds after the window's first pair; infinite for the whole window.
    pub to_s: f64,
    /// Largest number of columns.
    pub columns: usize,
}

/// Window in the store.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct WindowSummary {
    /// Boot of the device.
    pub boot: u32,
    /// Number of the window since that boot.
    pub seq: u32,
    /// Time at which it was stored, in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Switching frequency in hertz.
    pub f_sw_hz: u32,
    /// Number of its half-cycle since the boot.
    pub half_cycle: u32,
    /// `true` if its samples are stored.
    pub samples: bool,
}

/// R and L over a half-cycle. All lists that are not empty have the same length.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Trajectory {
    /// Times in seconds after the window's first pair.
    pub t_s: Vec<f64>,
    /// R in ohm.
    pub r_ohm: Vec<f64>,
    /// L in henry.
    pub l_h: Vec<f64>,
    /// Standard deviation of R in ohm; empty if unknown.
    pub r_sigma_ohm: Vec<f64>,
    /// Standard deviation of L in henry; empty if unknown.
    pub l_sigma_h: Vec<f64>,
}

/// Measurements of a scope over the whole switching periods of a view.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = Measured)]
pub struct ScopeMeasurement {
    /// Number of switching periods evaluated; if 0, only the peaks can be known.
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
    /// Phase by which the coil voltage's fundamental leads that of the current, in degree.
    pub phase_deg: Option<f64>,
    /// Total harmonic distortion of the voltage up to half the sampling rate, in percent of the fundamental.
    pub thd_v_pct: Option<f64>,
    /// Total harmonic distortion of the current, in percent of the fundamental.
    pub thd_i_pct: Option<f64>,
}

/// Window, decimated to the columns of a display.
///
/// If the view holds no more pairs than columns, each pair is a column and `min` equals `max`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Scope {
    /// Boot of the device.
    pub boot: u32,
    /// Number of the window since that boot.
    pub seq: u32,
    /// Time at which it was stored, in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Number of its half-cycle since the boot.
    pub half_cycle: u32,
    /// Switching frequency in hertz.
    pub f_sw_hz: u32,
    /// Sampling rate in hertz.
    pub sample_rate_hz: f64,
    /// Length of the window in seconds.
    pub duration_s: f64,
    /// Number of pairs in the window.
    pub pairs: u32,
    /// Number of pairs at the end of the ADC's range.
    pub saturated: u32,
    /// Start of the view, in seconds after the first pair.
    pub from_s: f64,
    /// End of the view, in seconds after the first pair.
    pub to_s: f64,
    /// `true` if columns hold more than one pair.
    pub decimated: bool,
    /// Middle of each column, in seconds after the first pair.
    pub t_s: Vec<f64>,
    /// Smallest voltage of each column, in volt.
    pub v_min_v: Vec<f64>,
    /// Largest voltage of each column, in volt.
    pub v_max_v: Vec<f64>,
    /// Smallest current of each column, in ampere.
    pub i_min_a: Vec<f64>,
    /// Largest current of each column, in ampere.
    pub i_max_a: Vec<f64>,
    /// Measurements over the view.
    pub measured: ScopeMeasurement,
    /// Estimate of the device's Kalman filter.
    pub ekf: Trajectory,
    /// The network's R(t) and L(t); `None` before it has identified the window, or if they are not stored.
    pub network: Option<Trajectory>,
    /// `true` if the network's result passed the gate; `None` without a result.
    pub pass: Option<bool>,
    /// Reason of the refusal; empty if it passed.
    pub why: String,
    /// True R(t) and L(t); `None` unless the device is simulated in the daemon.
    pub truth: Option<Trajectory>,
    /// Mean of the network's R weighted with the squared current, in ohm.
    pub r_mean_ohm: Option<f64>,
    /// Mean of the network's L weighted with the squared current, in henry.
    pub l_mean_h: Option<f64>,
    /// Mean of the true R, weighted in the same way, in ohm.
    pub r_true_mean_ohm: Option<f64>,
    /// Mean of the true L, weighted in the same way, in henry.
    pub l_true_mean_h: Option<f64>,
}
