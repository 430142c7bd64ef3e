//! Dimensionless surface impedance of a saturating half-space.
//!
//! With h = H/α, depth in skin depths δ = √(2/(ω µ σ)) and time in radians, the diffusion σ ∂B/∂t = ∂²H/∂z² of a Fröhlich
//! metal, B = µ H/(1 + |H|/α), becomes 2 ∂φ(h)/∂τ = ∂²h/∂ζ² with φ(h) = h/(1 + |h|), which contains no property of the metal.
//! The flux A per circumference that a field of amplitude H drives through the surface is therefore A = µ δ F(H/α) H, with one
//! function F for all such metals and frequencies. Two numbers describe a metal: α, and √(µ/σ), from which µ δ follows.

use nalgebra::Complex;

use super::depth::DepthGrid;
use super::error::{FieldError, in_range};
use super::harmonic::{Column, magnitude};
use super::material::Material;

/// Metal of the computation; any metal of the law gives the same F.
const METAL: Material = Material::Froehlich {
    alpha_a_per_m: 1_000.0,
    b_per_t: 1.0,
    sigma_s_per_m: 1e6,
};

/// Frequency for which the depth grid is made, where it covers most skin depths.
const F_HZ: f64 = 20e3;

/// Nodes into the depth: 44 leave .1 % of F, these .0015 %, since the error falls with the square of their distance.
const NODES: usize = 352;

/// Largest h: the saturated front is then eight skin depths deep, and the grid has sixteen.
pub const MAX_FIELD: f64 = 60.0;

/// Most iterations; saturation needs some thirty.
const MAX_ITERATIONS: usize = 400;

/// Relative change of F at which the iteration ends.
const F_TOLERANCE: f64 = 1e-9;

/// F at an amplitude h of the surface field over α, 0 to [`MAX_FIELD`], by describing function; F(0) is
/// (1 − j)/2.
///
/// # Errors
/// [`FieldError::OutOfRange`]; [`FieldError::NotSettled`].
pub fn flux_of_field(h: f64) -> Result<Complex<f64>, FieldError> {
    in_range("h", h, 0.0, MAX_FIELD, "0 to 60")?;
    let depth = DepthGrid::new(&METAL, 0.1, NODES)?;
    let sigma = METAL.sigma_s_per_m();
    let sheet_s: Vec<f64> = depth.step_m.iter().map(|step| sigma * step).collect();
    let curve = METAL.curve();
    let omega = 2.0 * core::f64::consts::PI * F_HZ;
    let unit = METAL.mu_initial_h_per_m() * METAL.skin_depth_m(F_HZ);
    let mut mu = vec![curve.describing_h_per_m(0.0); NODES];
    let (mut last, mut change) = (Complex::new(0.0, 0.0), f64::INFINITY);
    for _ in 0..MAX_ITERATIONS {
        let column = Column::solve(&depth, &sheet_s, omega, &mu);
        let f = column.flux_per_h / unit;
        change = magnitude(f - last) / magnitude(f);
        if change < F_TOLERANCE {
            return Ok(f);
        }
        last = f;
        let mut at = Complex::new(h * curve.alpha_a_per_m, 0.0);
        for (mu, down) in mu.iter_mut().zip(&column.down) {
            // The first node is the surface itself.
            if *down != Complex::new(0.0, 0.0) {
                at *= down;
            }
            *mu = curve.describing_h_per_m(magnitude(at));
        }
    }
    Err(FieldError::NotSettled {
        f_hz: F_HZ,
        i_a: h,
        change,
        iterations: MAX_ITERATIONS,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_saturation_it_is_the_skin_effects() {
        let f = flux_of_field(0.0).unwrap();
        assert!((f - Complex::new(0.5, -0.5)).norm() < 3e-5, "{f}");
    }

    /// Agarwal's limit for a step-shaped B(H), to which Fröhlich's law tends slowly: the tangent of the impedance's angle is ½, R
    /// is twice X.
    #[test]
    fn saturation_turns_the_angle_towards_losses() {
        let angle = |h: f64| {
            let f = flux_of_field(h).unwrap();
            -f.im / f.re
        };
        let all = [0.0, 0.3, 1.0, 3.0, 10.0, 60.0].map(angle);
        println!("{all:?}");
        assert!(all.windows(2).all(|p| p[1] > p[0]));
        assert!(all[5] > 1.3 && all[5] < 2.0);
    }

    #[test]
    fn beyond_the_grid_it_refuses() {
        assert!(flux_of_field(61.0).is_err() && flux_of_field(f64::NAN).is_err());
    }
}
