//! Banded least squares: phasors of the switching harmonics as B-splines in slow time, then R(t) and
//! L(t) as rational splines through the phasors of the fundamental. Two linear solves per mains half-cycle,
//! no iteration, no start value.
//!
//! Splines are smooth, but R and L have kinks at the mains zero crossings. Each half-cycle is therefore
//! a problem of its own.

mod impedance;
mod phasors;
mod rational;

use std::time::Instant;

use ihd_signal::Segment;
use ihd_signal::noise::WhiteNoise;
use ihd_signal::segment::MIN_PERIODS;
use ihd_spline::harmonic::MIN_INTERVAL_PERIODS;
use serde::{Deserialize, Serialize};

use super::model_residual::ModelResidual;
use super::{Estimate, IdentifyError, Method};

/// Options of the fit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LeastSquaresSettings {
    /// B-spline intervals of the phasors in a mains half-cycle.
    pub phasor_intervals: usize,
    /// Spline intervals of R and L in a mains half-cycle.
    pub impedance_intervals: usize,
    /// Expected second difference of the coefficients of R and ωL at full current, as a share of the impedance, which limits
    /// bends by noise. It grows where the current is small.
    pub bend: f64,
}

impl Default for LeastSquaresSettings {
    fn default() -> Self {
        Self {
            phasor_intervals: 24,
            impedance_intervals: 24,
            bend: 1.4e-3,
        }
    }
}

/// Fits every half-cycle of the segment that is long enough; one estimate per switching period. `noise` is the segment's.
///
/// # Errors
/// [`ihd_signal::SegmentError::TooShort`] if no half-cycle is long enough, [`IdentifyError::Unfit`] if the
/// samples cannot distinguish the harmonics.
pub fn identify(
    segment: &Segment,
    noise: WhiteNoise,
    settings: &LeastSquaresSettings,
) -> Result<Estimate, IdentifyError> {
    let started = Instant::now();
    let mut estimate = Estimate::new(Method::LeastSquares, segment.f_sw_hz);
    let mut residual = ModelResidual::default();
    let mut buffers = [Vec::new(), Vec::new()];
    let least = MIN_PERIODS * segment.samples_per_period();
    for (from, to) in segment.half_cycles() {
        if (to - from) as f64 >= least {
            let fit = phasors::SplineFit::new(segment, from..to, settings, noise, &mut buffers)?;
            impedance::fit(segment, &fit, settings, noise, &mut estimate, &mut residual)?;
        }
    }
    if estimate.t_s.is_empty() {
        return Err(segment.too_short(MIN_PERIODS).into());
    }
    residual.note_in(&mut estimate);
    estimate.elapsed = started.elapsed();
    Ok(estimate)
}

/// Number of spline intervals for a stretch of this duration.
fn intervals(per_half_cycle: usize, duration_s: f64, segment: &Segment) -> usize {
    let share = (duration_s / segment.half_cycle_s()).min(1.0);
    let ideal = (per_half_cycle as f64 * share).round().max(1.0);
    let most = (duration_s * segment.f_sw_hz / MIN_INTERVAL_PERIODS)
        .floor()
        .max(1.0);
    ideal.min(most) as usize
}
