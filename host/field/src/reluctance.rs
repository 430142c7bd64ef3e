//! Magnetic network of shield, ferrite, coil and load: node classes and coefficients of the five-point equations for ψ = r A_φ.

use super::geometry::Geometry;
use super::grid::Grid;
use super::material::{MU_0, Material};

/// Treatment of the load.
#[derive(Clone, Copy)]
pub(super) enum Inside<'a> {
    /// Its surface bounds the network: the metal behind is another model's.
    Surface,
    /// Linear metals, load and shield, belong to the network.
    Metal(&'a Material),
    /// No load; the shield belongs to the network.
    Air,
}

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
    /// (r, z) of each surface node.
    pub(super) surface: Vec<(f64, f64)>,
    /// Number of unknowns.
    pub(super) free: usize,
    inside: Inside<'a>,
}

impl<'a> Network<'a> {
    pub(super) fn new(geometry: &'a Geometry, refinement: f64, inside: Inside<'a>) -> Self {
        let grid = match inside {
            Inside::Surface => Grid::around(geometry, refinement),
            Inside::Metal(metal) => Grid::through(geometry, metal, refinement),
            Inside::Air => Grid::without(geometry, refinement),
        };
        let mut a = Self {
            geometry,
            grid,
            nodes: Vec::new(),
            surface: Vec::new(),
            free: 0,
            inside,
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
        let solid = around(i, j)
            .into_iter()
            .filter(|&(i, j)| self.is_solid(i, j))
            .count();
        match solid {
            0 => {
                self.free += 1;
                Node::Free(self.free - 1)
            }
            4 => Node::Zero,
            _ => {
                self.surface.push((self.grid.r_m[i], self.grid.z_m[j]));
                Node::Surface(self.surface.len() - 1)
            }
        }
    }

    /// Middle of the cell whose lower left node is (i, j).
    fn middle(&self, i: usize, j: usize) -> (f64, f64) {
        let (r, z) = (&self.grid.r_m, &self.grid.z_m);
        ((r[i] + r[i + 1]) / 2.0, (z[j] + z[j + 1]) / 2.0)
    }

    /// Area of the cell whose lower left node is (i, j), in m².
    fn cell_m2(&self, i: usize, j: usize) -> f64 {
        let (r, z) = (&self.grid.r_m, &self.grid.z_m);
        (r[i + 1] - r[i]) * (z[j + 1] - z[j])
    }

    /// Returns `true` for a cell of the load that is not the network's.
    fn is_solid(&self, i: usize, j: usize) -> bool {
        let (r, z) = self.middle(i, j);
        matches!(self.inside, Inside::Surface) && self.geometry.in_load(r, z)
    }

    /// Reluctivity of a cell in m/H; 0 in a load that is not the network's.
    fn reluctivity(&self, i: usize, j: usize) -> f64 {
        let (r, z) = self.middle(i, j);
        let g = self.geometry;
        let ferrite = (g.ferrite_bottom_m()..g.ferrite_top_m()).contains(&z);
        match self.inside {
            _ if r < g.ferrite_radius_m && ferrite => 1.0 / (MU_0 * g.ferrite_mu_r),
            Inside::Surface if g.in_load(r, z) => 0.0,
            Inside::Metal(metal) if g.in_load(r, z) => 1.0 / metal.mu_initial_h_per_m(),
            _ => 1.0 / MU_0,
        }
    }

    /// Conductivity of a cell in S/m.
    fn sigma_s_per_m(&self, i: usize, j: usize) -> f64 {
        let (r, z) = self.middle(i, j);
        match self.inside {
            Inside::Metal(metal) if self.geometry.in_load(r, z) => metal.sigma_s_per_m(),
            Inside::Metal(_) | Inside::Air
                if (-self.geometry.shield_thickness_m..0.0).contains(&z) =>
            {
                Material::ALUMINIUM.sigma_s_per_m()
            }
            _ => 0.0,
        }
    }

    /// Coil turns in the dual cell of node (i, j).
    pub(super) fn turns(&self, i: usize, j: usize) -> f64 {
        let g = self.geometry;
        let mut turns = 0.0;
        for (ci, cj) in around(i, j) {
            let (r, z) = self.middle(ci, cj);
            if (g.coil_inner_m..g.coil_outer_m).contains(&r)
                && (g.coil_bottom_m()..g.coil_top_m()).contains(&z)
            {
                turns += g.turn_density_per_m2() * self.cell_m2(ci, cj) / 4.0;
            }
        }
        turns
    }

    /// Eddy current around node (i, j) per volt-second of −dψ/dt, in S/m.
    pub(super) fn conductance(&self, i: usize, j: usize) -> f64 {
        let quarters = around(i, j).into_iter();
        let sum: f64 = quarters
            .map(|(i, j)| self.sigma_s_per_m(i, j) * self.cell_m2(i, j) / 4.0)
            .sum();
        sum / self.grid.r_m[i]
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
}

/// Cells around an inner node, by their lower left nodes.
fn around(i: usize, j: usize) -> [(usize, usize); 4] {
    [(i - 1, j - 1), (i, j - 1), (i - 1, j), (i, j)]
}
