//! Magnetic and electric laws of the load.

use super::error::{FieldError, in_range};

/// Permeability of vacuum in H/m.
pub const MU_0: f64 = 4e-7 * core::f64::consts::PI;

/// A load material: B(H) and conductivity.
///
/// The Fröhlich chord is B = H / (b (α + |H|)); its slope α / (b (α + |H|)²) is what the paper
/// (section IV) writes as µ0 µ_r(H). A linear material has `saturation_per_t` = 0 and B = µ H.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Material {
    /// Ferromagnetic, saturating at 1/b tesla.
    Froehlich {
        /// α in A/m.
        alpha_a_per_m: f64,
        /// b in 1/T.
        b_per_t: f64,
        /// Conductivity in S/m.
        sigma_s_per_m: f64,
    },
    /// Linear, as austenitic stainless steel or aluminium.
    Linear {
        /// Relative permeability.
        mu_r: f64,
        /// Conductivity in S/m.
        sigma_s_per_m: f64,
    },
}

impl Material {
    /// The load of section IV: α = 1500 A/m, b = 0.5 1/T, σ = 8 MS/m.
    pub const PAPER: Self = Self::Froehlich {
        alpha_a_per_m: 1500.0,
        b_per_t: 0.5,
        sigma_s_per_m: 8e6,
    };

    /// Grey cast iron as of pans, EN-GJL-200 to -300: 0.70 to 0.77 µΩm and a largest permeability of 220 to
    /// 330 µH/m (EN 1561, informative annex on physical properties), which the Fröhlich law has at H = 0:
    /// 1/(α b) = 327 µH/m. It saturates at 1.8 T: steel's 2.1 T less a tenth of graphite by volume and the
    /// cementite.
    pub const GREY_CAST_IRON: Self = Self::Froehlich {
        alpha_a_per_m: 5500.0,
        b_per_t: 1.0 / 1.8,
        sigma_s_per_m: 1.36e6,
    };

    /// Austenitic stainless steel 304 at room temperature.
    pub const STAINLESS_304: Self = Self::Linear {
        mu_r: 1.02,
        sigma_s_per_m: 1.39e6,
    };

    /// Aluminium.
    pub const ALUMINIUM: Self = Self::Linear {
        mu_r: 1.0,
        sigma_s_per_m: 3.5e7,
    };

    /// Refuses NaN and values no metal has.
    pub fn check(&self) -> Result<(), FieldError> {
        in_range(
            "sigma_s_per_m",
            self.sigma_s_per_m(),
            1e4,
            1e8,
            "1e4 to 1e8 S/m",
        )?;
        match *self {
            Self::Froehlich {
                alpha_a_per_m,
                b_per_t,
                ..
            } => {
                in_range("alpha_a_per_m", alpha_a_per_m, 1.0, 1e6, "1 to 1e6 A/m")?;
                in_range("b_per_t", b_per_t, 0.1, 100.0, "0.1 to 100 1/T")
            }
            Self::Linear { mu_r, .. } => in_range("mu_r", mu_r, 0.9, 1e5, "0.9 to 1e5"),
        }
    }

    /// Conductivity in S/m.
    pub fn sigma_s_per_m(&self) -> f64 {
        match *self {
            Self::Froehlich { sigma_s_per_m, .. } | Self::Linear { sigma_s_per_m, .. } => {
                sigma_s_per_m
            }
        }
    }

    /// Both laws in one formula, for loops without branches: B = c·H/(α + |H|)·… see
    /// [`BhCurve`].
    pub fn curve(&self) -> BhCurve {
        match *self {
            Self::Froehlich {
                alpha_a_per_m,
                b_per_t,
                ..
            } => BhCurve {
                alpha_a_per_m,
                saturating: 1.0,
                b_sat_t: 1.0 / b_per_t,
            },
            Self::Linear { mu_r, .. } => BhCurve {
                alpha_a_per_m: 1.0,
                saturating: 0.0,
                b_sat_t: mu_r * MU_0,
            },
        }
    }

    /// Slope dB/dH at H = 0, in H/m.
    pub fn mu_initial_h_per_m(&self) -> f64 {
        self.curve().slope_h_per_m(0.0)
    }

    /// Skin depth at H = 0, in metre, at a frequency in hertz.
    pub fn skin_depth_m(&self, f_hz: f64) -> f64 {
        let omega = 2.0 * core::f64::consts::PI * f_hz;
        (2.0 / (omega * self.mu_initial_h_per_m() * self.sigma_s_per_m())).sqrt()
    }
}

/// B(H) = b_sat · H / (α + s |H|), with s = 1 for Fröhlich and s = 0 (α = 1 A/m, b_sat = µ · 1 A/m)
/// for a linear material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BhCurve {
    /// α in A/m.
    pub alpha_a_per_m: f64,
    /// s: 1 saturating, 0 linear.
    pub saturating: f64,
    /// Saturation in tesla.
    pub b_sat_t: f64,
}

impl BhCurve {
    /// Flux density in tesla at a field strength in A/m.
    pub fn b_t(&self, h_a_per_m: f64) -> f64 {
        self.b_sat_t * h_a_per_m / (self.alpha_a_per_m + self.saturating * h_a_per_m.abs())
    }

    /// Slope dB/dH in H/m.
    pub fn slope_h_per_m(&self, h_a_per_m: f64) -> f64 {
        let d = self.alpha_a_per_m + self.saturating * h_a_per_m.abs();
        self.b_sat_t * self.alpha_a_per_m / (d * d)
    }

    /// Describing function: fundamental of B over fundamental of H for H = `amplitude`·cos θ,
    /// in H/m. (2 / π Ĥ) ∫₀^π B(Ĥ cos θ) cos θ dθ in closed form.
    pub fn describing_h_per_m(&self, amplitude_a_per_m: f64) -> f64 {
        use core::f64::consts::{FRAC_PI_2, PI};
        let x = self.saturating * amplitude_a_per_m.abs() / self.alpha_a_per_m;
        let initial = self.b_sat_t / self.alpha_a_per_m;
        if x < 1e-3 {
            // (4/π) Σ (−x)^n ∫ cos^(n+2) over a quarter period.
            let shape = 1.0 - x * 8.0 / (3.0 * PI) + x * x * 0.75;
            return initial * shape;
        }
        // J = ∫₀^{π/2} dθ / (1 + x cos θ); near x = 1 by its Taylor polynomial.
        let j = if (x - 1.0).abs() < 1e-4 {
            1.0 - (x - 1.0) / 3.0
        } else if x < 1.0 {
            2.0 / (1.0 - x * x).sqrt() * libm::atan(((1.0 - x) / (1.0 + x)).sqrt())
        } else {
            2.0 / (x * x - 1.0).sqrt() * libm::atanh(((x - 1.0) / (x + 1.0)).sqrt())
        };
        initial * 4.0 / PI * (1.0 / x - (FRAC_PI_2 - j) / (x * x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slope_is_the_derivative_of_the_chord_and_equals_the_papers_law() {
        let c = Material::PAPER.curve();
        for h in [0.0, 10.0, 1500.0, -4000.0, 20e3] {
            let d = 1e-3;
            let numeric = (c.b_t(h + d) - c.b_t(h - d)) / (2.0 * d);
            assert!((numeric / c.slope_h_per_m(h) - 1.0).abs() < 1e-6, "H = {h}");
            let paper = 1500.0 / (0.5 * (1500.0 + h.abs()).powi(2));
            assert!((paper / c.slope_h_per_m(h) - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn describing_function_equals_its_integral() {
        let c = Material::PAPER.curve();
        for h in [
            0.01, 1.0, 1.6, 100.0, 1499.9, 1500.0, 1500.1, 1501.0, 9e3, 1e6,
        ] {
            // The integrand is even and periodic; midpoint rule.
            let n = 200_000;
            let mut sum = 0.0;
            for k in 0..n {
                let cos = ((k as f64 + 0.5) / n as f64 * core::f64::consts::PI).cos();
                sum += c.b_t(h * cos) * cos;
            }
            let integral = 2.0 * sum / (n as f64 * h);
            let error = c.describing_h_per_m(h) / integral - 1.0;
            assert!(error.abs() < 1e-8, "H = {h}: {error:e}");
        }
    }

    #[test]
    fn linear_material_has_constant_slope() {
        let c = Material::ALUMINIUM.curve();
        assert_eq!(c.slope_h_per_m(0.0), c.slope_h_per_m(1e4));
        assert!((c.describing_h_per_m(1e4) / MU_0 - 1.0).abs() < 1e-12);
    }

    #[test]
    fn refuses_nan_by_name() {
        let m = Material::Linear {
            mu_r: f64::NAN,
            sigma_s_per_m: 1e6,
        };
        assert!(m.check().unwrap_err().to_string().contains("mu_r"));
    }
}
