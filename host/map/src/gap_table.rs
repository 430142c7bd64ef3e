//! The field between shield and pot, over the radius of a pot's base and its lift: [`ihd_field::gap`] at nodes, cubic in
//! between. Made by `cargo run --release -p ihd-map --example gap_table`; a test computes nodes of it again.

use std::sync::LazyLock;

use ihd_field::gap::GapOperator;
use ihd_field::model::RINGS;
use ihd_field::{FieldError, Geometry};

use crate::surface_table::lagrange;

/// Radii of a pot's base in metre; the coil ends at 105 mm, where everything bends most.
pub const RADII_M: [f64; 16] = [
    0.025, 0.031, 0.037, 0.044, 0.051, 0.058, 0.065, 0.072, 0.079, 0.086, 0.093, 0.099, 0.105,
    0.111, 0.119, 0.130,
];

/// Lifts above the pot's usual place in metre.
pub const LIFTS_M: [f64; 11] = [
    -0.002, -0.0005, 0.001, 0.003, 0.006, 0.010, 0.015, 0.022, 0.032, 0.045, 0.065,
];

/// Numbers of a node: L0, P, W and the lower half of S.
const NUMBERS: usize = 1 + 2 * RINGS + RINGS * (RINGS + 1) / 2;

/// 4 bytes a number, little endian, radius by radius, lift by lift.
static FILE: &[u8] = include_bytes!("gap_table.bin");

static TABLE: LazyLock<Vec<f64>> = LazyLock::new(|| {
    let number = |b: &[u8]| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    FILE.chunks_exact(4).map(number).collect()
});

/// The gap under one pot.
#[derive(Clone, Debug)]
pub(crate) struct Gap {
    /// Flux linkage per ampere without flux in the pot, in henry.
    pub l0_h: f64,
    /// Drive of each ring, in metre.
    pub p_m: [f64; RINGS],
    /// Area of each ring, in m².
    pub w_m2: [f64; RINGS],
    /// Reluctance between rings.
    pub s: [[f64; RINGS]; RINGS],
}

impl Gap {
    /// Under a pot of this radius and lift in metre; beyond the table its edge counts.
    pub fn of(radius_m: f64, lift_m: f64) -> Self {
        let (radius, by_radius) = place(&RADII_M, radius_m);
        let (lift, by_lift) = place(&LIFTS_M, lift_m);
        let mut numbers = [0.0; NUMBERS];
        for (k, x) in by_radius.iter().enumerate() {
            for (n, y) in by_lift.iter().enumerate() {
                let node = (radius + k) * LIFTS_M.len() + lift + n;
                let at = &TABLE[node * NUMBERS..][..NUMBERS];
                for (sum, number) in numbers.iter_mut().zip(at) {
                    *sum += x * y * number;
                }
            }
        }
        Self::from_numbers(&numbers)
    }

    fn from_numbers(numbers: &[f64; NUMBERS]) -> Self {
        let (head, half) = numbers.split_at(1 + 2 * RINGS);
        let mut s = [[0.0; RINGS]; RINGS];
        let lower = (0..RINGS).flat_map(|m| (0..=m).map(move |n| (m, n)));
        for ((m, n), value) in lower.zip(half) {
            s[m][n] = *value;
            s[n][m] = *value;
        }
        Self {
            l0_h: head[0],
            p_m: std::array::from_fn(|k| head[1 + k]),
            w_m2: std::array::from_fn(|k| head[1 + RINGS + k]),
            s,
        }
    }
}

/// The first of four nodes around `x`, and their weights.
fn place(nodes: &[f64], x: f64) -> (usize, [f64; 4]) {
    let x = x.clamp(nodes[0], nodes[nodes.len() - 1]);
    let above = nodes.partition_point(|n| *n < x);
    let first = above.saturating_sub(2).min(nodes.len() - 4);
    (
        first,
        lagrange(std::array::from_fn(|k| nodes[first + k]), x),
    )
}

/// The table's bytes, computed: some two seconds.
///
/// # Errors
/// [`FieldError`] of the gap.
pub fn compute() -> Result<Vec<u8>, FieldError> {
    let mut bytes = Vec::with_capacity(FILE.len());
    for radius_m in RADII_M {
        for lift_m in LIFTS_M {
            bytes.extend(node(radius_m, lift_m)?);
        }
    }
    Ok(bytes)
}

fn node(radius_m: f64, lift_m: f64) -> Result<Vec<u8>, FieldError> {
    let paper = Geometry::paper();
    let geometry = Geometry {
        load_radius_m: radius_m,
        load_gap_m: paper.load_gap_m + lift_m,
        ..paper
    };
    let gap = GapOperator::new(&geometry, RINGS, 1.0)?;
    let half = (0..RINGS).flat_map(|m| gap.s[m * RINGS..][..=m].to_vec());
    let numbers = [gap.l0_h]
        .into_iter()
        .chain(gap.p_m.clone())
        .chain(gap.w_m2.clone())
        .chain(half);
    Ok(numbers.flat_map(|x| (x as f32).to_le_bytes()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_is_what_the_gap_gives() {
        assert_eq!(FILE.len(), 4 * NUMBERS * RADII_M.len() * LIFTS_M.len());
        for (r, l) in [(0, 0), (7, 3), (12, 10), (15, 5)] {
            let at = 4 * NUMBERS * (r * LIFTS_M.len() + l);
            let fresh = node(RADII_M[r], LIFTS_M[l]).unwrap();
            assert_eq!(
                &FILE[at..at + fresh.len()],
                fresh,
                "node {r}, {l}: make the table again"
            );
        }
    }

    /// Between the nodes, against the gap itself: halving its cells changes P by up to 1 %.
    #[test]
    fn between_nodes_it_is_the_gap() {
        for (radius_m, lift_m) in [
            (0.0475, 0.002),
            (0.0895, 0.0),
            (0.102, 0.008),
            (0.108, 0.019),
        ] {
            let mut fresh = node(radius_m, lift_m)
                .unwrap()
                .chunks_exact(4)
                .map(|b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])))
                .collect::<Vec<_>>();
            fresh.truncate(NUMBERS);
            let exact = Gap::from_numbers(&fresh.try_into().unwrap());
            let found = Gap::of(radius_m, lift_m);
            assert!(
                (found.l0_h / exact.l0_h - 1.0).abs() < 5e-3,
                "{} {}",
                found.l0_h,
                exact.l0_h
            );
            let largest = exact.p_m.iter().fold(0.0, |m: f64, p| m.max(*p));
            for k in 0..RINGS {
                assert!(
                    (found.p_m[k] - exact.p_m[k]).abs() < 3e-2 * largest,
                    "ring {k} at {radius_m}"
                );
            }
        }
    }
}
