//! Dimensions of coil, ferrite, shield and load.

use ihd_shared::board;

use super::error::{FieldError, in_range};

/// Share of the 23 turns that acts on the field: H and flux linkage both scale with it, L and R
/// with its square.
///
/// Pure geometry (1.0) gives 45 kHz inductances of 45 µH (no current) to 28 µH (45 A), a resonance interval of 23-29 kHz with
/// 1080 nF; the paper reads 27-36 kHz from its simulation and 29-34 kHz from its prototype. With 0.84 the interval lies within
/// the first and contains the second (test `resonance_interval_is_the_papers`). The paper leaves the ferrite's permeability,
/// thickness and radius open, and does not state how its permeability law was evaluated at an amplitude;
/// `docs/simulator.md` shows what each could account for.
pub const TURNS_CALIBRATION: f64 = 0.84;

/// Axisymmetric arrangement, bottom to top: aluminium shield, gap, ferrite plate, gap, coil, gap, load. The load is a disc, or a
/// base with a wall. All lengths in metre.
#[derive(Clone, Debug, PartialEq)]
pub struct Geometry {
    /// Turns of the coil, spread evenly over its cross-section.
    pub turns: f64,
    /// Inner radius of the coil.
    pub coil_inner_m: f64,
    /// Outer radius of the coil.
    pub coil_outer_m: f64,
    /// Thickness of the coil.
    pub coil_thickness_m: f64,
    /// Distance from coil to load.
    pub load_gap_m: f64,
    /// Radius of the load's base; larger than the modelled space means an infinite plate.
    pub load_radius_m: f64,
    /// Radius of a hole around the axis of a load that does not saturate; 0 for none.
    pub hole_radius_m: f64,
    /// Thickness of the load's base.
    pub load_thickness_m: f64,
    /// Thickness of a ferromagnetic foil that the base's lower side consists of; 0 for none.
    pub foil_thickness_m: f64,
    /// Height of the load's wall above its base; 0 is a disc.
    pub wall_height_m: f64,
    /// Thickness of the wall.
    pub wall_thickness_m: f64,
    /// Distance from ferrite to coil.
    pub ferrite_gap_m: f64,
    /// Thickness of the ferrite plate.
    pub ferrite_thickness_m: f64,
    /// Radius of the ferrite plate.
    pub ferrite_radius_m: f64,
    /// Relative permeability of the ferrite, linear.
    pub ferrite_mu_r: f64,
    /// Distance from shield to ferrite.
    pub shield_gap_m: f64,
    /// Thickness of the aluminium shield; 0 is a perfect conductor.
    pub shield_thickness_m: f64,
    /// Share of the turns that acts on the field: the one calibration constant, see
    /// [`TURNS_CALIBRATION`]. 1 is pure geometry.
    pub turns_calibration: f64,
}

impl Geometry {
    /// Arrangement of the paper's section IV. The paper does not give the ferrite's thickness, radius and permeability, nor the
    /// load's radius: 5 mm, the coil's radius, 2000 and 105 mm are this project's.
    pub fn paper() -> Self {
        Self {
            turns: 23.0,
            coil_inner_m: 12.5e-3,
            coil_outer_m: 105e-3,
            coil_thickness_m: 3e-3,
            load_gap_m: 5.5e-3,
            load_radius_m: 105e-3,
            hole_radius_m: 0.0,
            load_thickness_m: 5e-3,
            foil_thickness_m: 0.0,
            wall_height_m: 0.0,
            wall_thickness_m: 2e-3,
            ferrite_gap_m: 1e-3,
            ferrite_thickness_m: 5e-3,
            ferrite_radius_m: 105e-3,
            ferrite_mu_r: 2000.0,
            shield_gap_m: 0.5e-3,
            shield_thickness_m: 1e-3,
            turns_calibration: TURNS_CALIBRATION,
        }
    }

    /// Arrangement of the board's coil under a pot of 21 cm.
    pub fn of_board() -> Self {
        let metre = |um: u32| f64::from(um) / 1e6;
        Self {
            turns: f64::from(board::COIL_TURNS),
            coil_inner_m: metre(board::COIL_INNER_UM),
            coil_outer_m: metre(board::COIL_OUTER_UM),
            coil_thickness_m: metre(board::COIL_THICKNESS_UM),
            load_gap_m: metre(board::POT_GAP_UM),
            ferrite_gap_m: metre(board::FERRITE_GAP_UM),
            ferrite_thickness_m: metre(board::FERRITE_THICKNESS_UM),
            ferrite_radius_m: metre(board::FERRITE_RADIUS_UM),
            ferrite_mu_r: f64::from(board::FERRITE_MU_R),
            shield_gap_m: metre(board::SHIELD_GAP_UM),
            shield_thickness_m: metre(board::SHIELD_THICKNESS_UM),
            ..Self::paper()
        }
    }

    /// Checks every dimension and their order.
    pub fn check(&self) -> Result<(), FieldError> {
        self.check_ranges()?;
        self.check_order()
    }

    fn check_ranges(&self) -> Result<(), FieldError> {
        let part = (1e-4, 1.0, "0.1 mm to 1 m");
        let metre = (0.0, 1.0, "0 to 1 m");
        // Below a tenth of a millimetre the depth has no grid.
        let foil = match self.foil_thickness_m == 0.0 {
            true => (0.0, 0.0, "0"),
            false => (1e-4, 0.1, "0, or 0.1 mm to 100 mm"),
        };
        let ranges = [
            ("turns", self.turns, (1.0, 1e4, "1 to 10000")),
            ("coil_outer_m", self.coil_outer_m, part),
            ("coil_thickness_m", self.coil_thickness_m, part),
            ("load_gap_m", self.load_gap_m, part),
            ("load_radius_m", self.load_radius_m, part),
            ("load_thickness_m", self.load_thickness_m, part),
            ("wall_thickness_m", self.wall_thickness_m, part),
            ("ferrite_gap_m", self.ferrite_gap_m, part),
            ("ferrite_thickness_m", self.ferrite_thickness_m, part),
            ("ferrite_radius_m", self.ferrite_radius_m, part),
            ("shield_gap_m", self.shield_gap_m, part),
            ("coil_inner_m", self.coil_inner_m, metre),
            ("foil_thickness_m", self.foil_thickness_m, foil),
            (
                "wall_height_m",
                self.wall_height_m,
                (0.0, 0.3, "0 to 0.3 m"),
            ),
            (
                "shield_thickness_m",
                self.shield_thickness_m,
                (0.0, 0.05, "0 to 50 mm"),
            ),
            ("ferrite_mu_r", self.ferrite_mu_r, (1.0, 1e5, "1 to 100000")),
            (
                "turns_calibration",
                self.turns_calibration,
                (0.1, 2.0, "0.1 to 2"),
            ),
            ("hole_radius_m", self.hole_radius_m, metre),
        ];
        ranges
            .into_iter()
            .try_for_each(|(field, value, (min, max, allowed))| {
                in_range(field, value, min, max, allowed)
            })
    }

    fn check_order(&self) -> Result<(), FieldError> {
        let radius = ("load_radius_m", self.load_radius_m);
        let thickness = ("load_thickness_m", self.load_thickness_m);
        let has_wall = self.wall_height_m > 0.0;
        let wall = (("wall_thickness_m", self.wall_thickness_m), radius);
        let ordered = [
            (
                ("coil_inner_m", self.coil_inner_m),
                ("coil_outer_m", self.coil_outer_m),
            ),
            (("hole_radius_m", self.hole_radius_m), radius),
            (("foil_thickness_m", self.foil_thickness_m), thickness),
        ];
        for ((smaller, smaller_m), (larger, larger_m)) in
            ordered.into_iter().chain(has_wall.then_some(wall))
        {
            if smaller_m >= larger_m {
                return Err(FieldError::Order {
                    smaller,
                    smaller_m,
                    larger,
                    larger_m,
                });
            }
        }
        Ok(())
    }

    /// Height of the ferrite's lower face above the shield.
    pub fn ferrite_bottom_m(&self) -> f64 {
        self.shield_gap_m
    }

    /// Height of the ferrite's upper face above the shield.
    pub fn ferrite_top_m(&self) -> f64 {
        self.shield_gap_m + self.ferrite_thickness_m
    }

    /// Height of the coil's lower face above the shield.
    pub fn coil_bottom_m(&self) -> f64 {
        self.ferrite_top_m() + self.ferrite_gap_m
    }

    /// Height of the coil's upper face above the shield.
    pub fn coil_top_m(&self) -> f64 {
        self.coil_bottom_m() + self.coil_thickness_m
    }

    /// Height of the load's surface above the shield.
    pub fn load_surface_m(&self) -> f64 {
        self.coil_top_m() + self.load_gap_m
    }

    /// Height of a foil's upper face above the shield.
    pub fn foil_top_m(&self) -> f64 {
        self.load_surface_m() + self.foil_thickness_m
    }

    /// Height of the base's upper face above the shield.
    pub fn load_top_m(&self) -> f64 {
        self.load_surface_m() + self.load_thickness_m
    }

    /// Inner radius of the wall.
    pub fn wall_inner_m(&self) -> f64 {
        self.load_radius_m - self.wall_thickness_m
    }

    /// Returns `true` for a point of the load's base or wall.
    pub(crate) fn in_load(&self, r_m: f64, z_m: f64) -> bool {
        let (surface, top) = (self.load_surface_m(), self.load_top_m());
        let base = (surface..top).contains(&z_m);
        let wall = (top..top + self.wall_height_m).contains(&z_m) && r_m > self.wall_inner_m();
        (self.hole_radius_m..self.load_radius_m).contains(&r_m) && (base || wall)
    }

    /// Turns per square metre of the coil's cross-section.
    pub fn turn_density_per_m2(&self) -> f64 {
        self.turns / (self.coil_thickness_m * (self.coil_outer_m - self.coil_inner_m))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reference_board_has_the_papers_coil() {
        if board::NAME == "reference" {
            assert_eq!(Geometry::of_board(), Geometry::paper());
        }
        Geometry::of_board().check().unwrap();
    }

    #[test]
    fn impossible_dimensions_are_refused_by_name() {
        let mut g = Geometry::paper();
        g.coil_inner_m = 0.2;
        assert!(g.check().unwrap_err().to_string().contains("coil_inner_m"));
        let mut g = Geometry::paper();
        g.load_gap_m = f64::NAN;
        assert!(g.check().unwrap_err().to_string().contains("load_gap_m"));
        let mut g = Geometry::paper();
        g.foil_thickness_m = 50e-6;
        let why = g.check().unwrap_err().to_string();
        assert!(why.starts_with("foil_thickness_m"), "{why}");
    }
}
