//! The (r, z) grid of the gap: lines on every material boundary, fine near the coil, growing
//! outwards.

use super::geometry::Geometry;

/// Far boundary of the modelled space, in metre; the field there is below 1e-3 of its maximum.
const FAR_M: f64 = 0.45;

/// Growth of the cells outside the arrangement.
const GROWTH: f64 = 1.25;

/// Cell size in the arrangement at refinement 1, radially and axially, in metre.
const CELL_R_M: f64 = 1.5e-3;
const CELL_Z_M: f64 = 0.9e-3;

/// Two lines closer than this are one line.
const SAME_M: f64 = 1e-6;

/// Grid lines in ascending order; r starts at 0 (axis), z at 0 (shield).
#[derive(Clone, Debug)]
pub struct Grid {
    /// Radii in metre.
    pub r_m: Vec<f64>,
    /// Heights above the shield in metre.
    pub z_m: Vec<f64>,
}

impl Grid {
    /// Creates the lines for an arrangement; `refinement` 2 halves every cell. Without a load the space above the coil is air.
    pub fn new(g: &Geometry, refinement: f64) -> Self {
        let mut r = vec![
            0.0,
            g.coil_inner_m,
            g.coil_outer_m,
            g.load_radius_m.min(FAR_M),
            g.ferrite_radius_m.min(FAR_M),
        ];
        // Room around the load's corner, where the flux of the outer ring leaves.
        r.push((g.load_radius_m + g.load_gap_m).min(FAR_M));
        r.push((g.coil_outer_m + 10e-3).min(FAR_M));
        let z = vec![
            0.0,
            g.ferrite_bottom_m(),
            g.ferrite_top_m(),
            g.coil_bottom_m(),
            g.coil_top_m(),
            g.load_surface_m(),
            g.load_surface_m() + g.load_rim_m,
        ];
        Self {
            r_m: lines(r, CELL_R_M / refinement, refinement),
            z_m: lines(z, CELL_Z_M / refinement, refinement),
        }
    }
}

/// Divides each interval between `marks` evenly into at least two cells of at most `cell_m`, then adds growing cells out to
/// [`FAR_M`].
fn lines(mut marks: Vec<f64>, cell_m: f64, refinement: f64) -> Vec<f64> {
    marks.sort_by(f64::total_cmp);
    marks.dedup_by(|a, b| (*a - *b).abs() < SAME_M);
    let mut out = vec![marks[0]];
    for pair in marks.windows(2) {
        let width = pair[1] - pair[0];
        let cells = (width / cell_m).ceil().max(2.0 * refinement) as usize;
        for k in 1..=cells {
            out.push(pair[0] + width * k as f64 / cells as f64);
        }
    }
    let growth = libm::pow(GROWTH, 1.0 / refinement);
    let mut cell = cell_m;
    let mut at = out[out.len() - 1];
    while at < FAR_M - SAME_M {
        cell *= growth;
        at = if at + 1.5 * cell > FAR_M {
            FAR_M
        } else {
            at + cell
        };
        out.push(at);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_boundary_is_a_line() {
        let g = Geometry::paper();
        let grid = Grid::new(&g, 1.0);
        for z in [
            g.ferrite_top_m(),
            g.coil_bottom_m(),
            g.coil_top_m(),
            g.load_surface_m(),
        ] {
            assert!(grid.z_m.iter().any(|l| (l - z).abs() < 1e-9), "z = {z}");
        }
        for r in [g.coil_inner_m, g.coil_outer_m, g.load_radius_m] {
            assert!(grid.r_m.iter().any(|l| (l - r).abs() < 1e-9), "r = {r}");
        }
        assert!(grid.r_m.windows(2).all(|p| p[1] > p[0]));
        assert!((grid.z_m.last().unwrap() - FAR_M).abs() < 1e-9);
    }
}
