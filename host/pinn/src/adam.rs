//! Adam (Kingma and Ba 2015, algorithm 1): the paper's optimiser (section V). The harmonic branch can use it for
//! comparison.

use crate::PinnError;
use crate::optimiser::Descent;
use crate::parameters::Parameters;
use crate::progress::{Log, Settling, StopReason};
use crate::slow_model::SlowModel;

/// Decay of the mean gradient and of the mean square, with the usual values of Kingma and Ba.
const DECAY: (f64, f64) = (0.9, 0.999);

/// Steps over which the change of R and L is compared with the tolerance: single steps of Adam are small.
const SETTLING_STEPS: usize = 200;

/// State of Adam (Kingma and Ba 2015, algorithm 1), in double precision whatever computes the
/// gradient.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Adam {
    /// Number of steps so far.
    pub steps: u32,
    pub mean: Vec<f64>,
    pub square: Vec<f64>,
    epsilon: f64,
}

impl Adam {
    /// Creates the state for `count` parameters.
    pub fn new(count: usize, epsilon: f64) -> Self {
        Self {
            steps: 0,
            mean: vec![0.0; count],
            square: vec![0.0; count],
            epsilon,
        }
    }

    /// Moves `theta` against `gradient`.
    pub fn step(&mut self, rate: f64, theta: &mut [f64], gradient: impl IntoIterator<Item = f64>) {
        self.steps += 1;
        let power = f64::from(self.steps);
        let (mean_bias, square_bias) = (1.0 - DECAY.0.powf(power), 1.0 - DECAY.1.powf(power));
        let state = self.mean.iter_mut().zip(&mut self.square);
        for ((x, (mean, square)), g) in theta.iter_mut().zip(state).zip(gradient) {
            *mean += (1.0 - DECAY.0) * (g - *mean);
            *square += (1.0 - DECAY.1) * (g * g - *square);
            *x -= rate * (*mean / mean_bias) / ((*square / square_bias).sqrt() + self.epsilon);
        }
    }
}

/// Minimises |e|², the squared residuals of `physics`, from `parameters` on by gradient steps. Returns the best
/// parameters seen, because Adam does not descend at every step. `tolerance` is compared with
/// the mean relative change of R and L over [`SETTLING_STEPS`] steps.
///
/// On a burn backend `physics` must live on an autodiff device.
pub(crate) fn descend(
    physics: &SlowModel,
    parameters: Parameters,
    learning_rate: f64,
    tolerance: f64,
    log: &mut Log<'_>,
) -> Result<Descent, PinnError> {
    let mut theta = parameters.flat();
    // The loss is far below 1 in its units; the usual 1e-8 would suppress the gradient.
    let mut adam = Adam::new(theta.len(), 1e-12);
    let mut settling = Settling::over(SETTLING_STEPS);
    let mut at = parameters.clone();
    let mut best = Descent {
        parameters,
        squares: f64::INFINITY,
        stopped: StopReason::RolledBack,
    };
    loop {
        let now = physics.gradient(&at)?;
        if !now.squares.is_finite() {
            best.stopped = StopReason::RolledBack;
            return Ok(best);
        }
        if now.squares < best.squares {
            best.parameters = at.clone();
            best.squares = now.squares;
        }
        if let Some(limit) = log.exhausted() {
            best.stopped = limit;
            return Ok(best);
        }
        let change = settling.change(now.outputs.clone());
        log.record(now.squares, change, &now.outputs);
        if change < tolerance {
            best.stopped = StopReason::Settled;
            return Ok(best);
        }
        adam.step(learning_rate, &mut theta, now.values);
        at = at.with_flat(&theta);
    }
}

#[cfg(test)]
mod tests {
    use super::Adam;

    #[test]
    fn the_first_step_has_the_length_of_the_rate_whatever_the_gradient() {
        // With m/(1-b1) = g and v/(1-b2) = g^2 the step is rate * g/|g|.
        let mut theta = [1.0, -2.0, 0.5];
        let mut adam = Adam::new(3, 1e-12);
        adam.step(1e-3, &mut theta, [1e-6, -3.0, 0.0]);
        assert!((theta[0] - (1.0 - 1e-3)).abs() < 1e-8);
        assert!((theta[1] - (-2.0 + 1e-3)).abs() < 1e-12);
        assert_eq!(theta[2], 0.5);
    }

    #[test]
    fn a_parabola_is_descended() {
        let mut theta = [3.0];
        let mut adam = Adam::new(1, 1e-12);
        for _ in 0..4000 {
            let slope = 2.0 * (theta[0] - 1.0);
            adam.step(1e-2, &mut theta, [slope]);
        }
        assert!((theta[0] - 1.0).abs() < 1e-3);
    }
}
