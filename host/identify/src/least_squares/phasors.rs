//! Phasors of the switching harmonics as B-splines, by least squares over all samples
//! ([`ihd_spline::harmonic`]).

use std::ops::Range;

use ihd_signal::Segment;
use ihd_signal::noise::WhiteNoise;
use ihd_spline::CubicSpline;
use ihd_spline::harmonic::{HarmonicFit, phasor};
use ihd_spline::residual::Excess;
use nalgebra::Complex;

use super::{LeastSquaresSettings, intervals};
use crate::{IdentifyError, Method};

/// Harmonics that are fitted. R and L come from the first; the others are there because their
/// modulation reaches over to it.
const ORDERS: [u32; 4] = [1, 3, 5, 7];

/// Blocks of a switching period: see [`ihd_spline::harmonic`].
const BLOCKS_PER_PERIOD: f64 = 16.0;

type Phasor = Complex<f64>;

/// The fitted harmonics of a stretch.
pub struct Fit {
    /// The splines' basis, in seconds after the first sample.
    pub spline: CubicSpline,
    /// Samples of one interval.
    pub samples_per_interval: f64,
    /// Time of the stretch's first sample in seconds.
    pub t0_s: f64,
    /// Duration of the stretch in seconds.
    pub duration_s: f64,
    /// What the fit leaves of the fundamental beyond white noise.
    pub excess: Excess,
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
    /// Its slope without the rotation, in ampere per second.
    pub i_slope: Phasor,
}

impl Fit {
    /// Fits a range of samples within one mains half-cycle.
    ///
    /// # Errors
    /// [`IdentifyError::Unfit`] when the sampling cannot distinguish the harmonics.
    pub fn new(
        segment: &Segment,
        range: Range<usize>,
        settings: &LeastSquaresSettings,
        noise: WhiteNoise,
    ) -> Result<Self, IdentifyError> {
        let per_period = segment.samples_per_period();
        let (v_v, i_a) = (&segment.v_v[range.clone()], &segment.i_a[range.clone()]);
        let used = ORDERS
            .iter()
            .filter(|&&h| 2.0 * f64::from(h) + 1.0 < per_period)
            .count()
            .max(1);
        let duration_s = v_v.len() as f64 * segment.dt_s;
        let count = intervals(settings.phasor_intervals, duration_s, segment);
        let spline = CubicSpline::new(count, duration_s);
        let block = ((per_period / BLOCKS_PER_PERIOD).round() as usize).max(1);
        let fit = HarmonicFit {
            spline: &spline,
            orders: &ORDERS[..used],
            gains: &[1.0; ORDERS.len()][..used],
            periods_per_sample: segment.f_sw_hz * segment.dt_s,
            dt_s: segment.dt_s,
            block,
            centre: 0.5 * block as f64,
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
        let excess = Excess::of(&fit, [v_v, i_a], [&v, &i], white);
        Ok(Self {
            excess,
            samples_per_interval: v_v.len() as f64 / count as f64,
            t0_s: segment.t_s(range.start),
            duration_s,
            spline,
            orders: used,
            v,
            i,
        })
    }

    /// The fundamental at `tau_s` seconds after the stretch's first sample.
    pub fn at(&self, tau_s: f64) -> Fundamental {
        let local = self.spline.at(tau_s);
        let of = |x: &[f64], weights| phasor(x, self.orders, 0, &local, weights);
        Fundamental {
            v: of(&self.v, &local.values),
            i: of(&self.i, &local.values),
            i_slope: of(&self.i, &local.slopes_per_s),
        }
    }
}
