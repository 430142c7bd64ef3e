//! The magnetostatic field between shield and load, condensed to the load's rings.
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

use nalgebra::DMatrix;
use nalgebra_sparse::{CooMatrix, CscMatrix, factorization::CscCholesky};

use super::error::FieldError;
use super::geometry::Geometry;
use super::reluctance::{Network, Node};

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
}

impl GapOperator {
    /// Solves the gap for a load of `rings` rings of equal width. `refinement` 1 is the standard
    /// grid, 2 halves its cells.
    pub fn new(geometry: &Geometry, rings: usize, refinement: f64) -> Result<Self, FieldError> {
        geometry.check()?;
        condense(&Network::new(geometry, refinement, true), rings)
    }

    /// Inductance of the coil over its ferrite without a load, in henry.
    pub fn bare_coil_h(geometry: &Geometry, refinement: f64) -> Result<f64, FieldError> {
        geometry.check()?;
        Ok(condense(&Network::new(geometry, refinement, false), 0)?.l0_h)
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

/// Eliminates the free nodes.
fn condense(network: &Network<'_>, rings: usize) -> Result<GapOperator, FieldError> {
    let columns = rings + 1;
    let mut shape = DMatrix::<f64>::zeros(network.surface.len(), rings);
    for k in 0..network.surface.len() {
        for ring in 0..rings {
            shape[(k, ring)] = network.shape(k, ring, rings);
        }
    }
    // Right-hand sides: coil turns, then −K_fs T for each ring. And T' K_ss T.
    let mut matrix = CooMatrix::new(network.free, network.free);
    let mut rhs = DMatrix::<f64>::zeros(network.free, columns);
    let mut s = DMatrix::<f64>::zeros(rings, rings);
    for (a, b, k) in network.edges() {
        for (x, y) in [(a, b), (b, a)] {
            match (network.nodes[x], network.nodes[y]) {
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
    let nz = network.grid.z_m.len();
    for (index, node) in network.nodes.iter().enumerate() {
        if let Node::Free(f) = *node {
            rhs[(f, 0)] = network.turns(index / nz, index % nz);
        }
    }
    let cholesky =
        CscCholesky::factor(&CscMatrix::from(&matrix)).map_err(|_| FieldError::Singular {
            nodes: network.free,
        })?;
    let psi = cholesky.solve(&rhs);
    Ok(operator(network, rings, &shape, &rhs, &psi, &s))
}

/// The condensed system in terms of the rings.
fn operator(
    network: &Network<'_>,
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
            (0..network.surface.len())
                .map(|k| two_pi * shape[(k, ring)] * network.surface[k].2)
                .sum()
        })
        .collect();
    let turns = network.geometry.turns_calibration;
    GapOperator {
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
    use super::super::material::MU_0;
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
