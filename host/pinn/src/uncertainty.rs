//! Standard deviations of R(t) and L(t): Laplace's approximation around the hybrid's minimum (MacKay 1992).
//!
//! With normal noise of variance s^2 on each residual and the prior, the weights are normal
//! around the minimum with covariance `s^2 (J^T J + strength I)^-1`; R and L are linear in them to
//! first order.

use crate::PinnError;
use crate::normal_matrix::Factor;
use crate::own_network::OwnNetwork;
use crate::parameters::{OUTPUTS, Parameters};
use crate::slow_model::SlowModel;

/// Ridge relative to the largest diagonal entry, for directions that no residual determines.
const RIDGE: f64 = 1e-12;

/// Standard deviations of R (ohm) and L (H) at given times.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Sigmas {
    pub r_ohm: Vec<f64>,
    pub l_h: Vec<f64>,
}

/// Laplace's approximation at `parameters`, with `noise` the variance of one residual and
/// `strength` the prior's; `None` if the normal matrix is singular.
pub(crate) fn laplace(
    model: &SlowModel,
    parameters: &Parameters,
    noise: f64,
    strength: f64,
    times_s: &[f64],
) -> Result<Option<Sigmas>, PinnError> {
    let normal = model.jacobian(parameters)?.gram();
    let ridge = strength + RIDGE * normal.diagonal().max();
    let Some(factor) = Factor::new(&normal, ridge) else {
        return Ok(None);
    };
    let times = times_s.len();
    let (all, none) = (vec![1.0; times], vec![0.0; times]);
    let outputs = [[all.clone(), none.clone()], [none, all]];
    let network = OwnNetwork::at(parameters, times_s.iter().copied());
    let rows = network
        .forward(parameters)
        .derivatives(parameters, &outputs);
    let mut r_ohm: Vec<f64> = factor.inverse_forms(&rows.dense());
    r_ohm.iter_mut().for_each(|x| *x = (noise * *x).sqrt());
    let mut l_h = r_ohm.split_off(times);
    r_ohm.iter_mut().for_each(|x| *x *= parameters.r_scale_ohm);
    l_h.iter_mut().for_each(|x| *x *= parameters.l_scale_h);
    Ok(Some(Sigmas { r_ohm, l_h }))
}

/// Spread of an ensemble's members: the sample standard deviation at each time.
pub(crate) fn spread(members: &[&[f64]]) -> Vec<f64> {
    let count = members.len() as f64;
    let times = members.first().map_or(0, |m| m.len());
    (0..times)
        .map(|k| {
            let mean = members.iter().map(|m| m[k]).sum::<f64>() / count;
            let squares: f64 = members.iter().map(|m| (m[k] - mean).powi(2)).sum();
            (squares / (count - 1.0).max(1.0)).sqrt()
        })
        .collect()
}

const _: () = assert!(OUTPUTS == 2, "R and L");

#[cfg(test)]
mod tests {
    use super::spread;

    #[test]
    fn the_spread_is_the_sample_standard_deviation() {
        let (a, b, c) = ([1.0, 5.0], [2.0, 5.0], [3.0, 5.0]);
        assert_eq!(spread(&[&a, &b, &c]), [1.0, 0.0]);
    }
}
