//! Description of the pot on the coil, its place and temperature, from which the field model is made.

use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use ihd_field::FieldError;
use ihd_field::geometry::Geometry;
use ihd_field::material::Material;
use ihd_field::model::FieldSettings;
use ihd_field::profile::Metals;

use crate::perturbation::Perturbation;

/// Thickness of a pot's base in metre.
const BASE_THICKNESS_M: f64 = 5e-3;

/// Thickness of a lid in metre.
const LID_THICKNESS_M: f64 = 0.6e-3;

/// Width of cutlery in metre: a tablespoon's bowl has 4 cm, its handle 1 to 2.
const CUTLERY_WIDTH_M: f64 = 30e-3;

/// Width and thickness of a ring in metre: a trivet, or the ring under a round-bottomed pan.
const RING_WIDTH_M: f64 = 20e-3;
const RING_THICKNESS_M: f64 = 3e-3;

/// Thickness of a household's foil in metre.
const HOUSEHOLD_FOIL_M: f64 = 15e-6;

/// Thickness that stands for it in metre, as the field model takes none below: a sheet far thinner than its skin depth acts by the
/// product of thickness and conductivity alone.
const SHEET_M: f64 = 1e-4;

/// Thickness of a sandwich base's foil in metre: 0.4 to 0.6 mm are usual.
const FOIL_THICKNESS_M: f64 = 0.5e-3;

/// Number of angles at which the rim of an off-centre pot is evaluated, over half a turn.
const SECTORS: usize = 4;

/// Range of a base's diameters that have a name, in centimetre.
const DIAMETERS_CM: RangeInclusive<f64> = 4.0..=28.0;

/// Smallest distance of the rim of an off-centre pot from the coil's axis, in metre; a nearer rim is set to it. At 8 mm beyond the
/// coil's inner radius, above 2 of its 23 turns, it is as good as no pot.
const MIN_RIM_M: f64 = 20e-3;

/// Allowed offset of any pot as a share of its diameter: its rim stays outside the coil's axis.
const ALLOWED_OFFSET: f64 = 0.4;

/// A pot of 12 cm or more may be off centre by 60 mm: the coil's axis is then at its rim.
const WIDE_OFFSET_M: f64 = 60e-3;

/// Curie point of the ferromagnetic metals less 20 °C, in kelvin: ferritic stainless steel loses its magnetism at 680 °C.
const CURIE_RISE_K: f64 = 660.0;

/// Smallest remaining share of the saturation: a law that saturates at zero has no skin.
const MIN_SATURATION: f64 = 0.02;

/// Base of a pot by its metals, or what a household has in its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PotBase {
    /// Ferromagnetic stainless steel: the paper's load.
    Ferritic,
    /// Grey cast iron.
    CastIron,
    /// Austenitic stainless steel 304.
    Stainless,
    /// Aluminium.
    Aluminium,
    /// Aluminium on a foil of ferritic steel: a sandwich base.
    Clad,
    /// A household's aluminium foil, flat on the glass.
    Foil,
    /// A lid of stainless steel 304.
    Lid,
    /// Cutlery of ferritic steel through the coil's axis, as long as a pot is wide.
    Spoon,
    /// A flat ring of stainless steel 304.
    Ring,
}

/// Pot, or none.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SimulatedPot {
    /// Base; `None` if there is no pot.
    #[serde(rename = "metal")]
    pub base: Option<PotBase>,
    /// Diameter of its base in metre.
    pub diameter_m: f64,
    /// Distance above its usual place, in metre.
    pub lift_m: f64,
    /// Distance of its axis from the coil's, in metre.
    pub offset_m: f64,
    /// Temperature of its base in degrees Celsius.
    pub temperature_c: f64,
    /// Departure from the standard field model; ignored by formulas.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub perturbation: Option<Perturbation>,
}

/// A name that denotes no pot.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "unknown pot `{0}`: use ferritic-D, cast-iron-D, stainless-D, aluminium-D, clad-D, foil-D, lid-D, spoon-D or ring-D with D = 4 to 28 (base or length in cm), or none"
)]
pub struct UnknownPotName(String);

impl FromStr for SimulatedPot {
    type Err = UnknownPotName;

    fn from_str(name: &str) -> Result<Self, UnknownPotName> {
        let unknown = || UnknownPotName(name.to_owned());
        let (base, cm) = match name {
            "none" => return Ok(Self::NONE),
            // Names of the formulas' loads.
            "ferromagnetic" => ("ferritic", 21.0),
            "small" => ("ferritic", 12.0),
            _ if PotBase::of_name(name).is_some() => (name, 21.0),
            _ => {
                let (base, cm) = name.rsplit_once('-').ok_or_else(unknown)?;
                (base, cm.parse::<f64>().map_err(|_| unknown())?)
            }
        };
        if !DIAMETERS_CM.contains(&cm) {
            return Err(unknown());
        }
        let base = PotBase::of_name(base).ok_or_else(unknown)?;
        Ok(Self::new(base, cm * 1e-2))
    }
}

impl fmt::Display for SimulatedPot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.base {
            None => f.write_str("none"),
            // Rounded to a thousandth of a millimetre: 0.07 m are not 7.000000000000001 cm.
            Some(base) => write!(
                f,
                "{}-{}",
                base.name(),
                (self.diameter_m * 1e6).round() / 1e4
            ),
        }
    }
}

impl SimulatedPot {
    /// No pot.
    pub const NONE: Self = Self {
        base: None,
        diameter_m: 0.21,
        lift_m: 0.0,
        offset_m: 0.0,
        temperature_c: 20.0,
        perturbation: None,
    };

    /// Creates a centred pot at room temperature.
    pub fn new(base: PotBase, diameter_m: f64) -> Self {
        Self {
            base: Some(base),
            diameter_m,
            ..Self::NONE
        }
    }

    /// Field models whose mean is this pot, with their weights; empty for no pot.
    ///
    /// Off centre: seen from the coil's axis the rim is at ρ(θ) = d cos θ + √(R² − d² sin² θ).
    /// Each sector of the coil's turns is taken as if the pot had radius ρ(θ) all round; the
    /// sectors carry the same current and their voltages add. Fields that cross from one sector to
    /// the next are neglected.
    ///
    /// Cutlery of width w covers 2w/πR of a disc of radius R, but for the coil's: so much of the turns sees the disc, and the rest
    /// next to nothing. What returns at its edges is neglected, as in steel the current flows in a skin far thinner than wide.
    pub fn field_settings(
        &self,
        winding_r_ohm: f64,
    ) -> Result<Vec<(f64, FieldSettings)>, FieldError> {
        let Some(base) = self.base else {
            return Ok(Vec::new());
        };
        self.check()?;
        let radius_m = 0.5 * self.diameter_m;
        let radii = if self.offset_m == 0.0 {
            vec![radius_m]
        } else {
            (0..SECTORS)
                .map(|k| {
                    let angle = std::f64::consts::PI * (k as f64 + 0.5) / SECTORS as f64;
                    let (s, c) = (
                        self.offset_m * libm::sin(angle),
                        self.offset_m * libm::cos(angle),
                    );
                    (c + (radius_m * radius_m - s * s).sqrt()).max(MIN_RIM_M)
                })
                .collect()
        };
        let weight = 1.0 / radii.len() as f64;
        let coil = Geometry::of_board();
        let covered = match base {
            PotBase::Spoon => {
                let within_m = radius_m.min(coil.coil_outer_m);
                (2.0 * CUTLERY_WIDTH_M / (std::f64::consts::PI * within_m)).min(1.0)
            }
            _ => 1.0,
        };
        let of_radius = |(weight, load_radius_m): (f64, f64)| {
            let settings = FieldSettings {
                geometry: Geometry {
                    load_radius_m,
                    hole_radius_m: base.hole_radius_m(load_radius_m),
                    load_gap_m: coil.load_gap_m + self.lift_m,
                    load_thickness_m: base.thickness_m(),
                    foil_thickness_m: base.foil_thickness_m(),
                    ..coil.clone()
                },
                material: base.at(self.temperature_c),
                foil: PotBase::Ferritic.at(self.temperature_c),
                winding_r_ohm,
                ..FieldSettings::paper()
            };
            let settings = match self.perturbation {
                Some(perturbation) => perturbation.apply_to(settings),
                None => settings,
            };
            (weight, settings)
        };
        let seen = radii.into_iter().map(|radius| (covered * weight, radius));
        let rest = (covered < 1.0).then_some((1.0 - covered, MIN_RIM_M));
        Ok(seen.chain(rest).map(of_radius).collect())
    }

    /// Properties of the metals of this pot at a temperature in °C; `None` without a pot.
    pub fn metals_at(&self, temperature_c: f64) -> Option<Metals> {
        let standard = self.base?.at(temperature_c);
        let perturbed = self.perturbation.map(|p| p.material(standard));
        Some(Metals {
            base: perturbed.unwrap_or(standard),
            foil: PotBase::Ferritic.at(temperature_c),
        })
    }

    /// Checks that the field model holds for size and place of the pot.
    ///
    /// # Errors
    /// The first number out of its range.
    pub fn check(&self) -> Result<(), FieldError> {
        use ihd_field::error::in_range;
        in_range("pot diameter_m", self.diameter_m, 0.04, 0.4, "4 to 40 cm")?;
        in_range("pot lift_m", self.lift_m, 0.0, 0.1, "0 to 100 mm")?;
        let wide = if self.diameter_m < 2.0 * WIDE_OFFSET_M - 1e-9 {
            0.0
        } else {
            WIDE_OFFSET_M
        };
        in_range(
            "pot offset_m",
            self.offset_m,
            0.0,
            wide.max(ALLOWED_OFFSET * self.diameter_m),
            "0 to 0.4 of the pot's diameter, or to 60 mm for 12 cm and more",
        )?;
        in_range(
            "pot temperature_c",
            self.temperature_c,
            -40.0,
            600.0,
            "-40 to 600 °C",
        )
    }
}

impl PotBase {
    /// All bases.
    pub const ALL: [Self; 9] = [
        Self::Ferritic,
        Self::CastIron,
        Self::Stainless,
        Self::Aluminium,
        Self::Clad,
        Self::Foil,
        Self::Lid,
        Self::Spoon,
        Self::Ring,
    ];

    /// Name on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ferritic => "ferritic",
            Self::CastIron => "cast-iron",
            Self::Stainless => "stainless",
            Self::Aluminium => "aluminium",
            Self::Clad => "clad",
            Self::Foil => "foil",
            Self::Lid => "lid",
            Self::Spoon => "spoon",
            Self::Ring => "ring",
        }
    }

    fn of_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|base| base.name() == name)
    }

    /// Thickness of the base in metre.
    fn thickness_m(self) -> f64 {
        match self {
            Self::Foil => SHEET_M,
            Self::Lid => LID_THICKNESS_M,
            Self::Ring => RING_THICKNESS_M,
            Self::Ferritic
            | Self::CastIron
            | Self::Stainless
            | Self::Aluminium
            | Self::Clad
            | Self::Spoon => BASE_THICKNESS_M,
        }
    }

    /// Thickness of the foil below the base in metre; 0 for none.
    fn foil_thickness_m(self) -> f64 {
        match self {
            Self::Clad => FOIL_THICKNESS_M,
            Self::Ferritic
            | Self::CastIron
            | Self::Stainless
            | Self::Aluminium
            | Self::Foil
            | Self::Lid
            | Self::Spoon
            | Self::Ring => 0.0,
        }
    }

    /// Radius in metre of the hole in a base of this radius; 0 for none.
    fn hole_radius_m(self, radius_m: f64) -> f64 {
        match self {
            Self::Ring => (radius_m - RING_WIDTH_M).max(0.0),
            Self::Ferritic
            | Self::CastIron
            | Self::Stainless
            | Self::Aluminium
            | Self::Clad
            | Self::Foil
            | Self::Lid
            | Self::Spoon => 0.0,
        }
    }

    /// Resistivity at a temperature in °C over that at 20 °C; of a sandwich base the foil's, in which most heat arises.
    pub fn resistivity_factor(self, temperature_c: f64) -> f64 {
        let per_kelvin = match self {
            Self::Ferritic | Self::Clad | Self::Spoon => 1.1e-3,
            Self::CastIron => 1.9e-3,
            Self::Stainless | Self::Lid | Self::Ring => 0.9e-3,
            Self::Aluminium | Self::Foil => 4.0e-3,
        };
        1.0 + per_kelvin * (temperature_c - 20.0)
    }

    /// Saturation of a ferromagnetic metal at a temperature in °C over that at 20 °C: 1 − (ΔT/660 K)².
    fn saturation_factor(self, temperature_c: f64) -> f64 {
        match self {
            Self::Stainless | Self::Aluminium | Self::Foil | Self::Lid | Self::Ring => 1.0,
            Self::Ferritic | Self::CastIron | Self::Clad | Self::Spoon => {
                let x = (temperature_c - 20.0).max(0.0) / CURIE_RISE_K;
                (1.0 - x * x).max(MIN_SATURATION)
            }
        }
    }

    /// Resistivity times saturation at a temperature in °C over that at 20 °C, which is all that heat does to a
    /// thick load: with it a hot load at f is the cold one at f over this factor, its R and X this factor
    /// times as large. The skin of a metal B = B_s H/(α + |H|) has µ δ ∝ √(ρ B_s/α ω) at every H/α; of a linear
    /// one, thick or not, only ω/ρ counts.
    pub fn heat_factor(self, temperature_c: f64) -> f64 {
        self.resistivity_factor(temperature_c) * self.saturation_factor(temperature_c)
    }

    /// Density in kg/m³, specific heat in J/kgK and thermal conductivity in W/mK near 100 °C (ASM Metals Handbook; EN 1561 for cast
    /// iron).
    pub fn thermal(self) -> (f64, f64, f64) {
        match self {
            Self::Ferritic | Self::Spoon => (7700.0, 460.0, 26.0),
            Self::CastIron => (7200.0, 500.0, 48.0),
            Self::Stainless | Self::Lid | Self::Ring => (8000.0, 500.0, 16.0),
            Self::Aluminium | Self::Clad | Self::Foil => (2700.0, 900.0, 230.0),
        }
    }

    /// Material of the base at a temperature in °C. Resistivity grows linearly; a ferromagnetic metal's saturation
    /// falls as 1 − (ΔT/ΔT_Curie)² with a Curie point of 680 °C.
    pub fn at(self, temperature_c: f64) -> Material {
        let material = match self {
            Self::Ferritic | Self::Spoon => Material::PAPER,
            Self::CastIron => Material::GREY_CAST_IRON,
            Self::Stainless | Self::Lid | Self::Ring => Material::STAINLESS_304,
            Self::Aluminium => Material::ALUMINIUM,
            Self::Foil => Material::Linear {
                mu_r: 1.0,
                sigma_s_per_m: Material::ALUMINIUM.sigma_s_per_m() * HOUSEHOLD_FOIL_M / SHEET_M,
            },
            Self::Clad => return Self::Aluminium.at(temperature_c),
        };
        let hot_sigma = material.sigma_s_per_m() / self.resistivity_factor(temperature_c);
        match material {
            Material::Froehlich {
                alpha_a_per_m,
                b_per_t,
                ..
            } => Material::Froehlich {
                alpha_a_per_m,
                b_per_t: b_per_t / self.saturation_factor(temperature_c),
                sigma_s_per_m: hot_sigma,
            },
            Material::Linear { mu_r, .. } => Material::Linear {
                mu_r,
                sigma_s_per_m: hot_sigma,
            },
            // No metal of the table has this material.
            other @ Material::Saturating { .. } => other,
        }
    }
}

#[cfg(test)]
mod tests;
