//! Surface of a load as a line in the (r, z) plane, and its rings.
//!
//! The line runs from the axis along the base's bottom to its edge, up the side, and on: over a disc towards the axis, on a pot up
//! the wall. Arc length s divides it into elements with quadratic shape functions, the last with a linear one; each node is a ring.
//! The flux A per circumference is interpolated along s. Lumping the area at the nodes is Simpson's rule, so that rings
//! couple through the gap alone and the error still falls with a high power of the element's length.

use super::geometry::Geometry;
use super::profile::Section;

/// Rings at the standard resolution; finer ones have a multiple of it.
pub const RINGS: usize = 16;

/// Lengths of the bottom's elements over the radius, from the axis to the edge, where the field changes most.
const BOTTOM: [f64; 5] = [0.25, 0.25, 0.2, 0.18, 0.12];

/// Lengths of the last three elements, over a disc's radius. The rest of the way to the axis has no field.
const LAST_LENGTHS: [f64; 3] = [0.15, 0.35, 0.3];

/// The same over a foil, which the flux leaves near its edge; its edge and the side above it have two elements each.
const BOTTOM_FOIL: [f64; 3] = [0.5, 0.37, 0.13];
const BEYOND_FOIL: [f64; 2] = [0.15, 0.35];

/// Length of the lower one of the two at a foil's edge over its thickness, and of the one above the foil over the rest of the side.
const LOWER_EDGE: f64 = 0.75;
const ABOVE_FOIL: f64 = 0.2;

/// Two lengths closer than this are equal.
const SAME_M: f64 = 1e-8;

/// Element of the line: from s = `from_m` to `to_m`.
struct Element {
    from_m: f64,
    to_m: f64,
    quadratic: bool,
    section: Section,
}

/// Surface line of a load with its rings.
pub(super) struct Contour<'a> {
    geometry: &'a Geometry,
    elements: Vec<Element>,
}

impl<'a> Contour<'a> {
    /// Divides the surface into `rings` rings, a multiple of [`RINGS`].
    pub(super) fn new(geometry: &'a Geometry, rings: usize) -> Self {
        let lengths = lengths_m(geometry);
        let last = lengths.len() - 1;
        let mut elements = Vec::new();
        let mut from_m = 0.0;
        for (n, (length, section)) in lengths.into_iter().enumerate() {
            // The last element remains one: its end is not a ring.
            let parts = if n == last { 1 } else { rings / RINGS };
            for _ in 0..parts {
                let to_m = from_m + length / parts as f64;
                elements.push(Element {
                    from_m,
                    to_m,
                    quadratic: n < last,
                    section,
                });
                from_m = to_m;
            }
        }
        Self { geometry, elements }
    }

    /// Returns each ring's part of the surface. Between foil and base it is the base, as almost no flux enters that.
    pub(super) fn sections(&self) -> Vec<Section> {
        let next = self.elements.iter().skip(1).map(|element| element.section);
        let pairs = self.elements.iter().zip(next);
        let of = |(element, next): (&Element, Section)| match next {
            Section::Base => [element.section, next],
            Section::Foil | Section::FoilEdge => [element.section; 2],
        };
        pairs.flat_map(of).collect()
    }

    /// Arc length of a point on the line; `None` for a point beside it.
    pub(super) fn arc_m(&self, r_m: f64, z_m: f64) -> Option<f64> {
        let g = self.geometry;
        let (radius, up) = (g.load_radius_m, z_m - g.load_surface_m());
        if up.abs() < SAME_M {
            Some(r_m)
        } else if (r_m - radius).abs() < SAME_M {
            Some(radius + up)
        } else if g.wall_height_m == 0.0 && (up - g.load_thickness_m).abs() < SAME_M {
            Some(radius + up + radius - r_m)
        } else {
            None
        }
    }

    /// Radius at an arc length.
    fn radius_m(&self, s_m: f64) -> f64 {
        let g = self.geometry;
        let back = s_m - g.load_radius_m - g.load_thickness_m;
        if g.wall_height_m > 0.0 || back < 0.0 {
            s_m.min(g.load_radius_m)
        } else {
            g.load_radius_m - back
        }
    }

    /// Rings with their share of A at an arc length. The shares are 0 on the axis, and from the line's end on.
    pub(super) fn shares(&self, s_m: f64) -> Vec<(usize, f64)> {
        let mut first = 0;
        for element in &self.elements {
            let nodes = if element.quadratic { 2 } else { 1 };
            if s_m <= element.to_m {
                let x = (s_m - element.from_m) / (element.to_m - element.from_m);
                let shapes = if element.quadratic {
                    vec![
                        (1.0 - x) * (1.0 - 2.0 * x),
                        4.0 * x * (1.0 - x),
                        x * (2.0 * x - 1.0),
                    ]
                } else {
                    vec![1.0 - x]
                };
                // Node 0 is the axis and no ring.
                let rings = (first..).zip(shapes);
                return rings
                    .filter(|(n, _)| *n > 0)
                    .map(|(n, x)| (n - 1, x))
                    .collect();
            }
            first += nodes;
        }
        Vec::new()
    }

    /// Area of each ring in m².
    pub(super) fn areas_m2(&self) -> Vec<f64> {
        let mut areas = vec![0.0];
        for element in &self.elements {
            let (from, to) = (element.from_m, element.to_m);
            let (length, middle) = (to - from, (from + to) / 2.0);
            let [at_from, at_middle, at_to] = [from, middle, to].map(|s| self.radius_m(s));
            if let Some(last) = areas.last_mut() {
                *last += length / 6.0
                    * if element.quadratic {
                        at_from
                    } else {
                        2.0 * at_from + at_to
                    };
            }
            if element.quadratic {
                areas.extend([4.0 * length / 6.0 * at_middle, length / 6.0 * at_to]);
            }
        }
        let two_pi = 2.0 * core::f64::consts::PI;
        areas.iter().skip(1).map(|a| two_pi * a).collect()
    }
}

/// Lengths of the elements from the axis on, with their part of the surface.
fn lengths_m(geometry: &Geometry) -> Vec<(f64, Section)> {
    let radius = geometry.load_radius_m;
    let (foil_m, base_m) = (geometry.foil_thickness_m, geometry.load_thickness_m);
    let (bottom, below, side, shares): (&[f64], _, Vec<_>, &[f64]) = if foil_m > 0.0 {
        let (lower_m, above_m) = (LOWER_EDGE * foil_m, base_m - foil_m);
        let side = [
            (lower_m, Section::FoilEdge),
            (foil_m - lower_m, Section::FoilEdge),
            (ABOVE_FOIL * above_m, Section::Base),
            ((1.0 - ABOVE_FOIL) * above_m, Section::Base),
        ];
        (&BOTTOM_FOIL, Section::Foil, side.into(), &BEYOND_FOIL)
    } else {
        (
            &BOTTOM,
            Section::Base,
            [(base_m, Section::Base)].into(),
            &LAST_LENGTHS,
        )
    };
    let bottom = bottom.iter().map(|share| (share * radius, below));
    // A wall takes the place of the disc's top.
    let beyond = if geometry.wall_height_m > 0.0 {
        geometry.wall_height_m / shares.iter().sum::<f64>()
    } else {
        radius
    };
    let beyond = shares.iter().map(|share| (share * beyond, Section::Base));
    bottom.chain(side).chain(beyond).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn areas_of_bottom_and_side_are_the_discs() {
        let mut g = Geometry::paper();
        g.wall_height_m = 0.1;
        for rings in [16, 48] {
            let contour = Contour::new(&g, rings);
            let areas = contour.areas_m2();
            assert_eq!(areas.len(), rings);
            // The last element's shape function is 1 - x: half of its area counts.
            let side = g.load_thickness_m + g.wall_height_m * (1.0 - 0.5 * 0.3 / 0.8);
            let expected = core::f64::consts::PI * g.load_radius_m * (g.load_radius_m + 2.0 * side);
            let sum: f64 = areas.iter().sum();
            assert!((sum / expected - 1.0).abs() < 1e-12, "{sum} {expected}");
        }
    }

    #[test]
    fn a_flux_that_is_quadratic_in_s_is_interpolated_exactly() {
        let g = Geometry::paper();
        let mut foil = g.clone();
        foil.foil_thickness_m = 0.4e-3;
        assert_eq!(Contour::new(&foil, 16).sections().len(), 16);
        let contour = Contour::new(&g, 16);
        let flux = |s: f64| s * (0.3 - s);
        // Rings' arc lengths: where a ring's share is 1.
        let mut at = Vec::new();
        for e in contour.elements.iter().filter(|e| e.quadratic) {
            at.extend([(e.from_m + e.to_m) / 2.0, e.to_m]);
        }
        for s in [0.01, 0.07, 0.1049, 0.107, 0.12, 0.15] {
            let sum: f64 = contour
                .shares(s)
                .iter()
                .map(|(ring, x)| x * flux(at[*ring]))
                .sum();
            assert!((sum - flux(s)).abs() < 1e-12, "s = {s}: {sum} {}", flux(s));
        }
        assert!(contour.shares(0.3).is_empty());
    }

    #[test]
    fn points_on_all_faces_have_their_arc_length() {
        let mut g = Geometry::paper();
        let (bottom, top, radius) = (g.load_surface_m(), g.load_top_m(), g.load_radius_m);
        let of = |g: &Geometry, r, z| Contour::new(g, 16).arc_m(r, z);
        assert_eq!(of(&g, 0.04, bottom), Some(0.04));
        assert!((of(&g, radius, top).unwrap() - radius - g.load_thickness_m).abs() < 1e-12);
        assert!((of(&g, 0.08, top).unwrap() - 0.135).abs() < 1e-12);
        assert_eq!(of(&g, 0.08, bottom - 1e-3), None);
        g.wall_height_m = 0.06;
        assert_eq!(of(&g, 0.08, top), None);
        assert!((of(&g, radius, top + 0.02).unwrap() - 0.13).abs() < 1e-12);
    }
}
