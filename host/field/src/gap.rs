//! The magnetostatic field between shield and load, condensed to the load's rings ([`crate::contour`]).
//!
//! The unknown is ψ = r A_φ on a tensor grid (finite volumes, five points): around every dual cell
//! Σ H·length = enclosed current. Coil current and the flux entering the load are sources; the
//! shield and the far boundary have ψ = 0 (perfect conductor). The solution is linear in both, so
//! for ring values A (flux per circumference in the load's surface layer, Wb/m), H (tangential
//! field at the load, A/m), coil current i and flux linkage λ:
//!
//!   W H = P i − S A,   λ = L0 i + Pᵀ A
//!
//! S is symmetric and positive, and the same P appears twice, so that no energy is lost in between.

use nalgebra::{Complex, DMatrix, DVector};
use nalgebra_sparse::{CooMatrix, CscMatrix, factorization::CscCholesky};

use super::contour::Contour;
use super::error::FieldError;
use super::geometry::Geometry;
use super::material::MU_0;
use super::reluctance::{Inside, Network, Node};

/// Condensed field of the gap; see the module's equations.
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
    /// ∫ h_m h_n over the shield, row by row, with h the tangential field there per ampere (first row) and per A of each ring.
    shield: DMatrix<f64>,
}

impl GapOperator {
    /// Solves the gap for a load of `rings` rings, a multiple of [`RINGS`](crate::contour::RINGS). `refinement` 1 is the
    /// standard grid, 2 halves its cells.
    pub fn new(geometry: &Geometry, rings: usize, refinement: f64) -> Result<Self, FieldError> {
        geometry.check()?;
        let network = Network::new(geometry, refinement, Inside::Surface);
        condense(&network, &Contour::new(geometry, rings))
    }

    /// ∫ H² over the shield per A² of coil current, without units, for the rings' A in Wb/m at one ampere.
    pub(crate) fn shield_share(&self, a: &DVector<Complex<f64>>) -> Complex<f64> {
        let at = |n: usize| {
            if n == 0 {
                Complex::new(1.0, 0.0)
            } else {
                a[n - 1]
            }
        };
        let mut sum = Complex::new(0.0, 0.0);
        for m in 0..=self.rings() {
            for n in 0..=self.rings() {
                sum += at(m) * at(n) * self.shield[(m, n)];
            }
        }
        sum
    }

    /// Number of rings.
    pub fn rings(&self) -> usize {
        self.w_m2.len()
    }
}

/// ψ at each surface node for unit A of each ring.
fn shapes(network: &Network<'_>, contour: &Contour<'_>, rings: usize) -> DMatrix<f64> {
    let mut shape = DMatrix::zeros(network.surface.len(), rings);
    for (k, &(r, z)) in network.surface.iter().enumerate() {
        // A pot's inside has no field.
        let shares = contour.arc_m(r, z).map(|s| contour.shares(s));
        for (ring, share) in shares.unwrap_or_default() {
            shape[(k, ring)] = share * r;
        }
    }
    shape
}

/// Equations of the free nodes, and the energy between surface nodes, in terms of the rings.
struct NodeEquations {
    /// K_ff.
    matrix: CooMatrix<f64>,
    /// Right-hand sides: coil turns, then −K_fs T for each ring.
    rhs: DMatrix<f64>,
    /// T' K_ss T.
    surface: DMatrix<f64>,
}

impl NodeEquations {
    fn new(network: &Network<'_>, shape: &DMatrix<f64>) -> Self {
        let rings = shape.ncols();
        let mut equations = Self {
            matrix: CooMatrix::new(network.free, network.free),
            rhs: DMatrix::zeros(network.free, rings + 1),
            surface: DMatrix::zeros(rings, rings),
        };
        for (a, b, k) in network.edges() {
            for (x, y) in [(a, b), (b, a)] {
                match (network.nodes[x], network.nodes[y]) {
                    (Node::Free(f), other) => equations.add_free(f, other, k, shape),
                    (Node::Surface(f), other) => equations.add_surface(f, other, k, shape),
                    (Node::Zero, _) => {}
                }
            }
        }
        let nz = network.grid.z_m.len();
        for (index, node) in network.nodes.iter().enumerate() {
            if let Node::Free(f) = *node {
                equations.rhs[(f, 0)] = network.turns(index / nz, index % nz);
            }
        }
        equations
    }

    /// Adds an edge of coefficient `k` from the free node `f`.
    fn add_free(&mut self, f: usize, other: Node, k: f64, shape: &DMatrix<f64>) {
        self.matrix.push(f, f, k);
        match other {
            Node::Free(g) => self.matrix.push(f, g, -k),
            Node::Surface(g) => {
                for ring in 0..shape.ncols() {
                    self.rhs[(f, 1 + ring)] += k * shape[(g, ring)];
                }
            }
            Node::Zero => {}
        }
    }

    /// Adds an edge of coefficient `k` from the surface node `f`.
    fn add_surface(&mut self, f: usize, other: Node, k: f64, shape: &DMatrix<f64>) {
        let rings = shape.ncols();
        for m in 0..rings {
            for n in 0..rings {
                self.surface[(m, n)] += k * shape[(f, m)] * shape[(f, n)];
                if let Node::Surface(g) = other {
                    self.surface[(m, n)] -= k * shape[(f, m)] * shape[(g, n)];
                }
            }
        }
    }
}

/// Eliminates the free nodes.
fn condense(network: &Network<'_>, contour: &Contour<'_>) -> Result<GapOperator, FieldError> {
    let w_m2 = contour.areas_m2();
    let shape = shapes(network, contour, w_m2.len());
    let NodeEquations {
        matrix,
        rhs,
        surface,
    } = NodeEquations::new(network, &shape);
    let cholesky =
        CscCholesky::factor(&CscMatrix::from(&matrix)).map_err(|_| FieldError::Singular {
            nodes: network.free,
        })?;
    let psi = cholesky.solve(&rhs);
    let shield = shield(network, &psi);
    Ok(operator(
        network.geometry,
        w_m2,
        &rhs,
        &psi,
        &surface,
        shield,
    ))
}

/// ∫ h_m h_n over the shield of the solutions `psi`.
fn shield(network: &Network<'_>, psi: &DMatrix<f64>) -> DMatrix<f64> {
    let (r, z) = (&network.grid.r_m, &network.grid.z_m);
    let mut sum = DMatrix::zeros(psi.ncols(), psi.ncols());
    for i in 1..r.len() - 1 {
        // ψ is 0 in the shield: the field is the slope to the first node above it.
        let Node::Free(f) = network.nodes[i * z.len() + 1] else {
            continue;
        };
        let per_psi = 1.0 / (MU_0 * r[i] * (z[1] - z[0]));
        let area = core::f64::consts::PI * r[i] * (r[i + 1] - r[i - 1]);
        for m in 0..psi.ncols() {
            for n in 0..psi.ncols() {
                sum[(m, n)] += area * per_psi * per_psi * psi[(f, m)] * psi[(f, n)];
            }
        }
    }
    sum
}

/// The condensed system in terms of the rings.
fn operator(
    geometry: &Geometry,
    w_m2: Vec<f64>,
    rhs: &DMatrix<f64>,
    psi: &DMatrix<f64>,
    s_direct: &DMatrix<f64>,
    mut shield: DMatrix<f64>,
) -> GapOperator {
    let two_pi = 2.0 * core::f64::consts::PI;
    let rings = w_m2.len();
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
    let turns = geometry.turns_calibration;
    for n in 0..=rings {
        shield[(0, n)] *= turns;
        shield[(n, 0)] *= turns;
    }
    GapOperator {
        shield,
        l0_h: two_pi * energy[(0, 0)] * turns * turns,
        p_m: (0..rings)
            .map(|ring| two_pi * energy[(1 + ring, 0)] * turns)
            .collect(),
        s,
        w_m2,
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
}
