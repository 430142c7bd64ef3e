//! A worker's answer to one window (docs/fleet.md): R(t) and L(t) as stated. Frequency, current, power, sensors and
//! verdict are not part of it: the device's daemon computes them from the window itself.

use std::time::{Duration, Instant};

use ihd_gate::claim::{ClaimedResult, Confirmation};
use ihd_link::Window;
use ihd_model::{FitRemark, FitStep};
use ihd_signal::Segment;
use ihd_store::StoredCurve;
use ihd_survey::calibration::blind::Correction;
use ihd_train::NetworkConfig;
use ihd_train::learning::analyse_window;

use super::fit::{FitSummary, FitTrace, weighted_mean};

/// A worker's answer to one window.
#[derive(Clone, Debug, PartialEq)]
pub struct WorkerAnswer {
    /// The worker's name.
    pub by: String,
    /// Skew in seconds that was taken out of the window's current.
    pub skew_s: Option<f64>,
    /// R(t) and L(t), or the reason for which there are none.
    pub load: Result<StatedLoad, String>,
    /// Duration of the computation.
    pub busy: Duration,
}

/// R(t) and L(t) as stated by a worker, thinned. The lists are equally long; those of the deviations may be empty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StatedLoad {
    /// Seconds after the mains zero crossing.
    pub t_s: Vec<f64>,
    /// R in ohm.
    pub r_ohm: Vec<f64>,
    /// L in henry.
    pub l_h: Vec<f64>,
    /// Standard deviation of R in ohm.
    pub r_sigma_ohm: Vec<f64>,
    /// Standard deviation of L in henry.
    pub l_sigma_h: Vec<f64>,
    /// Number of optimiser steps.
    pub iterations: u32,
    /// Selected steps of the optimiser.
    pub steps: Vec<FitStep>,
    /// Remarks on window and result.
    pub remarks: Vec<FitRemark>,
}

impl WorkerAnswer {
    /// Identifies a window. The answer depends only on the window, the skew in seconds to remove from its current, and the network, so that
    /// it is the same on every machine.
    pub fn compute(
        by: String,
        window: &Window,
        skew_s: Option<f64>,
        network: NetworkConfig,
    ) -> Self {
        let began = Instant::now();
        let correction = skew_s.map(|skew_s| Correction {
            skew_s,
            ..Correction::default()
        });
        let analysis = analyse_window(window, correction.as_ref(), network);
        let load = match (analysis.identified, analysis.refused) {
            (Some(identified), None) => {
                let trace = FitTrace::new(Some(&identified), &analysis.findings, None);
                let summary = FitSummary::from_identified(&identified);
                let curve = trace.curve.unwrap_or_default();
                Ok(StatedLoad {
                    t_s: curve.t_s,
                    r_ohm: curve.r_ohm,
                    l_h: curve.l_h,
                    r_sigma_ohm: curve.r_sigma_ohm,
                    l_sigma_h: curve.l_sigma_h,
                    iterations: summary.iterations,
                    steps: trace.steps,
                    remarks: trace.remarks,
                })
            }
            (_, why) => Err(why.unwrap_or_default()),
        };
        Self {
            by,
            skew_s,
            load,
            busy: began.elapsed(),
        }
    }
}

impl StatedLoad {
    /// Returns the claim that is checked against the samples.
    pub fn claim(&self) -> ClaimedResult<'_> {
        ClaimedResult {
            t_s: &self.t_s,
            r_ohm: &self.r_ohm,
            l_h: &self.l_h,
        }
    }

    /// Returns the summary: values as stated, current from the samples, deviations no smaller than the noise allows.
    pub fn summary(&self, confirmed: &Confirmation) -> FitSummary {
        let i_a = &confirmed.i_amplitude_a;
        let sigma_pct = |sigma: &[f64], value: &[f64], least: f64| {
            let relative: Vec<f64> = sigma
                .iter()
                .zip(value)
                .map(|(s, x)| 100.0 * s / x)
                .collect();
            match relative.len() == value.len() {
                true => weighted_mean(i_a, &relative).max(least),
                false => least,
            }
        };
        let [least_r_pct, least_l_pct] = confirmed.sigma_pct;
        FitSummary {
            i_crest_a: i_a.iter().copied().fold(0.0, f64::max),
            r_ohm: weighted_mean(i_a, &self.r_ohm),
            l_h: weighted_mean(i_a, &self.l_h),
            sigma_r_pct: sigma_pct(&self.r_sigma_ohm, &self.r_ohm, least_r_pct),
            sigma_l_pct: sigma_pct(&self.l_sigma_h, &self.l_h, least_l_pct),
            iterations: self.iterations,
        }
    }

    /// Returns the trace with R(t) and L(t) as stated and the current from the samples.
    pub fn into_trace(self, confirmed: Confirmation) -> FitTrace {
        FitTrace {
            steps: self.steps,
            remarks: self.remarks,
            curve: Some(StoredCurve {
                t_s: self.t_s,
                r_ohm: self.r_ohm,
                l_h: self.l_h,
                i_a: confirmed.i_amplitude_a,
                r_sigma_ohm: self.r_sigma_ohm,
                l_sigma_h: self.l_sigma_h,
            }),
            ..FitTrace::default()
        }
    }
}

/// Returns the mean power of a window's half-cycle in watt, from its samples.
pub fn power_w(segment: &Segment) -> Option<f64> {
    let products = segment
        .v_v
        .iter()
        .zip(segment.i_a.iter())
        .map(|(v, i)| v * i);
    let mean = products.sum::<f64>() / segment.len() as f64;
    mean.is_finite().then_some(mean)
}
