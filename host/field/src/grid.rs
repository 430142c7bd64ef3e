//! The (r, z) grid: lines on every material boundary, fine near coil and metal, growing outwards.

use super::geometry::Geometry;
use super::material::Material;

/// Far boundary of the modelled space, in metre; the field there is below 1e-3 of its maximum.
const FAR_M: f64 = 0.45;

/// Growth of the cells outside the arrangement.
const GROWTH: f64 = 1.25;

/// Growth of the cells from a conductor's face.
const GROWTH_AT_FACE: f64 = 1.35;

/// Cell size in the arrangement at refinement 1, radially and axially, in metre.
const CELL_R_M: f64 = 1.5e-3;
const CELL_Z_M: f64 = 0.9e-3;

/// The same where a conductor is resolved, and sizes beside the coil's and the ferrite's faces.
const WIDE_CELL_R_M: f64 = 3e-3;
const WIDE_CELL_Z_M: f64 = 1.5e-3;
const COIL_CELL_R_M: f64 = 1e-3;
const COIL_CELL_Z_M: f64 = 0.6e-3;

/// Size of the cells at the top of a wall, in metre.
const WALL_TOP_CELL_M: f64 = 4e-3;

/// Size of the cells at a foil's edge over its thickness.
const FOIL_CELL: f64 = 0.25;

/// First cell at a resolved conductor's face, in skin depths at [`F_FACE_HZ`].
const FIRST_CELL: f64 = 0.2;

/// Frequency in hertz for which faces are resolved.
const F_FACE_HZ: f64 = 60e3;

/// Two lines closer than this are one line.
const SAME_M: f64 = 1e-6;

/// Grid lines in ascending order.
#[derive(Clone, Debug)]
pub struct Grid {
    /// Radii in metre, from 0 (axis).
    pub r_m: Vec<f64>,
    /// Heights above the shield in metre.
    pub z_m: Vec<f64>,
}

/// Line that must exist, and the size of the cells beside it.
#[derive(Clone, Copy)]
struct Mark {
    at_m: f64,
    cell_m: f64,
}

impl Grid {
    /// Creates the lines around a load whose surface bounds the space; `refinement` 2 halves every cell.
    pub fn around(g: &Geometry, refinement: f64) -> Self {
        let (cell_r_m, cell_z_m) = (CELL_R_M / refinement, CELL_Z_M / refinement);
        let mut r = radii(g, cell_r_m);
        let mut z = heights(g, cell_z_m);
        load(g, cell_r_m.min(cell_z_m), &mut r, &mut z);
        Self {
            r_m: lines(&r, cell_r_m, refinement),
            z_m: lines(&z, cell_z_m, refinement),
        }
    }

    /// Creates the lines through a load and a shield whose skin depths they resolve.
    pub fn through(g: &Geometry, metal: &Material, refinement: f64) -> Self {
        let skin_m = metal.skin_depth_m(F_FACE_HZ);
        Self::resolved(g, Some(skin_m * FIRST_CELL / refinement), refinement)
    }

    /// Creates the lines through a shield without a load above the coil.
    pub fn without(g: &Geometry, refinement: f64) -> Self {
        Self::resolved(g, None, refinement)
    }

    fn resolved(g: &Geometry, face_m: Option<f64>, refinement: f64) -> Self {
        let (cell_r_m, cell_z_m) = (WIDE_CELL_R_M / refinement, WIDE_CELL_Z_M / refinement);
        let mut r = radii(g, COIL_CELL_R_M / refinement);
        let mut z = heights(g, COIL_CELL_Z_M / refinement);
        if let Some(face_m) = face_m {
            load(g, face_m, &mut r, &mut z);
        }
        if g.shield_thickness_m > 0.0 {
            let cell_m = Material::ALUMINIUM.skin_depth_m(F_FACE_HZ) * FIRST_CELL / refinement;
            for at_m in [0.0, -g.shield_thickness_m] {
                z.push(Mark { at_m, cell_m });
            }
            z.push(outer_boundary(-FAR_M));
        }
        Self {
            r_m: lines(&r, cell_r_m, refinement),
            z_m: lines(&z, cell_z_m, refinement),
        }
    }
}

/// Line at the boundary, where any cell is fine enough.
fn outer_boundary(at_m: f64) -> Mark {
    Mark {
        at_m,
        cell_m: f64::INFINITY,
    }
}

/// Radii that every grid has.
fn radii(g: &Geometry, cell_m: f64) -> Vec<Mark> {
    let inner = [
        0.0,
        g.coil_inner_m,
        g.coil_outer_m,
        g.ferrite_radius_m,
        g.coil_outer_m + 10e-3,
    ];
    let mut marks = vec![outer_boundary(FAR_M)];
    marks.extend(inner.map(|at_m| Mark {
        at_m: at_m.min(FAR_M),
        cell_m,
    }));
    marks
}

/// Heights that every grid has.
fn heights(g: &Geometry, cell_m: f64) -> Vec<Mark> {
    let inner = [
        0.0,
        g.ferrite_bottom_m(),
        g.ferrite_top_m(),
        g.coil_bottom_m(),
        g.coil_top_m(),
    ];
    let mut marks = vec![outer_boundary(FAR_M)];
    marks.extend(inner.map(|at_m| Mark { at_m, cell_m }));
    marks
}

/// Adds the faces of a load.
fn load(g: &Geometry, cell_m: f64, r: &mut Vec<Mark>, z: &mut Vec<Mark>) {
    let near = |at_m: f64| Mark {
        at_m: at_m.min(FAR_M),
        cell_m,
    };
    r.push(near(g.load_radius_m));
    if g.hole_radius_m > 0.0 {
        r.push(near(g.hole_radius_m));
    }
    z.extend([g.load_surface_m(), g.load_top_m()].map(near));
    if g.foil_thickness_m > 0.0 {
        let fine = |at_m| Mark {
            cell_m: cell_m.min(g.foil_thickness_m * FOIL_CELL),
            ..near(at_m)
        };
        r.push(fine(g.load_radius_m));
        z.extend([g.load_surface_m(), g.foil_top_m()].map(fine));
    }
    if g.wall_height_m > 0.0 {
        r.push(near(g.wall_inner_m()));
        // There is little field there.
        z.push(Mark {
            at_m: g.load_top_m() + g.wall_height_m,
            cell_m: WALL_TOP_CELL_M,
        });
    }
}

/// Divides each interval between marks: cells grow from both ends up to `cell_m`, or to the larger of both ends' cells; at least
/// two cells.
fn lines(marks: &[Mark], cell_m: f64, refinement: f64) -> Vec<f64> {
    let mut marks = marks.to_vec();
    marks.sort_by(|a, b| a.at_m.total_cmp(&b.at_m));
    marks.dedup_by(|next, kept| {
        let same = (next.at_m - kept.at_m).abs() < SAME_M;
        if same {
            kept.cell_m = kept.cell_m.min(next.cell_m);
        }
        same
    });
    let mut out = vec![marks[0].at_m];
    for pair in marks.windows(2) {
        let width = pair[1].at_m - pair[0].at_m;
        let graded = pair.iter().any(|m| m.cell_m < 0.99 * cell_m);
        let growth = libm::pow(
            if graded { GROWTH_AT_FACE } else { GROWTH },
            1.0 / refinement,
        );
        let largest = pair[0].cell_m.max(pair[1].cell_m).max(cell_m);
        let mut ends = [Vec::new(), Vec::new()];
        let mut next = [pair[0].cell_m, pair[1].cell_m];
        let mut filled = 0.0;
        while filled < width {
            let side = usize::from(next[1] < next[0]);
            ends[side].push(next[side]);
            filled += next[side];
            next[side] = (next[side] * growth).min(largest);
        }
        let [mut cells, back] = ends;
        cells.extend(back.into_iter().rev());
        let least = (2.0 * refinement) as usize;
        if cells.len() < least {
            (cells, filled) = (vec![1.0; least], least as f64);
        }
        let mut at = pair[0].at_m;
        let scale = width / filled;
        for cell in &cells[..cells.len() - 1] {
            at += cell * scale;
            out.push(at);
        }
        out.push(pair[1].at_m);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_boundary_is_a_line() {
        let mut g = Geometry::paper();
        g.wall_height_m = 0.08;
        for grid in [
            Grid::around(&g, 1.0),
            Grid::through(&g, &Material::ALUMINIUM, 1.0),
        ] {
            for z in [
                0.0,
                g.ferrite_top_m(),
                g.coil_bottom_m(),
                g.coil_top_m(),
                g.load_surface_m(),
                g.load_top_m(),
                g.load_top_m() + g.wall_height_m,
            ] {
                assert!(grid.z_m.iter().any(|l| (l - z).abs() < 1e-9), "z = {z}");
            }
            for r in [
                g.coil_inner_m,
                g.coil_outer_m,
                g.load_radius_m,
                g.wall_inner_m(),
            ] {
                assert!(grid.r_m.iter().any(|l| (l - r).abs() < 1e-9), "r = {r}");
            }
            for axis in [&grid.r_m, &grid.z_m] {
                assert!(axis.windows(2).all(|p| p[1] > p[0]));
                assert!((axis.last().unwrap() - FAR_M).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_resolved_face_has_cells_below_a_skin_depth_on_both_sides() {
        let g = Geometry::paper();
        let grid = Grid::through(&g, &Material::STAINLESS_304, 1.0);
        let skin_m = Material::STAINLESS_304.skin_depth_m(80e3);
        let beside = |axis: &[f64], at: f64| {
            let k = axis.iter().position(|l| (l - at).abs() < 1e-9).unwrap();
            (axis[k + 1] - axis[k]).max(axis[k] - axis[k - 1])
        };
        assert!(beside(&grid.z_m, g.load_surface_m()) < 0.5 * skin_m);
        assert!(beside(&grid.z_m, g.load_top_m()) < 0.5 * skin_m);
        assert!(beside(&grid.r_m, g.load_radius_m) < 0.5 * skin_m);
    }
}
