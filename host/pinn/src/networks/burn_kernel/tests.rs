//! The fused kernel against burn's reverse mode, and both against finite differences.

use super::*;
use crate::SlowEmbedding;
use crate::networks::collocation::{Collocation, Impedances};
use crate::networks::fused::Fused;
use crate::networks::shape::Shape;
use crate::trial;
use crate::vi_mlp::ViMlp;

const WEIGHTS: Weights = Weights { w_f: 5.0, w_i: 1.0 };

/// 183 points, so that blocks and tiles have remainders; hidden widths likewise.
fn trial_problem(vi: &ViMlp, slow: SlowEmbedding) -> (Shape, Collocation, Impedances) {
    let samples = trial::samples();
    let points = Collocation::new(&samples, vi, &slow, 1);
    let shape = Shape::new(
        (vi.width(), &vi.hidden_layers),
        (slow.width(), &[16, 16, 16, 16]),
    );
    (shape, points, Impedances { r: 0.7, x: 0.9 })
}

fn assert_close(a: &[f32], b: &[f32], tolerance: f32, what: &str) {
    let largest = b.iter().fold(0.0_f32, |m, x| m.max(x.abs()));
    assert!(largest > 1e-2 && a.len() == b.len());
    for (at, (a, b)) in a.iter().zip(b).enumerate() {
        assert!(
            (a - b).abs() < tolerance * largest,
            "{what} {at}: {a} against {b}"
        );
    }
}

#[test]
fn fused_and_ndarray_give_one_loss_and_one_gradient_to_rounding() {
    for (hidden_layers, slow) in [
        (vec![64; 3], SlowEmbedding::Symmetric),
        (vec![20, 7], SlowEmbedding::Fourier { first: 1, count: 1 }),
    ] {
        let vi = ViMlp {
            hidden_layers,
            downsampling: 50,
            ..ViMlp::default()
        };
        let (shape, points, impedances) = trial_problem(&vi, slow);
        let problem = Problem {
            shape: &shape,
            points: &points,
            impedances,
        };
        let theta = shape.xavier(5);
        let evaluate = |kernel: &mut dyn Kernel| {
            let mut gradient = vec![0.0; shape.len];
            let terms = kernel.loss(&problem, &theta, 0..points.len(), WEIGHTS, &mut gradient);
            (terms.expect("computes"), gradient)
        };
        let (terms, gradient) = evaluate(&mut Fused::new(&shape));
        let mut burn = Burn::new(Backend::Ndarray, trial::device());
        let (by_burn, burns) = evaluate(&mut burn);
        assert_close(&gradient, &burns, 2e-5, "gradient");
        let ours = [terms.l_f, terms.l_i1, terms.l_i2];
        for (a, b) in ours.iter().zip([by_burn.l_f, by_burn.l_i1, by_burn.l_i2]) {
            assert!((a / b - 1.0).abs() < 1e-5, "{a} against {b}");
        }
        let mut fused = Fused::new(&shape);
        let (v, i) = fused.signals(&problem, &theta).expect("computes");
        let (v_burn, i_burn) = burn.signals(&problem, &theta).expect("computes");
        assert_close(&v, &v_burn, 1e-5, "v");
        assert_close(&i, &i_burn, 1e-5, "i");
    }
}

#[test]
fn the_gradient_is_the_finite_difference_of_burns_loss_in_double_precision() {
    let vi = ViMlp {
        hidden_layers: vec![12, 9],
        downsampling: 50,
        ..ViMlp::default()
    };
    let (shape, points, impedances) = trial_problem(&vi, SlowEmbedding::Symmetric);
    let problem = Problem {
        shape: &shape,
        points: &points,
        impedances,
    };
    let theta = shape.xavier(2);
    let mut gradient = vec![0.0; shape.len];
    let all = 0..points.len();
    let mut fused = Fused::new(&shape);
    let computed = fused.loss(&problem, &theta, all.clone(), WEIGHTS, &mut gradient);
    computed.expect("computes");
    let mut burn = Burn::double(Backend::Ndarray, trial::device());
    let largest = gradient.iter().fold(0.0_f32, |m, x| m.max(x.abs()));
    let mut unused = vec![0.0; shape.len];
    for p in (0..shape.len).step_by(13) {
        let mut total_at = |value: f32| {
            let mut moved = theta.clone();
            moved[p] = value;
            let terms = burn.loss(&problem, &moved, all.clone(), WEIGHTS, &mut unused);
            terms.expect("computes").total(WEIGHTS)
        };
        // The step as f32 has it; the loss is read back in single precision, so it is large.
        let (up, down) = (theta[p] + 1e-2, theta[p] - 1e-2);
        let numeric = (total_at(up) - total_at(down)) / f64::from(up - down);
        let error = (numeric - f64::from(gradient[p])).abs();
        assert!(
            error < 2e-3 * f64::from(largest),
            "{p}: {numeric} {}",
            gradient[p]
        );
    }
}

#[test]
fn the_tangent_of_the_network_is_its_finite_difference_in_double_precision() {
    let vi = ViMlp {
        downsampling: 50,
        ..ViMlp::default()
    };
    let (shape, points, impedances) = trial_problem(&vi, SlowEmbedding::Symmetric);
    let problem = Problem {
        shape: &shape,
        points: &points,
        impedances,
    };
    let burn = Burn::double(Backend::Ndarray, trial::device());
    let networks = burn.networks(&problem, &shape.xavier(9));
    let wide = |values: Vec<f64>, width: usize| -> Tensor<3> {
        let shape = [1, values.len() / width, width];
        Tensor::from_data(TensorData::new(values, shape), (&burn.device, DType::F64))
    };
    let (f_sw_hz, step) = (45e3, 1e-5);
    let per_radian_s = (std::f64::consts::TAU * f_sw_hz).recip();
    for t_s in [1.234_5e-3, 5.5e-3] {
        let at = |shift: f64| {
            let (x, rate) = vi.features(t_s + shift * per_radian_s, f_sw_hz, 50.0);
            let batch = Batch {
                fast: wide(x, vi.width()),
                fast_rate: wide(rate, vi.width()),
                slow: wide(vec![0.1, 0.2], 2),
                v: wide(vec![0.0], 1),
                i: wide(vec![0.0], 1),
            };
            let outputs = networks.outputs(&batch, &problem);
            let number = |x: Tensor<3>| x.into_data().try_into_vec::<f64>().expect("f64")[0];
            (number(outputs.i), number(outputs.i_rate))
        };
        let numeric = (at(step).0 - at(-step).0) / (2.0 * step);
        let (_, exact) = at(0.0);
        assert!(
            (numeric - exact).abs() < 1e-8 * (1.0 + exact.abs()),
            "{numeric} {exact}"
        );
    }
}
