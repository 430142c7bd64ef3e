//! NMSE of reconstructed waveforms, as defined in the paper's section V and Table 3, and without its filter.

use super::{Point, lowpass};

/// Σ(x̂ − x)²/Σx² of voltage and current in percent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Nmse {
    /// Against the waveforms without noise.
    pub clean: (f64, f64),
    /// NMSE against these after the paper's low-pass.
    pub filtered: (f64, f64),
    /// NMSE with the reconstruction after the low-pass, too.
    pub both: (f64, f64),
}

impl Nmse {
    /// NMSE of reconstructed samples in volt and ampere, which belong to `samples` of the point's capture, evenly spaced; `None` if
    /// these are not, or fewer than two.
    pub fn compute(
        v_volt: &[f64],
        i_ampere: &[f64],
        samples: &[usize],
        point: &Point,
    ) -> Option<Self> {
        let clean = &point.trial.clean;
        let stride = samples.get(1)?.checked_sub(*samples.first()?)?;
        if samples.windows(2).any(|w| w[0] + stride != w[1]) {
            return None;
        }
        let dt_s = stride as f64 * clean.dt_s;
        let at = |x: &[f64]| -> Vec<f64> { samples.iter().map(|k| x[*k]).collect() };
        let (v, i) = (at(&point.filtered.0), at(&point.filtered.1));
        let smooth = |x: &[f64]| lowpass::zero_phase(x, dt_s);
        Some(Self {
            clean: (pct(v_volt, &at(&clean.v_v)), pct(i_ampere, &at(&clean.i_a))),
            filtered: (pct(v_volt, &v), pct(i_ampere, &i)),
            both: (pct(&smooth(v_volt), &v), pct(&smooth(i_ampere), &i)),
        })
    }
}

/// NMSE of the waveforms without noise against themselves after the low-pass, over a range of samples.
pub(super) fn unfiltered_itself(point: &Point, (from, to): (usize, usize)) -> (f64, f64) {
    let clean = &point.trial.clean;
    let (v, i) = &point.filtered;
    (
        pct(&clean.v_v[from..to], &v[from..to]),
        pct(&clean.i_a[from..to], &i[from..to]),
    )
}

fn pct(hat: &[f64], right: &[f64]) -> f64 {
    let error: f64 = hat.iter().zip(right).map(|(a, b)| (a - b).powi(2)).sum();
    100.0 * error / right.iter().map(|x| x * x).sum::<f64>()
}
