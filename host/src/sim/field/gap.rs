//! The magnetostatic field between shield and load, condensed to the load's rings.
//!
//! Unknown is ψ = r A_φ on a tensor grid (finite volumes, five points): around every dual cell
//! Σ H·length = enclosed current. Coil current and the flux entering the load are sources; the
//! shield and the far boundary have ψ = 0 (perfect conductor). The solution is linear in both, so
//! for ring values A (flux per circumference in the load's surface layer, Wb/m), H (tangential
//! field at the load, A/m), coil current i and flux linkage λ:
//!
//!   W H = P i − S A,   λ = L0 i + Pᵀ A
//!
//! S is symmetric and positive, and the same P appears twice: no energy is lost in between.

use nalgebra::DMatrix;
use nalgebra_sparse::{CooMatrix, CscMatrix, factorization::CscCholesky};

use super::error::FieldError;
use super::geometry::Geometry;
use super::grid::Grid;
use super::material::MU_0;

/// The condensed gap; see the module's equations.
#[derive(Clone, Debug, PartialEq)]
pub struct GapOperator {
    /// Flux linkage per ampere with no flux in the load, in henry.
    pub l0_h: f64,
    /// P, in metre: ring mmf per ampere times the ring's circumference.
    pub p_m: Vec<f64>,
    /// S, row by row, in m²/H·m = m/(H/m).
    pub s: Vec<f64>,
    /// W, the area of each ring in m².
    pub w_m2: Vec<f64>,
}

/// What a grid node is to the solver.
#[derive(Clone, Copy, PartialEq)]
enum Node {
    /// Unknown with its number.
    Free(usize),
    /// On the load's surface, with its number.
    Surface(usize),
    /// ψ = 0.
    Zero,
}

impl GapOperator {
    /// Solves the gap for a load of `rings` rings of equal width. `refinement` 1 is the standard
    /// grid, 2 halves its cells.
    pub fn new(geometry: &Geometry, rings: usize, refinement: f64) -> Result<Self, FieldError> {
        geometry.check()?;
        Assembly::new(geometry, refinement, true).condense(rings)
    }

    /// Inductance of the coil over its ferrite without a load, in henry.
    pub fn bare_coil_h(geometry: &Geometry, refinement: f64) -> Result<f64, FieldError> {
        geometry.check()?;
        Ok(Assembly::new(geometry, refinement, false).condense(0)?.l0_h)
    }

    /// Number of rings.
    pub fn rings(&self) -> usize {
        self.w_m2.len()
    }

    /// Surface field per ampere if no flux entered the load, in 1/m: the thin-gap profile.
    pub fn profile_per_m(&self) -> Vec<f64> {
        self.p_m
            .iter()
            .zip(&self.w_m2)
            .map(|(p, w)| p / w)
            .collect()
    }
}

/// Grid, node classes and coefficients of one arrangement.
struct Assembly<'a> {
    geometry: &'a Geometry,
    grid: Grid,
    nodes: Vec<Node>,
    /// (r, z) of each surface node and the length of load surface it stands for.
    surface: Vec<(f64, f64, f64)>,
    free: usize,
    with_load: bool,
}

impl<'a> Assembly<'a> {
    fn new(geometry: &'a Geometry, refinement: f64, with_load: bool) -> Self {
        let grid = Grid::new(geometry, refinement);
        let mut a = Self {
            geometry,
            grid,
            nodes: Vec::new(),
            surface: Vec::new(),
            free: 0,
            with_load,
        };
        let (nr, nz) = (a.grid.r_m.len(), a.grid.z_m.len());
        for i in 0..nr {
            for j in 0..nz {
                let edge = i == 0 || j == 0 || i == nr - 1 || j == nz - 1;
                let node = if edge { Node::Zero } else { a.classify(i, j) };
                a.nodes.push(node);
            }
        }
        a
    }

    fn classify(&mut self, i: usize, j: usize) -> Node {
        let inside = [(i - 1, j - 1), (i, j - 1), (i - 1, j), (i, j)]
            .iter()
            .filter(|&&(ci, cj)| self.in_load(ci, cj))
            .count();
        match inside {
            0 => {
                self.free += 1;
                Node::Free(self.free - 1)
            }
            4 => Node::Zero,
            _ if self.grid.z_m[j]
                > self.geometry.load_surface_m() + self.geometry.load_rim_m - 1e-9 =>
            {
                Node::Zero
            }
            _ => {
                let (r, z) = (self.grid.r_m[i], self.grid.z_m[j]);
                let bottom = (z - self.geometry.load_surface_m()).abs() < 1e-9;
                let length = if !bottom {
                    0.0
                } else if self.in_load(i, j) {
                    (self.grid.r_m[i + 1] - self.grid.r_m[i - 1]) / 2.0
                } else {
                    (self.grid.r_m[i] - self.grid.r_m[i - 1]) / 2.0
                };
                self.surface.push((r, z, length));
                Node::Surface(self.surface.len() - 1)
            }
        }
    }

    /// Middle of the cell whose lower left node is (i, j).
    fn middle(&self, i: usize, j: usize) -> (f64, f64) {
        let (r, z) = (&self.grid.r_m, &self.grid.z_m);
        ((r[i] + r[i + 1]) / 2.0, (z[j] + z[j + 1]) / 2.0)
    }

    fn in_load(&self, i: usize, j: usize) -> bool {
        let (r, z) = self.middle(i, j);
        let bottom = self.geometry.load_surface_m();
        self.with_load
            && r < self.geometry.load_radius_m
            && (bottom..bottom + self.geometry.load_rim_m).contains(&z)
    }

    /// Reluctivity of a cell in m/H; none inside the load.
    fn reluctivity(&self, i: usize, j: usize) -> f64 {
        let (r, z) = self.middle(i, j);
        let g = self.geometry;
        if self.in_load(i, j) {
            0.0
        } else if r < g.ferrite_radius_m && (g.ferrite_bottom_m()..g.ferrite_top_m()).contains(&z) {
            1.0 / (MU_0 * g.ferrite_mu_r)
        } else {
            1.0 / MU_0
        }
    }

    /// Coil turns in the dual cell of node (i, j).
    fn turns(&self, i: usize, j: usize) -> f64 {
        let g = self.geometry;
        let mut turns = 0.0;
        for (ci, cj) in [(i - 1, j - 1), (i, j - 1), (i - 1, j), (i, j)] {
            let (r, z) = self.middle(ci, cj);
            if (g.coil_inner_m..g.coil_outer_m).contains(&r)
                && (g.coil_bottom_m()..g.coil_top_m()).contains(&z)
            {
                let dr = self.grid.r_m[ci + 1] - self.grid.r_m[ci];
                let dz = self.grid.z_m[cj + 1] - self.grid.z_m[cj];
                turns += g.turn_density_per_m2() * dr * dz / 4.0;
            }
        }
        turns
    }

    /// Every grid edge between inner nodes with its coefficient: (node, node, A per Wb).
    fn edges(&self) -> Vec<(usize, usize, f64)> {
        let (r, z) = (&self.grid.r_m, &self.grid.z_m);
        let (nr, nz) = (r.len(), z.len());
        let mut edges = Vec::with_capacity(2 * nr * nz);
        for i in 0..nr - 1 {
            for j in 1..nz - 1 {
                // Radial: H_z along the two half cells above and below.
                let (below, above) = (z[j] - z[j - 1], z[j + 1] - z[j]);
                let nu =
                    self.reluctivity(i, j - 1) * below / 2.0 + self.reluctivity(i, j) * above / 2.0;
                let middle = (r[i] + r[i + 1]) / 2.0;
                edges.push((
                    i * nz + j,
                    (i + 1) * nz + j,
                    nu / (middle * (r[i + 1] - r[i])),
                ));
            }
        }
        for i in 1..nr - 1 {
            for j in 0..nz - 1 {
                // Axial: H_r along the two half cells inside and outside.
                let (inner, outer) = (r[i] - r[i - 1], r[i + 1] - r[i]);
                let nu =
                    self.reluctivity(i - 1, j) * inner / 2.0 + self.reluctivity(i, j) * outer / 2.0;
                edges.push((i * nz + j, i * nz + j + 1, nu / (r[i] * (z[j + 1] - z[j]))));
            }
        }
        edges
    }

    /// ψ at surface node `k` for unit A of ring `ring`: a hat over the ring centres times r, and
    /// on the side wall the outer ring's value, falling to zero over the rim.
    fn shape(&self, k: usize, ring: usize, rings: usize) -> f64 {
        let (r, z, _) = self.surface[k];
        let width = self.geometry.load_radius_m / rings as f64;
        let at = (r / width - 0.5).clamp(-0.5, (rings - 1) as f64);
        let hat = if at < 0.0 {
            // Towards the axis A falls in proportion to r.
            if ring == 0 { (at + 0.5) / 0.5 } else { 0.0 }
        } else {
            (1.0 - (at - ring as f64).abs()).max(0.0)
        };
        let up = (z - self.geometry.load_surface_m()) / self.geometry.load_rim_m;
        hat * r * (1.0 - up).clamp(0.0, 1.0)
    }

    fn condense(&self, rings: usize) -> Result<GapOperator, FieldError> {
        let columns = rings + 1;
        let mut shape = DMatrix::<f64>::zeros(self.surface.len(), rings);
        for k in 0..self.surface.len() {
            for ring in 0..rings {
                shape[(k, ring)] = self.shape(k, ring, rings);
            }
        }
        // Right-hand sides: coil turns, then −K_fs T for each ring. And T' K_ss T.
        let mut matrix = CooMatrix::new(self.free, self.free);
        let mut rhs = DMatrix::<f64>::zeros(self.free, columns);
        let mut s = DMatrix::<f64>::zeros(rings, rings);
        for (a, b, k) in self.edges() {
            for (x, y) in [(a, b), (b, a)] {
                match (self.nodes[x], self.nodes[y]) {
                    (Node::Free(f), other) => {
                        matrix.push(f, f, k);
                        match other {
                            Node::Free(g) => matrix.push(f, g, -k),
                            Node::Surface(g) => {
                                for ring in 0..rings {
                                    rhs[(f, 1 + ring)] += k * shape[(g, ring)];
                                }
                            }
                            Node::Zero => {}
                        }
                    }
                    (Node::Surface(f), other) => {
                        for m in 0..rings {
                            for n in 0..rings {
                                s[(m, n)] += k * shape[(f, m)] * shape[(f, n)];
                                if let Node::Surface(g) = other {
                                    s[(m, n)] -= k * shape[(f, m)] * shape[(g, n)];
                                }
                            }
                        }
                    }
                    (Node::Zero, _) => {}
                }
            }
        }
        let nz = self.grid.z_m.len();
        for (index, node) in self.nodes.iter().enumerate() {
            if let Node::Free(f) = *node {
                rhs[(f, 0)] = self.turns(index / nz, index % nz);
            }
        }
        let cholesky = CscCholesky::factor(&CscMatrix::from(&matrix))
            .map_err(|_| FieldError::Singular { nodes: self.free })?;
        let psi = cholesky.solve(&rhs);
        Ok(self.operator(rings, &shape, &rhs, &psi, &s))
    }

    fn operator(
        &self,
        rings: usize,
        shape: &DMatrix<f64>,
        rhs: &DMatrix<f64>,
        psi: &DMatrix<f64>,
        s_direct: &DMatrix<f64>,
    ) -> GapOperator {
        let two_pi = 2.0 * core::f64::consts::PI;
        // Written out: a library product may sum in another order on another processor.
        let energy = DMatrix::from_fn(rings + 1, rings + 1, |m, n| {
            rhs.column(m)
                .iter()
                .zip(psi.column(n).iter())
                .map(|(a, b)| a * b)
                .sum::<f64>()
        });
        let mut s = Vec::with_capacity(rings * rings);
        for m in 0..rings {
            for n in 0..rings {
                // Symmetric by construction up to rounding; made exactly so.
                let direct = (s_direct[(m, n)] + s_direct[(n, m)]) / 2.0;
                let schur = direct - (energy[(1 + m, 1 + n)] + energy[(1 + n, 1 + m)]) / 2.0;
                s.push(two_pi * schur);
            }
        }
        let w_m2 = (0..rings)
            .map(|ring| {
                (0..self.surface.len())
                    .map(|k| two_pi * shape[(k, ring)] * self.surface[k].2)
                    .sum()
            })
            .collect();
        let turns = self.geometry.turns_calibration;
        GapOperator {
            l0_h: two_pi * energy[(0, 0)] * turns * turns,
            p_m: (0..rings)
                .map(|ring| two_pi * energy[(1 + ring, 0)] * turns)
                .collect(),
            s,
            w_m2,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thin_gap_inductance_is_the_slab_formula_plus_fringe() {
        // A perfectly conducting wide load: H = turns/width above the coil, µ0 H²/2 stored in
        // load gap + a third of the coil; the fringe at both radii changes that by some percent.
        let mut g = Geometry::paper();
        g.load_radius_m = 0.2;
        g.ferrite_radius_m = 0.2;
        g.ferrite_mu_r = 1e5;
        g.turns_calibration = 1.0;
        let gap = GapOperator::new(&g, 16, 1.0).unwrap();
        let k = g.turns / (g.coil_outer_m - g.coil_inner_m);
        let area = core::f64::consts::PI * (g.coil_outer_m.powi(2) - g.coil_inner_m.powi(2));
        let slab_h = MU_0 * k * k * area * (g.load_gap_m + g.coil_thickness_m / 3.0);
        let ratio = gap.l0_h / slab_h;
        println!("L0 {:.3} µH, slab {:.3} µH", gap.l0_h * 1e6, slab_h * 1e6);
        assert!((0.85..1.0).contains(&ratio), "ratio {ratio}");
    }

    #[test]
    fn halving_the_cells_changes_little() {
        let g = Geometry::paper();
        let a = GapOperator::new(&g, 16, 1.0).unwrap();
        let b = GapOperator::new(&g, 16, 2.0).unwrap();
        assert!(
            (a.l0_h / b.l0_h - 1.0).abs() < 5e-3,
            "{} {}",
            a.l0_h,
            b.l0_h
        );
        for ring in 0..16 {
            let scale = b.p_m.iter().fold(0.0, |m: f64, p| m.max(*p));
            assert!(
                (a.p_m[ring] - b.p_m[ring]).abs() < 1e-2 * scale,
                "ring {ring}"
            );
        }
    }

    #[test]
    fn stored_energy_is_positive_for_every_current_and_flux() {
        let gap = GapOperator::new(&Geometry::paper(), 16, 1.0).unwrap();
        let s = DMatrix::from_row_slice(16, 16, &gap.s);
        assert!(s.clone().cholesky().is_some());
        assert!(gap.l0_h > 0.0);
        assert!((s.clone() - s.transpose()).amax() == 0.0);
    }

    #[test]
    fn coil_without_load_has_more_inductance_than_over_a_conductor() {
        let g = Geometry::paper();
        let bare = GapOperator::bare_coil_h(&g, 1.0).unwrap();
        let loaded = GapOperator::new(&g, 16, 1.0).unwrap().l0_h;
        println!(
            "bare {:.1} µH, conductor {:.1} µH",
            bare * 1e6,
            loaded * 1e6
        );
        assert!(bare > 3.0 * loaded);
    }
}
