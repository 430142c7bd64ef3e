//! Eq. (7) of the paper's two networks and its gradient by one fused kernel: forward pass, tangent, loss and
//! backward pass over blocks of points that stay in the cache, in single precision and on one core.

mod elementary;
mod net;
mod product;

use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};

use self::elementary::softplus;
use self::net::{Net, PointValue};
use super::kernel::{Kernel, Problem, Terms, Weights};
use super::shape::Shape;
use crate::PinnError;

/// Points per block, whose activations fit the second-level cache.
const BLOCK: usize = 64;

/// Both networks with their buffers.
pub(crate) struct Fused {
    arch: Arch,
    vi: Net<true>,
    rl: Net<false>,
    /// Outputs of a block's points, then the loss's derivatives by them.
    vi_points: Vec<PointValue>,
    rl_points: Vec<PointValue>,
}

impl Fused {
    /// Allocates the buffers for networks of this shape.
    pub fn new(shape: &Shape) -> Self {
        Self {
            arch: Arch::new(),
            vi: Net::new(&shape.vi, BLOCK),
            rl: Net::new(&shape.rl, BLOCK),
            vi_points: vec![PointValue::default(); BLOCK],
            rl_points: vec![PointValue::default(); BLOCK],
        }
    }
}

impl Kernel for Fused {
    fn loss(
        &mut self,
        problem: &Problem<'_>,
        theta: &[f32],
        batch: Range<usize>,
        weights: Weights,
        gradient: &mut [f32],
    ) -> Result<Terms, PinnError> {
        self.vi.load(theta);
        self.rl.load(theta);
        let arch = self.arch;
        let terms = arch.dispatch(Pass {
            nets: self,
            problem,
            batch,
            weights,
        });
        self.vi.store_gradient(gradient);
        self.rl.store_gradient(gradient);
        Ok(terms)
    }

    fn signals(
        &mut self,
        problem: &Problem<'_>,
        theta: &[f32],
    ) -> Result<(Vec<f32>, Vec<f32>), PinnError> {
        self.vi.load(theta);
        let arch = self.arch;
        Ok(arch.dispatch(Signals {
            nets: self,
            problem,
        }))
    }
}

/// Loss and gradient over `batch`.
struct Pass<'a> {
    nets: &'a mut Fused,
    problem: &'a Problem<'a>,
    batch: Range<usize>,
    weights: Weights,
}

impl WithSimd for Pass<'_> {
    type Output = Terms;

    #[inline(always)]
    fn with_simd<S: Simd>(self, s: S) -> Terms {
        let (nets, points) = (self.nets, self.problem.points);
        let (fast, slow) = (points.fast_width, points.slow_width);
        let count = self.batch.len();
        let mut squares = [0.0_f64; 3];
        for start in self.batch.clone().step_by(BLOCK) {
            let end = (start + BLOCK).min(self.batch.end);
            let m = end - start;
            let x = &points.fast[start * fast..end * fast];
            let x_rate = &points.fast_rate[start * fast..end * fast];
            let x_slow = &points.slow[start * slow..end * slow];
            let (vi_points, rl_points) = (&mut nets.vi_points[..m], &mut nets.rl_points[..m]);
            nets.vi.forward(s, x, x_rate, vi_points);
            nets.rl.forward(s, x_slow, &[], rl_points);
            let samples = points.v[start..end].iter().zip(&points.i[start..end]);
            for ((vi, rl), (v, i)) in vi_points.iter_mut().zip(rl_points.iter_mut()).zip(samples) {
                let residuals = differentiate(self.problem, self.weights, count, vi, rl, *v, *i);
                for (sum, e) in squares.iter_mut().zip(residuals) {
                    *sum += f64::from(e * e);
                }
            }
            nets.vi.backward(s, x, x_rate, vi_points);
            nets.rl.backward(s, x_slow, &[], rl_points);
        }
        let [l_f, l_i1, l_i2] = squares.map(|sum| sum / count.max(1) as f64);
        Terms { l_f, l_i1, l_i2 }
    }
}

/// The three residuals at one point; replaces the networks' outputs by the loss's derivatives by
/// them.
#[inline(always)]
fn differentiate(
    problem: &Problem<'_>,
    weights: Weights,
    count: usize,
    vi: &mut PointValue,
    rl: &mut PointValue,
    v: f32,
    i: f32,
) -> [f32; 3] {
    let [v_hat, i_hat] = vi.outputs;
    let [(y_r, slope_r), (y_x, slope_x)] = rl.outputs.map(softplus);
    let (r, x) = (problem.impedances.r * y_r, problem.impedances.x * y_x);
    let physics = v_hat - r * i_hat - x * vi.rate;
    let residuals = [physics, v_hat - v, i_hat - i];
    let share = 2.0 / count as f32;
    let by_physics = share * weights.w_f * physics;
    let by_data = [residuals[1], residuals[2]].map(|e| share * weights.w_i * e);
    *rl = PointValue {
        outputs: [
            -by_physics * problem.impedances.r * slope_r * i_hat,
            -by_physics * problem.impedances.x * slope_x * vi.rate,
        ],
        rate: 0.0,
    };
    *vi = PointValue {
        outputs: [by_data[0] + by_physics, by_data[1] - by_physics * r],
        rate: -by_physics * x,
    };
    residuals
}

/// `v_hat` and `i_hat` at all points.
struct Signals<'a> {
    nets: &'a mut Fused,
    problem: &'a Problem<'a>,
}

impl WithSimd for Signals<'_> {
    type Output = (Vec<f32>, Vec<f32>);

    #[inline(always)]
    fn with_simd<S: Simd>(self, s: S) -> Self::Output {
        let (points, nets) = (self.problem.points, self.nets);
        let row = BLOCK * points.fast_width;
        let mut signals = (Vec::new(), Vec::new());
        for (x, x_rate) in points.fast.chunks(row).zip(points.fast_rate.chunks(row)) {
            let at_points = &mut nets.vi_points[..x.len() / points.fast_width];
            nets.vi.forward(s, x, x_rate, at_points);
            for at in at_points {
                signals.0.push(at.outputs[0]);
                signals.1.push(at.outputs[1]);
            }
        }
        signals
    }
}
