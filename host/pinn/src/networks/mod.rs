//! The paper's two networks, VI-MLP (eq. (2)) and RL-MLP (eq. (3)), trained together on every sample: eq. (7) by
//! Adam.

mod burn_kernel;
pub(crate) mod checkpoint;
mod collocation;
mod fused;
mod kernel;
mod shape;
pub(crate) mod signals;
mod train;

use self::signals::Signals;
pub(crate) use self::train::identify;

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
