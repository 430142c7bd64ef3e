//! One network of the paper: its weights in padded rows, its activations of one block, y = act(x W + b) layer
//! by layer with its tangent, and the backward pass (reverse mode by hand).

use pulp::Simd;

use super::elementary::{sin_cos, tanh};
use super::product::{Rows, accumulate_gradient, accumulate_rows, affine, dot, padded};
use crate::networks::shape::LayerPlace;
use crate::parameters::OUTPUTS;

/// A hidden layer. With `RATE` each point has two rows: the value, and `m` rows later its rate of
/// change (the tangent); the activation is then the sine, else the hyperbolic tangent.
struct Hidden {
    place: LayerPlace,
    /// Columns of the input and of the output; all but the first input are padded.
    inputs: usize,
    outputs: usize,
    w: Vec<f32>,
    w_transposed: Vec<f32>,
    b: Vec<f32>,
    g_w: Vec<f32>,
    g_b: Vec<f32>,
    /// Values before the activation; the backward pass of the sine stores the cosine here.
    pre: Vec<f32>,
    /// Values after the activation.
    act: Vec<f32>,
}

/// Output layer with two linear outputs.
struct Output {
    place: LayerPlace,
    w: [Vec<f32>; OUTPUTS],
    b: [f32; OUTPUTS],
    g_w: [Vec<f32>; OUTPUTS],
    g_b: [f32; OUTPUTS],
}

/// A network's outputs at one point, or the loss's derivatives by them.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct PointValue {
    /// v, i of the VI-MLP; both outputs before the softplus of the RL-MLP.
    pub outputs: [f32; OUTPUTS],
    /// Rate of change of output 1: di/dtheta of the VI-MLP.
    pub rate: f32,
}

/// A network.
pub(super) struct Net<const RATE: bool> {
    hidden: Vec<Hidden>,
    output: Output,
    delta: [Vec<f32>; 2],
}

impl<const RATE: bool> Net<RATE> {
    /// Allocates buffers for blocks of up to `block` points.
    pub fn new(places: &[LayerPlace], block: usize) -> Self {
        let rows = if RATE { 2 * block } else { block };
        let (last, hidden) = places.split_last().expect("a network has an output layer");
        let mut widest = 0;
        let hidden: Vec<Hidden> = hidden
            .iter()
            .enumerate()
            .map(|(index, place)| {
                let inputs = if index == 0 {
                    place.inputs
                } else {
                    padded(place.inputs)
                };
                let outputs = padded(place.outputs);
                widest = widest.max(outputs);
                Hidden {
                    place: place.clone(),
                    inputs,
                    outputs,
                    w: vec![0.0; inputs * outputs],
                    w_transposed: vec![0.0; inputs * outputs],
                    b: vec![0.0; outputs],
                    g_w: vec![0.0; inputs * outputs],
                    g_b: vec![0.0; outputs],
                    pre: vec![0.0; rows * outputs],
                    act: vec![0.0; rows * outputs],
                }
            })
            .collect();
        let column = || std::array::from_fn(|_| vec![0.0; padded(last.inputs)]);
        Self {
            hidden,
            output: Output {
                place: last.clone(),
                w: column(),
                b: [0.0; OUTPUTS],
                g_w: column(),
                g_b: [0.0; OUTPUTS],
            },
            delta: std::array::from_fn(|_| vec![0.0; rows * widest]),
        }
    }

    /// Reads the weights from the flat vector and clears the gradient.
    pub fn load(&mut self, theta: &[f32]) {
        for layer in &mut self.hidden {
            let weights = &theta[layer.place.weights.clone()];
            for (k, row) in weights.chunks_exact(layer.place.outputs).enumerate() {
                layer.w[k * layer.outputs..][..row.len()].copy_from_slice(row);
                for (n, value) in row.iter().enumerate() {
                    layer.w_transposed[n * layer.inputs + k] = *value;
                }
            }
            layer.b[..layer.place.outputs].copy_from_slice(&theta[layer.place.biases.clone()]);
            layer.g_w.fill(0.0);
            layer.g_b.fill(0.0);
        }
        let output = &mut self.output;
        let weights = &theta[output.place.weights.clone()];
        for (k, row) in weights.chunks_exact(OUTPUTS).enumerate() {
            for (column, value) in output.w.iter_mut().zip(row) {
                column[k] = *value;
            }
        }
        output
            .b
            .copy_from_slice(&theta[output.place.biases.clone()]);
        output.g_w.iter_mut().for_each(|g| g.fill(0.0));
        output.g_b = [0.0; OUTPUTS];
    }

    /// Writes the gradient into the flat vector.
    pub fn store_gradient(&self, gradient: &mut [f32]) {
        for layer in &self.hidden {
            let rows = gradient[layer.place.weights.clone()].chunks_exact_mut(layer.place.outputs);
            for (row, g) in rows.zip(layer.g_w.chunks_exact(layer.outputs)) {
                row.copy_from_slice(&g[..row.len()]);
            }
            let biases = &mut gradient[layer.place.biases.clone()];
            biases.copy_from_slice(&layer.g_b[..layer.place.outputs]);
        }
        let output = &self.output;
        let rows = gradient[output.place.weights.clone()].chunks_exact_mut(OUTPUTS);
        for (k, row) in rows.enumerate() {
            for (slot, g) in row.iter_mut().zip(&output.g_w) {
                *slot = g[k];
            }
        }
        gradient[output.place.biases.clone()].copy_from_slice(&output.g_b);
    }

    /// The network's outputs at the points whose inputs are the rows of `x`; `x_rate` holds the
    /// inputs' rates of change and is not looked at without `RATE`.
    #[inline(always)]
    pub fn forward<S: Simd>(
        &mut self,
        s: S,
        x: &[f32],
        x_rate: &[f32],
        at_points: &mut [PointValue],
    ) {
        let m = at_points.len();
        for index in 0..self.hidden.len() {
            let (before, from_here) = self.hidden.split_at_mut(index);
            let layer = &mut from_here[0];
            let (inputs, n) = (layer.inputs, layer.outputs);
            let (values, rates) = match before.last() {
                None => (x, x_rate),
                Some(last) => last.act.split_at(m * inputs),
            };
            let rows = |values| Rows {
                values,
                width: inputs,
            };
            let (pre, pre_rate) = layer.pre.split_at_mut(m * n);
            let values = &values[..m * inputs];
            affine(s, rows(values), &layer.w, Some(&layer.b), pre, n);
            if RATE {
                let pre_rate = &mut pre_rate[..m * n];
                affine(s, rows(&rates[..m * inputs]), &layer.w, None, pre_rate, n);
                let (act, act_rate) = layer.act.split_at_mut(m * n);
                sines(s, pre, pre_rate, act, &mut act_rate[..m * n]);
            } else {
                tangents(s, pre, &mut layer.act[..m * n]);
            }
        }
        let Some(last) = self.hidden.last() else {
            return;
        };
        let (n, output) = (last.outputs, &self.output);
        for (p, at) in at_points.iter_mut().enumerate() {
            let act = &last.act[p * n..(p + 1) * n];
            // No closure: one that is not inlined would lose the instruction set.
            at.outputs = [
                output.b[0] + dot(s, act, &output.w[0]),
                output.b[1] + dot(s, act, &output.w[1]),
            ];
            if RATE {
                at.rate = dot(s, &last.act[(m + p) * n..(m + p + 1) * n], &output.w[1]);
            }
        }
    }

    /// Adds to the gradient, `by` being the loss's derivatives by the outputs that
    /// [`Self::forward`] last gave for the same `x`.
    #[inline(always)]
    pub fn backward<S: Simd>(&mut self, s: S, x: &[f32], x_rate: &[f32], by: &[PointValue]) {
        let m = by.len();
        self.backward_output(s, by);
        let [delta, next] = &mut self.delta;
        for index in (0..self.hidden.len()).rev() {
            let (before, from_here) = self.hidden.split_at_mut(index);
            let layer = &mut from_here[0];
            let (inputs, n) = (layer.inputs, layer.outputs);
            let (d, d_rate) = delta.split_at_mut(m * n);
            let (pre, pre_rate) = layer.pre.split_at(m * n);
            if RATE {
                sines_back(
                    s,
                    pre,
                    &pre_rate[..m * n],
                    &layer.act[..m * n],
                    d,
                    &mut d_rate[..m * n],
                );
            } else {
                tangents_back(s, &layer.act[..m * n], d);
            }
            accumulate_rows(s, d, &mut layer.g_b);
            let rows = |values| Rows {
                values,
                width: inputs,
            };
            let all = if RATE { 2 * m } else { m };
            match before.last() {
                None => {
                    accumulate_gradient(s, rows(x), d, &mut layer.g_w, n);
                    if RATE {
                        let d_rate = &d_rate[..m * n];
                        accumulate_gradient(s, rows(x_rate), d_rate, &mut layer.g_w, n);
                    }
                }
                Some(last) => {
                    let d = &delta[..all * n];
                    let input = rows(&last.act[..all * inputs]);
                    accumulate_gradient(s, input, d, &mut layer.g_w, n);
                    let d = Rows {
                        values: d,
                        width: n,
                    };
                    let out = &mut next[..all * inputs];
                    affine(s, d, &layer.w_transposed, None, out, inputs);
                    std::mem::swap(delta, next);
                }
            }
        }
    }

    /// The output layer's part of [`Self::backward`]: its gradient, and the first delta.
    #[inline(always)]
    fn backward_output<S: Simd>(&mut self, s: S, by: &[PointValue]) {
        let Some(last) = self.hidden.last() else {
            return;
        };
        let (m, n) = (by.len(), last.outputs);
        let output = &mut self.output;
        let [w0, w1] = &output.w;
        let [(w0, _), (w1, _)] = [S::as_simd_f32s(w0), S::as_simd_f32s(w1)];
        let [g0, g1] = &mut output.g_w;
        let (g0, g1) = (S::as_mut_simd_f32s(g0).0, S::as_mut_simd_f32s(g1).0);
        let (act, act_rate) = last.act.split_at(m * n);
        let (delta, delta_rate) = self.delta[0].split_at_mut(m * n);
        for (p, by) in by.iter().enumerate() {
            let row = p * n..(p + 1) * n;
            let (act, _) = S::as_simd_f32s(&act[row.clone()]);
            let (delta, _) = S::as_mut_simd_f32s(&mut delta[row.clone()]);
            let [by0, by1] = by.outputs.map(|y| s.splat_f32s(y));
            for k in 0..act.len() {
                delta[k] = s.mul_add_e_f32s(by1, w1[k], s.mul_f32s(by0, w0[k]));
                g0[k] = s.mul_add_e_f32s(by0, act[k], g0[k]);
                g1[k] = s.mul_add_e_f32s(by1, act[k], g1[k]);
            }
            if RATE {
                let (act_rate, _) = S::as_simd_f32s(&act_rate[row.clone()]);
                let (delta_rate, _) = S::as_mut_simd_f32s(&mut delta_rate[row]);
                let by_rate = s.splat_f32s(by.rate);
                for k in 0..act_rate.len() {
                    delta_rate[k] = s.mul_f32s(by_rate, w1[k]);
                    g1[k] = s.mul_add_e_f32s(by_rate, act_rate[k], g1[k]);
                }
            }
            for (sum, by) in output.g_b.iter_mut().zip(by.outputs) {
                *sum += by;
            }
        }
    }
}

/// `act = sin pre`, `act_rate = cos pre * pre_rate`; the cosine stays in `pre`.
#[inline(always)]
fn sines<S: Simd>(s: S, pre: &mut [f32], pre_rate: &[f32], act: &mut [f32], act_rate: &mut [f32]) {
    let (pre, pre_rate) = (S::as_mut_simd_f32s(pre).0, S::as_simd_f32s(pre_rate).0);
    let (act, act_rate) = (S::as_mut_simd_f32s(act).0, S::as_mut_simd_f32s(act_rate).0);
    let rates = pre_rate.iter().zip(act_rate);
    for ((pre, act), (pre_rate, act_rate)) in pre.iter_mut().zip(act).zip(rates) {
        let (sin, cos) = sin_cos(s, *pre);
        *act = sin;
        *act_rate = s.mul_f32s(cos, *pre_rate);
        *pre = cos;
    }
}

/// From derivatives by `act`, `act_rate` to those by the value before the sine and its rate, in
/// place: d/dz = cos z d - sin z z' d', d/dz' = cos z d'.
#[inline(always)]
fn sines_back<S: Simd>(
    s: S,
    cos: &[f32],
    pre_rate: &[f32],
    sin: &[f32],
    d: &mut [f32],
    d_rate: &mut [f32],
) {
    let (cos, pre_rate) = (S::as_simd_f32s(cos).0, S::as_simd_f32s(pre_rate).0);
    let (sin, d) = (S::as_simd_f32s(sin).0, S::as_mut_simd_f32s(d).0);
    let (d_rate, _) = S::as_mut_simd_f32s(d_rate);
    let forward = cos.iter().zip(sin).zip(pre_rate);
    for (((cos, sin), pre_rate), (d, d_rate)) in forward.zip(d.iter_mut().zip(d_rate)) {
        let bend = s.mul_f32s(s.mul_f32s(*sin, *pre_rate), *d_rate);
        *d = s.sub_f32s(s.mul_f32s(*cos, *d), bend);
        *d_rate = s.mul_f32s(*cos, *d_rate);
    }
}

/// `act = tanh pre`.
#[inline(always)]
fn tangents<S: Simd>(s: S, pre: &[f32], act: &mut [f32]) {
    let (pre, act) = (S::as_simd_f32s(pre).0, S::as_mut_simd_f32s(act).0);
    for (pre, act) in pre.iter().zip(act) {
        *act = tanh(s, *pre);
    }
}

/// From derivatives by `act` to those by the value before, in place: d tanh = 1 - tanh^2.
#[inline(always)]
fn tangents_back<S: Simd>(s: S, act: &[f32], d: &mut [f32]) {
    let (act, d) = (S::as_simd_f32s(act).0, S::as_mut_simd_f32s(d).0);
    let one = s.splat_f32s(1.0);
    for (act, d) in act.iter().zip(d) {
        *d = s.mul_f32s(*d, s.sub_f32s(one, s.mul_f32s(*act, *act)));
    }
}
