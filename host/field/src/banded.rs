//! Symmetric positive band matrices: a grid's equations, numbered column by column.
//!
//! Rows of the factor are updated whole, so that the compiler vectorises; a general sparse factorisation of these fills the same
//! band with an index for each number.

/// Upper half of a symmetric band matrix.
pub(super) struct Banded {
    size: usize,
    /// Numbers per row: the diagonal and those right of it.
    width: usize,
    rows: Vec<f64>,
}

impl Banded {
    /// Creates a zero matrix; a row's last number is `band` right of the diagonal.
    pub(super) fn new(size: usize, band: usize) -> Self {
        let width = band + 1;
        Self {
            size,
            width,
            rows: vec![0.0; size * width],
        }
    }

    /// Adds to an element on or above the diagonal; those below are the same and ignored.
    pub(super) fn add(&mut self, row: usize, column: usize, value: f64) {
        if column >= row {
            self.rows[row * self.width + column - row] += value;
        }
    }

    /// Solution for a right-hand side; `None` if the matrix is not positive. Consumes the matrix: its factor takes the place.
    pub(super) fn solve(mut self, right: &[f64]) -> Option<Vec<f64>> {
        let mut x = right.to_vec();
        for row in 0..self.size {
            let (head, below) = self.rows.split_at_mut((row + 1) * self.width);
            let pivot = &head[row * self.width..];
            if pivot[0].is_nan() || pivot[0] <= 0.0 {
                return None;
            }
            let inverse = 1.0 / pivot[0];
            let known = x[row];
            for (n, target) in below
                .chunks_exact_mut(self.width)
                .take(self.width - 1)
                .enumerate()
            {
                let factor = pivot[n + 1] * inverse;
                if factor != 0.0 {
                    for (t, p) in target.iter_mut().zip(&pivot[n + 1..]) {
                        *t -= factor * p;
                    }
                    x[row + n + 1] -= factor * known;
                }
            }
        }
        for row in (0..self.size).rev() {
            let pivot = &self.rows[row * self.width..][..self.width];
            let right: f64 = pivot
                .iter()
                .skip(1)
                .zip(&x[row + 1..])
                .map(|(p, x)| p * x)
                .sum();
            x[row] = (x[row] - right) / pivot[0];
        }
        Some(x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solution_satisfies_the_system_and_an_indefinite_one_has_none() {
        let element = |m: usize, n: usize| match m.abs_diff(n) {
            0 => 5.0 + m as f64,
            1 => -1.0,
            3 => -2.0,
            _ => 0.0,
        };
        let fill = |shift: f64| {
            let mut matrix = Banded::new(9, 3);
            for (m, n) in (0..9).flat_map(|m: usize| (0..9).map(move |n| (m, n))) {
                if m.abs_diff(n) <= 3 {
                    matrix.add(m, n, element(m, n) - if m == n { shift } else { 0.0 });
                }
            }
            matrix
        };
        let right: Vec<f64> = (0..9).map(|n| f64::from(n * n) - 7.0).collect();
        let x = fill(0.0).solve(&right).unwrap();
        for (m, b) in right.iter().enumerate() {
            let sum: f64 = x.iter().enumerate().map(|(n, x)| element(m, n) * x).sum();
            assert!((sum - b).abs() < 1e-12, "row {m}");
        }
        assert_eq!(fill(6.0).solve(&right), None);
    }
}
