//! Frequency domain: R and L of the fundamental at a current, by describing function.
//!
//! H and B are reduced to their fundamentals; at every node µ is the describing function of the material at that node's
//! amplitude. Grids and gap are those of the time domain; the solution is found by repeated substitution. At zero amplitude it
//! is the small-signal linear impedance.

use ihd_signal::Load;
use nalgebra::{Complex, DMatrix, DVector};

use super::depth::DepthGrid;
use super::error::{FieldError, in_range};
use super::material::BhCurve;
use super::model::{Body, FieldModel, Rings};
use super::profile::Profile;

/// Most iterations.
const MAX_ITERATIONS: usize = 200;

/// Frequency in hertz at which the time domain takes the shield's resistance.
const SHIELD_F_HZ: f64 = 50e3;

/// Relative change of the impedance at which the iteration ends.
const IMPEDANCE_TOLERANCE: f64 = 1e-10;

/// R and L of the fundamental at `f_hz` (1 kHz to 1 MHz) and current amplitude `i_a` (0 to 1000 A; 0 is small
/// signal).
pub fn impedance(model: &FieldModel, f_hz: f64, i_a: f64) -> Result<Load, FieldError> {
    in_range("f_hz", f_hz, 1e3, 1e6, "1 kHz to 1 MHz")?;
    in_range("i_a", i_a, 0.0, 1e3, "0 to 1000 A")?;
    let lambda_h = match &model.body {
        Body::Modes(modes) => modes.inductance_h(f_hz),
        Body::Rings(rings) => inductance_h(rings, f_hz, i_a)?,
    };
    let omega = 2.0 * core::f64::consts::PI * f_hz;
    Ok(Load {
        r_ohm: model.winding_r_ohm - omega * lambda_h.im,
        l_h: lambda_h.re,
    })
}

/// λ/i of a saturating load, in henry; its imaginary part is −R/ω.
fn inductance_h(model: &Rings, f_hz: f64, i_a: f64) -> Result<Complex<f64>, FieldError> {
    let omega = 2.0 * core::f64::consts::PI * f_hz;
    let rings = model.gap.rings();
    let ways = Way::all(model);
    let way = |ring: usize| &ways[model.of_ring[ring]];
    let mut mu: Vec<Vec<f64>> = (0..rings).map(|j| way(j).mu_initial_h_per_m()).collect();
    let mut last = Complex::new(0.0, 0.0);
    let mut change = f64::INFINITY;
    for _ in 0..MAX_ITERATIONS {
        let columns: Vec<Column> = (0..rings).map(|j| way(j).column(omega, &mu[j])).collect();
        let a = surface_flux(model, &columns)?;
        let lambda = model.gap.l0_h
            + (0..rings)
                .map(|j| a[j] * model.gap.p_m[j])
                .sum::<Complex<f64>>()
            + model.shield_h(&a, f_hz);
        change = magnitude(lambda - last) / magnitude(lambda);
        if change < IMPEDANCE_TOLERANCE {
            return Ok(lambda);
        }
        last = lambda;
        for (j, column) in columns.iter().enumerate() {
            let mut h = a[j] / column.flux_per_h * i_a;
            let curves = &way(j).curves;
            for (n, (mu, curve)) in mu[j].iter_mut().zip(curves).enumerate() {
                if n > 0 {
                    h *= column.down[n];
                }
                *mu = curve.describing_h_per_m(magnitude(h));
            }
        }
    }
    Err(FieldError::NotSettled {
        f_hz,
        i_a,
        change,
        iterations: MAX_ITERATIONS,
    })
}

/// Resistance in ohm that the shield adds under a saturating load, at [`SHIELD_F_HZ`] and no current: what the time domain has of it.
pub(super) fn shield_r_ohm(model: &Rings) -> Result<f64, FieldError> {
    let omega = 2.0 * core::f64::consts::PI * SHIELD_F_HZ;
    let ways = Way::all(model);
    let column = |way: &usize| ways[*way].column(omega, &ways[*way].mu_initial_h_per_m());
    let columns: Vec<Column> = model.of_ring.iter().map(column).collect();
    let a = surface_flux(model, &columns)?;
    Ok(-omega * model.shield_h(&a, SHIELD_F_HZ).im)
}

/// |z| with IEEE operations only; `hypot` differs between platforms.
pub(super) fn magnitude(z: Complex<f64>) -> f64 {
    z.norm_sqr().sqrt()
}

/// Way into the load, ready for the columns of a frequency.
struct Way<'a> {
    depth: &'a DepthGrid,
    sheet_s: Vec<f64>,
    curves: Vec<BhCurve>,
}

impl<'a> Way<'a> {
    fn all(model: &'a Rings) -> Vec<Self> {
        let of = |profile: &'a Profile| Self {
            depth: &profile.depth,
            sheet_s: profile.sheet_s(&model.metals),
            curves: profile.curves(&model.metals),
        };
        model.profiles.iter().map(of).collect()
    }

    fn mu_initial_h_per_m(&self) -> Vec<f64> {
        let slope = |curve: &BhCurve| curve.slope_h_per_m(0.0);
        self.curves.iter().map(slope).collect()
    }

    fn column(&self, omega: f64, mu: &[f64]) -> Column {
        Column::solve(self.depth, &self.sheet_s, omega, mu)
    }
}

/// Linear diffusion under one ring.
pub(super) struct Column {
    /// Ratio of H at node n to H at node n−1.
    pub(super) down: Vec<Complex<f64>>,
    /// A at the surface over H there, in Wb/A.
    pub(super) flux_per_h: Complex<f64>,
}

impl Column {
    /// Solves one ring; `sheet` is conductivity times distance to the next node in siemens, `mu` the permeability of each node in H/m.
    pub(super) fn solve(depth: &DepthGrid, sheet: &[f64], omega: f64, mu: &[f64]) -> Self {
        let cell = &depth.cell_m;
        let j_omega = Complex::i() * omega;
        let nodes = cell.len();
        let mut down = vec![Complex::new(0.0, 0.0); nodes + 1];
        for n in (1..nodes).rev() {
            let (up_g, down_g) = (1.0 / sheet[n - 1], 1.0 / sheet[n]);
            let diagonal = j_omega * cell[n] * mu[n] + up_g + down_g - down[n + 1] * down_g;
            down[n] = Complex::new(up_g, 0.0) / diagonal;
        }
        let entering = (Complex::new(1.0, 0.0) - down[1]) / sheet[0];
        Self {
            flux_per_h: entering / j_omega + cell[0] * mu[0],
            down,
        }
    }
}

/// A of each ring at one ampere: (W/ζ + S) A = P.
fn surface_flux(model: &Rings, columns: &[Column]) -> Result<DVector<Complex<f64>>, FieldError> {
    let rings = columns.len();
    let mut m = DMatrix::from_fn(rings, rings, |i, j| {
        Complex::new(model.gap.s[i * rings + j], 0.0)
    });
    for (j, c) in columns.iter().enumerate() {
        m[(j, j)] += Complex::new(model.gap.w_m2[j], 0.0) / c.flux_per_h;
    }
    let p = DVector::from_fn(rings, |j, _| Complex::new(model.gap.p_m[j], 0.0));
    m.lu()
        .solve(&p)
        .ok_or(FieldError::Singular { nodes: rings })
}

#[cfg(test)]
mod tests {
    use super::super::material::Material;
    use super::super::model::FieldSettings;
    use super::*;

    #[test]
    fn a_thick_linear_plate_has_the_skin_effects_surface_impedance() {
        // ζ = A/H = µ δ (1 − j)/2.
        let model = Rings::new(&FieldSettings::paper()).unwrap();
        let (f_hz, mu) = (45e3, Material::PAPER.mu_initial_h_per_m());
        let omega = 2.0 * core::f64::consts::PI * f_hz;
        let way = &Way::all(&model)[0];
        let column = way.column(omega, &vec![mu; way.curves.len()]);
        let expected = Complex::new(1.0, -1.0) * (mu * Material::PAPER.skin_depth_m(f_hz) / 2.0);
        let error = (column.flux_per_h - expected).norm() / expected.norm();
        assert!(error < 3e-3, "{error:e}");
    }

    #[test]
    fn saturation_lowers_both_r_and_l() {
        let model = FieldModel::new(&FieldSettings::paper()).unwrap();
        let at = |i| impedance(&model, 45e3, i).unwrap();
        let z: Vec<_> = [0.0, 1.0, 10.0, 40.0].map(at).into();
        assert!(
            z.windows(2)
                .all(|p| p[1].r_ohm < p[0].r_ohm && p[1].l_h < p[0].l_h)
        );
    }

    /// Ampere-turns make the field, and every turn sees its flux: what `TURNS_RATIO` of the prior and the formulas says.
    #[test]
    fn fewer_turns_in_the_same_place_are_the_square_at_a_larger_current() {
        let (mut few, k) = (FieldSettings::paper(), 17.0 / 23.0);
        few.geometry.turns *= k;
        let [few, paper] =
            [few, FieldSettings::paper()].map(|settings| FieldModel::new(&settings).unwrap());
        for i_a in [1.0, 20.0, 70.0] {
            let is = impedance(&few, 45e3, i_a).unwrap();
            let of = impedance(&paper, 45e3, k * i_a).unwrap();
            assert!(
                (is.r_ohm / of.r_ohm / (k * k) - 1.0).abs() < 1e-4,
                "{i_a} A"
            );
            assert!((is.l_h / of.l_h / (k * k) - 1.0).abs() < 1e-4, "{i_a} A");
        }
    }

    #[test]
    fn refuses_what_is_not_a_number() {
        let model = FieldModel::new(&FieldSettings::paper()).unwrap();
        let e = impedance(&model, f64::NAN, 1.0).unwrap_err();
        assert!(e.to_string().contains("f_hz"), "{e}");
    }
}
