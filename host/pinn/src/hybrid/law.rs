//! R(t) and L(t) of a window at once, where the law that was learned from simulated loads holds.

use std::f64::consts::TAU;

use super::inputs::Inputs;
use super::misfit::Misfit;
use super::result::Curves;
use crate::at_once::{HalfCyclePoint, LawFit, Widths, Window};
use crate::harmonic_branch::HarmonicBranch;
use crate::loss::{SlowPhysics, slow_times_s};
use crate::noise::{noise_variance, white_noise};
use crate::parameters::Parameters;
use crate::progress::StopReason;
use crate::result::result_times_s;
use crate::waveform::NormalisedWaveform;

/// Physics term of a window with all that its law needs.
pub(super) struct LawWindow<'a> {
    inputs: &'a Inputs<'a>,
    branch: &'a HarmonicBranch,
    outline: &'a Parameters,
    window: Window,
    white: (f64, f64),
    data_losses: (f64, f64),
    /// R in ohm and L in henry of the constant load that fits best.
    typical: [f64; 2],
}

impl<'a> LawWindow<'a> {
    /// Condenses the window; `branch` is fitted to the data alone.
    pub fn new(
        inputs: &'a Inputs<'a>,
        branch: &'a HarmonicBranch,
        outline: &'a Parameters,
    ) -> Self {
        let (samples, config) = (inputs.samples, inputs.config);
        let times = slow_times_s(samples.duration_s(), config.slow_points);
        let physics =
            SlowPhysics::condense(branch, samples, outline, &inputs.laws, config.w_f, times);
        let data_losses = inputs.system.losses(branch);
        let white = white_noise(samples, branch, data_losses, config.noise);
        let [r, l] = physics.best_constant();
        let typical = [r * outline.r_scale_ohm, l * outline.l_scale_h];
        let places = physics
            .tau_s
            .iter()
            .map(|tau_s| place(samples, branch, *tau_s));
        Self {
            window: Window {
                places: places.collect(),
                noise: noise_variance(samples, white, config.w_f, typical),
                physics,
            },
            inputs,
            branch,
            outline,
            white,
            data_losses,
            typical,
        }
    }

    /// R(t) and L(t) by the law; `None` if it does not hold here.
    pub fn curves(&self) -> Option<Curves> {
        let (samples, config) = (self.inputs.samples, self.inputs.config);
        let physics = &self.window.physics;
        let law = LawFit::new(&self.window, &Widths::LEARNED)?;
        let outputs: Vec<_> = self
            .window
            .places
            .iter()
            .map(|place| law.at(*place).0)
            .collect();
        let by_physics = (physics, config.w_f);
        let branch = (self.branch, self.white);
        let misfit = Misfit::new(samples, branch, by_physics, &outputs, self.typical);
        let scales = [self.outline.r_scale_ohm, self.outline.l_scale_h];
        let share = |(tau_s, [r, l]): (&f64, &[f64; 2])| {
            misfit.share_of_load(*tau_s, (r * scales[0], l * scales[1]))
        };
        let shares: Vec<f64> = physics.tau_s.iter().zip(&outputs).map(share).collect();
        if !LawFit::holds(&shares) {
            return None;
        }
        let squares: f64 = physics.residuals(&outputs).iter().map(|e| e * e).sum();
        let mut curves = Curves {
            tau_s: result_times_s(samples, config),
            r_ohm: Vec::new(),
            l_h: Vec::new(),
            r_sigma_ohm: Vec::new(),
            l_sigma_h: Vec::new(),
            chi2: Vec::new(),
            physics_loss: squares + physics.floor,
            data_losses: self.data_losses,
            parameters: self.network(),
            stopped: StopReason::ClosedForm,
        };
        for &tau_s in &curves.tau_s {
            let ([r, l], variances) = law.at(place(samples, self.branch, tau_s));
            let (r_ohm, l_h) = (r * scales[0], l * scales[1]);
            let chi2 = misfit.chi2(tau_s, (r_ohm, l_h));
            let [r_sigma, l_sigma] = variances.map(|variance| (variance * chi2).sqrt());
            curves.r_ohm.push(r_ohm);
            curves.l_h.push(l_h);
            curves.r_sigma_ohm.push(r_sigma * scales[0]);
            curves.l_sigma_h.push(l_sigma * scales[1]);
            curves.chi2.push(chi2);
        }
        Some(curves)
    }

    /// Network for a later window: the one that was given, or one that has not been trained.
    fn network(&self) -> Parameters {
        let (outline, config) = (self.outline.clone(), self.inputs.config);
        if !outline.layers.is_empty() {
            return outline;
        }
        outline.initial(
            &config.hidden_layers,
            config.seed,
            self.window.physics.best_constant(),
        )
    }
}

fn place(samples: &NormalisedWaveform, branch: &HarmonicBranch, tau_s: f64) -> HalfCyclePoint {
    let phase = TAU * samples.f_mains_hz * (samples.t0_s + tau_s);
    HalfCyclePoint {
        i_a: branch.amplitude(tau_s) * samples.i_max_ampere,
        cosine: phase.cos(),
    }
}

/// Problem of a recording, for the recipe.
#[cfg(test)]
pub(crate) fn window(recorded: &crate::Waveform<'_>, config: &crate::PinnConfig) -> Window {
    use super::setup;
    let samples = recorded.normalise().expect("a sound window");
    let basis = setup::harmonic_basis(&samples, config).expect("a sound window");
    let system = crate::vi_system::DataSystem::assemble(&samples, basis);
    let branch = system.fit().expect("separable");
    let inputs = Inputs {
        samples: &samples,
        config,
        system: &system,
        order: 0.0,
        laws: setup::laws(0.0, &branch.basis, config),
    };
    let outline = setup::network_outline(&samples, config);
    LawWindow::new(&inputs, &branch, &outline).window
}
