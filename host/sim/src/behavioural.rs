//! Behavioural loads: R and L as a closed law of current amplitude and frequency.
//!
//! With these the paper's equation (1), v = R i + L di/dt, holds exactly, so the ferromagnetic pot
//! is the behavioural reference load of the project's studies.

use std::fmt;

use ihd_shared::board::BARE_COIL_NH;
use ihd_shared::hob::TURNS_RATIO;

/// Kind of pot on the coil.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum PotKind {
    /// Full-size ferromagnetic pot: the behavioural reference load.
    #[default]
    Ferromagnetic,
    /// Ferromagnetic pot of 12 cm.
    Small,
    /// Aluminium pan.
    Aluminium,
    /// Austenitic stainless steel 304.
    Stainless,
    /// No pot.
    None,
}

/// Frequency at which the laws below are given, in hertz.
const REFERENCE_HZ: f64 = 45e3;

impl PotKind {
    /// All kinds, for lists and tests.
    pub const ALL: [Self; 5] = [
        Self::Ferromagnetic,
        Self::Small,
        Self::Aluminium,
        Self::Stainless,
        Self::None,
    ];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ferromagnetic => "ferromagnetic",
            Self::Small => "small",
            Self::Aluminium => "aluminium",
            Self::Stainless => "stainless",
            Self::None => "none",
        }
    }
}

impl fmt::Display for PotKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Load at one frequency, for evaluation at every sample.
#[derive(Clone, Copy, Debug)]
pub struct BehaviouralLoad {
    pot: PotKind,
    r_factor: f64,
    l_factor: f64,
}

impl BehaviouralLoad {
    /// Creates the load of a pot at a switching frequency in hertz.
    ///
    /// R ∝ f^½ by the skin effect; the part of L that is in magnetic material ∝ f^−0.3, the gap's part constant.
    pub fn new(pot: PotKind, f_sw_hz: f64) -> Self {
        let x = f_sw_hz / REFERENCE_HZ;
        Self {
            pot,
            r_factor: libm::sqrt(x),
            l_factor: libm::pow(x, -0.3),
        }
    }

    /// R in ohm and L in henry at an amplitude of the current's fundamental in ampere.
    ///
    /// Ferromagnetic: R = (2.2 + 3.5/(1 + I/15))·(f/45k)^½ ohm,
    /// L = 16 + (1 + 15/(1 + (I/14)^1.5))·(f/45k)^−0.3 µH, I in ampere, f in hertz. Small: a ferritic pot of 12 cm by the field
    /// model, 3.18 ohm and 32.9 µH at 77.4 kHz and 16.2 A, 1.51 ohm and 31.9 µH at 36.7 kHz and 60.6 A. All over 23 turns
    /// ([`TURNS_RATIO`]).
    pub fn r_l(&self, i_a: f64) -> (f64, f64) {
        let i_a = i_a * TURNS_RATIO;
        let square = TURNS_RATIO * TURNS_RATIO;
        let (r, gap_uh, material_uh) = match self.pot {
            PotKind::Ferromagnetic => {
                let y = i_a / 14.0;
                (
                    2.2 + 3.5 / (1.0 + i_a / 15.0),
                    16.0,
                    1.0 + 15.0 / (1.0 + y * libm::sqrt(y)),
                )
            }
            PotKind::Small => (
                1.27 + 3.45 / (1.0 + i_a / 8.0),
                28.7,
                3.0 + 4.0 / (1.0 + i_a / 15.0),
            ),
            PotKind::Aluminium => (0.22, 17.0, 0.0),
            PotKind::Stainless => (0.76, 18.0, 0.0),
            // The board file's, on the reference coil.
            PotKind::None => (0.1, f64::from(BARE_COIL_NH) * 1e-3 / square, 0.0),
        };
        (
            square * r * self.r_factor,
            square * (gap_uh + material_uh * self.l_factor) * 1e-6,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reference_load_has_its_values() {
        let load = BehaviouralLoad::new(PotKind::Ferromagnetic, 45e3);
        let (r0, l0) = load.r_l(0.0);
        assert!((r0 - 5.7).abs() < 1e-12 && (l0 - 32e-6).abs() < 1e-15);
        let (r, l) = load.r_l(14.0);
        assert!((r - (2.2 + 3.5 / (1.0 + 14.0 / 15.0))).abs() < 1e-12);
        assert!((l - 24.5e-6).abs() < 1e-15);
        for (f_hz, i_a, r_ohm, l_uh) in
            [(77_413.0, 16.2, 3.177, 32.9), (36_670.0, 60.6, 1.513, 31.9)]
        {
            let (r, l) = BehaviouralLoad::new(PotKind::Small, f_hz).r_l(i_a);
            assert!((r / r_ohm - 1.0).abs() < 0.05, "{r} {r_ohm}");
            assert!((l * 1e6 / l_uh - 1.0).abs() < 0.05, "{l} {l_uh}");
        }
        let (r4, l4) = BehaviouralLoad::new(PotKind::Ferromagnetic, 180e3).r_l(0.0);
        assert!((r4 / r0 - 2.0).abs() < 1e-12);
        assert!((l4 - (16.0 + 16.0 * 4f64.powf(-0.3)) * 1e-6).abs() < 1e-15);
    }
}
