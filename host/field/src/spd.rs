//! Small symmetric positive systems: the coupling of the rings, once per time step.

/// Solves M x = b for two right-hand sides, M given with its full square stored by rows and
/// overwritten. No pivoting: M is symmetric and positive definite.
///
/// Whole rows are updated, above the diagonal too: the extra work is cheaper than ragged loops.
#[inline(always)]
pub fn solve_two<const N: usize>(m: &mut [[f64; N]; N], x: &mut [f64; N], y: &mut [f64; N]) {
    for k in 0..N {
        let pivot = 1.0 / m[k][k];
        let row = m[k];
        let (xk, yk) = (x[k], y[k]);
        for i in k + 1..N {
            // Symmetric: the column below the pivot equals the row right of it.
            let factor = row[i] * pivot;
            for j in 0..N {
                m[i][j] -= factor * row[j];
            }
            x[i] -= factor * xk;
            y[i] -= factor * yk;
        }
    }
    for k in (0..N).rev() {
        let pivot = 1.0 / m[k][k];
        let (mut xk, mut yk) = (x[k], y[k]);
        for j in k + 1..N {
            xk -= m[k][j] * x[j];
            yk -= m[k][j] * y[j];
        }
        x[k] = xk * pivot;
        y[k] = yk * pivot;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solution_satisfies_the_system() {
        // Hilbert-like matrix plus a diagonal: symmetric, positive.
        let mut m = [[0.0; 8]; 8];
        for (i, row) in m.iter_mut().enumerate() {
            for (j, v) in row.iter_mut().enumerate() {
                *v = 1.0 / (1.0 + i as f64 + j as f64) + if i == j { 0.1 } else { 0.0 };
            }
        }
        let original = m;
        let (mut x, mut y) = ([1.0; 8], [0.0; 8]);
        y[3] = 2.0;
        let (b, c) = (x, y);
        solve_two(&mut m, &mut x, &mut y);
        for i in 0..8 {
            let mx: f64 = (0..8).map(|j| original[i][j] * x[j]).sum();
            let my: f64 = (0..8).map(|j| original[i][j] * y[j]).sum();
            assert!((mx - b[i]).abs() < 1e-12 && (my - c[i]).abs() < 1e-12);
        }
    }
}
