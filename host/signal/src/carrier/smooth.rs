//! Whittaker's smoother: a smooth sequence close to weighted values.

/// Minimises Σ w·(f − y)² + stiffness·Σ (second difference of f)²; a straight line wherever the weights are zero.
pub(super) fn whittaker(y: &[f64], weight: &[f64], stiffness: f64) -> Vec<f64> {
    let n = y.len();
    if n < 3 {
        return y.to_vec();
    }
    // Lower band of the matrix: the diagonal and two below it.
    let mut band = vec![[0.0; 3]; n];
    let mut x: Vec<f64> = y.iter().zip(weight).map(|(y, w)| y * w).collect();
    // Small enough to matter only where all weights are zero.
    let least = 1e-12 * stiffness.max(1.0);
    for (row, w) in band.iter_mut().zip(weight) {
        row[0] = w + least;
    }
    const STENCIL: [f64; 3] = [1.0, -2.0, 1.0];
    for k in 0..n - 2 {
        for (a, p) in STENCIL.iter().enumerate() {
            for (b, q) in STENCIL.iter().enumerate().take(a + 1) {
                band[k + a][a - b] += stiffness * p * q;
            }
        }
    }
    // L·D·Lᵀ in place: band[k] = [D, L(k, k−1), L(k, k−2)].
    for k in 0..n {
        if k >= 2 {
            band[k][2] /= band[k - 2][0];
        }
        if k >= 1 {
            let two = if k >= 2 {
                band[k][2] * band[k - 2][0] * band[k - 1][1]
            } else {
                0.0
            };
            band[k][1] = (band[k][1] - two) / band[k - 1][0];
        }
        let mut d = band[k][0];
        if k >= 1 {
            d -= band[k][1] * band[k][1] * band[k - 1][0];
        }
        if k >= 2 {
            d -= band[k][2] * band[k][2] * band[k - 2][0];
        }
        band[k][0] = d;
        if k >= 1 {
            x[k] -= band[k][1] * x[k - 1];
        }
        if k >= 2 {
            x[k] -= band[k][2] * x[k - 2];
        }
    }
    for k in (0..n).rev() {
        x[k] /= band[k][0];
        if k + 1 < n {
            x[k] -= band[k + 1][1] * x[k + 1];
        }
        if k + 2 < n {
            x[k] -= band[k + 2][2] * x[k + 2];
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn straight_lines_stay_and_gaps_are_bridged_by_them() {
        let y: Vec<f64> = (0..40).map(|k| 3.0 + 0.5 * f64::from(k)).collect();
        let mut weight = vec![1.0; 40];
        for (a, b) in whittaker(&y, &weight, 80.0).iter().zip(&y) {
            assert!((a - b).abs() < 1e-8, "{a} {b}");
        }
        let mut spoilt = y.clone();
        spoilt[15..22].fill(1e3);
        weight[15..22].fill(0.0);
        for (a, b) in whittaker(&spoilt, &weight, 80.0).iter().zip(&y) {
            assert!((a - b).abs() < 1e-6, "{a} {b}");
        }
    }

    #[test]
    fn it_minimises_what_it_says() {
        let y = [1.0, -2.0, 0.5, 3.0, 2.0, -1.0, 0.0];
        let w = [1.0, 0.3, 2.0, 0.0, 1.0, 1.0, 0.5];
        let cost = |f: &[f64]| {
            let data: f64 = (0..7).map(|k| w[k] * (f[k] - y[k]).powi(2)).sum();
            let bend: f64 = f
                .windows(3)
                .map(|f| (f[0] - 2.0 * f[1] + f[2]).powi(2))
                .sum();
            data + 4.0 * bend
        };
        let found = whittaker(&y, &w, 4.0);
        let least = cost(&found);
        for k in 0..7 {
            for step in [-1e-3, 1e-3] {
                let mut other = found.clone();
                other[k] += step;
                assert!(cost(&other) > least);
            }
        }
    }
}
