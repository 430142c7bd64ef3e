//! Way into the load under a ring: depth nodes in one metal, or in a foil and the base behind it.

use super::depth::DepthGrid;
use super::error::FieldError;
use super::geometry::Geometry;
use super::material::{BhCurve, Material};

/// Part of a foil's nodes that lies in the base behind it: one in so many.
const BEHIND: usize = 4;

/// Largest depth behind a foil's edge, in metre.
const MAX_M: f64 = 0.1;

/// Metals of a load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Metals {
    /// Metal of base and wall.
    pub base: Material,
    /// Metal of the foil below the base; of no meaning without one.
    pub foil: Material,
}

/// Depth nodes with the foil's share of each.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// Nodes.
    pub depth: DepthGrid,
    /// Share of the distance from each node to the next that lies in the foil; nodes with a share are the foil's.
    in_foil: Vec<f64>,
}

impl Profile {
    fn solid(
        metal: &Material,
        thickness_m: f64,
        nodes: usize,
        in_foil: f64,
    ) -> Result<Self, FieldError> {
        Ok(Self {
            depth: DepthGrid::new(metal, thickness_m, nodes)?,
            in_foil: vec![in_foil; nodes],
        })
    }

    /// A foil on a base, each so thick in metre. The foil ends where a node's control volume does.
    fn foil_on_base(
        metals: &Metals,
        foil_m: f64,
        base_m: f64,
        nodes: usize,
    ) -> Result<Self, FieldError> {
        let behind = nodes / BEHIND;
        let mut profile = Self::solid(&metals.foil, foil_m, nodes - behind, 1.0)?;
        let volumes = DepthGrid::new(&metals.base, base_m, behind)?.step_m;
        let DepthGrid { cell_m, step_m } = &mut profile.depth;
        // The foil's last step ends at its far face, the base's first half volume begins there.
        let (last, to_face_m) = (cell_m.len() - 1, step_m[cell_m.len() - 1]);
        cell_m[last] += 0.5 * to_face_m;
        step_m[last] += 0.5 * volumes[0];
        profile.in_foil[last] = to_face_m / step_m[last];
        let middles = volumes.windows(2).map(|pair| 0.5 * (pair[0] + pair[1]));
        step_m.extend(middles.chain([0.5 * volumes[behind - 1]]));
        cell_m.extend(volumes);
        profile.in_foil.resize(nodes, 0.0);
        Ok(profile)
    }

    /// Conductivity times distance from each node to the next deeper one (last: to the boundary where H = 0), in siemens.
    pub fn sheet_s(&self, metals: &Metals) -> Vec<f64> {
        let [base, foil] = [metals.base, metals.foil].map(|metal| metal.sigma_s_per_m());
        let steps = self.depth.step_m.iter().zip(&self.in_foil);
        steps
            .map(|(step, share)| step * (share * foil + (1.0 - share) * base))
            .collect()
    }

    /// Magnetisation curve of each node.
    pub fn curves(&self, metals: &Metals) -> Vec<BhCurve> {
        let [base, foil] = [metals.base, metals.foil].map(|metal| metal.curve());
        let of = |share: &f64| if *share > 0.0 { foil } else { base };
        self.in_foil.iter().map(of).collect()
    }
}

/// Part of a load's surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Section {
    /// Lower face of the foil.
    Foil,
    /// Edge of the foil.
    FoilEdge,
    /// The base; all of a load without a foil.
    Base,
}

impl Section {
    /// Returns the profile under a ring of this part, of so many nodes.
    ///
    /// # Errors
    /// [`FieldError::OutOfRange`] of a thickness, or of too few nodes.
    pub(crate) fn profile(
        self,
        geometry: &Geometry,
        metals: &Metals,
        nodes: usize,
    ) -> Result<Profile, FieldError> {
        let (foil_m, base_m) = (geometry.foil_thickness_m, geometry.load_thickness_m);
        match self {
            Self::Foil => Profile::foil_on_base(metals, foil_m, base_m - foil_m, nodes),
            Self::FoilEdge => {
                Profile::solid(&metals.foil, geometry.load_radius_m.min(MAX_M), nodes, 1.0)
            }
            Self::Base => Profile::solid(&metals.base, base_m, nodes, 0.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_foil_and_its_base_fill_the_bottom() {
        let metals = Metals {
            base: Material::ALUMINIUM,
            foil: Material::PAPER,
        };
        let p = Profile::foil_on_base(&metals, 0.5e-3, 4.5e-3, 44).unwrap();
        let (sheet_s, curves) = (p.sheet_s(&metals), p.curves(&metals));
        assert_eq!([p.depth.nodes(), sheet_s.len(), curves.len()], [44; 3]);
        let thickness_m = |metal: Material| {
            let cells = p.depth.cell_m.iter().zip(&curves);
            let own = cells.filter(|(_, curve)| **curve == metal.curve());
            own.map(|(cell, _)| cell).sum::<f64>()
        };
        assert!((thickness_m(metals.foil) - 0.5e-3).abs() < 1e-12);
        assert!((thickness_m(metals.base) - 4.5e-3).abs() < 1e-12);
        let all_s: f64 = sheet_s.iter().sum();
        assert!((all_s / (8e6 * 0.5e-3 + 3.5e7 * 4.5e-3) - 1.0).abs() < 1e-12);
    }
}
