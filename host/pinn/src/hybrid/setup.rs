//! Setup of the first pass: functions of the VI branch, outline of the network, impedance law.

use std::f64::consts::TAU;

use ihd_signal::noise::mean_square;
use ihd_spline::harmonic::MIN_INTERVAL_PERIODS;
use ihd_spline::{CubicSpline, quiet_interval_s};

use crate::harmonic_branch::{HarmonicBasis, HarmonicBranch};
use crate::impedance_law::{self, HarmonicLaw, ImpedanceOrder, NamedOrder};
use crate::loss::{SlowPhysics, slow_times_s};
use crate::parameters::Parameters;
use crate::waveform::NormalisedWaveform;
use crate::{PinnConfig, PinnError};

/// Functions of the VI branch; an error if the samples cannot distinguish them.
pub(super) fn harmonic_basis(
    samples: &NormalisedWaveform,
    config: &PinnConfig,
) -> Result<HarmonicBasis, PinnError> {
    let half_cycle_s = 0.5 / samples.f_mains_hz;
    let share = samples.duration_s() / half_cycle_s;
    // A piece between two steps of the load may have ten periods, with three per interval.
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

/// Spline with knots denser toward the zero crossings, as far as the measured noise allows.
fn spline(samples: &NormalisedWaveform, intervals: usize, config: &PinnConfig) -> CubicSpline {
    let duration_s = samples.duration_s();
    let half_cycle_s = 0.5 / samples.f_mains_hz;
    let noise = config.noise.unwrap_or([f64::INFINITY; 2]);
    let unit = [samples.v_max_volt, samples.i_max_ampere];
    let channels = [&samples.v, &samples.i]
        .into_iter()
        .zip(noise.into_iter().zip(unit));
    let quiet_s = channels.map(|(x, (sigma, unit))| {
        let variance = (sigma / unit).powi(2) / samples.block as f64;
        quiet_interval_s(variance / mean_square(x), samples.dt_s, half_cycle_s)
    });
    let least_s = MIN_INTERVAL_PERIODS * TAU / samples.omega;
    CubicSpline::graded(intervals, duration_s, quiet_s.fold(least_s, f64::max))
}

/// Checks for at least two samples per period of the highest harmonic.
fn check_rate(samples: &NormalisedWaveform, config: &PinnConfig) -> Result<(), PinnError> {
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

/// Checks for enough points, in total and within each spline interval.
fn check_length(
    samples: &NormalisedWaveform,
    basis: &HarmonicBasis,
    intervals: usize,
) -> Result<(), PinnError> {
    let per_period = TAU / (samples.omega * samples.dt_s);
    let pairs = samples.len();
    for (needed, why) in [
        (4 * basis.len(), "four per unknown"),
        (
            (MIN_INTERVAL_PERIODS * per_period * intervals as f64).ceil() as usize,
            "three switching periods per spline interval",
        ),
    ] {
        if pairs < needed {
            return Err(PinnError::TooShort { pairs, needed, why });
        }
    }
    Ok(())
}

/// Start parameters, or the network's scales without layers.
pub(super) fn network_outline(samples: &NormalisedWaveform, config: &PinnConfig) -> Parameters {
    match &config.start {
        // The mains frequency is always that of the present window.
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

/// Impedance law of this order at the physics harmonics.
pub(super) fn laws(order: f64, basis: &HarmonicBasis, config: &PinnConfig) -> Vec<HarmonicLaw> {
    let covered = |h: &u32| config.physics_harmonics.contains(h);
    let all = basis.harmonics.iter().enumerate();
    all.filter(|(_, h)| covered(h))
        .map(|(index, _)| HarmonicLaw::new(order, basis, index))
        .collect()
}

/// Order as given, or the order with which R and L of each slow time leave least of the physics
/// term, before any network.
pub(super) fn impedance_order(
    branch: &HarmonicBranch,
    samples: &NormalisedWaveform,
    parameters: &Parameters,
    config: &PinnConfig,
) -> f64 {
    match config.impedance_order {
        ImpedanceOrder::Given(order) => return order,
        ImpedanceOrder::Named(NamedOrder::Identified) => {}
    }
    let misfit = |order: f64| {
        let times = slow_times_s(samples.duration_s(), config.slow_points);
        let laws = laws(order, &branch.basis, config);
        SlowPhysics::condense(branch, samples, parameters, &laws, config.w_f, times).floor
    };
    impedance_law::least(misfit)
}
