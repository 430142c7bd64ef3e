//! Comparison of standard deviations with least squares on the same segment, for estimators that know only noise or their own
//! tuning. A difference from least squares beyond the deviations of both is an error of one of them.

use std::borrow::Cow;

use ihd_signal::noise::WhiteNoise;
use ihd_signal::{Remark, Segment, Severity};

use super::trajectory::TrajectoryCursor;
use super::{Estimate, IdentifyOptions, least_squares};

/// Points on either side over which squared differences are averaged.
const NEIGHBOUR_POINTS: usize = 10;

/// Largest mean squared difference by chance, relative to the stated variances.
const MAX_CHANCE_RATIO: f64 = 1.5;

/// Relative differences of R and L from which they are a warning: the errors that must be reported.
const LIMITS: [f64; 2] = [1e-2, 7e-3];

/// Raises σ of `estimate` by its contradiction to least squares, which uses the fundamental alone and the whole half-cycle.
/// Leaves it unchanged if least squares fails, or the estimate states no σ. `known`: the result of least squares if it is known;
/// `of_whole`: the noise for a segment that is too short to show its own.
pub(crate) fn raise_sigmas(
    estimate: &mut Estimate,
    segment: &Segment,
    known: Option<&Estimate>,
    of_whole: &dyn Fn() -> WhiteNoise,
    settings: &IdentifyOptions,
) {
    if estimate.r_sigma_ohm.len() != estimate.t_s.len() {
        return;
    }
    let computed = || {
        let centred = segment.without_offsets();
        let noise = WhiteNoise::measure(&centred).or_else(of_whole);
        least_squares::identify(&centred, noise, &settings.least_squares).map(Cow::Owned)
    };
    let Ok(reference) = known.map_or_else(computed, |known| Ok(Cow::Borrowed(known))) else {
        return;
    };
    let Some(mut trajectory) = TrajectoryCursor::from(&reference, f64::NEG_INFINITY) else {
        return;
    };
    let (mut r, mut l) = (Vec::new(), Vec::new());
    for t_s in &estimate.t_s {
        let (value, admitted) = (
            trajectory.r_l(*t_s),
            trajectory.sigma(*t_s).unwrap_or_default(),
        );
        r.push((value.0, admitted.0));
        l.push((value.1, admitted.1));
    }
    let r_off = raise(&mut estimate.r_sigma_ohm, &estimate.r_ohm, &r);
    let l_off = raise(&mut estimate.l_sigma_h, &estimate.l_h, &l);
    if r_off > LIMITS[0] || l_off > LIMITS[1] {
        let text = format!(
            "{} and least squares contradict each other: R by {:.1} %, L by {:.1} % (median)",
            estimate.method,
            100.0 * r_off,
            100.0 * l_off
        );
        let larger = (r_off / LIMITS[0]).max(l_off / LIMITS[1]);
        let remark = Remark::new("contradicts_least_squares", Severity::Warning, text);
        estimate.remarks.push(remark.with(larger, Some(1.0)));
    }
}

/// Raises `sigma` of `values` where they differ from the reference (value, σ) by more than chance; returns the median of
/// the relative differences.
fn raise(sigma: &mut [f64], values: &[f64], reference: &[(f64, f64)]) -> f64 {
    let beyond: Vec<[f64; 2]> = (0..values.len())
        .map(|k| {
            let (right, admitted) = reference[k];
            let variance = sigma[k] * sigma[k] + admitted * admitted;
            [(values[k] - right).powi(2), MAX_CHANCE_RATIO * variance]
        })
        .collect();
    for (k, sigma) in sigma.iter_mut().enumerate() {
        let near = &beyond
            [k.saturating_sub(NEIGHBOUR_POINTS)..(k + NEIGHBOUR_POINTS + 1).min(beyond.len())];
        let mean = |x: usize| near.iter().map(|b| b[x]).sum::<f64>() / near.len() as f64;
        let admitted = reference[k].1;
        let raised = *sigma * *sigma + admitted * admitted + (mean(0) - mean(1)).max(0.0);
        // Values that are not finite are left to the estimator's own check.
        if raised.is_finite() {
            *sigma = raised.sqrt();
        }
    }
    let relative = values
        .iter()
        .zip(reference)
        .map(|(x, (right, _))| (x / right - 1.0).abs());
    ihd_signal::noise::median(&mut relative.collect::<Vec<_>>()).unwrap_or(0.0)
}
