//! Load that departs from the standard field model in one respect, for judging methods that assume this model.

use std::fmt;
use std::str::FromStr;

use ihd_field::material::{Knee, Material};
use ihd_field::model::FieldSettings;
use serde::{Deserialize, Serialize};

/// Relative permeability of the magnetisation curve's tail. At 12 kA/m, what 60 A make on a 21 cm pot, the Fröhlich
/// law has a slope of 12 µ0 left; steel in its approach to saturation has some 15 to 30.
const TAIL_MU_R: f64 = 20.0;

/// Number of rings of the finer load.
const MANY_RINGS: usize = 32;

/// Relative permeability of a ferrite of a warm, cheap plate.
const POOR_FERRITE_MU_R: f64 = 1000.0;

/// Height of a pot's wall in metre; the standard one is a disc.
const WALL_HEIGHT_M: f64 = 80e-3;

/// Distance from ferrite to coil with two additional sheets of mica, in metre; the standard one is 1 mm.
const WIDE_COIL_GAP_M: f64 = 2e-3;

/// Departure from the standard model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Perturbation {
    /// The magnetisation curve of a ferromagnetic metal goes on rising: µ_r 20 beside the Fröhlich law.
    Tail,
    /// Its knee is sharper: H/√(α² + H²) instead of H/(α + |H|).
    SharpKnee,
    /// 32 rings instead of 16; not in the time domain, whose rings are compiled in.
    Rings,
    /// The gap's grid with cells of half the size.
    FineGap,
    /// A ferrite of µ_r 1000 instead of 2000.
    Ferrite,
    /// The pot has a wall of 80 mm.
    Wall,
    /// The coil is 2 mm above the ferrite instead of 1.
    CoilGap,
}

/// A name that denotes no perturbation.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "unknown perturbation `{0}`: use tail, sharp-knee, rings, fine-gap, ferrite, wall or coil-gap"
)]
pub struct UnknownPerturbation(String);

impl Perturbation {
    /// All perturbations.
    pub const ALL: [Self; 7] = [
        Self::Tail,
        Self::SharpKnee,
        Self::Rings,
        Self::FineGap,
        Self::Ferrite,
        Self::Wall,
        Self::CoilGap,
    ];

    /// Name on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tail => "tail",
            Self::SharpKnee => "sharp-knee",
            Self::Rings => "rings",
            Self::FineGap => "fine-gap",
            Self::Ferrite => "ferrite",
            Self::Wall => "wall",
            Self::CoilGap => "coil-gap",
        }
    }

    /// Material that replaces a standard one; a linear one stays.
    pub fn material(self, standard: Material) -> Material {
        let (knee, tail_mu_r) = match self {
            Self::Tail => (Knee::Froehlich, TAIL_MU_R),
            Self::SharpKnee => (Knee::Sharp, 0.0),
            _ => return standard,
        };
        match standard {
            Material::Froehlich {
                alpha_a_per_m,
                b_per_t,
                sigma_s_per_m,
            } => Material::Saturating {
                knee,
                alpha_a_per_m,
                b_per_t,
                tail_mu_r,
                sigma_s_per_m,
            },
            other => other,
        }
    }

    /// Returns the model with this departure.
    #[must_use]
    pub fn apply_to(self, standard: FieldSettings) -> FieldSettings {
        let mut settings = standard;
        settings.material = self.material(settings.material);
        let geometry = &mut settings.geometry;
        match self {
            Self::Tail | Self::SharpKnee => {}
            Self::Rings => settings.rings = MANY_RINGS,
            Self::FineGap => settings.gap_refinement = 2.0,
            Self::Ferrite => geometry.ferrite_mu_r = POOR_FERRITE_MU_R,
            Self::Wall => geometry.wall_height_m = WALL_HEIGHT_M,
            Self::CoilGap => geometry.ferrite_gap_m = WIDE_COIL_GAP_M,
        }
        settings
    }
}

impl fmt::Display for Perturbation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Perturbation {
    type Err = UnknownPerturbation;

    fn from_str(name: &str) -> Result<Self, UnknownPerturbation> {
        let found = Self::ALL.into_iter().find(|p| p.name() == name);
        found.ok_or_else(|| UnknownPerturbation(name.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pot::{PotBase, SimulatedPot};
    use ihd_field::{FieldModel, harmonic};

    fn z(perturbation: Option<Perturbation>, i_a: f64) -> (f64, f64) {
        let pot = SimulatedPot {
            perturbation,
            ..SimulatedPot::new(PotBase::Ferritic, 0.18)
        };
        let settings = pot.field_settings(0.1).unwrap().remove(0).1;
        let z = harmonic::impedance(&FieldModel::new(&settings).unwrap(), 50e3, i_a).unwrap();
        (z.r_ohm, z.l_h)
    }

    #[test]
    fn every_one_changes_the_load_by_as_much_as_its_physics() {
        for p in Perturbation::ALL {
            assert_eq!(p.name().parse(), Ok(p));
            let off = |i_a: f64| {
                let ((r, l), (r_0, l_0)) = (z(Some(p), i_a), z(None, i_a));
                (100.0 * (r / r_0 - 1.0), 100.0 * (l / l_0 - 1.0))
            };
            let (small, large) = (off(0.5), off(40.0));
            println!("{p}: {small:.2?} % at 0.5 A, {large:.2?} % at 40 A");
            match p {
                // The surface impedance goes with √µ. At no field µ_r is 1061: half of 20/1061. Saturated at 12 kA/m the
                // chord is 118 µ0, so no ring gains more than half of 20/118.
                Perturbation::Tail => {
                    assert!((0.0..0.95).contains(&small.0) && (1.0..8.5).contains(&large.0));
                }
                // At no field the same; at H = α the chord is √2 times as large, so no ring gains more than 2^¼ − 1.
                Perturbation::SharpKnee => {
                    assert!(small.0.abs() < 5.0 && (2.0..19.0).contains(&large.0));
                }
                // Discretisation: docs/simulator.md.
                Perturbation::Rings | Perturbation::FineGap => {
                    assert!(large.0.abs() < 2.0 && large.0 != 0.0);
                }
                // 92 mm of ferrite count as 46 µm more of air under a gap of some 10 mm.
                Perturbation::Ferrite => assert!((-1.0..-0.01).contains(&large.1)),
                // A wall has the flux of side and top in its place, and more of it.
                Perturbation::Wall => assert!((0.0..10.0).contains(&small.0)),
                // Ferrite holds H at zero at its face; only what leaks out of the wider gap is lost to the pot.
                Perturbation::CoilGap => assert!((-5.0..0.0).contains(&large.1) && large.0 < 0.0),
            }
        }
        assert!("round".parse::<Perturbation>().is_err());
    }

    #[test]
    fn a_metal_that_is_linear_keeps_its_law() {
        assert_eq!(
            Perturbation::Tail.material(Material::ALUMINIUM),
            Material::ALUMINIUM
        );
    }
}
