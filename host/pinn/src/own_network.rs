//! The RL-MLP in own code, at all slow times at once: values and derivatives in double precision.
//!
//! The values of all times are adjacent, so that every loop runs over the times. Loops are compiled for the instruction set
//! that `pulp` detects, with explicit fused multiply-adds, so that the digits do not depend on it.

use ihd_signal::vectorised::{LN_2, vectorised};

use crate::network_jacobian::{LayerDerivatives, NetworkJacobian};
use crate::normal_matrix::add_times;
use crate::parameters::{OUTPUTS, Parameters, softplus};

/// Inputs of the RL-MLP at a list of times.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct OwnNetwork {
    times: usize,
    /// Features of all times, feature by feature; then ones, for the biases.
    features: Vec<f64>,
}

/// Inputs of each layer at all times, and outputs of the last.
pub(crate) struct Activations<'a> {
    network: &'a OwnNetwork,
    /// Values of each hidden layer after the tanh, unit by unit; then ones.
    hidden: Vec<Vec<f64>>,
    /// Values before the softplus, output by output.
    sums: Vec<f64>,
}

impl OwnNetwork {
    /// Computes the inputs from `parameters` and these times, in seconds after a mains zero crossing.
    pub fn at(parameters: &Parameters, t_s: impl Iterator<Item = f64>) -> Self {
        let rows: Vec<Vec<f64>> = t_s.map(|t_s| parameters.features(t_s)).collect();
        let column = |k: usize| rows.iter().map(move |row| row[k]);
        Self {
            times: rows.len(),
            features: (0..parameters.width())
                .flat_map(column)
                .chain(ones(rows.len()))
                .collect(),
        }
    }

    /// Computes all layers with the weights of `parameters`.
    pub fn forward(&self, parameters: &Parameters) -> Activations<'_> {
        let mut activations = Activations {
            network: self,
            hidden: Vec::with_capacity(parameters.layers.len()),
            sums: Vec::new(),
        };
        for (index, layer) in parameters.layers.iter().enumerate() {
            let input = activations.input(index);
            let mut sums = vec![0.0; layer.outputs * self.times];
            let hidden = index + 1 < parameters.layers.len();
            vectorised(
                #[inline(always)]
                || {
                    let units = sums.chunks_exact_mut(self.times.max(1));
                    for (o, (sums, bias)) in units.zip(&layer.biases).enumerate() {
                        sums.fill(*bias);
                        let weights = layer.weights.chunks_exact(layer.outputs);
                        for (x, weights) in input.chunks_exact(self.times.max(1)).zip(weights) {
                            add_times(sums, x, weights[o]);
                        }
                        if hidden {
                            sums.iter_mut().for_each(|x| *x = tanh(*x));
                        }
                    }
                },
            );
            if hidden {
                sums.extend(ones(self.times));
                activations.hidden.push(sums);
            } else {
                activations.sums = sums;
            }
        }
        activations
    }
}

impl Activations<'_> {
    /// Inputs of a layer.
    fn input(&self, layer: usize) -> &[f64] {
        match layer.checked_sub(1) {
            None => &self.network.features,
            Some(before) => &self.hidden[before],
        }
    }

    /// R / r_scale and L / l_scale at each time.
    pub fn outputs(&self) -> Vec<[f64; OUTPUTS]> {
        let times = self.network.times;
        let at = |k: usize| std::array::from_fn(|o| softplus(self.sums[o * times + k]));
        (0..times).map(at).collect()
    }

    /// Derivatives by all parameters, in the order of `Parameters::flat`, of weighted sums of the outputs. One row per time for
    /// each of `factors`, which hold the weights of the two outputs at each time.
    pub fn derivatives(
        &self,
        parameters: &Parameters,
        factors: &[[Vec<f64>; OUTPUTS]],
    ) -> NetworkJacobian {
        let times = self.network.times;
        let rows = factors.len() * times;
        // softplus' = 1 / (1 + e^-x).
        let slopes: Vec<f64> = self.sums.iter().map(|x| 1.0 / (1.0 + (-x).exp())).collect();
        let of_output = |o: usize| {
            let slopes = &slopes[o * times..(o + 1) * times];
            let factors = factors.iter().flat_map(move |by| &by[o]);
            factors.zip(slopes.iter().cycle()).map(|(f, s)| f * s)
        };
        let mut delta: Vec<f64> = (0..OUTPUTS).flat_map(of_output).collect();
        let mut layers = Vec::with_capacity(parameters.layers.len());
        for (index, layer) in parameters.layers.iter().enumerate().rev() {
            let input = self.input(index);
            // The first layer's inputs are the features.
            let mut before = vec![0.0; if index > 0 { layer.inputs * rows } else { 0 }];
            // d tanh = 1 - tanh², and the input is that tanh.
            vectorised(
                #[inline(always)]
                || {
                    let weights = layer.weights.chunks_exact(layer.outputs);
                    let units = input.chunks_exact(times.max(1));
                    let of_unit = before.chunks_exact_mut(rows.max(1));
                    for ((before, weights), x) in of_unit.zip(weights).zip(units) {
                        for (delta, weight) in delta.chunks_exact(rows.max(1)).zip(weights) {
                            add_times(before, delta, *weight);
                        }
                        for before in before.chunks_exact_mut(times.max(1)) {
                            for (d, a) in before.iter_mut().zip(x) {
                                *d *= (-a).mul_add(*a, 1.0);
                            }
                        }
                    }
                },
            );
            let inputs = input.to_vec();
            let by_sums = std::mem::replace(&mut delta, before);
            layers.push(LayerDerivatives { inputs, by_sums });
        }
        layers.reverse();
        NetworkJacobian {
            times,
            rows,
            layers,
        }
    }
}

/// Input of the biases at so many times.
fn ones(times: usize) -> impl Iterator<Item = f64> {
    std::iter::repeat_n(1.0, times)
}

/// tanh x to 3e-16, without branches.
#[inline(always)]
fn tanh(x: f64) -> f64 {
    let e = exp_negative(-2.0 * x.abs());
    ((1.0 - e) / (1.0 + e)).copysign(x)
}

/// e^x for x ≤ 0; below −700 that of −700. NaN stays NaN.
#[inline(always)]
fn exp_negative(x: f64) -> f64 {
    /// Constant whose addition leaves the integer part of a small number in the last bits.
    const WHOLE: f64 = 6_755_399_441_055_744.0;
    /// 1/k! from k = 13 down to 2; the remainder is below 2e-17.
    const TAYLOR: [f64; 12] = [
        1.605_904_383_682_161_3e-10,
        2.087_675_698_786_81e-9,
        2.505_210_838_544_172e-8,
        2.755_731_922_398_589e-7,
        2.755_731_922_398_589_3e-6,
        2.480_158_730_158_73e-5,
        1.984_126_984_126_984e-4,
        1.388_888_888_888_889e-3,
        8.333_333_333_333_333e-3,
        4.166_666_666_666_666_4e-2,
        1.666_666_666_666_666_6e-1,
        0.5,
    ];
    // `max` would replace NaN by −700.
    let x = if x < -700.0 { -700.0 } else { x };
    let shifted = x.mul_add(std::f64::consts::LOG2_E, WHOLE);
    let whole = shifted - WHOLE;
    let rest = (-whole).mul_add(LN_2.1, (-whole).mul_add(LN_2.0, x));
    let mut sum = TAYLOR[0];
    for term in &TAYLOR[1..] {
        sum = sum.mul_add(rest, *term);
    }
    let power = (rest * rest).mul_add(sum, rest) + 1.0;
    power * f64::from_bits(shifted.to_bits().wrapping_add(1023) << 52)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trial;

    #[test]
    fn tanh_is_tanh_and_carries_what_is_no_number() {
        for k in -4000..4000 {
            let x = f64::from(k) * 0.01 + 1e-3;
            assert!((tanh(x) - x.tanh()).abs() < 4e-16, "{x}");
        }
        for x in [0.0, -0.0, 1e-300, 1e300, f64::INFINITY, f64::NEG_INFINITY] {
            assert!((tanh(x) - x.tanh()).abs() < 4e-16, "{x}");
        }
        assert!(tanh(f64::NAN).is_nan());
        for x in [-0.1, -1.0, -17.3, -345.6, -699.0] {
            assert!((exp_negative(x) / x.exp() - 1.0).abs() < 1e-15);
        }
    }

    #[test]
    fn values_are_those_of_the_parameters_one_by_one() {
        let network = trial::network();
        let times = [1e-3, 2.7e-3, 9.9e-3];
        let all = OwnNetwork::at(&network, times.into_iter());
        for (t_s, found) in times.iter().zip(all.forward(&network).outputs()) {
            let right = network.outputs(&network.features(*t_s));
            assert!((found[0] - right[0]).abs() + (found[1] - right[1]).abs() < 1e-14);
        }
    }

    #[test]
    fn the_derivatives_are_finite_differences() {
        let network = trial::network();
        let times = [0.4e-3, 2.7e-3];
        let all = OwnNetwork::at(&network, times.into_iter());
        // R alone, and a mixture that differs from time to time.
        let factors = [
            [vec![1.0; 2], vec![0.0; 2]],
            [vec![-0.5, 2.0], vec![0.25, 3.0]],
        ];
        let found = all.forward(&network).derivatives(&network, &factors);
        let found = found.dense();
        let flat = network.flat();
        assert_eq!(found.shape(), (4, flat.len()));
        let step = 1e-6;
        for p in 0..flat.len() {
            let at = |shift: f64| {
                let mut moved = flat.clone();
                moved[p] += shift;
                all.forward(&network.with_flat(&moved)).outputs()
            };
            let (after, before) = (at(step), at(-step));
            for (block, factors) in factors.iter().enumerate() {
                for k in 0..2 {
                    let sum = |y: &[[f64; 2]]| factors[0][k] * y[k][0] + factors[1][k] * y[k][1];
                    let numeric = (sum(&after) - sum(&before)) / (2.0 * step);
                    assert!((numeric - found[(2 * block + k, p)]).abs() < 1e-8);
                }
            }
        }
    }
}
