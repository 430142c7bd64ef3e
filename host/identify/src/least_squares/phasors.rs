//! Phasors of the switching harmonics as B-splines, by least squares over all samples
//! ([`ihd_spline::harmonic`]).

use std::ops::Range;

use ihd_signal::fourier::sinc;
use ihd_signal::noise::WhiteNoise;
use ihd_signal::vectorised::{dot, vectorised};
use ihd_signal::{ORDERS, Segment};
use ihd_spline::harmonic::{HarmonicFit, MIN_INTERVAL_PERIODS, phasor};
use ihd_spline::residual::Excess;
use ihd_spline::{CubicSpline, quiet_interval_s};
use nalgebra::Complex;

use super::{LeastSquaresSettings, intervals};
use crate::{IdentifyError, Method};

/// Duration of the bridge's edges in seconds, from the hob's ratings.
const EDGE_S: f64 = ihd_shared::hob::EDGE_NS as f64 * 1e-9;

/// Relative uncertainty of the edges' duration.
const EDGE_SPREAD: f64 = 0.1;

/// Blocks per switching period, see [`ihd_spline::harmonic`].
const BLOCKS_PER_PERIOD: f64 = 16.0;

type Phasor = Complex<f64>;

/// Fitted harmonics of a stretch.
pub struct SplineFit {
    /// Basis of the splines, in seconds after the first sample.
    pub spline: CubicSpline,
    /// Number of the splines' intervals.
    pub intervals: usize,
    /// Samples of one interval.
    pub samples_per_interval: f64,
    /// Time of the stretch's first sample in seconds.
    pub t0_s: f64,
    /// Duration of the stretch in seconds.
    pub duration_s: f64,
    /// Residual of the fit at the fundamental beyond white noise.
    pub excess: Excess,
    /// Amplitude that the sampling folds onto the fundamental, over that of an edge's fundamental.
    aliased: f64,
    /// Third harmonic over its share of an edge.
    third: f64,
    orders: usize,
    v: Vec<f64>,
    i: Vec<f64>,
}

/// Phasors of the fundamental at one time.
pub struct Fundamental {
    /// Coil voltage in volt.
    pub v: Phasor,
    /// Coil current in ampere.
    pub i: Phasor,
    /// Slope of `i` without the rotation, in ampere per second.
    pub i_slope: Phasor,
}

impl SplineFit {
    /// Fits a range of samples within one mains half-cycle; the buffers are used if they must be converted.
    ///
    /// # Errors
    /// [`IdentifyError::Unfit`] if the samples cannot distinguish the harmonics.
    pub fn new(
        segment: &Segment,
        range: Range<usize>,
        settings: &LeastSquaresSettings,
        noise: WhiteNoise,
        [v_buffer, i_buffer]: &mut [Vec<f64>; 2],
    ) -> Result<Self, IdentifyError> {
        let per_period = segment.samples_per_period();
        let (v_v, i_a) = (
            segment.v_v.block(range.clone(), v_buffer),
            segment.i_a.block(range.clone(), i_buffer),
        );
        // R and L come from the first harmonic; the others are needed because their modulation overlaps with it.
        let used = ORDERS
            .iter()
            .filter(|&&h| 2.0 * f64::from(h) + 1.0 < per_period)
            .count()
            .max(1);
        let duration_s = v_v.len() as f64 * segment.dt_s;
        let count = intervals(settings.phasor_intervals, duration_s, segment);
        let noise_of = relative_noise(v_v, noise.v_v).max(relative_noise(i_a, noise.i_a));
        let quiet = quiet_interval_s(noise_of, segment.dt_s, segment.half_cycle_s());
        let spline = CubicSpline::graded(
            count,
            duration_s,
            quiet.max(MIN_INTERVAL_PERIODS / segment.f_sw_hz),
        );
        let block = ((per_period / BLOCKS_PER_PERIOD).round() as usize).max(1);
        let fit = HarmonicFit {
            spline: &spline,
            orders: &ORDERS[..used],
            gains: &[1.0; ORDERS.len()][..used],
            periods_per_sample: segment.f_sw_hz * segment.dt_s,
            dt_s: segment.dt_s,
            block,
            centre: 0.5 * (block - 1) as f64,
        };
        let solved = fit.normal_equations(v_v, i_a).solve();
        let [v, i] = solved.map_err(|singular| IdentifyError::Unfit {
            method: Method::LeastSquares,
            why: format!(
                "the sampling cannot tell the harmonics of f_sw apart ({singular}): sample faster, or \
                 not at a small multiple of f_sw"
            ),
        })?;
        let white = [noise.v_v, noise.i_a];
        let excess = Excess::compute(&fit, [v_v, i_a], [&v, &i], white);
        Ok(Self {
            aliased: aliased(
                segment.f_sw_hz,
                per_period,
                1.0 / (2.0 * duration_s / count as f64),
            ),
            third: sinc(3.0 * segment.f_sw_hz * EDGE_S) / 3.0,
            excess,
            intervals: count,
            samples_per_interval: v_v.len() as f64 / count as f64,
            t0_s: segment.t_s(range.start),
            duration_s,
            spline,
            orders: used,
            v,
            i,
        })
    }

    /// Amplitude in volt of the edges' harmonics that the sampling may have folded onto the fundamental, without an anti-alias
    /// filter. Their strength is taken from the third harmonic, of which the current has hardly any.
    pub fn aliased_v(&self, tau_s: f64) -> f64 {
        if self.orders < 2 {
            return self.at(tau_s).v.norm() * self.aliased;
        }
        let local = self.spline.at(tau_s);
        phasor(&self.v, self.orders, 1, local.first, &local.values).norm() / self.third
            * self.aliased
    }

    /// The fundamental at `tau_s` seconds after the stretch's first sample.
    pub fn at(&self, tau_s: f64) -> Fundamental {
        let local = self.spline.at(tau_s);
        let of = |x: &[f64], weights| phasor(x, self.orders, 0, local.first, weights);
        Fundamental {
            v: of(&self.v, &local.values),
            i: of(&self.i, &local.values),
            i_slope: of(&self.i, &local.slopes_per_s),
        }
    }
}

/// Variance of a sample's noise over the mean square of the signal.
fn relative_noise(x: &[f64], sigma: f64) -> f64 {
    let square = vectorised(
        #[inline(always)]
        || dot(x, x),
    );
    sigma * sigma * x.len() as f64 / square
}

/// Root of the sum of squares of the edges' odd harmonics that lie within `band_hz` of the fundamental after sampling,
/// 1/h · sinc(h f t_e), as mean square over the possible t_e.
fn aliased(f_sw_hz: f64, per_period: f64, band_hz: f64) -> f64 {
    let last = (2.0 / (f_sw_hz * EDGE_S)) as u32;
    let folded = |h: &u32| {
        let off = |shift: f64| {
            let turns = (f64::from(*h) + shift) / per_period;
            (turns - turns.round()).abs() * per_period * f_sw_hz
        };
        f64::from(*h) > 0.5 * per_period && off(1.0).min(off(-1.0)) < band_hz
    };
    let square = |h: u32| {
        let at = |edge: f64| sinc(f64::from(h) * f_sw_hz * EDGE_S * edge) / f64::from(h);
        let [low, middle, high] = [1.0 - EDGE_SPREAD, 1.0, 1.0 + EDGE_SPREAD].map(at);
        (low * low + middle * middle + high * high) / 3.0
    };
    (3..=last)
        .step_by(2)
        .filter(folded)
        .map(square)
        .sum::<f64>()
        .sqrt()
}
