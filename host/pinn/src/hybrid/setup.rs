//! What the first pass starts from: the VI branch's functions, the network's outline, the impedance law.

use std::f64::consts::TAU;

use ihd_spline::{CubicSpline, quiet_interval_s};

use crate::harmonic_branch::{HarmonicBasis, HarmonicBranch};
use crate::impedance_law::{self, AtHarmonic, ImpedanceOrder, Named};
use crate::loss::{SlowPhysics, slow_times_s};
use crate::parameters::Parameters;
use crate::waveform::Normalised;
use crate::{Config, PinnError};

/// Switching periods of a spline's interval that tell the harmonics apart.
const LEAST_PERIODS: f64 = 3.0;

/// The VI branch's functions, if the sampling can tell them apart.
pub(super) fn harmonic_basis(
    samples: &Normalised,
    config: &Config,
) -> Result<HarmonicBasis, PinnError> {
    let half_cycle_s = 0.5 / samples.f_mains_hz;
    let share = samples.duration_s() / half_cycle_s;
    // Of a piece between two steps of the load there may be ten periods, three an interval.
    let periods = samples.len() as f64 * samples.omega * samples.dt_s / TAU;
    let least = ((periods / 3.0) as usize).clamp(1, 4);
    let intervals = ((config.spline_intervals as f64 * share).ceil() as usize).max(least);
    let basis = HarmonicBasis {
        spline: spline(samples, intervals, config),
        harmonics: config.harmonics.clone(),
        omega: samples.omega,
        gains: config.harmonics.iter().map(|h| samples.gain(*h)).collect(),
    };
    check_rate(samples, config)?;
    check_length(samples, &basis, intervals)?;
    Ok(basis)
}

/// Knots denser toward the zero crossings, as far as the measured noise allows.
fn spline(samples: &Normalised, intervals: usize, config: &Config) -> CubicSpline {
    let duration_s = samples.duration_s();
    let half_cycle_s = 0.5 / samples.f_mains_hz;
    let noise = config.noise.unwrap_or([f64::INFINITY; 2]);
    let unit = [samples.v_max_volt, samples.i_max_ampere];
    let channels = [&samples.v, &samples.i]
        .into_iter()
        .zip(noise.into_iter().zip(unit));
    let quiet_s = channels.map(|(x, (sigma, unit))| {
        let mean_square = x.iter().map(|x| x * x).sum::<f64>() / x.len().max(1) as f64;
        let variance = (sigma / unit).powi(2) / samples.block as f64;
        quiet_interval_s(variance / mean_square, samples.dt_s, half_cycle_s)
    });
    let least_s = LEAST_PERIODS * TAU / samples.omega;
    CubicSpline::graded(intervals, duration_s, quiet_s.fold(least_s, f64::max))
}

/// Two samples a period of the highest harmonic, at least.
fn check_rate(samples: &Normalised, config: &Config) -> Result<(), PinnError> {
    let (f_sw_hz, f_adc_hz) = (samples.omega / TAU, 1.0 / samples.dt_s);
    let harmonic = config.harmonics.iter().copied().max().unwrap_or(1);
    let needed_hz = 2.0 * f64::from(harmonic) * f_sw_hz;
    if f_adc_hz > needed_hz {
        return Ok(());
    }
    Err(PinnError::SamplingTooSlow {
        f_adc_hz,
        f_sw_hz,
        harmonic,
        needed_hz,
    })
}

/// Points enough for the unknowns, in the whole and within each spline interval.
fn check_length(
    samples: &Normalised,
    basis: &HarmonicBasis,
    intervals: usize,
) -> Result<(), PinnError> {
    let per_period = TAU / (samples.omega * samples.dt_s);
    let pairs = samples.len();
    for (needed, why) in [
        (4 * basis.len(), "four per unknown"),
        (
            (LEAST_PERIODS * per_period * intervals as f64).ceil() as usize,
            "three switching periods per spline interval",
        ),
    ] {
        if pairs < needed {
            return Err(PinnError::TooShort { pairs, needed, why });
        }
    }
    Ok(())
}

/// The parameters to start from, or the network's scales with no layers yet.
pub(super) fn network_outline(samples: &Normalised, config: &Config) -> Parameters {
    match &config.start {
        // The window at hand has the last word on the mains frequency.
        Some(start) => Parameters {
            f_mains_hz: samples.f_mains_hz,
            ..start.clone()
        },
        None => Parameters {
            embedding: config.embedding,
            f_mains_hz: samples.f_mains_hz,
            r_scale_ohm: config.r_scale_ohm,
            l_scale_h: config.l_scale_h,
            layers: Vec::new(),
            vi_layers: Vec::new(),
            inputs: config.inputs.clone(),
        },
    }
}

/// The law of this order at the physics harmonics.
pub(super) fn laws(order: f64, basis: &HarmonicBasis, config: &Config) -> Vec<AtHarmonic> {
    let covered = |h: &u32| config.physics_harmonics.contains(h);
    let all = basis.harmonics.iter().enumerate();
    all.filter(|(_, h)| covered(h))
        .map(|(index, _)| AtHarmonic::new(order, basis, index))
        .collect()
}

/// The order as given, or the one with which R and L of each slow time leave least of the physics
/// term, before any network.
pub(super) fn impedance_order(
    branch: &HarmonicBranch,
    samples: &Normalised,
    parameters: &Parameters,
    config: &Config,
) -> f64 {
    match config.impedance_order {
        ImpedanceOrder::Given(order) => return order,
        ImpedanceOrder::Named(Named::Identified) => {}
    }
    let misfit = |order: f64| {
        let times = slow_times_s(samples.duration_s(), config.slow_points);
        let laws = laws(order, &branch.basis, config);
        SlowPhysics::condense(branch, samples, parameters, &laws, config.w_f, times).floor
    };
    impedance_law::least(misfit)
}
