//! Symmetric positive definite band matrices: the normal equations of a spline fit.

use ihd_signal::vectorised::vectorised;

/// The matrix is not positive definite to working precision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "row {row} of the normal equations depends on the rows before it: the data cannot tell the unknowns apart"
)]
pub struct SingularMatrix {
    /// First row of the matrix that failed.
    pub row: usize,
}

/// Symmetric band matrix, stored as its lower band row by row.
#[derive(Debug, Clone)]
pub struct Banded {
    size: usize,
    /// Sub-diagonals kept beside the diagonal.
    half_bandwidth: usize,
    entries: Vec<f64>,
}

impl Banded {
    /// Creates a matrix of zeros with that many rows and sub-diagonals.
    pub fn zeros(size: usize, half_bandwidth: usize) -> Self {
        Self {
            size,
            half_bandwidth,
            entries: vec![0.0; size * (half_bandwidth + 1)],
        }
    }

    fn at(&self, row: usize, column: usize) -> usize {
        row * (self.half_bandwidth + 1) + column + self.half_bandwidth - row
    }

    /// Entry (row, column) of the lower triangle; zero outside the band.
    pub fn get(&self, row: usize, column: usize) -> f64 {
        if row - column > self.half_bandwidth {
            0.0
        } else {
            self.entries[self.at(row, column)]
        }
    }

    /// Adds `value` to entry (row, column) of the lower triangle, which must lie in the band.
    pub fn add(&mut self, row: usize, column: usize, value: f64) {
        let at = self.at(row, column);
        self.entries[at] += value;
    }

    /// xᵀAx.
    pub fn quadratic_form(&self, x: &[f64]) -> f64 {
        let row = |r: usize| {
            let lowest = r.saturating_sub(self.half_bandwidth);
            let beside: f64 = (lowest..r).map(|c| self.get(r, c) * x[c]).sum();
            x[r] * (2.0 * beside + self.get(r, r) * x[r])
        };
        (0..self.size.min(x.len())).map(row).sum()
    }

    /// Multiplies every entry by `factor`.
    pub fn scale(&mut self, factor: f64) {
        self.entries.iter_mut().for_each(|entry| *entry *= factor);
    }

    /// Solves for each right-hand side in place, by Cholesky factorisation.
    ///
    /// # Errors
    /// [`SingularMatrix`] if the matrix is not positive definite to working precision.
    pub fn solve(mut self, right_hand_sides: &mut [Vec<f64>]) -> Result<(), SingularMatrix> {
        self.factorise()?;
        for x in right_hand_sides {
            self.substitute(x);
        }
        Ok(())
    }

    fn factorise(&mut self) -> Result<(), SingularMatrix> {
        vectorised(
            #[inline(always)]
            || self.factorise_rows(),
        )
    }

    #[inline(always)]
    fn factorise_rows(&mut self) -> Result<(), SingularMatrix> {
        for row in 0..self.size {
            let lowest = row.saturating_sub(self.half_bandwidth);
            let diagonal = self.entries[self.at(row, row)];
            for column in lowest..=row {
                let from = lowest.max(column.saturating_sub(self.half_bandwidth));
                let (a, b, run) = (self.at(row, from), self.at(column, from), column - from);
                let dot = dot(&self.entries[a..a + run], &self.entries[b..b + run]);
                let rest = self.entries[a + run] - dot;
                if column < row {
                    self.entries[a + run] = rest / self.entries[b + run];
                } else if rest > 1e-13 * diagonal && rest.is_finite() {
                    self.entries[a + run] = rest.sqrt();
                } else {
                    return Err(SingularMatrix { row });
                }
            }
        }
        Ok(())
    }

    fn substitute(&self, x: &mut [f64]) {
        for row in 0..self.size {
            let lowest = row.saturating_sub(self.half_bandwidth);
            let dot: f64 = (lowest..row).map(|c| self.get(row, c) * x[c]).sum();
            x[row] = (x[row] - dot) / self.get(row, row);
        }
        for row in (0..self.size).rev() {
            let highest = (row + self.half_bandwidth).min(self.size - 1);
            let dot: f64 = (row + 1..=highest).map(|r| self.get(r, row) * x[r]).sum();
            x[row] = (x[row] - dot) / self.get(row, row);
        }
    }
}

/// Σ x·y as eight partial sums, which the compiler can vectorise.
#[inline(always)]
fn dot(x: &[f64], y: &[f64]) -> f64 {
    let (x, last_x) = x.as_chunks::<8>();
    let (y, last_y) = y.as_chunks::<8>();
    let mut sums = [0.0; 8];
    for (x, y) in x.iter().zip(y) {
        for k in 0..8 {
            sums[k] = x[k].mul_add(y[k], sums[k]);
        }
    }
    let whole =
        ((sums[0] + sums[4]) + (sums[1] + sums[5])) + ((sums[2] + sums[6]) + (sums[3] + sums[7]));
    let mut rest = 0.0;
    for (x, y) in last_x.iter().zip(last_y) {
        rest = x.mul_add(*y, rest);
    }
    whole + rest
}

#[cfg(test)]
mod tests {
    use super::{Banded, SingularMatrix};

    /// Diagonally dominant band matrix with irregular entries.
    fn example(size: usize, half_bandwidth: usize) -> Banded {
        let mut matrix = Banded::zeros(size, half_bandwidth);
        for row in 0..size {
            matrix.add(row, row, 2.0 * half_bandwidth as f64 + 1.0);
            for column in row.saturating_sub(half_bandwidth)..row {
                matrix.add(row, column, ((row * 7 + column * 3) as f64).sin());
            }
        }
        matrix
    }

    #[test]
    fn the_solution_satisfies_the_equations() {
        for (size, half_bandwidth) in [(1, 0), (5, 4), (40, 7)] {
            let matrix = example(size, half_bandwidth);
            let wanted: Vec<f64> = (0..size).map(|n| (n as f64).cos()).collect();
            let symmetric = |r: usize, c: usize| matrix.get(r.max(c), r.min(c));
            let mut x = vec![
                (0..size)
                    .map(|r| (0..size).map(|c| symmetric(r, c) * wanted[c]).sum())
                    .collect::<Vec<f64>>(),
            ];
            matrix.clone().solve(&mut x).expect("positive definite");
            assert!(x[0].iter().zip(&wanted).all(|(a, b)| (a - b).abs() < 1e-12));
        }
    }

    #[test]
    fn the_quadratic_form_is_that_of_both_triangles() {
        let matrix = example(9, 3);
        let x: Vec<f64> = (0..9).map(|n| (n as f64).sin() + 0.2).collect();
        let mut right = 0.0;
        for r in 0..9 {
            for c in 0..9 {
                right += x[r] * matrix.get(r.max(c), r.min(c)) * x[c];
            }
        }
        assert!((matrix.quadratic_form(&x) - right).abs() < 1e-12);
    }

    #[test]
    fn a_matrix_without_full_rank_is_refused_by_row() {
        let mut matrix = Banded::zeros(3, 2);
        for (row, column) in [(0, 0), (1, 0), (1, 1), (2, 2)] {
            matrix.add(row, column, 1.0);
        }
        let refused = matrix.solve(&mut [vec![0.0; 3]]);
        assert_eq!(refused, Err(SingularMatrix { row: 1 }));
    }
}
