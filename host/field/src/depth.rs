//! Graded depth grid of the load, fine at the surface where the field is.

use super::error::{FieldError, in_range};
use super::material::Material;

/// Lowest frequency whose fundamental the grid must hold, in hertz.
const F_MIN_HZ: f64 = 20e3;

/// Depth of the grid in skin depths of the unsaturated material at [`F_MIN_HZ`]. A saturated
/// front reaches four times deeper than the unsaturated skin depth (20 kA/m, 20 kHz); 16 leaves
/// that again four times over.
const SKIN_DEPTHS: f64 = 16.0;

/// Last interval over first.
const GRADING: f64 = 66.0;

/// Nodes n = 0 (surface) to N−1, then a boundary where H = 0.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthGrid {
    /// Width of each node's control volume, in metre; N values, half a cell at the surface.
    pub cell_m: Vec<f64>,
    /// Distance from each node to the next deeper one (last: to the boundary), in metre.
    pub step_m: Vec<f64>,
}

impl DepthGrid {
    /// Grid of `nodes` for a plate of `thickness_m`.
    pub fn new(material: &Material, thickness_m: f64, nodes: usize) -> Result<Self, FieldError> {
        in_range(
            "load_thickness_m",
            thickness_m,
            1e-4,
            0.1,
            "0.1 mm to 100 mm",
        )?;
        in_range("depth_nodes", nodes as f64, 8.0, 1000.0, "8 to 1000")?;
        let depth_m = thickness_m.min(SKIN_DEPTHS * material.skin_depth_m(F_MIN_HZ));
        let growth = libm::pow(GRADING, 1.0 / (nodes as f64 - 1.0));
        let mut step_m: Vec<f64> = Vec::with_capacity(nodes);
        let mut width = 1.0;
        for _ in 0..nodes {
            step_m.push(width);
            width *= growth;
        }
        let scale = depth_m / step_m.iter().sum::<f64>();
        step_m.iter_mut().for_each(|s| *s *= scale);
        let mut cell_m = vec![step_m[0] / 2.0];
        cell_m.extend(step_m.windows(2).map(|s| (s[0] + s[1]) / 2.0));
        Ok(Self { cell_m, step_m })
    }

    /// Number of nodes.
    pub fn nodes(&self) -> usize {
        self.step_m.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fills_a_thin_plate_and_grows_inwards() {
        let g = DepthGrid::new(&Material::STAINLESS_304, 1.5e-3, 44).unwrap();
        assert!((g.step_m.iter().sum::<f64>() - 1.5e-3).abs() < 1e-12);
        assert!(g.step_m.windows(2).all(|s| s[1] > s[0]));
        assert!((g.step_m[43] / g.step_m[0] - GRADING).abs() < 1e-9);
    }

    #[test]
    fn refuses_a_thickness_that_is_not_a_number() {
        let e = DepthGrid::new(&Material::PAPER, f64::NAN, 44).unwrap_err();
        assert!(e.to_string().contains("load_thickness_m"));
    }
}
