//! A worker's answer to one window (docs/fleet.md): R(t) and L(t) as it states them. Frequency, current, power, sensors and
//! verdict are no part of it: the device's daemon takes them from the window itself.

use std::time::{Duration, Instant};

use ihd_gate::claim::{Claim, Confirmed};
use ihd_link::Window;
use ihd_signal::Segment;
use ihd_store::Curve;
use ihd_survey::calibration::blind::Correction;
use ihd_train::NetworkConfig;
use ihd_train::learning::identify_alone;

use super::outcome::{Course, Numbers, weighted_mean};
use crate::model::{FitRemark, FitStep};

/// A worker's answer to one window.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// The worker's name.
    pub by: String,
    /// Skew in seconds that was taken out of the window's current.
    pub skew_s: Option<f64>,
    /// R(t) and L(t), or why there are none.
    pub found: Result<Stated, String>,
    /// Time that it took.
    pub busy: Duration,
}

/// R(t) and L(t) as stated, thinned. The lists are equally long; those of the deviations may be empty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stated {
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
    /// Steps of the optimiser.
    pub iterations: u32,
    /// Some of these steps.
    pub steps: Vec<FitStep>,
    /// Remarks on window and result.
    pub remarks: Vec<FitRemark>,
}

impl Answer {
    /// Identifies a window from nothing but it and the skew in seconds that is to be taken out of its current: the same on
    /// every machine.
    pub fn find(by: String, window: &Window, skew_s: Option<f64>, network: NetworkConfig) -> Self {
        let began = Instant::now();
        let correction = skew_s.map(|skew_s| Correction {
            skew_s,
            ..Correction::default()
        });
        let alone = identify_alone(window, correction.as_ref(), network);
        let found = match (alone.identified, alone.refused) {
            (Some(identified), None) => {
                let course = Course::of(Some(&identified), &alone.findings, None);
                let numbers = Numbers::of(&identified);
                let curve = course.curve.unwrap_or_default();
                Ok(Stated {
                    t_s: curve.t_s,
                    r_ohm: curve.r_ohm,
                    l_h: curve.l_h,
                    r_sigma_ohm: curve.r_sigma_ohm,
                    l_sigma_h: curve.l_sigma_h,
                    iterations: numbers.iterations,
                    steps: course.steps,
                    remarks: course.remarks,
                })
            }
            (_, why) => Err(why.unwrap_or_default()),
        };
        Self {
            by,
            skew_s,
            found,
            busy: began.elapsed(),
        }
    }
}

impl Stated {
    /// The statement that is held against the samples.
    pub fn claim(&self) -> Claim<'_> {
        Claim {
            t_s: &self.t_s,
            r_ohm: &self.r_ohm,
            l_h: &self.l_h,
        }
    }

    /// The window's numbers: values as stated, currents of the samples, deviations no smaller than noise allows.
    pub fn numbers(&self, confirmed: &Confirmed) -> Numbers {
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
        Numbers {
            i_crest_a: i_a.iter().copied().fold(0.0, f64::max),
            r_ohm: weighted_mean(i_a, &self.r_ohm),
            l_h: weighted_mean(i_a, &self.l_h),
            sigma_r_pct: sigma_pct(&self.r_sigma_ohm, &self.r_ohm, least_r_pct),
            sigma_l_pct: sigma_pct(&self.l_sigma_h, &self.l_h, least_l_pct),
            iterations: self.iterations,
        }
    }

    /// R(t) and L(t) for the store, with the current of the samples.
    pub fn into_course(self, confirmed: Confirmed) -> Course {
        Course {
            steps: self.steps,
            remarks: self.remarks,
            curve: Some(Curve {
                t_s: self.t_s,
                r_ohm: self.r_ohm,
                l_h: self.l_h,
                i_a: confirmed.i_amplitude_a,
                r_sigma_ohm: self.r_sigma_ohm,
                l_sigma_h: self.l_sigma_h,
            }),
            ..Course::default()
        }
    }
}

/// Mean power of a window's half-cycle in watt, from its samples.
pub fn power_w(segment: &Segment) -> Option<f64> {
    let products = segment
        .v_v
        .iter()
        .zip(segment.i_a.iter())
        .map(|(v, i)| v * i);
    let mean = products.sum::<f64>() / segment.len() as f64;
    mean.is_finite().then_some(mean)
}
