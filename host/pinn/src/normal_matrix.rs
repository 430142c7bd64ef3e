//! Normal matrices AᵀA of a few hundred columns: their product, Cholesky factor and solutions.
//!
//! Plain loops over fixed lanes with explicit fused multiply-adds, compiled for the instruction set that `pulp`
//! detects: sums run in the same order whatever its registers' width, so that the digits are the same everywhere.

use ihd_signal::vectorised::vectorised;
use nalgebra::{DMatrix, DVector};

/// Doubles of the widest register.
const LANES: usize = 8;

/// Doubles that a sum of products reads at a time.
const HALF: usize = LANES / 2;

/// Columns of a product that are computed at a time: their sums and inputs fit 16 registers.
const TILE: (usize, usize) = (3, 3);

/// Columns of a panel of the factorisation.
const PANEL: usize = 8;

/// Right-hand sides that are solved at a time.
const BATCH_SIDES: usize = 32;

/// `n` rounded up to whole lanes.
fn padded(n: usize) -> usize {
    n.next_multiple_of(LANES)
}

/// AᵀA.
pub(crate) fn gram(a: &DMatrix<f64>) -> DMatrix<f64> {
    let (length, count) = a.shape();
    let mut product = DMatrix::zeros(count, count);
    let columns: Vec<&[f64]> = a.as_slice().chunks_exact(length.max(1)).collect();
    each_dot(&columns, &columns, true, |row, column, sum| {
        product[(row, column)] = sum;
        product[(column, row)] = sum;
    });
    product
}

/// Scalar products of all columns of `left`, a row of the result each, with all of `right`; a column has `length` entries.
pub(crate) fn dots_between(left: &[f64], right: &[f64], length: usize) -> DMatrix<f64> {
    let left: Vec<&[f64]> = left.chunks_exact(length.max(1)).collect();
    let right: Vec<&[f64]> = right.chunks_exact(length.max(1)).collect();
    let mut product = DMatrix::zeros(left.len(), right.len());
    each_dot(&left, &right, false, |row, column, sum| {
        product[(row, column)] = sum;
    });
    product
}

/// Calls `take` with the scalar product of each of `left`, the row, and each of `right`, the column; if `upper`, without the tiles
/// below the diagonal.
fn each_dot(
    left: &[&[f64]],
    right: &[&[f64]],
    upper: bool,
    mut take: impl FnMut(usize, usize, f64),
) {
    let columns = right.len();
    vectorised(
        #[inline(always)]
        || {
            for first in (0..columns).step_by(TILE.1) {
                let these = std::array::from_fn(|k| right[(first + k).min(columns - 1)]);
                let rows = match upper {
                    true => left.len().min(first + TILE.1),
                    false => left.len(),
                };
                for from in (0..rows).step_by(TILE.0) {
                    let those = std::array::from_fn(|k| left[(from + k).min(left.len() - 1)]);
                    let sums: [[f64; TILE.1]; TILE.0] = dots(those, these);
                    for (r, row) in sums.iter().enumerate().take(left.len() - from) {
                        for (c, sum) in row.iter().enumerate().take(columns - first) {
                            take(from + r, first + c, *sum);
                        }
                    }
                }
            }
        },
    );
}

/// Scalar products of all of `left` with all of `right`, which have the same length.
#[inline(always)]
fn dots<const L: usize, const R: usize>(left: [&[f64]; L], right: [&[f64]; R]) -> [[f64; R]; L] {
    let length = left[0].len();
    let count = length / HALF;
    let mut a: [&[[f64; HALF]]; L] = [&[]; L];
    let mut b: [&[[f64; HALF]]; R] = [&[]; R];
    // The slices have the same length for the compiler, so that no index is checked in the loop.
    for l in 0..L {
        a[l] = &left[l].as_chunks().0[..count];
    }
    for r in 0..R {
        b[r] = &right[r].as_chunks().0[..count];
    }
    let mut sums = [[[0.0; HALF]; R]; L];
    for at in 0..count {
        for l in 0..L {
            for r in 0..R {
                for k in 0..HALF {
                    sums[l][r][k] = a[l][at][k].mul_add(b[r][at][k], sums[l][r][k]);
                }
            }
        }
    }
    let mut out = [[0.0; R]; L];
    for l in 0..L {
        for r in 0..R {
            let [a, b, c, d] = sums[l][r];
            out[l][r] = (a + c) + (b + d);
            for k in count * HALF..length {
                out[l][r] = left[l][k].mul_add(right[r][k], out[l][r]);
            }
        }
    }
    out
}

/// Aᵀx.
pub(crate) fn transposed_times(a: &DMatrix<f64>, x: &[f64]) -> DVector<f64> {
    let mut out = DVector::zeros(a.ncols());
    vectorised(
        #[inline(always)]
        || {
            let columns = a.as_slice().chunks_exact(a.nrows().max(1));
            for (out, column) in out.as_mut_slice().iter_mut().zip(columns) {
                *out = dots([column], [x])[0][0];
            }
        },
    );
    out
}

/// Ax.
pub(crate) fn times(a: &DMatrix<f64>, x: &DVector<f64>) -> Vec<f64> {
    let mut out = vec![0.0; a.nrows()];
    vectorised(
        #[inline(always)]
        || {
            let columns = a.as_slice().chunks_exact(a.nrows().max(1));
            for (column, factor) in columns.zip(x.as_slice()) {
                add_times(&mut out, column, *factor);
            }
        },
    );
    out
}

/// `sums += factor · x`, for use within [`vectorised`].
#[inline(always)]
pub(crate) fn add_times(sums: &mut [f64], x: &[f64], factor: f64) {
    for (sum, x) in sums.iter_mut().zip(x) {
        *sum = factor.mul_add(*x, *sum);
    }
}

/// L of a positive definite matrix L Lᵀ.
pub(crate) struct Factor {
    size: usize,
    /// Entries of a row, `size` in whole panels.
    width: usize,
    /// Rows of L, with one on the diagonal beyond `size`.
    rows: Vec<f64>,
}

impl Factor {
    /// Factorises `matrix` with `ridge` added to its diagonal; `None` if rounding makes it indefinite.
    pub fn new(matrix: &DMatrix<f64>, ridge: f64) -> Option<Self> {
        let size = matrix.nrows();
        let width = padded(size);
        let mut rows = vec![0.0; width * width];
        for (k, row) in rows.chunks_exact_mut(width).enumerate() {
            if k < size {
                // Symmetric: a column is a row.
                row[..size].copy_from_slice(&matrix.as_slice()[k * size..(k + 1) * size]);
                row[k] += ridge;
            } else {
                row[k] = 1.0;
            }
        }
        let mut factor = Self { size, width, rows };
        let mut panel = vec![0.0; PANEL * width];
        let sound = vectorised(
            #[inline(always)]
            || {
                let mut first = 0;
                while first < width && factor.eliminate(first, &mut panel) {
                    first += PANEL;
                }
                first == width
            },
        );
        sound.then_some(factor)
    }

    /// Computes a panel of columns of L from `first` on, and subtracts their products from the columns right of it.
    #[inline(always)]
    fn eliminate(&mut self, first: usize, panel: &mut [f64]) -> bool {
        let width = self.width;
        let after = first + PANEL;
        let Some(corner) = self.corner(first) else {
            return false;
        };
        // Transposed, so that lanes are rows.
        for (k, column) in panel.chunks_exact_mut(width).enumerate() {
            for (i, x) in column.iter_mut().enumerate().skip(after) {
                *x = self.rows[i * width + first + k];
            }
        }
        for (k, factors) in corner.iter().enumerate() {
            let (before, from_here) = panel.split_at_mut(k * width);
            let column = &mut from_here[after..width];
            for (m, other) in before.chunks_exact(width).enumerate() {
                let factor = -factors[m];
                for (x, y) in column.iter_mut().zip(&other[after..]) {
                    *x = factor.mul_add(*y, *x);
                }
            }
            let inverse = 1.0 / factors[k];
            column.iter_mut().for_each(|x| *x *= inverse);
        }
        for i in after..width {
            let row = &mut self.rows[i * width..(i + 1) * width];
            let factors: [f64; PANEL] = std::array::from_fn(|k| panel[k * width + i]);
            row[first..after].copy_from_slice(&factors);
            let mut at = after;
            while at <= i {
                let mut sums: [f64; LANES] = std::array::from_fn(|k| row[at + k]);
                for (factor, column) in factors.iter().zip(panel.chunks_exact(width)) {
                    let column = &column[at..at + LANES];
                    for k in 0..LANES {
                        sums[k] = (-factor).mul_add(column[k], sums[k]);
                    }
                }
                row[at..at + LANES].copy_from_slice(&sums);
                at += LANES;
            }
        }
        true
    }

    /// Factorises the block on the diagonal from `first` on.
    #[inline(always)]
    fn corner(&mut self, first: usize) -> Option<[[f64; PANEL]; PANEL]> {
        let mut corner = [[0.0_f64; PANEL]; PANEL];
        for r in 0..PANEL {
            let row = &mut self.rows[(first + r) * self.width + first..][..PANEL];
            for c in 0..=r {
                let mut rest = row[c];
                for (a, b) in corner[r][..c].iter().zip(&corner[c][..c]) {
                    rest = (-a).mul_add(*b, rest);
                }
                corner[r][c] = if c < r {
                    rest / corner[c][c]
                } else if rest > 0.0 && rest.is_finite() {
                    rest.sqrt()
                } else {
                    return None;
                };
            }
            row.copy_from_slice(&corner[r]);
        }
        Some(corner)
    }

    /// Solution for one right-hand side.
    pub fn solve(&self, right: &DVector<f64>) -> DVector<f64> {
        let mut x = right.clone();
        let values = x.as_mut_slice();
        vectorised(
            #[inline(always)]
            || {
                for (k, row) in self.rows.chunks_exact(self.width).enumerate() {
                    if k < self.size {
                        let sum = dots([&row[..k]], [&values[..k]])[0][0];
                        values[k] = (values[k] - sum) / row[k];
                    }
                }
                for k in (0..self.size).rev() {
                    let row = &self.rows[k * self.width..];
                    let here = values[k] / row[k];
                    values[k] = here;
                    for (x, l) in values[..k].iter_mut().zip(row) {
                        *x = (-here).mul_add(*l, *x);
                    }
                }
            },
        );
        x
    }

    /// xᵀ(L Lᵀ)⁻¹x of each row x of `rows`.
    pub fn inverse_forms(&self, rows: &DMatrix<f64>) -> Vec<f64> {
        let count = rows.nrows();
        let mut forms = Vec::with_capacity(count);
        let mut solved = vec![[0.0; BATCH_SIDES]; self.size];
        for first in (0..count).step_by(BATCH_SIDES) {
            let these = BATCH_SIDES.min(count - first);
            for (k, lanes) in solved.iter_mut().enumerate() {
                let column = &rows.as_slice()[k * count + first..][..these];
                lanes[..these].copy_from_slice(column);
            }
            let squares = vectorised(
                #[inline(always)]
                || self.forward(&mut solved),
            );
            forms.extend_from_slice(&squares[..these]);
        }
        forms
    }

    /// ln det(L Lᵀ).
    pub fn log_determinant(&self) -> f64 {
        let diagonal = (0..self.size).map(|k| self.rows[k * self.width + k]);
        2.0 * diagonal.map(f64::ln).sum::<f64>()
    }

    /// (L Lᵀ)⁻¹.
    pub fn inverse(&self) -> DMatrix<f64> {
        let mut below = DMatrix::zeros(self.size, self.size);
        for first in (0..self.size).step_by(BATCH_SIDES) {
            let mut solved = vec![[0.0; BATCH_SIDES]; self.size];
            for (lane, row) in solved[first..].iter_mut().take(BATCH_SIDES).enumerate() {
                row[lane] = 1.0;
            }
            vectorised(
                #[inline(always)]
                || self.forward(&mut solved),
            );
            let these = BATCH_SIDES.min(self.size - first);
            for (k, lanes) in solved.iter().enumerate() {
                for (lane, x) in lanes[..these].iter().enumerate() {
                    below[(k, first + lane)] = *x;
                }
            }
        }
        gram(&below)
    }

    /// Solves L x = b in place, lane by lane; returns |x|² of each.
    #[inline(always)]
    fn forward(&self, solved: &mut [[f64; BATCH_SIDES]]) -> [f64; BATCH_SIDES] {
        let mut squares = [0.0; BATCH_SIDES];
        for k in 0..solved.len() {
            let (before, from_here) = solved.split_at_mut(k);
            let mut lanes = from_here[0];
            let row = &self.rows[k * self.width..][..=k];
            for (factor, other) in row.iter().zip(before.iter()) {
                for (x, y) in lanes.iter_mut().zip(other) {
                    *x = (-factor).mul_add(*y, *x);
                }
            }
            let inverse = 1.0 / row[k];
            for (x, square) in lanes.iter_mut().zip(&mut squares) {
                *x *= inverse;
                *square = x.mul_add(*x, *square);
            }
            from_here[0] = lanes;
        }
        squares
    }
}

#[cfg(test)]
mod tests;
