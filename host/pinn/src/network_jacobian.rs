//! Jacobian of weighted sums of the RL-MLP's outputs, kept as factors.
//!
//! The derivative by a weight is the weight's input times the derivative by the sum that it is part of. All residuals of a time have
//! the same inputs. An entry of JᵀJ, for a weight from a to b and one from c to d, is therefore Σ (a c) (b d) over the times: the sums of
//! pairs of inputs with pairs of derivatives, of which there are less than half as many products as of columns with columns.

use ihd_signal::vectorised::{dot, vectorised};
use nalgebra::{DMatrix, DVector};

use crate::normal_matrix::{add_times, dots_between};

/// Derivatives by the parameters of one layer.
pub(crate) struct LayerDerivatives {
    /// Inputs of the layer at all times, input by input; the last is 1, for the biases.
    pub inputs: Vec<f64>,
    /// Derivatives of all residuals by each sum of the layer, sum by sum.
    pub by_sums: Vec<f64>,
}

/// Derivatives of residuals by all parameters, in the order of `Parameters::flat`. A row per residual: all times of the first kind
/// of residual, then of the next.
pub(crate) struct NetworkJacobian {
    /// Number of times.
    pub times: usize,
    /// Number of residuals, a multiple of the number of times.
    pub rows: usize,
    /// The first layer first.
    pub layers: Vec<LayerDerivatives>,
}

/// One layer with the place of its parameters.
struct Block<'a> {
    first: usize,
    inputs: Vec<&'a [f64]>,
    by_sums: Vec<&'a [f64]>,
}

impl Block<'_> {
    fn parameter(&self, input: usize, sum: usize) -> usize {
        self.first + input * self.by_sums.len() + sum
    }
}

impl NetworkJacobian {
    fn blocks(&self) -> Vec<Block<'_>> {
        let mut first = 0;
        let mut blocks = Vec::with_capacity(self.layers.len());
        for LayerDerivatives { inputs, by_sums } in &self.layers {
            let block = Block {
                first,
                inputs: inputs.chunks_exact(self.times.max(1)).collect(),
                by_sums: by_sums.chunks_exact(self.rows.max(1)).collect(),
            };
            first = block.parameter(block.inputs.len(), 0);
            blocks.push(block);
        }
        blocks
    }

    /// Number of parameters.
    pub fn columns(&self) -> usize {
        let blocks = self.blocks();
        blocks.last().map_or(0, |b| b.parameter(b.inputs.len(), 0))
    }

    /// J.
    pub fn dense(&self) -> DMatrix<f64> {
        let mut all = Vec::with_capacity(self.rows * self.columns());
        for block in self.blocks() {
            for input in block.inputs {
                for by_sum in &block.by_sums {
                    for of_kind in by_sum.chunks_exact(self.times) {
                        all.extend(of_kind.iter().zip(input).map(|(d, x)| d * x));
                    }
                }
            }
        }
        DMatrix::from_vec(self.rows, self.columns(), all)
    }

    /// JᵀJ.
    pub fn gram(&self) -> DMatrix<f64> {
        let (blocks, columns) = (self.blocks(), self.columns());
        let mut product = DMatrix::zeros(columns, columns);
        let mut set = |row, column, sum| {
            product[(row, column)] = sum;
            product[(column, row)] = sum;
        };
        for (k, a) in blocks.iter().enumerate() {
            for (after, b) in blocks[k..].iter().enumerate() {
                let same = after == 0;
                let inputs = pairs(a.inputs.len(), b.inputs.len(), same);
                let by_sums = pairs(a.by_sums.len(), b.by_sums.len(), same);
                let of_inputs = self.products(&inputs, &a.inputs, &b.inputs);
                let of_sums = self.products(&by_sums, &a.by_sums, &b.by_sums);
                let sums = dots_between(&of_inputs, &of_sums, self.times);
                for (r, &(i, j)) in inputs.iter().enumerate() {
                    for (c, &(m, n)) in by_sums.iter().enumerate() {
                        set(a.parameter(i, m), b.parameter(j, n), sums[(r, c)]);
                        if same {
                            set(a.parameter(i, n), b.parameter(j, m), sums[(r, c)]);
                        }
                    }
                }
            }
        }
        product
    }

    /// Products of these pairs of `a` and `b` at each time, summed over the kinds of residuals.
    fn products(&self, pairs: &[(usize, usize)], a: &[&[f64]], b: &[&[f64]]) -> Vec<f64> {
        let mut products = vec![0.0; pairs.len() * self.times];
        vectorised(
            #[inline(always)]
            || {
                for (out, &(i, j)) in products.chunks_exact_mut(self.times).zip(pairs) {
                    let kinds = a[i].chunks_exact(self.times);
                    for (a, b) in kinds.zip(b[j].chunks_exact(self.times)) {
                        add_products(out, a, b);
                    }
                }
            },
        );
        products
    }

    /// Jᵀx.
    pub fn transposed_times(&self, x: &[f64]) -> DVector<f64> {
        let mut out = DVector::zeros(self.columns());
        let mut weighted = vec![0.0; self.times];
        for block in self.blocks() {
            vectorised(
                #[inline(always)]
                || {
                    for (n, by_sum) in block.by_sums.iter().enumerate() {
                        weighted.fill(0.0);
                        let kinds = by_sum.chunks_exact(self.times);
                        for (d, x) in kinds.zip(x.chunks_exact(self.times)) {
                            add_products(&mut weighted, d, x);
                        }
                        for (m, input) in block.inputs.iter().enumerate() {
                            out[block.parameter(m, n)] = dot(input, &weighted);
                        }
                    }
                },
            );
        }
        out
    }

    /// Jx.
    pub fn times(&self, x: &DVector<f64>) -> Vec<f64> {
        let mut out = vec![0.0; self.rows];
        let mut change = vec![0.0; self.times];
        for block in self.blocks() {
            vectorised(
                #[inline(always)]
                || {
                    for (n, by_sum) in block.by_sums.iter().enumerate() {
                        change.fill(0.0);
                        for (m, input) in block.inputs.iter().enumerate() {
                            let weight = x[block.parameter(m, n)];
                            add_times(&mut change, input, weight);
                        }
                        let kinds = by_sum.chunks_exact(self.times);
                        for (out, d) in out.chunks_exact_mut(self.times).zip(kinds) {
                            add_products(out, d, &change);
                        }
                    }
                },
            );
        }
        out
    }
}

/// Pairs of one of `a` and one of `b`; of the same layer each once in either order.
fn pairs(a: usize, b: usize, same: bool) -> Vec<(usize, usize)> {
    let second = |i| (if same { i } else { 0 })..b;
    (0..a)
        .flat_map(|i| second(i).map(move |j| (i, j)))
        .collect()
}

/// `sums += a · b`, for use within [`vectorised`].
#[inline(always)]
fn add_products(sums: &mut [f64], a: &[f64], b: &[f64]) {
    for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
        *sum = a.mul_add(*b, *sum);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::own_network::OwnNetwork;
    use crate::trial;

    #[test]
    fn products_are_those_of_the_matrix() {
        let network = trial::network();
        let times: Vec<f64> = (0..37).map(|k| 0.27e-3 * f64::from(k)).collect();
        let factors = [1.0, -0.7].map(|share| {
            let of_r = times.iter().map(|t| share + 40.0 * t).collect();
            [of_r, times.iter().map(|t| 1.0 - share * t).collect()]
        });
        let jacobian = OwnNetwork::at(&network, times.iter().copied())
            .forward(&network)
            .derivatives(&network, &factors);
        let dense = jacobian.dense();
        assert_eq!(dense.shape(), (2 * times.len(), network.flat_len()));
        let right = dense.transpose() * &dense;
        assert!((jacobian.gram() - &right).amax() < 1e-13 * right.amax());
        let x = DVector::from_fn(dense.ncols(), |k, _| (k as f64).sin());
        assert!((DVector::from(jacobian.times(&x)) - &dense * &x).amax() < 1e-12);
        let y = DVector::from_fn(dense.nrows(), |k, _| (k as f64).cos());
        let back = jacobian.transposed_times(y.as_slice());
        assert!((back - dense.transpose() * y).amax() < 1e-11);
    }
}
