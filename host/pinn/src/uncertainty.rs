//! Standard deviations of R(t) and L(t): Laplace's approximation around the hybrid's minimum (MacKay 1992).
//!
//! With normal noise of variance s^2 on each residual and the prior's pull, the weights are normal
//! around the minimum with covariance `s^2 (J^T J + strength I)^-1`; R and L are linear in them to
//! first order.

use nalgebra::{DMatrix, DVector};

use crate::PinnError;
use crate::output_jacobian::output_rows;
use crate::parameters::{OUTPUTS, Parameters};
use crate::slow_model::SlowModel;

/// Ridge relative to the largest diagonal entry, for directions that no residual sees.
const RIDGE: f64 = 1e-12;

/// Standard deviations of R (ohm) and L (H) at given times.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Sigmas {
    pub r_ohm: Vec<f64>,
    pub l_h: Vec<f64>,
}

/// Laplace's approximation at `parameters`, `noise` being the variance of one residual and
/// `strength` the prior's; nothing where the normal matrix is singular beyond repair.
pub(crate) fn laplace(
    model: &SlowModel,
    parameters: &Parameters,
    noise: f64,
    strength: f64,
    times_s: &[f64],
) -> Result<Option<Sigmas>, PinnError> {
    let count = parameters.flat_len();
    let rows = model.jacobian(parameters)?;
    let transposed = DMatrix::from_column_slice(count, rows.len() / count, &rows);
    let mut normal = &transposed * transposed.transpose();
    let ridge = strength + RIDGE * normal.diagonal().max();
    for k in 0..count {
        normal[(k, k)] += ridge;
    }
    let Some(factor) = normal.cholesky() else {
        return Ok(None);
    };
    let deviation = |row: &Vec<f64>| {
        let row = DVector::from_column_slice(row);
        (noise * row.dot(&factor.solve(&row))).max(0.0).sqrt()
    };
    let mut sigmas = Sigmas {
        r_ohm: Vec::with_capacity(times_s.len()),
        l_h: Vec::with_capacity(times_s.len()),
    };
    for &t_s in times_s {
        let features = parameters.features(t_s);
        let [r, l] = output_rows(parameters, &features);
        sigmas.r_ohm.push(parameters.r_scale_ohm * deviation(&r));
        sigmas.l_h.push(parameters.l_scale_h * deviation(&l));
    }
    Ok(Some(sigmas))
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
