//! Magnetic and electric laws of the load.

use super::error::{FieldError, in_range};

/// Permeability of vacuum in H/m.
pub const MU_0: f64 = 4e-7 * core::f64::consts::PI;

/// Shape of a magnetisation curve's knee.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Knee {
    /// Fröhlich's law: B = H / (b (α + |H|)).
    Froehlich,
    /// Sharper law: B = H / (b √(α² + H²)).
    Sharp,
    /// The paper's µ0 µ_r(H) = α / (b (α + |H|)²) taken as B/H. B falls beyond H = α, so that it has no time domain; in the
    /// frequency domain µ is that of the amplitude, as a solver does with a µ_r(H) that was typed in.
    Literal,
}

/// Material of a load: B(H) and conductivity.
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
    /// Ferromagnetic by another law than Fröhlich's, to test methods that assume the latter.
    Saturating {
        /// Shape of the transition from the slope at zero field to saturation.
        knee: Knee,
        /// α in A/m; the slope at zero field is 1/(α b), as with Fröhlich's law.
        alpha_a_per_m: f64,
        /// b in 1/T: without the tail it saturates at 1/b tesla.
        b_per_t: f64,
        /// Relative permeability that is left beside, at any field: B gets µ0 · this · H. 0 is none.
        tail_mu_r: f64,
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

    /// The same numbers with [`Knee::Literal`], in the frequency domain only.
    pub const PAPER_LITERAL: Self = Self::Saturating {
        knee: Knee::Literal,
        alpha_a_per_m: 1500.0,
        b_per_t: 0.5,
        tail_mu_r: 0.0,
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

    /// Checks that all numbers are possible for a metal.
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
            Self::Saturating {
                alpha_a_per_m,
                b_per_t,
                tail_mu_r,
                ..
            } => {
                in_range("tail_mu_r", tail_mu_r, 0.0, 100.0, "0 to 100")?;
                in_range("alpha_a_per_m", alpha_a_per_m, 1.0, 1e6, "1 to 1e6 A/m")?;
                in_range("b_per_t", b_per_t, 0.1, 100.0, "0.1 to 100 1/T")
            }
            Self::Linear { mu_r, .. } => in_range("mu_r", mu_r, 0.9, 1e5, "0.9 to 1e5"),
        }
    }

    /// Conductivity in S/m.
    pub fn sigma_s_per_m(&self) -> f64 {
        match *self {
            Self::Froehlich { sigma_s_per_m, .. }
            | Self::Saturating { sigma_s_per_m, .. }
            | Self::Linear { sigma_s_per_m, .. } => sigma_s_per_m,
        }
    }

    /// Returns the law in the common form of [`BhCurve`], for loops without branches.
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
                knee: Knee::Froehlich,
                tail_h_per_m: 0.0,
            },
            Self::Saturating {
                knee,
                alpha_a_per_m,
                b_per_t,
                tail_mu_r,
                ..
            } => BhCurve {
                alpha_a_per_m,
                saturating: 1.0,
                b_sat_t: 1.0 / b_per_t,
                knee,
                tail_h_per_m: tail_mu_r * MU_0,
            },
            Self::Linear { mu_r, .. } => BhCurve {
                alpha_a_per_m: 1.0,
                saturating: 0.0,
                b_sat_t: mu_r * MU_0,
                knee: Knee::Froehlich,
                tail_h_per_m: 0.0,
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

/// B(H) = b_sat · H / (α + s |H|) + µ_t H, with s = 1 for Fröhlich and s = 0 (α = 1 A/m, b_sat = µ · 1 A/m)
/// for a linear material; with the sharp knee b_sat · H / √(α² + H²) + µ_t H.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BhCurve {
    /// α in A/m.
    pub alpha_a_per_m: f64,
    /// s: 1 if saturating, 0 if linear.
    pub saturating: f64,
    /// Saturation flux density in tesla.
    pub b_sat_t: f64,
    /// Shape of the knee.
    pub knee: Knee,
    /// µ_t, the remaining slope at any field, in H/m.
    pub tail_h_per_m: f64,
}

impl BhCurve {
    /// Flux density in tesla at a field strength in A/m.
    pub fn b_t(&self, h_a_per_m: f64) -> f64 {
        let alpha = self.alpha_a_per_m;
        let saturating = match self.knee {
            Knee::Froehlich => {
                self.b_sat_t * h_a_per_m / (alpha + self.saturating * h_a_per_m.abs())
            }
            Knee::Sharp => {
                self.b_sat_t * h_a_per_m / (alpha * alpha + h_a_per_m * h_a_per_m).sqrt()
            }
            Knee::Literal => self.literal_h_per_m(h_a_per_m) * h_a_per_m,
        };
        saturating + self.tail_h_per_m * h_a_per_m
    }

    /// Slope dB/dH in H/m.
    pub fn slope_h_per_m(&self, h_a_per_m: f64) -> f64 {
        let alpha = self.alpha_a_per_m;
        let saturating = match self.knee {
            Knee::Froehlich => {
                let d = alpha + self.saturating * h_a_per_m.abs();
                self.b_sat_t * alpha / (d * d)
            }
            Knee::Sharp => {
                let square = alpha * alpha + h_a_per_m * h_a_per_m;
                self.b_sat_t * alpha * alpha / (square * square.sqrt())
            }
            Knee::Literal => {
                let h = h_a_per_m.abs();
                self.literal_h_per_m(h) * (alpha - h) / (alpha + h)
            }
        };
        saturating + self.tail_h_per_m
    }

    /// Describing function: fundamental of B over fundamental of H for H = `amplitude`·cos θ,
    /// in H/m. (2 / π Ĥ) ∫₀^π B(Ĥ cos θ) cos θ dθ in closed form.
    pub fn describing_h_per_m(&self, amplitude_a_per_m: f64) -> f64 {
        let saturating = match self.knee {
            Knee::Froehlich => self.describing_froehlich(amplitude_a_per_m),
            Knee::Sharp => self.describing_sharp(amplitude_a_per_m),
            Knee::Literal => self.literal_h_per_m(amplitude_a_per_m),
        };
        saturating + self.tail_h_per_m
    }

    /// The paper's µ0 µ_r(H).
    fn literal_h_per_m(&self, h_a_per_m: f64) -> f64 {
        let d = self.alpha_a_per_m + h_a_per_m.abs();
        self.b_sat_t * self.alpha_a_per_m / (d * d)
    }

    /// Describing function of the sharp knee. ∫ cos²/√(1 + x² cos²) over a quarter period is (√(1 + x²) E − K/√(1 + x²))/x²,
    /// with the complete elliptic integrals of the parameter m = x²/(1 + x²).
    fn describing_sharp(&self, amplitude_a_per_m: f64) -> f64 {
        use core::f64::consts::PI;
        let x = amplitude_a_per_m.abs() / self.alpha_a_per_m;
        let initial = self.b_sat_t / self.alpha_a_per_m;
        if x < 1e-2 {
            return initial * (1.0 - 0.375 * x * x);
        }
        let stretch = (1.0 + x * x).sqrt();
        let (k, e) = elliptic(x * x / (1.0 + x * x));
        initial * 4.0 / PI * (stretch * e - k / stretch) / (x * x)
    }

    fn describing_froehlich(&self, amplitude_a_per_m: f64) -> f64 {
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

/// Complete elliptic integrals K and E of the parameter m, 0 to 1, by the arithmetic-geometric mean: six
/// halvings of the difference's exponent are beyond 1e-16 for any m of a double.
fn elliptic(m: f64) -> (f64, f64) {
    let (mut a, mut g, mut c2) = (1.0, (1.0 - m).sqrt(), m);
    let (mut sum, mut weight) = (0.5 * c2, 0.5);
    for _ in 0..AGM_STEPS {
        let c = 0.5 * (a - g);
        (a, g) = (0.5 * (a + g), (a * g).sqrt());
        c2 = c * c;
        weight *= 2.0;
        sum += weight * c2;
    }
    let k = core::f64::consts::FRAC_PI_2 / a;
    (k, k * (1.0 - sum))
}

/// Steps of the arithmetic-geometric mean.
const AGM_STEPS: usize = 8;

#[cfg(test)]
mod tests;
