//! Training: fits of windows by the network, step by step.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Step of the optimiser.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FitStep {
    /// Number of the step, from 1.
    pub step: u32,
    /// Loss after the step.
    pub loss: f64,
    /// Mean relative change of R and L (the larger of both) over the last few steps, 0.01 being 1 %; `None` for the first few.
    pub change: Option<f64>,
}

/// Remark on a window or its result; codes in docs/identification.md.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct FitRemark {
    /// Code of the remark.
    pub code: String,
    /// `info`, `warning` or `error`.
    pub severity: String,
    /// Description.
    pub text: String,
}

/// Fit of a window: accepted, or refused by the gate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Fit {
    /// Boot of the device.
    pub boot: u32,
    /// Number of the window since that boot.
    pub seq: u32,
    /// Time at which the result was stored, in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Switching frequency in hertz.
    pub f_sw_hz: u32,
    /// Mean of R weighted with the squared current, in ohm.
    pub r_ohm: Option<f64>,
    /// Mean of L weighted with the squared current, in henry.
    pub l_h: Option<f64>,
    /// Standard deviation of R in percent.
    pub sigma_r_pct: Option<f64>,
    /// Standard deviation of L in percent.
    pub sigma_l_pct: Option<f64>,
    /// `true` if it passed the gate.
    pub pass: bool,
    /// Reason of the refusal; empty if it passed.
    pub why: String,
    /// Remarks on it; empty for fits from before the daemon's start.
    pub remarks: Vec<FitRemark>,
    /// `true` if it changed the lookup.
    pub changed_lookup: bool,
    /// Number of optimiser steps.
    pub iterations: u32,
    /// Duration in seconds; `None` for fits from before the daemon's start.
    pub seconds: Option<f64>,
    /// Selected steps; empty for fits from before the daemon's start.
    pub steps: Vec<FitStep>,
    /// Relative error of R in percent of the truth; `None` unless the device is simulated in the daemon.
    pub r_error_pct: Option<f64>,
    /// Relative error of L in percent of the truth; `None` unless the device is simulated in the daemon.
    pub l_error_pct: Option<f64>,
}
