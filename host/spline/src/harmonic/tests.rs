use super::*;

/// Two signals with harmonics 1, 2 and 5, the fundamental growing linearly.
fn signals(periods_per_sample: f64, dt_s: f64, samples: usize) -> [Vec<f64>; 2] {
    let at = |n: usize| (TAU * periods_per_sample * n as f64, n as f64 * dt_s);
    let v = (0..samples).map(at).map(|(angle, tau_s)| {
        (1.0 + 50.0 * tau_s) * (angle + 0.3).cos() + 0.4 * (5.0 * angle - 1.0).cos()
    });
    let i = (0..samples)
        .map(at)
        .map(|(angle, _)| 2.0 * angle.sin() + 0.1 * (2.0 * angle).cos());
    [v.collect(), i.collect()]
}

fn fitted(orders: &[u32], block: usize, gains: &[f64]) -> ([Vec<f64>; 2], CubicSpline) {
    let (periods_per_sample, dt_s, samples) = (1.0 / 97.3, 1e-7, 60_000);
    let spline = CubicSpline::new(6, samples as f64 * dt_s);
    let [v, i] = signals(periods_per_sample, dt_s, samples);
    let fit = HarmonicFit {
        spline: &spline,
        orders,
        gains,
        periods_per_sample,
        dt_s,
        block,
        centre: 0.5 * (block - 1) as f64,
    };
    let solved = fit.normal_equations(&v, &i).solve().expect("regular");
    (solved, spline)
}

#[test]
fn each_order_has_its_own_phasor_with_single_samples_and_with_blocks() {
    let orders = [1, 2, 5];
    for block in [1, 6] {
        let ([v, i], spline) = fitted(&orders, block, &[1.0; 3]);
        for tau_s in [0.1e-3, 2.9e-3, 5.7e-3] {
            let local = spline.at(tau_s);
            let of = |x: &[f64], index| phasor(x, 3, index, local.first, &local.values);
            let growing = Complex::from_polar(1.0 + 50.0 * tau_s, 0.3);
            for (found, right) in [
                (of(&v, 0), growing),
                (of(&v, 1), Complex::new(0.0, 0.0)),
                (of(&v, 2), Complex::from_polar(0.4, -1.0)),
                (of(&i, 0), Complex::new(0.0, -2.0)),
                (of(&i, 1), Complex::new(0.1, 0.0)),
            ] {
                assert!((found - right).norm() < 1e-5, "{block}: {found} {right}");
            }
            let slope = phasor(&v, 3, 0, local.first, &local.slopes_per_s);
            assert!(
                (slope - Complex::from_polar(50.0, 0.3)).norm() < 2e-2,
                "{slope}"
            );
        }
    }
}

/// Comparison with the equations written out: (cos, sin) of each order of each spline at every sample.
#[test]
fn single_samples_give_the_normal_equations_as_they_are_written() {
    let (periods_per_sample, dt_s, samples) = (1.0 / 20.33, 1e-6, 400);
    let (orders, gains) = ([1, 3, 5, 7, 9], [1.0, 0.9, 0.8, 0.7, 0.6]);
    let spline = CubicSpline::new(3, samples as f64 * dt_s);
    let [v, i] = signals(periods_per_sample, dt_s, samples);
    let fit = HarmonicFit {
        spline: &spline,
        orders: &orders,
        gains: &gains,
        periods_per_sample,
        dt_s,
        block: 1,
        centre: 0.0,
    };
    let found = fit.normal_equations(&v, &i);
    let size = fit.unknowns();
    let mut gram = vec![vec![0.0; size]; size];
    let (mut rhs_v, mut rhs_i) = (vec![0.0; size], vec![0.0; size]);
    for n in 0..samples {
        let local = spline.at(n as f64 * dt_s);
        let mut row = vec![0.0; size];
        for (m, value) in local.values.iter().enumerate() {
            for (k, (h, gain)) in orders.iter().zip(&gains).enumerate() {
                let angle = TAU * f64::from(*h) * periods_per_sample * n as f64;
                let at = 2 * ((local.first + m) * orders.len() + k);
                row[at] = value * gain * angle.cos();
                row[at + 1] = value * gain * angle.sin();
            }
        }
        for r in 0..size {
            rhs_v[r] += row[r] * v[n];
            rhs_i[r] += row[r] * i[n];
            for c in 0..size {
                gram[r][c] += row[r] * row[c];
            }
        }
    }
    let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
    for r in 0..size {
        assert!(near(found.v[r], rhs_v[r]) && near(found.i[r], rhs_i[r]));
        let in_band = r.saturating_sub(8 * orders.len() - 1)..=r;
        for (c, right) in gram[r][in_band.clone()]
            .iter()
            .zip(in_band)
            .map(|(x, c)| (c, x))
        {
            assert!(near(found.gram.get(r, c), *right), "{r} {c}");
        }
    }
}

#[test]
fn orders_that_the_sampling_cannot_distinguish_are_refused() {
    // Four samples a period: the third order is the fundamental's alias.
    let spline = CubicSpline::new(1, 1e-3);
    let fit = HarmonicFit {
        spline: &spline,
        orders: &[1, 3],
        gains: &[1.0, 1.0],
        periods_per_sample: 0.25,
        dt_s: 1e-6,
        block: 1,
        centre: 0.0,
    };
    let x: Vec<f64> = (0..1000).map(|n| f64::from(n % 4)).collect();
    assert!(fit.normal_equations(&x, &x).solve().is_err());
}
