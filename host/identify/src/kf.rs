//! The paper's linear Kalman filter, eq. (10)-(14): R and L/T_s as random walks, observed through
//! v = R·i + (L/T_s)·T_s·di/dt with an external derivative.
//!
//! The derivative is a central difference over [`KfSettings::derivative_periods`] of a switching
//! period. A short one has the current's noise in the regressor, which makes L too small; a
//! long one smears the bridge's edges. The paper reports the same: poor results, above all for R.

use std::time::Instant;

use ihd_signal::correlation::mean_impedance;
use ihd_signal::noise::WhiteNoise;
use ihd_signal::{Remark, Segment, Severity};
use serde::{Deserialize, Serialize};

use super::ekf::waveforms::{EkfWaveforms, PeriodMeans, finite};
use super::{Estimate, IdentifyError, IdentifyOptions, Method};

/// Options of the linear filter.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KfSettings {
    /// Width of the central difference in switching periods, at least two samples.
    pub derivative_periods: f64,
    /// Time over which R and ωL may change by the magnitude of the mean impedance, in seconds.
    pub change_s: f64,
    /// Standard deviation of eq. (10)'s residual, as a share of the rms voltage.
    pub residual: f64,
}

impl Default for KfSettings {
    fn default() -> Self {
        Self {
            derivative_periods: 0.03,
            change_s: 10e-3,
            residual: 0.2,
        }
    }
}

/// θ = (R, ωL) and its covariance; the regressor is (i, di/dt / ω), so that both have one unit.
struct Filter {
    theta: [f64; 2],
    p: [f64; 3],
}

impl Filter {
    #[inline(always)]
    fn step(&mut self, z: [f64; 2], v: f64, q: f64, r: f64) {
        let p = &mut self.p;
        p[0] += q;
        p[2] += q;
        let u = [p[0] * z[0] + p[1] * z[1], p[1] * z[0] + p[2] * z[1]];
        let by_s = 1.0 / (u[0] * z[0] + u[1] * z[1] + r);
        let e = (v - self.theta[0] * z[0] - self.theta[1] * z[1]) * by_s;
        self.theta[0] += u[0] * e;
        self.theta[1] += u[1] * e;
        p[0] -= u[0] * u[0] * by_s;
        p[1] -= u[0] * u[1] * by_s;
        p[2] -= u[1] * u[1] * by_s;
    }
}

/// Attenuation of L from which a remark is made.
const MIN_ATTENUATION: f64 = 0.01;

/// Remark on the attenuation of L by noise of the current: if `share` of the regressor's mean square is noise, L is smaller
/// by as much (errors in variables).
fn attenuation(share: f64) -> Option<Remark> {
    if share.is_nan() || share <= MIN_ATTENUATION {
        return None;
    }
    let percent = 100.0 * share.min(1.0);
    let text = format!(
        "noise of the current makes its derivative, and so L too small: by {percent:.1} % from the noise measured; take \
         another method, or a longer derivative_periods"
    );
    let remark = Remark::new("noise_bias", Severity::Error, text);
    Some(remark.with(percent, Some(100.0 * MIN_ATTENUATION)))
}

/// Runs the linear filter over the segment.
///
/// # Errors
/// [`IdentifyError::Diverged`] if an estimate is not finite.
pub fn identify(segment: &Segment, settings: &IdentifyOptions) -> Result<Estimate, IdentifyError> {
    let started = Instant::now();
    let kf = &settings.kf;
    let omega = std::f64::consts::TAU * segment.f_sw_hz;
    let z = mean_impedance(segment);
    let (r0, x0) = settings.start.map_or((z.re, z.im), |(r, l)| (r, omega * l));
    let z2 = r0 * r0 + x0 * x0;
    let (n, per_period) = (segment.len(), segment.samples_per_period());
    let half = ((0.5 * kf.derivative_periods * per_period).round() as usize).max(1);
    // x per radian: di/dt / ω.
    let slope = 1.0 / (2.0 * half as f64 * segment.dt_s * omega);
    let v_rms = (segment.v_v.iter().map(|v| v * v).sum::<f64>() / n as f64).sqrt();
    let q = z2 * segment.dt_s / kf.change_s;
    let r = (kf.residual * v_rms) * (kf.residual * v_rms) * half as f64;
    let mut filter = Filter {
        theta: [r0, x0],
        p: [z2, 0.0, z2],
    };
    let mut means = PeriodMeans::new(segment, [1.0, 1.0 / omega]);
    let mut waves = EkfWaveforms::new(n, 1.0, 1.0);
    let mut changes = 0.0;
    for k in 0..n {
        let (before, after) = (k.saturating_sub(half), (k + half).min(n - 1));
        let span = (after - before) as f64 / (2.0 * half as f64);
        let change = (segment.i_a[after] - segment.i_a[before]) * slope / span;
        let z = [segment.i_a[k], change];
        changes += change * change;
        filter.step(z, segment.v_v[k], q, r);
        means.push(filter.theta[0], filter.theta[1], [filter.p[0], filter.p[2]]);
        waves.push(z[0], filter.theta[0] * z[0] + filter.theta[1] * z[1]);
    }
    let mut estimate = means.finish(Method::Kf);
    finite(&estimate, segment)?;
    waves.finish(&mut estimate);
    let noise = WhiteNoise::measure(segment).i_a * slope;
    estimate
        .remarks
        .extend(attenuation(2.0 * noise * noise * n as f64 / changes));
    // The linear filter uses the measured current, so that it reconstructs the voltage alone.
    estimate.i_hat_a = Vec::new();
    estimate.elapsed = started.elapsed();
    Ok(estimate)
}
