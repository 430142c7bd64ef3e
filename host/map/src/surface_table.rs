//! Table of F(h) of [`ihd_field::surface`], the flux that a metal's surface passes; one table serves all metals.

use std::sync::LazyLock;

use ihd_field::surface::{MAX_FIELD, flux_of_field};
use nalgebra::Complex;

/// Points of the table, even in ln(1 + h): F bends little there, and a cubic through four points has an error of 1e-6.
const POINTS: usize = 64;

static TABLE: LazyLock<Vec<Complex<f64>>> = LazyLock::new(|| {
    let last = (1.0 + MAX_FIELD).ln();
    (0..POINTS)
        .map(|k| {
            let h = (k as f64 / (POINTS - 1) as f64 * last).exp() - 1.0;
            // Within its range it converges (tests of host/field); a half-space without saturation is the fallback.
            flux_of_field(h.min(MAX_FIELD)).unwrap_or(Complex::new(0.5, -0.5))
        })
        .collect()
});

/// F at an amplitude of the surface field over α; constant beyond [`MAX_FIELD`], which no hob's coil reaches.
pub(crate) fn flux_of(h: f64) -> Complex<f64> {
    let (first, x) = place(h);
    weighted(first, lagrange(NODES, x))
}

/// Slope of F over ln of the amplitude.
pub(crate) fn flux_slope_of(h: f64) -> Complex<f64> {
    if !(0.0..MAX_FIELD).contains(&h) {
        return Complex::new(0.0, 0.0);
    }
    let (first, x) = place(h);
    weighted(first, lagrange_slopes(NODES, x)) * (scale() * h / (1.0 + h))
}

const NODES: [f64; 4] = [0.0, 1.0, 2.0, 3.0];

/// Points of the table per unit of ln(1 + h).
fn scale() -> f64 {
    (POINTS - 1) as f64 / (1.0 + MAX_FIELD).ln()
}

/// Index of the first of four points around an amplitude, and the distance from it in points.
fn place(h: f64) -> (usize, f64) {
    let x = ((1.0 + h.max(0.0)).ln() * scale()).min((POINTS - 1) as f64);
    let first = (x as usize).saturating_sub(1).min(POINTS - 4);
    (first, x - first as f64)
}

fn weighted(first: usize, weights: [f64; 4]) -> Complex<f64> {
    let table = &*TABLE;
    (0..4).fold(Complex::new(0.0, 0.0), |sum, k| {
        sum + table[first + k] * weights[k]
    })
}

/// Weights of four nodes in the cubic through them, at `x`.
pub(crate) fn lagrange(nodes: [f64; 4], x: f64) -> [f64; 4] {
    std::array::from_fn(|k| {
        (0..4)
            .filter(|n| *n != k)
            .map(|n| (x - nodes[n]) / (nodes[k] - nodes[n]))
            .product()
    })
}

/// Slopes of these weights.
pub(crate) fn lagrange_slopes(nodes: [f64; 4], x: f64) -> [f64; 4] {
    std::array::from_fn(|k| {
        let others = || (0..4).filter(move |n| *n != k);
        others()
            .map(|m| {
                let rest = others().filter(|n| *n != m);
                let product: f64 = rest
                    .map(|n| (x - nodes[n]) / (nodes[k] - nodes[n]))
                    .product();
                product / (nodes[k] - nodes[m])
            })
            .sum()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_its_points_the_table_follows_the_half_space() {
        for h in [0.0, 0.013, 0.4, 1.7, 6.1, 23.0, 58.0] {
            let (table, exact) = (flux_of(h), flux_of_field(h).unwrap());
            assert!(
                (table - exact).norm() < 2e-5 * exact.norm(),
                "{h}: {table} {exact}"
            );
        }
        assert_eq!(flux_of(1e9), flux_of(MAX_FIELD));
    }
}
