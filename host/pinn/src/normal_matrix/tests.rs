use rand::{RngExt, SeedableRng};

use super::*;

fn random(rows: usize, columns: usize) -> DMatrix<f64> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
    DMatrix::from_fn(rows, columns, |_, _| rng.random_range(-1.0..1.0))
}

#[test]
fn products_are_those_of_plain_sums() {
    for (rows, columns) in [(1, 1), (7, 3), (31, 12), (64, 17)] {
        let a = random(rows, columns);
        assert!((gram(&a) - a.transpose() * &a).amax() < 1e-13);
        let x = DVector::from_fn(columns, |k, _| k as f64 - 1.5);
        let y = DVector::from_fn(rows, |k, _| 0.5 * k as f64);
        assert!((DVector::from(times(&a, &x)) - &a * &x).amax() < 1e-12);
        assert!((transposed_times(&a, y.as_slice()) - a.transpose() * y).amax() < 1e-11);
    }
    assert_eq!(gram(&DMatrix::zeros(0, 0)).len(), 0);
}

#[test]
fn solutions_satisfy_the_equations_whatever_the_size() {
    for size in [1, 5, 8, 9, 24, 41] {
        let a = random(size + 20, size);
        let (product, ridge) = (gram(&a), 0.1);
        let factor = Factor::new(&product, ridge).expect("positive definite");
        let right = DVector::from_fn(size, |k, _| (k as f64).cos());
        let x = factor.solve(&right);
        let left = &product * &x + &x * ridge;
        assert!((left - &right).amax() < 1e-11, "{size}");
        let identity = (&product + DMatrix::identity(size, size) * ridge) * factor.inverse();
        assert!((identity - DMatrix::identity(size, size)).amax() < 1e-10);
        let determinant = (&product + DMatrix::identity(size, size) * ridge).determinant();
        assert!((factor.log_determinant() - determinant.ln()).abs() < 1e-9);
        // More right-hand sides than go together, and none whole.
        let rows = random(BATCH_SIDES + 3, size);
        for (k, form) in factor.inverse_forms(&rows).into_iter().enumerate() {
            let row = rows.row(k).transpose();
            let right = row.dot(&factor.solve(&row));
            assert!((form - right).abs() < 1e-10 * right, "{form} {right}");
        }
    }
}

#[test]
fn what_is_not_positive_definite_has_no_factor() {
    let twice = DMatrix::from_element(2, 2, 1.0);
    assert!(Factor::new(&twice, 0.0).is_none());
    assert!(Factor::new(&DMatrix::from_element(1, 1, f64::NAN), 0.0).is_none());
    assert!(Factor::new(&DMatrix::from_element(1, 1, f64::INFINITY), 0.0).is_none());
    assert!(Factor::new(&twice, 1e-3).is_some());
}
