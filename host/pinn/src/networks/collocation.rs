//! Collocation points: inputs of both networks, eqs. (2), (3), and the samples that they are compared with, eqs. (5),
//! (6), in single precision.

use std::f64::consts::TAU;

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::waveform::NormalisedWaveform;
use crate::{SlowEmbedding, ViMlp};

/// All collocation points of a window, one row each.
///
/// Time derivatives are per radian of the switching frequency, so that they are near 1 as the
/// values are: `d/dt = omega d/dtheta`.
#[derive(Debug, Clone)]
pub(crate) struct Collocation {
    /// Inputs of the VI-MLP and their derivatives, `fast_width` per row.
    pub fast: Vec<f32>,
    pub fast_rate: Vec<f32>,
    pub fast_width: usize,
    /// Inputs of the RL-MLP, `slow_width` per row.
    pub slow: Vec<f32>,
    pub slow_width: usize,
    /// Normalised samples.
    pub v: Vec<f32>,
    pub i: Vec<f32>,
    /// Index of each point's sample in the window.
    pub sample: Vec<usize>,
}

/// Factors from the RL-MLP's outputs to normalised impedances.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Impedances {
    /// R of output 1, times i_max/v_max.
    pub r: f32,
    /// Reactance omega L of output 1, times i_max/v_max.
    pub x: f32,
}

impl Collocation {
    /// Takes every `vi.downsampling`-th sample, in an order shuffled by `seed` if there are minibatches:
    /// each stretch of the list is then a random subset.
    pub fn new(samples: &NormalisedWaveform, vi: &ViMlp, slow: &SlowEmbedding, seed: u64) -> Self {
        let mut sample: Vec<usize> = (0..samples.len()).step_by(vi.downsampling).collect();
        if vi.minibatch.is_some() {
            sample.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
        }
        let mut points = Self {
            fast: Vec::new(),
            fast_rate: Vec::new(),
            fast_width: vi.width(),
            slow: Vec::new(),
            slow_width: slow.width(),
            v: Vec::with_capacity(sample.len()),
            i: Vec::with_capacity(sample.len()),
            sample: Vec::new(),
        };
        for &n in &sample {
            points.push(samples, vi, slow, n);
        }
        points.sample = sample;
        points
    }

    fn push(&mut self, samples: &NormalisedWaveform, vi: &ViMlp, slow: &SlowEmbedding, n: usize) {
        let t_s = samples.t0_s + n as f64 * samples.dt_s;
        let single = |x: &f64| *x as f32;
        let (values, rates) = vi.features(t_s, samples.omega / TAU, samples.f_mains_hz);
        self.fast.extend(values.iter().map(single));
        self.fast_rate.extend(rates.iter().map(single));
        let features = slow.features(t_s, samples.f_mains_hz);
        self.slow.extend(features.iter().map(single));
        self.v.push(samples.v[n] as f32);
        self.i.push(samples.i[n] as f32);
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.v.len()
    }
}
