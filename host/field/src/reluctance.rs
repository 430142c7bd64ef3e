//! Reluctance network between shield and load: node classes and coefficients of the
//! five-point equations for ψ = r A_φ.

use super::geometry::Geometry;
use super::grid::Grid;
use super::material::MU_0;

/// Class of a grid node.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Node {
    /// Unknown with its number.
    Free(usize),
    /// Node on the load's surface, with its number.
    Surface(usize),
    /// Node with ψ = 0.
    Zero,
}

/// Grid, node classes and coefficients of one arrangement.
pub(super) struct Network<'a> {
    /// Dimensions.
    pub(super) geometry: &'a Geometry,
    /// Grid lines.
    pub(super) grid: Grid,
    /// Class of each node, column by column.
    pub(super) nodes: Vec<Node>,
    /// (r, z) of each surface node, and the length of load surface that it represents.
    pub(super) surface: Vec<(f64, f64, f64)>,
    /// Number of unknowns.
    pub(super) free: usize,
    with_load: bool,
}

impl<'a> Network<'a> {
    pub(super) fn new(geometry: &'a Geometry, refinement: f64, with_load: bool) -> Self {
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

    /// Reluctivity of a cell in m/H; `None` inside the load.
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
    pub(super) fn turns(&self, i: usize, j: usize) -> f64 {
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
    pub(super) fn edges(&self) -> Vec<(usize, usize, f64)> {
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
    pub(super) fn shape(&self, k: usize, ring: usize, rings: usize) -> f64 {
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
}
