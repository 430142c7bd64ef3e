//! The three matrix products of a dense layer, in register tiles with explicit fused multiply-adds.
//!
//! Matrices are row by row, one row per point, and their columns fill whole registers
//! ([`LANES`]), so that every sum over points or inputs runs in the same order whatever the width
//! of a register: results do not depend on it.

use pulp::Simd;

/// Columns are padded to a multiple of this, the lanes of the widest register.
pub(super) const LANES: usize = 16;

/// `n` rounded up to whole registers.
pub(super) fn padded(n: usize) -> usize {
    n.div_ceil(LANES) * LANES
}

/// Rows of a tile: rows times two registers of sums, and what feeds them, fit 16 registers.
const ROWS: usize = 6;

/// A matrix, row by row.
#[derive(Clone, Copy)]
pub(super) struct Rows<'a> {
    pub values: &'a [f32],
    /// Columns.
    pub width: usize,
}

/// `out = x w + bias` with `w` of `x.width` rows and `n` columns, `n` a multiple of [`LANES`].
#[inline(always)]
pub(super) fn affine<S: Simd>(
    s: S,
    x: Rows<'_>,
    w: &[f32],
    bias: Option<&[f32]>,
    out: &mut [f32],
    n: usize,
) {
    let (w, _) = S::as_simd_f32s(w);
    let columns = n / S::F32_LANES;
    let wide = S::REGISTER_COUNT >= 32 && columns.is_multiple_of(4);
    let mut x_tiles = x.values.chunks_exact(ROWS * x.width);
    let mut out_tiles = out.chunks_exact_mut(ROWS * n);
    for (x_tile, out_tile) in x_tiles.by_ref().zip(out_tiles.by_ref()) {
        if wide {
            affine_rows::<S, ROWS, 4>(s, x_tile, w, bias, out_tile, columns);
        } else if columns.is_multiple_of(2) {
            affine_rows::<S, ROWS, 2>(s, x_tile, w, bias, out_tile, columns);
        } else {
            affine_rows::<S, ROWS, 1>(s, x_tile, w, bias, out_tile, columns);
        }
    }
    let last_rows = out_tiles.into_remainder().chunks_exact_mut(n);
    for (x_row, out_row) in x_tiles.remainder().chunks_exact(x.width).zip(last_rows) {
        affine_rows::<S, 1, 1>(s, x_row, w, bias, out_row, columns);
    }
}

/// `R` rows of [`affine`], `C` registers of columns at a time.
#[inline(always)]
fn affine_rows<S: Simd, const R: usize, const C: usize>(
    s: S,
    x: &[f32],
    w: &[S::f32s],
    bias: Option<&[f32]>,
    out: &mut [f32],
    columns: usize,
) {
    let width = x.len() / R;
    let x_rows: [&[f32]; R] = std::array::from_fn(|r| &x[r * width..(r + 1) * width]);
    let bias = bias.map(|b| S::as_simd_f32s(b).0);
    let (out, _) = S::as_mut_simd_f32s(out);
    for first in (0..columns).step_by(C) {
        let mut start = [s.splat_f32s(0.0); C];
        if let Some(bias) = bias {
            start.copy_from_slice(&bias[first..first + C]);
        }
        let mut sums = [start; R];
        for (k, w_row) in w.chunks_exact(columns).enumerate().take(width) {
            let w_row = &w_row[first..first + C];
            for r in 0..R {
                let factor = s.splat_f32s(x_rows[r][k]);
                for c in 0..C {
                    sums[r][c] = s.mul_add_e_f32s(factor, w_row[c], sums[r][c]);
                }
            }
        }
        for (r, sum) in sums.iter().enumerate() {
            out[r * columns + first..][..C].copy_from_slice(sum);
        }
    }
}

/// `g += x^T d`: the gradient by the weights, `x` the layer's input, `d` of `n` columns.
#[inline(always)]
pub(super) fn accumulate_gradient<S: Simd>(s: S, x: Rows<'_>, d: &[f32], g: &mut [f32], n: usize) {
    let columns = n / S::F32_LANES;
    let wide = S::REGISTER_COUNT >= 32 && columns.is_multiple_of(4);
    let (d, _) = S::as_simd_f32s(d);
    let (g, _) = S::as_mut_simd_f32s(g);
    let mut first = 0;
    while first < x.width {
        let g = &mut g[first * columns..];
        if first + ROWS <= x.width && !wide && columns.is_multiple_of(2) {
            outer::<S, ROWS, 2>(s, x, first, d, g, columns);
            first += ROWS;
        } else if first + 4 <= x.width {
            if wide {
                outer::<S, 4, 4>(s, x, first, d, g, columns);
            } else if columns.is_multiple_of(2) {
                outer::<S, 4, 2>(s, x, first, d, g, columns);
            } else {
                outer::<S, 4, 1>(s, x, first, d, g, columns);
            }
            first += 4;
        } else {
            outer::<S, 1, 1>(s, x, first, d, g, columns);
            first += 1;
        }
    }
}

/// `R` rows of the gradient from row `first` on, `C` registers of columns at a time.
#[inline(always)]
fn outer<S: Simd, const R: usize, const C: usize>(
    s: S,
    x: Rows<'_>,
    first: usize,
    d: &[S::f32s],
    g: &mut [S::f32s],
    columns: usize,
) {
    for column in (0..columns).step_by(C) {
        let mut sums = [[s.splat_f32s(0.0); C]; R];
        for (r, sum) in sums.iter_mut().enumerate() {
            sum.copy_from_slice(&g[r * columns + column..][..C]);
        }
        for (x_row, d_row) in x.values.chunks_exact(x.width).zip(d.chunks_exact(columns)) {
            let (x_row, d_row) = (&x_row[first..first + R], &d_row[column..column + C]);
            for r in 0..R {
                let factor = s.splat_f32s(x_row[r]);
                for c in 0..C {
                    sums[r][c] = s.mul_add_e_f32s(factor, d_row[c], sums[r][c]);
                }
            }
        }
        for (r, sum) in sums.iter().enumerate() {
            g[r * columns + column..][..C].copy_from_slice(sum);
        }
    }
}

/// `g += ` the sum of the rows of `d`: the gradient by the biases.
#[inline(always)]
pub(super) fn accumulate_rows<S: Simd>(s: S, d: &[f32], g: &mut [f32]) {
    let n = g.len();
    let (g, _) = S::as_mut_simd_f32s(g);
    for row in d.chunks_exact(n) {
        let (row, _) = S::as_simd_f32s(row);
        for (sum, value) in g.iter_mut().zip(row) {
            *sum = s.add_f32s(*sum, *value);
        }
    }
}

/// Sum of products of two rows of whole registers.
#[inline(always)]
pub(super) fn dot<S: Simd>(s: S, a: &[f32], b: &[f32]) -> f32 {
    let ((a, _), (b, _)) = (S::as_simd_f32s(a), S::as_simd_f32s(b));
    let mut sum = s.splat_f32s(0.0);
    for (x, y) in a.iter().zip(b) {
        sum = s.mul_add_e_f32s(*x, *y, sum);
    }
    s.reduce_sum_f32s(sum)
}
