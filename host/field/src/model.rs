//! Complete field model: load and winding.

use nalgebra::{Complex, DVector};

use super::contour::Contour;
use super::error::{FieldError, in_range};
use super::gap::GapOperator;
use super::geometry::Geometry;
use super::material::{MU_0, Material};
use super::modes::Modes;
use super::profile::{Metals, Profile};

pub use super::contour::RINGS;

/// Standard resolution: nodes into the depth of the load.
pub const DEPTH_NODES: usize = 44;

/// Parameters of a field model.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldSettings {
    /// Dimensions in metre.
    pub geometry: Geometry,
    /// Metal of the load.
    pub material: Material,
    /// Metal of the foil below its base, where [`Geometry::foil_thickness_m`] is above 0.
    pub foil: Material,
    /// Resistance of the winding and its leads in ohm.
    pub winding_r_ohm: f64,
    /// Rings of the load's surface, a multiple of [`RINGS`].
    pub rings: usize,
    /// Nodes into the depth of the load.
    pub depth_nodes: usize,
    /// Refinement of the gap's grid: 1 is the standard grid, 2 halves its cells.
    pub gap_refinement: f64,
}

impl FieldSettings {
    /// Arrangement of the paper (section IV), which has no winding loss.
    pub fn paper() -> Self {
        Self {
            geometry: Geometry::paper(),
            material: Material::PAPER,
            foil: Material::PAPER,
            winding_r_ohm: 0.0,
            rings: RINGS,
            depth_nodes: DEPTH_NODES,
            gap_refinement: 1.0,
        }
    }

    /// Metals of the load.
    pub fn metals(&self) -> Metals {
        Metals {
            base: self.material,
            foil: self.foil,
        }
    }
}

/// Ferromagnetic load: rings of its surface, coupled by the gap, with diffusion into the depth under each.
#[derive(Clone, Debug, PartialEq)]
pub struct Rings {
    /// Condensed gap.
    pub gap: GapOperator,
    /// Ways into the load, and its metals.
    pub profiles: Vec<Profile>,
    /// Metals of the load.
    pub metals: Metals,
    /// Each ring's place in `profiles`.
    pub of_ring: Vec<usize>,
    /// Shield with loss; otherwise a perfect conductor.
    pub lossy_shield: bool,
}

/// Coil and load without the winding's resistance.
#[derive(Clone, Debug, PartialEq)]
pub enum Body {
    /// A metal that saturates.
    Rings(Box<Rings>),
    /// A linear metal, resolved in the grid.
    Modes(Modes),
}

/// Solved field of coil and load, ready for time and frequency domain.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldModel {
    /// Coil and load.
    pub body: Body,
    /// Resistance of the winding in ohm.
    pub winding_r_ohm: f64,
}

impl FieldModel {
    /// Checks the settings and solves the field.
    ///
    /// # Errors
    /// [`FieldError`] of the settings.
    pub fn new(settings: &FieldSettings) -> Result<Self, FieldError> {
        check(settings)?;
        let (geometry, material) = (&settings.geometry, settings.material);
        let body = match material {
            Material::Linear { .. } if geometry.foil_thickness_m == 0.0 => {
                Body::Modes(Modes::loaded(geometry, &material, settings.gap_refinement)?)
            }
            Material::Linear { .. } | Material::Froehlich { .. } | Material::Saturating { .. } => {
                Body::Rings(Box::new(Rings::new(settings)?))
            }
        };
        Ok(Self {
            body,
            winding_r_ohm: settings.winding_r_ohm,
        })
    }

    /// Solves the field of the coil without a load.
    ///
    /// # Errors
    /// [`FieldError`] of the settings.
    pub fn bare_coil(settings: &FieldSettings) -> Result<Self, FieldError> {
        check(settings)?;
        Ok(Self {
            body: Body::Modes(Modes::bare_coil(
                &settings.geometry,
                settings.gap_refinement,
            )?),
            winding_r_ohm: settings.winding_r_ohm,
        })
    }
}

impl Rings {
    /// Solves the gap and makes the depth grid.
    ///
    /// # Errors
    /// [`FieldError`] of the settings.
    pub fn new(settings: &FieldSettings) -> Result<Self, FieldError> {
        check(settings)?;
        let geometry = &settings.geometry;
        let none = "0: only a linear metal without a foil may have a hole";
        in_range("hole_radius_m", geometry.hole_radius_m, 0.0, 0.0, none)?;
        let gap = GapOperator::new(geometry, settings.rings, settings.gap_refinement)?;
        let sections = Contour::new(geometry, settings.rings).sections();
        let mut parts = sections.clone();
        parts.dedup();
        let metals = settings.metals();
        let nodes = settings.depth_nodes;
        let profiles = parts
            .iter()
            .map(|part| part.profile(geometry, &metals, nodes));
        Ok(Self {
            gap,
            profiles: profiles.collect::<Result<_, _>>()?,
            metals,
            of_ring: sections
                .iter()
                .map(|section| parts.iter().take_while(|part| *part != section).count())
                .collect(),
            lossy_shield: geometry.shield_thickness_m > 0.0,
        })
    }

    /// Inductance that the shield's skin adds, in henry, at the rings' A in Wb/m per ampere: its surface impedance under the
    /// field of a perfect conductor. Its imaginary part is −R/ω.
    pub(crate) fn shield_h(&self, a: &DVector<Complex<f64>>, f_hz: f64) -> Complex<f64> {
        if !self.lossy_shield {
            return Complex::new(0.0, 0.0);
        }
        let skin_m = Material::ALUMINIUM.skin_depth_m(f_hz);
        self.gap.shield_share(a) * Complex::new(1.0, -1.0) * (MU_0 * skin_m / 2.0)
    }
}

fn check(settings: &FieldSettings) -> Result<(), FieldError> {
    let allowed = "16, 32, 48 or 64";
    in_range("rings", settings.rings as f64, 16.0, 64.0, allowed)?;
    if !settings.rings.is_multiple_of(RINGS) {
        return Err(FieldError::OutOfRange {
            field: "rings",
            value: settings.rings as f64,
            allowed,
        });
    }
    in_range(
        "gap_refinement",
        settings.gap_refinement,
        1.0,
        4.0,
        "1 to 4",
    )?;
    in_range(
        "winding_r_ohm",
        settings.winding_r_ohm,
        0.0,
        10.0,
        "0 to 10 ohm",
    )?;
    settings.foil.check()?;
    settings.material.check()
}
