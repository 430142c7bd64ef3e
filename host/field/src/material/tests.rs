use super::*;

const OTHERS: [Material; 3] = [
    Material::Saturating {
        knee: Knee::Froehlich,
        alpha_a_per_m: 1500.0,
        b_per_t: 0.5,
        tail_mu_r: 10.0,
        sigma_s_per_m: 8e6,
    },
    Material::Saturating {
        knee: Knee::Sharp,
        alpha_a_per_m: 1500.0,
        b_per_t: 0.5,
        tail_mu_r: 0.0,
        sigma_s_per_m: 8e6,
    },
    Material::Saturating {
        knee: Knee::Sharp,
        alpha_a_per_m: 5500.0,
        b_per_t: 0.6,
        tail_mu_r: 3.0,
        sigma_s_per_m: 1e6,
    },
];

#[test]
fn other_laws_have_the_slope_of_their_chord_the_same_beginning_and_their_end() {
    for material in OTHERS {
        let Material::Saturating {
            alpha_a_per_m,
            b_per_t,
            tail_mu_r,
            ..
        } = material
        else {
            panic!("a saturating law");
        };
        let c = material.curve();
        for h in [0.0, 10.0, 1500.0, -4000.0, 20e3] {
            let d = 1e-3;
            let numeric = (c.b_t(h + d) - c.b_t(h - d)) / (2.0 * d);
            assert!((numeric / c.slope_h_per_m(h) - 1.0).abs() < 1e-6, "H = {h}");
        }
        let initial = 1.0 / (alpha_a_per_m * b_per_t) + tail_mu_r * MU_0;
        assert!((c.slope_h_per_m(0.0) / initial - 1.0).abs() < 1e-12);
        let end = 1.0 / b_per_t + tail_mu_r * MU_0 * 1e9;
        assert!(
            (c.b_t(1e9) / end - 1.0).abs() < 1e-4,
            "{} {end}",
            c.b_t(1e9)
        );
    }
    // The sharper knee is nearer to saturation.
    let knee = |m: &Material| m.curve().b_t(1500.0);
    assert!(knee(&OTHERS[1]) > 1.3 * knee(&Material::PAPER));
}

#[test]
fn slope_is_the_derivative_of_the_chord_and_equals_the_papers_law() {
    let c = Material::PAPER.curve();
    for h in [0.0, 10.0, 1500.0, -4000.0, 20e3] {
        let d = 1e-3;
        let numeric = (c.b_t(h + d) - c.b_t(h - d)) / (2.0 * d);
        assert!((numeric / c.slope_h_per_m(h) - 1.0).abs() < 1e-6, "H = {h}");
        let paper = 1500.0 / (0.5 * (1500.0 + h.abs()).powi(2));
        assert!((paper / c.slope_h_per_m(h) - 1.0).abs() < 1e-12);
    }
}

#[test]
fn the_literal_law_is_the_default_ones_slope_and_has_its_largest_b_at_alpha() {
    let (literal, curve) = (Material::PAPER_LITERAL.curve(), Material::PAPER.curve());
    for h in [0.0, 300.0, 1500.0, -9e3] {
        let chord = literal.describing_h_per_m(h);
        assert!((chord / curve.slope_h_per_m(h) - 1.0).abs() < 1e-12);
        let d = 1e-3;
        let numeric = (literal.b_t(h + d) - literal.b_t(h - d)) / (2.0 * d);
        assert!((numeric - literal.slope_h_per_m(h)).abs() < 1e-8);
    }
    // 1/(4 b) = 0.5 T.
    assert!((literal.b_t(1500.0) - 0.5).abs() < 1e-12 && literal.b_t(4e3) < 0.5);
}

#[test]
fn describing_function_equals_its_integral() {
    let curves = [Material::PAPER].into_iter().chain(OTHERS);
    let fields = [
        0.01, 1.0, 1.6, 14.9, 15.1, 100.0, 1499.9, 1500.0, 1500.1, 1501.0, 9e3, 1e6,
    ];
    let points = curves.flat_map(|m| fields.map(|h| (m.curve(), h)));
    for (c, h) in points {
        // The integrand is even and periodic; midpoint rule.
        let n = 200_000;
        let mut sum = 0.0;
        for k in 0..n {
            let cos = ((k as f64 + 0.5) / n as f64 * core::f64::consts::PI).cos();
            sum += c.b_t(h * cos) * cos;
        }
        let integral = 2.0 * sum / (n as f64 * h);
        let error = c.describing_h_per_m(h) / integral - 1.0;
        assert!(error.abs() < 1e-8, "H = {h}: {error:e}");
    }
}

#[test]
fn linear_material_has_constant_slope() {
    let c = Material::ALUMINIUM.curve();
    assert_eq!(c.slope_h_per_m(0.0), c.slope_h_per_m(1e4));
    assert!((c.describing_h_per_m(1e4) / MU_0 - 1.0).abs() < 1e-12);
}

#[test]
fn refuses_nan_by_name() {
    let m = Material::Linear {
        mu_r: f64::NAN,
        sigma_s_per_m: 1e6,
    };
    assert!(m.check().unwrap_err().to_string().contains("mu_r"));
}
