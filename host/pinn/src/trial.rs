//! Small exact window and its parts, for the unit tests.

use std::f64::consts::TAU;

use crate::harmonic_branch::{HarmonicBasis, HarmonicBranch};
use crate::impedance_law::HarmonicLaw;
use crate::loss::{SlowPhysics, slow_times_s};
use crate::parameters::Parameters;
use crate::vi_system::DataSystem;
use crate::waveform::NormalisedWaveform;
use crate::{Backend, SlowEmbedding, Waveform};
use burn::tensor::Device;
use ihd_spline::CubicSpline;

/// The device of burn-ndarray.
pub(crate) fn device() -> Device {
    let device = Backend::Ndarray.device().expect("needs no hardware");
    device.expect("a backend of burn")
}

/// A half-cycle of a constant 4 ohm, 20 uH at 45 kHz, with a third harmonic.
pub(crate) fn samples() -> NormalisedWaveform {
    samples_at(45e3 * 61.0 / 3.0)
}

/// The same half-cycle at another sampling rate in hertz.
pub(crate) fn samples_at(rate_hz: f64) -> NormalisedWaveform {
    let (f_sw_hz, f_mains_hz) = (45e3, 50.0);
    let dt_s = 1.0 / rate_hz;
    let mains = TAU * f_mains_hz;
    let (mut v_volt, mut i_ampere) = (Vec::new(), Vec::new());
    for n in 0..(10e-3 * rate_hz) as u32 {
        let t = f64::from(n) * dt_s;
        let (a, slope) = (40.0 * (mains * t).sin(), 40.0 * mains * (mains * t).cos());
        let (mut i, mut di) = (0.0, 0.0);
        for (h, share) in [(1.0, 1.0), (3.0, 0.08)] {
            let omega = TAU * f_sw_hz * h;
            let (sin, cos) = (omega * t + h).sin_cos();
            i += share * a * cos;
            di += share * (slope * cos - a * omega * sin);
        }
        v_volt.push(4.0 * i + 20e-6 * di);
        i_ampere.push(i);
    }
    Waveform {
        f_sw_hz,
        f_mains_hz,
        t0_s: 0.0,
        dt_s,
        v_volt: &v_volt,
        i_ampere: &i_ampere,
    }
    .normalise()
    .expect("a sound window")
}

pub(crate) fn basis(samples: &NormalisedWaveform) -> HarmonicBasis {
    HarmonicBasis {
        spline: CubicSpline::new(16, samples.duration_s()),
        harmonics: vec![1, 3],
        omega: samples.omega,
        gains: vec![samples.gain(1), samples.gain(3)],
    }
}

/// Impedance law of this order at these positions of the basis; 0 is eq. (1).
pub(crate) fn laws(order: f64, basis: &HarmonicBasis, indices: &[usize]) -> Vec<HarmonicLaw> {
    let law = |index: &usize| HarmonicLaw::new(order, basis, *index);
    indices.iter().map(law).collect()
}

/// VI branch fitted to these samples alone.
pub(crate) fn fitted(samples: &NormalisedWaveform) -> HarmonicBranch {
    DataSystem::assemble(samples, basis(samples))
        .fit()
        .expect("separable")
}

/// Weight of the physics term, the paper's.
pub(crate) const W_F: f64 = 5.0;

/// The physics term of eq. (1) over the harmonics at these positions, at `count` slow times.
pub(crate) fn physics(
    branch: &HarmonicBranch,
    samples: &NormalisedWaveform,
    network: &Parameters,
    indices: &[usize],
    count: usize,
) -> SlowPhysics {
    let laws = laws(0.0, &branch.basis, indices);
    let times = slow_times_s(samples.duration_s(), count);
    SlowPhysics::condense(branch, samples, network, &laws, W_F, times)
}

/// An untrained network near 5 ohm, 25 uH: away from the truth, so that no residual vanishes.
pub(crate) fn network() -> Parameters {
    Parameters {
        embedding: SlowEmbedding::MainsPhase,
        f_mains_hz: 50.0,
        r_scale_ohm: 4.0,
        l_scale_h: 20e-6,
        layers: Vec::new(),
        vi_layers: Vec::new(),
        inputs: None,
    }
    .initial(&[5, 3], 11, [1.25, 1.25])
}
