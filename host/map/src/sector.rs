//! Field under one direction of a pot's rim: flux and surface field of each ring, and how the inductance follows the pot's numbers.

use ihd_field::model::RINGS;
use nalgebra::{Complex, SMatrix, SVector};

use crate::gap_table::Gap;
use crate::surface_table::{flux_of, flux_slope_of};

/// Most iterations of the surface field at one current.
const MAX_ITERATIONS: usize = 60;

/// Relative error of the impedance at which the iteration ends.
const IMPEDANCE_TOLERANCE: f64 = 1e-7;

const ZERO: Complex<f64> = Complex::new(0.0, 0.0);

type Rings = [Complex<f64>; RINGS];

/// Gap in one direction, and the field under it.
#[derive(Clone, Debug)]
pub(crate) struct Sector {
    gap: Gap,
    /// |H| of each ring in A/m, at the current `i_a`.
    h: [f64; RINGS],
    /// Current in ampere to which `h` belongs.
    i_a: f64,
}

/// Inductance of a sector in henry, complex, and its changes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SectorSlopes {
    pub inductance: Complex<f64>,
    pub by_ln_alpha: Complex<f64>,
    pub by_ln_s: Complex<f64>,
    /// Per change of the gap.
    pub by_gap: [Complex<f64>; 2],
}

impl Sector {
    pub fn new(gap: Gap) -> Self {
        Self {
            gap,
            h: [0.0; RINGS],
            i_a: 0.0,
        }
    }

    /// λ/i of the paper's turns in henry, complex: its imaginary part is −R/ω.
    pub fn inductance(&mut self, surface: f64, alpha: f64, i_a: f64) -> Complex<f64> {
        // The field scaled with the current is a closer start than the last field.
        let grown = if self.i_a > 0.0 { i_a / self.i_a } else { 0.0 };
        let mut h: [f64; RINGS] = std::array::from_fn(|k| self.h[k] * grown);
        // No impedance is known at first, and no change before the third.
        let (mut last, mut last_change) = (Complex::new(f64::NAN, 0.0), f64::NAN);
        for _ in 0..MAX_ITERATIONS {
            let zeta: Rings = std::array::from_fn(|k| flux_of(h[k] / alpha) * surface);
            let flux = self.factor(&zeta).solve(&self.gap.p_m);
            let inductance = self.linked(&flux);
            for k in 0..RINGS {
                h[k] = (flux[k] / zeta[k]).norm_sqr().sqrt() * i_a;
            }
            let size = inductance.norm_sqr();
            let change = ((inductance - last).norm_sqr() / size).sqrt();
            let fall = last_change - change;
            (last, last_change) = (inductance, change);
            // A geometric series with the ratio of the last two changes: the sum of what would follow.
            if change * change <= IMPEDANCE_TOLERANCE * fall {
                break;
            }
        }
        (self.h, self.i_a) = (h, i_a);
        last
    }

    /// Flux linkage of the fluxes per ampere.
    fn linked(&self, flux: &Rings) -> Complex<f64> {
        let drive = self.gap.p_m.iter().zip(flux);
        drive.fold(Complex::new(self.gap.l0_h, 0.0), |sum, (p, a)| sum + a * *p)
    }

    /// Changes of the inductance at the current that was solved last, by implicit differentiation.
    ///
    /// With M = W/ζ + S, M A = P and L = L0 + Pᵀ A, a change of the gap and of ζ gives
    /// dL = dL0 + Aᵀ dP + Aᵀ r + Σ q dζ/ζ with r = dP − dS A − dW A/ζ and q = W A²/ζ. ζ = s F(u) with u = |A/ζ| i/α changes by
    /// dζ/ζ = d ln s + g y, where g is the slope of ln F and y = d ln u = Re(dA/A − dζ/ζ) − d ln α: a real system for the y of all rings.
    pub fn slopes(&self, surface: f64, alpha: f64, by_gap: &[Gap; 2]) -> SectorSlopes {
        let zeta: Rings = std::array::from_fn(|k| flux_of(self.h[k] / alpha) * surface);
        let factor = self.factor(&zeta);
        let a = factor.solve(&self.gap.p_m);
        let h: Rings = std::array::from_fn(|k| a[k] / zeta[k]);
        let q: Rings = std::array::from_fn(|k| h[k] * a[k] * self.gap.w_m2[k]);
        let g: Rings =
            std::array::from_fn(|k| flux_slope_of(self.h[k] / alpha) * surface / zeta[k]);
        let inverse = factor.inverse();
        // Relative change of the flux in ring k per relative change of ζ in ring j.
        let by_zeta =
            |k: usize, j: usize| inverse[k.max(j)][k.min(j)] * h[j] * self.gap.w_m2[j] / a[k];
        let mut system = SMatrix::<f64, RINGS, RINGS>::zeros();
        let mut right = SMatrix::<f64, RINGS, 4>::zeros();
        let changes = by_gap.each_ref().map(|gap| {
            (0..RINGS)
                .map(|k| {
                    let turned = gap.s[k].iter().zip(&a).map(|(s, a)| a * *s);
                    -(turned.sum::<Complex<f64>>() + h[k] * gap.w_m2[k]) + gap.p_m[k]
                })
                .collect::<Vec<_>>()
        });
        for k in 0..RINGS {
            right[(k, 0)] = -1.0;
            right[(k, 1)] = -1.0;
            for j in 0..RINGS {
                let by = by_zeta(k, j);
                system[(k, j)] = -(by * g[j]).re;
                right[(k, 1)] += by.re;
                let known = inverse[k.max(j)][k.min(j)] / a[k];
                for (n, r) in changes.iter().enumerate() {
                    right[(k, 2 + n)] += (known * r[j]).re;
                }
            }
            system[(k, k)] += 1.0 + g[k].re;
        }
        // A field is there for every ζ, so that the system has a solution; without, nothing follows.
        let y = system.lu().solve(&right).unwrap_or_default();
        let by_field = |column: usize| {
            let y: SVector<f64, RINGS> = y.column(column).into();
            (0..RINGS).fold(ZERO, |sum, k| sum + q[k] * g[k] * y[k])
        };
        SectorSlopes {
            inductance: self.linked(&a),
            by_ln_alpha: by_field(0),
            by_ln_s: q.iter().sum::<Complex<f64>>() + by_field(1),
            by_gap: [0, 1].map(|n| {
                let (gap, r) = (&by_gap[n], &changes[n]);
                let explicit = (0..RINGS).map(|k| a[k] * (r[k] + gap.p_m[k]));
                explicit.sum::<Complex<f64>>() + gap.l0_h + by_field(2 + n)
            }),
        }
    }

    /// Factors of W/ζ + S.
    fn factor(&self, zeta: &Rings) -> Factor {
        let mut l = [[ZERO; RINGS]; RINGS];
        let mut d_inverse = [ZERO; RINGS];
        for j in 0..RINGS {
            // Row j of L·D, then of L.
            for k in 0..j {
                let left = l[j].iter().zip(&l[k]).take(k);
                let known = left.fold(ZERO, |sum, (a, b)| sum + a * b);
                l[j][k] = Complex::new(self.gap.s[j][k], 0.0) - known;
                // l[k][·] is already divided, l[j][·] is not.
            }
            let mut diagonal =
                Complex::new(self.gap.s[j][j], 0.0) + zeta[j].inv() * self.gap.w_m2[j];
            for k in 0..j {
                let scaled = l[j][k] * d_inverse[k];
                diagonal -= scaled * l[j][k];
                l[j][k] = scaled;
            }
            d_inverse[j] = diagonal.inv();
        }
        Factor { l, d_inverse }
    }
}

/// LDLᵀ of a complex symmetric matrix whose real part is positive, so that no pivot is needed.
struct Factor {
    /// Rows of L below its diagonal of ones.
    l: [Rings; RINGS],
    d_inverse: Rings,
}

impl Factor {
    /// Solution for a real right side.
    fn solve(&self, right: &[f64; RINGS]) -> Rings {
        let mut x = [ZERO; RINGS];
        for j in 0..RINGS {
            let known = self.l[j].iter().zip(&x).take(j);
            x[j] = known.fold(Complex::new(right[j], 0.0), |sum, (l, x)| sum - l * x);
        }
        for j in (0..RINGS).rev() {
            let above = self.l.iter().zip(&x).skip(j + 1);
            x[j] = above.fold(x[j] * self.d_inverse[j], |sum, (row, x)| sum - row[j] * x);
        }
        x
    }

    /// Lower half of the inverse.
    fn inverse(&self) -> [Rings; RINGS] {
        // L⁻¹, row by row.
        let mut below = [[ZERO; RINGS]; RINGS];
        for j in 0..RINGS {
            below[j][j] = Complex::new(1.0, 0.0);
            for m in 0..j {
                let row = below[m];
                let by = self.l[j][m];
                for k in 0..=m {
                    below[j][k] -= by * row[k];
                }
            }
        }
        let mut inverse = [[ZERO; RINGS]; RINGS];
        for (m, (row, d_inverse)) in below.iter().zip(&self.d_inverse).enumerate() {
            for k in 0..=m {
                let scaled = row[k] * d_inverse;
                for j in 0..=k {
                    inverse[k][j] += scaled * row[j];
                }
            }
        }
        inverse
    }
}
