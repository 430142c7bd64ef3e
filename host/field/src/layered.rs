//! Independent solution of the linear problem: coil between infinite layered plates, as an
//! integral over radial wave numbers (C. V. Dodd and W. E. Deeds, J. Appl. Phys. 39, 2829, 1968,
//! with layers below the coil too).
//!
//! Shares no grid and no code with [`super::gap`] and [`super::diffusion`]; conductors are exact,
//! the shield's finite conductivity included. Plates are infinite: compare with a wide load.

use ihd_signal::Load;
use nalgebra::Complex;

use super::error::{FieldError, in_range};
use super::geometry::Geometry;
use super::material::{MU_0, Material};

/// Largest wave number: those beyond carry less than 1e-5 of the inductance of a coil 3 mm thick.
const K_MAX_PER_M: f64 = 4000.0;

/// Intervals of the wave-number integral.
const K_INTERVALS: usize = 4000;

/// Material behind the ferrite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shield {
    /// Perfect conductor: no tangential electric field, as in the time-domain model.
    Perfect,
    /// A conductor, thick against its skin depth, σ in S/m.
    Conductor(f64),
}

/// R and L at `f_hz` in hertz for the material's permeability at zero field.
pub fn impedance(
    geometry: &Geometry,
    material: &Material,
    shield: Shield,
    f_hz: f64,
) -> Result<Load, FieldError> {
    geometry.check()?;
    material.check()?;
    in_range("f_hz", f_hz, 1e3, 1e6, "1 kHz to 1 MHz")?;
    let omega = 2.0 * core::f64::consts::PI * f_hz;
    let stack = Stack {
        geometry,
        material,
        shield,
        omega,
    };
    let dk = K_MAX_PER_M / K_INTERVALS as f64;
    // Simpson's rule; the integrand vanishes at k = 0.
    let mut sum = Complex::new(0.0, 0.0);
    for n in 1..=K_INTERVALS {
        let k = n as f64 * dk;
        let weight = if n == K_INTERVALS {
            1.0
        } else if n % 2 == 1 {
            4.0
        } else {
            2.0
        };
        let moment = radial_moment(k, geometry.coil_inner_m, geometry.coil_outer_m);
        sum += stack.axial(k) * (weight * moment * moment * k);
    }
    let density = geometry.turn_density_per_m2() * geometry.turns_calibration;
    let l = sum * (2.0 * core::f64::consts::PI * density * density * dk / 3.0);
    let z = Complex::i() * omega * l;
    Ok(Load {
        r_ohm: z.re,
        l_h: z.im / omega,
    })
}

/// ∫ r J1(kr) dr from `inner` to `outer`, by Simpson with 24 points a wavelength.
fn radial_moment(k: f64, inner: f64, outer: f64) -> f64 {
    let waves = k * (outer - inner) / (2.0 * core::f64::consts::PI);
    let n = 2 * ((12.0 * waves) as usize + 24);
    let dr = (outer - inner) / n as f64;
    let mut sum = 0.0;
    for m in 0..=n {
        let r = inner + m as f64 * dr;
        let weight = if m == 0 || m == n {
            1.0
        } else if m % 2 == 1 {
            4.0
        } else {
            2.0
        };
        sum += weight * r * libm::j1(k * r);
    }
    sum * dr / 3.0
}

/// √(re + j im) for positive parts, with IEEE operations only.
fn root(re: f64, im: f64) -> Complex<f64> {
    let real = ((re + (re * re + im * im).sqrt()) / 2.0).sqrt();
    Complex::new(real, im / (2.0 * real))
}

struct Stack<'a> {
    geometry: &'a Geometry,
    material: &'a Material,
    shield: Shield,
    omega: f64,
}

impl Stack<'_> {
    /// Double integral of Green's function over the coil's thickness at wave number `k`.
    fn axial(&self, k: f64) -> Complex<f64> {
        let g = self.geometry;
        let gap = g.load_surface_m() - g.ferrite_top_m();
        let (z1, z2) = (g.ferrite_gap_m, g.ferrite_gap_m + g.coil_thickness_m);
        let one = Complex::new(1.0, 0.0);
        let reflect = |y: Complex<f64>| (one * k - y) / (one * k + y);
        let (bottom, top) = (reflect(self.below(k)), reflect(self.above(k)));
        let down = (libm::exp(-k * z1) - libm::exp(-k * z2)) / k;
        let up = (libm::exp(-k * (gap - z2)) - libm::exp(-k * (gap - z1))) / k;
        let t = k * g.coil_thickness_m;
        let own = 2.0 * (t - 1.0 + libm::exp(-t)) / (k * k);
        let cross = bottom * top * (2.0 * libm::exp(-k * gap) * up * down);
        let reflected = bottom * (down * down) + top * (up * up) + cross;
        let repeat = one - bottom * top * libm::exp(-2.0 * k * gap);
        (one * own + reflected / repeat) * (MU_0 / (2.0 * k))
    }

    /// −(dA/dz)/A at the coil, looking into the load, in 1/m.
    fn above(&self, k: f64) -> Complex<f64> {
        let mu = self.material.mu_initial_h_per_m();
        let q = root(k * k, self.omega * mu * self.material.sigma_s_per_m());
        q * (MU_0 / mu)
    }

    /// −(dA/dz)/A at the coil, looking down into ferrite, gap and shield, in 1/m.
    fn below(&self, k: f64) -> Complex<f64> {
        let g = self.geometry;
        // tanh of the gap between shield and ferrite; a perfect shield is an infinite admittance.
        let tanh = libm::tanh(k * g.shield_gap_m);
        let behind_ferrite = match self.shield {
            Shield::Perfect => Complex::new(k / tanh, 0.0),
            Shield::Conductor(sigma) => {
                let y = root(k * k, self.omega * MU_0 * sigma);
                (y + k * tanh) / (Complex::new(k, 0.0) + y * tanh) * k
            }
        };
        let own = k / g.ferrite_mu_r;
        let tanh = libm::tanh(k * g.ferrite_thickness_m);
        (behind_ferrite + own * tanh) / (Complex::new(own, 0.0) + behind_ferrite * tanh) * own
    }
}
