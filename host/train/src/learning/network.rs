//! The network on one half-cycle of the device: a window to R(t) and L(t), and these to R and L over current.

use std::f64::consts::TAU;

use ihd_identify::network::{waveform, with_measured_noise};
use ihd_map::{CurrentCurve, MeasuredPoint, window_floor};
use ihd_pinn::{Identification, PinnConfig, PinnError, identify};
use ihd_shared::lookup::grid::I_MAX_MA;
use ihd_signal::Segment;
use ihd_signal::noise::WhiteNoise;

/// Trains the network on a window's segment and calls `on_step` after each step. Times of the result are seconds after the window's mains
/// zero crossing. Its deviations hold what noise does not explain ([`ihd_map::window_floor`]).
///
/// # Errors
/// [`PinnError`] if the window or the configuration cannot be used.
pub fn fit_window(
    segment: &Segment,
    config: PinnConfig,
    on_step: &mut dyn FnMut(&ihd_pinn::TrainingProgress),
) -> Result<Identification, PinnError> {
    let config = with_measured_noise(config, segment);
    let waveform = waveform(segment, (0, segment.len()), segment.zero_crossing_s);
    let mut identified = identify(&waveform, &config, on_step)?;
    raise_to_floor(&mut identified);
    Ok(identified)
}

/// Raises the deviations, which are those of noise, by what any window has beside it.
fn raise_to_floor(identified: &mut Identification) {
    let i_a = &identified.i_amplitude_a;
    let most_a = i_a.iter().copied().fold(0.0, f64::max);
    let floors: Vec<_> = i_a
        .iter()
        .map(|&i_a| window_floor(i_a.max(MIN_CURRENT_A), most_a))
        .collect();
    let raise = |sigma: &mut [f64], value: &[f64], q: usize| {
        for ((sigma, value), floor) in sigma.iter_mut().zip(value).zip(&floors) {
            *sigma = sigma.hypot(floor[q] * value);
        }
    };
    raise(&mut identified.r_sigma_ohm, &identified.r_ohm, 0);
    raise(&mut identified.l_sigma_h, &identified.l_h, 1);
}

/// Lowest current of the curve, in ampere: the network weighs samples with the squared current, so that values below follow from their
/// neighbours.
const MIN_CURRENT_A: f64 = 1.0;

/// Highest current of the curve, in ampere: twice the lookup's last knot, which no hob reaches. It bounds what a faulty device can report.
const MAX_CURRENT_A: f64 = 2e-3 * I_MAX_MA as f64;

/// Least noise that is assumed, relative to the largest current: the rest of 12-bit quantisation in a period's mean.
const MIN_NOISE: f64 = 1e-4;

/// R(t) and L(t) of a window with current and misfit: lists of equal length, evenly spaced in time.
#[derive(Clone, Copy, Debug)]
pub struct LoadTrajectory<'a> {
    /// Amplitude of the current's fundamental in ampere.
    pub i_amplitude_a: &'a [f64],
    /// R in ohm.
    pub r_ohm: &'a [f64],
    /// L in henry.
    pub l_h: &'a [f64],
    /// χ² of the residual against white noise; 1 is assumed beyond the list's end.
    pub chi2: &'a [f64],
}

impl<'a> From<&'a Identification> for LoadTrajectory<'a> {
    fn from(identified: &'a Identification) -> Self {
        Self {
            i_amplitude_a: &identified.i_amplitude_a,
            r_ohm: &identified.r_ohm,
            l_h: &identified.l_h,
            chi2: &identified.chi2,
        }
    }
}

/// Builds R and L over current for the map; `noise` is the segment's, `t_s` the window's time in seconds of the device.
///
/// The deviation at each time is that of the samples behind it, |Z| and the noise of both channels over the current, times the model's
/// misfit. Such deviations are independent from time to time, so that sums over times and windows are right. The network's own
/// deviations are common to the whole window and would be counted once for each time.
pub fn curve(
    segment: &Segment,
    noise: WhiteNoise,
    trajectory: &LoadTrajectory<'_>,
    t_s: f64,
) -> CurrentCurve {
    let per_time = segment.len() as f64 / trajectory.r_ohm.len().max(1) as f64;
    let omega = TAU * segment.f_sw_hz;
    let most_a = trajectory.i_amplitude_a.iter().copied().fold(0.0, f64::max);
    let point = |k: usize| {
        let (i_a, r_ohm, l_h) = (
            trajectory.i_amplitude_a[k],
            trajectory.r_ohm[k],
            trajectory.l_h[k],
        );
        let z2 = r_ohm * r_ohm + (omega * l_h).powi(2);
        let white = noise.v_v * noise.v_v + z2 * noise.i_a * noise.i_a;
        let least = z2 * (MIN_NOISE * most_a).powi(2);
        let left = trajectory.chi2.get(k).copied().unwrap_or(1.0);
        let sigma_v = (2.0 * (white * left + least) / per_time).sqrt();
        MeasuredPoint {
            i_a,
            r_ohm,
            l_h,
            r_sigma_ohm: sigma_v / i_a,
            l_sigma_h: sigma_v / (i_a * omega),
        }
    };
    let shown = (0..trajectory.r_ohm.len())
        .map(point)
        .filter(|p| (MIN_CURRENT_A..=MAX_CURRENT_A).contains(&p.i_a));
    CurrentCurve::new(segment.f_sw_hz, t_s, shown)
}
