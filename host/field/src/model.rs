//! Complete field model: gap, load material, depth grid, winding.

use super::depth::DepthGrid;
use super::error::{FieldError, in_range};
use super::gap::GapOperator;
use super::geometry::Geometry;
use super::material::Material;

/// Standard resolution (docs/simulator.md): rings over the load's radius.
pub const RINGS: usize = 16;

/// Standard resolution: nodes into the depth of the load.
pub const DEPTH_NODES: usize = 44;

/// Parameters of a field model.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldSettings {
    /// Dimensions in metre.
    pub geometry: Geometry,
    /// Load material.
    pub material: Material,
    /// Thickness of the load's base in metre.
    pub load_thickness_m: f64,
    /// Resistance of the winding and its leads in ohm.
    pub winding_r_ohm: f64,
    /// Rings over the load's radius.
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
            load_thickness_m: 5e-3,
            winding_r_ohm: 0.0,
            rings: RINGS,
            depth_nodes: DEPTH_NODES,
            gap_refinement: 1.0,
        }
    }
}

/// Solved gap and depth grid of the load, ready for time and frequency domain.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldModel {
    /// Condensed gap.
    pub gap: GapOperator,
    /// Depth grid of the load.
    pub depth: DepthGrid,
    /// Load material.
    pub material: Material,
    /// Resistance of the winding in ohm.
    pub winding_r_ohm: f64,
}

impl FieldModel {
    /// Checks the settings and solves the gap (some 50 ms).
    pub fn new(settings: &FieldSettings) -> Result<Self, FieldError> {
        in_range("rings", settings.rings as f64, 4.0, 64.0, "4 to 64")?;
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
        settings.material.check()?;
        Ok(Self {
            gap: GapOperator::new(&settings.geometry, settings.rings, settings.gap_refinement)?,
            depth: DepthGrid::new(
                &settings.material,
                settings.load_thickness_m,
                settings.depth_nodes,
            )?,
            material: settings.material,
            winding_r_ohm: settings.winding_r_ohm,
        })
    }
}
