//! The paper's two networks, VI-MLP (eq. (2)) and RL-MLP (eq. (3)), trained together on every sample: eq. (7) by
//! Adam.

mod burn_kernel;
pub(crate) mod checkpoint;
mod collocation;
mod fused;
mod kernel;
mod shape;
mod train;

pub(crate) use train::identify;

/// Outputs of a VI branch at some of the window's samples, normalised.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Signals {
    /// Indices of the samples, ascending.
    pub sample: Vec<usize>,
    pub v: Vec<f64>,
    pub i: Vec<f64>,
}

/// Signals of shuffled points in order of time.
fn in_order(sample: &[usize], v: &[f32], i: &[f32]) -> Signals {
    let mut order: Vec<usize> = (0..sample.len()).collect();
    order.sort_by_key(|at| sample[*at]);
    let pick = |x: &[f32]| order.iter().map(|at| f64::from(x[*at])).collect();
    Signals {
        sample: order.iter().map(|at| sample[*at]).collect(),
        v: pick(v),
        i: pick(i),
    }
}
