//! Identification of one window: choice of the training, ensemble, checkpoint.

use std::path::Path;

use crate::hybrid::hybrid;
use crate::loss::slow_times_s;
use crate::progress::Log;
use crate::waveform::NormalisedWaveform;
use crate::{
    Identification, PinnConfig, PinnError, TrainingProgress, Waveform, networks, uncertainty,
};

/// Truth of R (ohm) and L (H) at a time in seconds after the mains zero crossing.
pub type TruthAt<'a> = &'a dyn Fn(f64) -> (f64, f64);

/// Window to identify, with optional truth and checkpoint.
#[derive(Clone, Copy)]
pub struct IdentifyTask<'a> {
    /// Samples of the window.
    pub window: Waveform<'a>,
    /// Settings of the identification.
    pub config: &'a PinnConfig,
    /// Truth, if known; the progress then contains the errors against it.
    pub truth: Option<TruthAt<'a>>,
    /// Burnpack file of a training with a VI-MLP: the training continues from it if it exists, and writes it every
    /// 100 epochs and at the end.
    pub checkpoint: Option<&'a Path>,
}

/// Identifies R(t) and L(t) of the coil from one window by minimising the paper's eq. (7).
///
/// `progress` is called after every accepted optimiser step; see [`IdentifyTask::run`].
///
/// # Errors
/// [`PinnError`] if the window or the configuration cannot be used. A limit that is reached, or a
/// loss that is not finite, is no error but a [`crate::StopReason`].
pub fn identify(
    window: &Waveform<'_>,
    config: &PinnConfig,
    progress: &mut dyn FnMut(&TrainingProgress),
) -> Result<Identification, PinnError> {
    let task = IdentifyTask {
        window: *window,
        config,
        truth: None,
        checkpoint: None,
    };
    task.run(progress)
}

impl IdentifyTask<'_> {
    /// Identifies the window. With the harmonic VI branch by block-coordinate descent: the VI branch by linear least squares,
    /// the RL-MLP by the configured optimiser, alternating. With a VI-MLP both networks by Adam.
    ///
    /// # Errors
    /// Errors of [`identify`], and [`PinnError::Checkpoint`] for a checkpoint of another training.
    pub fn run(
        &self,
        progress: &mut dyn FnMut(&TrainingProgress),
    ) -> Result<Identification, PinnError> {
        self.config.validate()?;
        let mut samples = self.window.normalise()?;
        if self.config.vi_mlp.is_none() {
            let highest = self.config.harmonics.iter().copied().max().unwrap_or(1);
            samples = samples.averaged(self.config.most_points, highest);
        }
        let mut members = Vec::with_capacity(self.config.ensemble);
        for member in 0..self.config.ensemble {
            let config = PinnConfig {
                seed: self.config.seed.wrapping_add(member as u64),
                ensemble: 1,
                ..self.config.clone()
            };
            let checkpoint = self.checkpoint.map(|path| match member {
                0 => path.to_owned(),
                _ => path.with_extension(format!("{member}.bpk")),
            });
            let mut log = Log::start(&config, progress);
            log.truth = self
                .truth
                .map(|truth| truth_outputs(truth, &samples, &config));
            members.push(match &config.vi_mlp {
                None => hybrid(&samples, &config, log)?,
                Some(vi) => networks::identify(&samples, &config, vi, checkpoint.as_deref(), log)?,
            });
        }
        Ok(best_of(members))
    }
}

/// Member with the least loss. The members' spread is added to its uncertainty: all of them fit the same noise, which the spread
/// therefore does not contain.
fn best_of(mut members: Vec<Identification>) -> Identification {
    let spread = |of: fn(&Identification) -> &[f64]| {
        let values: Vec<&[f64]> = members.iter().map(of).collect();
        uncertainty::spread(&values)
    };
    let sigmas = (members.len() > 1).then(|| (spread(|m| &m.r_ohm), spread(|m| &m.l_h)));
    let total_s = members.iter().map(|m| m.elapsed_s).sum();
    let order = |a: &Identification, b: &Identification| a.losses.total.total_cmp(&b.losses.total);
    members.sort_by(order);
    let mut best = members.swap_remove(0);
    best.elapsed_s = total_s;
    if let Some((r, l)) = sigmas {
        best.r_sigma_ohm = with_spread(&best.r_sigma_ohm, r);
        best.l_sigma_h = with_spread(&best.l_sigma_h, l);
    }
    best
}

/// Standard deviations of a member and of the spread together; the spread alone if the member has none.
fn with_spread(own: &[f64], mut spread: Vec<f64>) -> Vec<f64> {
    for (sigma, own) in spread.iter_mut().zip(own) {
        *sigma = sigma.hypot(*own);
    }
    spread
}

/// R / r_scale and L / l_scale of the truth at the slow times, alternating.
fn truth_outputs(
    truth: TruthAt<'_>,
    samples: &NormalisedWaveform,
    config: &PinnConfig,
) -> Vec<f64> {
    slow_times_s(samples.duration_s(), config.slow_points)
        .iter()
        .flat_map(|tau| {
            let (r, l) = truth(samples.t0_s + tau);
            [r / config.r_scale_ohm, l / config.l_scale_h]
        })
        .collect()
}
