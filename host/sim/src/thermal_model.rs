//! Thermal model of a pot's base, its contents, and the glass below.
//!
//! ```text
//! power ─► base ──(metal, boundary layer, bubbles)──► contents ─► room (wall and lid)
//!            └─────────────► glass ─► below
//! ```
//!
//! The glass is the hob's own node, which also has a sensor and heats the coil ([`ThermalModel::advance_on`]), or one of the pot alone
//! ([`ThermalModel::advance`]).
//!
//! The base's node is the skin that carries the eddy currents, some 0.1 mm: the face below. Its heat passes the whole
//! thickness of the base.

use super::contents::PotContents;
use super::pot::{PotBase, SimulatedPot};
use super::temperatures::{GLASS_J_PER_K, GLASS_W_PER_K};

/// Room temperature of a pot alone, in °C.
const ROOM_C: f64 = 20.0;

/// [`PotContents::Food`]: heat capacity of base and lower wall with the food that heats at once, in J/K.
const LUMP_J_PER_K: f64 = 900.0;

/// [`PotContents::Food`]: heat passed on to the room in the end, in W/K, by way of the glass too.
const LUMP_W_PER_K: f64 = 14.0;

/// Thickness of an air gap that conducts as well as a flat base on glass, in metre: 8 W/K over the area of 21 cm, by 0.03 W/mK of air
/// at 60 °C.
const CONTACT_GAP_M: f64 = 0.13e-3;

/// Thickness of a base in metre, equal to the field model's.
const BASE_M: f64 = 5e-3;

/// Ratio of a pot's height to its diameter, and thickness of its wall in metre.
const WALL: (f64, f64) = (0.6, 1e-3);

/// Height of the lower part of the wall that heats with the base, in metre: √(k t/h) of a steel wall of 1 mm in air.
const FIN_M: f64 = 0.05;

/// Heat transfer from wall, lid and a dry base to the room, in W/m²K: natural convection and radiation near 100 °C, about half each
/// (VDI Heat Atlas, F2 and K1).
const TO_ROOM_W_PER_M2K: f64 = 10.0;

/// Emissivity of a dry steel base, for its radiation beyond [`TO_ROOM_W_PER_M2K`] when it is hot.
const EMISSIVITY: f64 = 0.3;

/// Stefan-Boltzmann constant in W/m²K⁴.
const STEFAN_BOLTZMANN: f64 = 5.67e-8;

/// Specific heat of water in J/kgK, and its heat of evaporation in J/kg.
const WATER: (f64, f64) = (4186.0, 2.257e6);

/// Boiling point at sea level in °C.
const BOILING_C: f64 = 100.0;

/// Density in kg/l and specific heat in J/kgK of vegetable oil.
const OIL: (f64, f64) = (0.91, 2000.0);

/// Nucleate boiling: q = this · (wall − boiling point)³, in W/m²K³. Rohsenow's correlation with water's properties at
/// 100 °C and C_sf = 0.0132, n = 1 (ground and polished stainless steel: Incropera, table 10.1).
const NUCLEATE_W_PER_M2K3: f64 = 131.0;

/// Heat transfer in W/m²K between the base and contents hotter than it, which are stably stratified: conduction, and stirring by
/// the wall.
const STRATIFIED_W_PER_M2K: f64 = 50.0;

/// Largest step of the explicit integration, in seconds: a twentieth of the base's shortest time constant.
const STEP_S: f64 = 0.05;

/// Temperatures of a pot with contents.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThermalModel {
    contents: PotContents,
    base_c: f64,
    bulk_c: f64,
    glass_c: f64,
    /// Conductance from the base to the glass over that of a flat base.
    contact: f64,
    /// Share of the base's contact that is left at its lift.
    lift_share: f64,
    /// Temperature around the pot, in °C.
    room_c: f64,
    /// Temperature of the base's inner face, in °C.
    face_c: f64,
    /// Mass left in the pot, in kg.
    mass_kg: f64,
    body: Body,
}

/// Thermal data of a pot.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Body {
    area_m2: f64,
    base_j_per_k: f64,
    /// Conductance through the base.
    through_w_per_k: f64,
    /// Conductance from wall and lid to the room.
    outside_w_per_k: f64,
    wall_j_per_k: f64,
}

impl Body {
    fn from_pot(pot: &SimulatedPot) -> Self {
        let (kg_per_m3, j_per_kgk, w_per_mk) = pot.base.unwrap_or(PotBase::Ferritic).thermal();
        let area_m2 = 0.25 * std::f64::consts::PI * pot.diameter_m * pot.diameter_m;
        let rim_m = std::f64::consts::PI * pot.diameter_m;
        let wall_m = WALL.0 * pot.diameter_m;
        let j_per_m3k = kg_per_m3 * j_per_kgk;
        Self {
            area_m2,
            base_j_per_k: j_per_m3k * (area_m2 * BASE_M + rim_m * FIN_M * WALL.1),
            through_w_per_k: w_per_mk * area_m2 / BASE_M,
            outside_w_per_k: TO_ROOM_W_PER_M2K * (area_m2 + rim_m * wall_m),
            wall_j_per_k: j_per_m3k * rim_m * (wall_m - FIN_M).max(0.0) * WALL.1,
        }
    }
}

impl Default for ThermalModel {
    /// Creates the lump at room temperature.
    fn default() -> Self {
        Self::new(PotContents::Food, &SimulatedPot::NONE)
    }
}

impl ThermalModel {
    /// Creates a pot with contents, all at the pot's temperature.
    pub fn new(contents: PotContents, pot: &SimulatedPot) -> Self {
        let start_c = pot.temperature_c;
        Self {
            contents,
            base_c: start_c,
            bulk_c: start_c,
            glass_c: ROOM_C,
            contact: 1.0,
            lift_share: 1.0,
            room_c: ROOM_C,
            face_c: start_c,
            mass_kg: match contents {
                PotContents::Water(litre) => litre,
                PotContents::Oil(litre) => litre * OIL.0,
                PotContents::Food | PotContents::Empty => 0.0,
            },
            body: Body::from_pot(pot),
        }
    }

    /// The same pot with another conductance to the glass, as a multiple of a flat base's: a bowed base, feet or a mat have less.
    pub fn with_contact(self, contact: f64) -> Self {
        Self { contact, ..self }
    }

    /// Lifts the pot to a height in metre, infinite for a pot that is away: air instead of the glass below.
    pub fn lift(&mut self, lift_m: f64) {
        self.lift_share = lift_share(lift_m);
    }

    /// Sets the temperature around the pot, in °C.
    pub fn set_room(&mut self, room_c: f64) {
        self.room_c = room_c;
    }

    /// Temperature of the base, where the eddy currents flow, in °C.
    pub fn temperature_c(&self) -> f64 {
        self.base_c
    }

    /// Temperature of the contents in °C; `None` if the pot is empty or the contents are one lump with the base.
    pub fn bulk_c(&self) -> Option<f64> {
        (self.mass_kg > 0.0).then_some(self.bulk_c)
    }

    /// Returns `true` if all of the water boils.
    pub fn is_boiling(&self) -> bool {
        self.is_water() && self.bulk_c >= BOILING_C
    }

    /// Share of the heat that bubbles carry away from the base: 0 to 1, above a half well before all of the water boils.
    pub fn bubble_share(&self) -> f64 {
        if !self.is_water() {
            return 0.0;
        }
        let (all, bubbles) = (self.flux(self.face_c).0, bubbles(self.face_c).0);
        if all > 0.0 { bubbles / all } else { 0.0 }
    }

    fn is_water(&self) -> bool {
        matches!(self.contents, PotContents::Water(_)) && self.mass_kg > 0.0
    }

    /// Heats with `power_w` for `dt_s`, on a glass of its own; what food gives to that is part of what it gives to the room.
    pub fn advance(&mut self, power_w: f64, dt_s: f64) {
        let (_, to_air, to_coil) = GLASS_W_PER_K;
        in_steps(dt_s, |step_s| {
            if self.contents == PotContents::Food {
                let flow_w = power_w - LUMP_W_PER_K * (self.base_c - self.room_c);
                self.base_c += flow_w * step_s / LUMP_J_PER_K;
                return;
            }
            let glass_w = self.step(power_w, step_s, self.glass_c);
            let down_w = (to_air + to_coil) * (self.glass_c - self.room_c);
            self.glass_c += (glass_w - down_w) * step_s / GLASS_J_PER_K;
        });
    }

    /// Heats with `power_w` for `dt_s`, on a hob's glass of a temperature in °C; returns the heat given to that, in joule.
    pub fn advance_on(&mut self, power_w: f64, dt_s: f64, glass_c: f64) -> f64 {
        let mut given_j = 0.0;
        in_steps(dt_s, |step_s| {
            given_j += step_s * self.step(power_w, step_s, glass_c);
        });
        given_j
    }

    /// Advances by a step beside a glass of a temperature in °C; returns the heat that flows into that, in watt.
    fn step(&mut self, power_w: f64, dt_s: f64, glass_c: f64) -> f64 {
        let (from_pot, to_air, to_coil) = GLASS_W_PER_K;
        let to_glass = self.contact * self.lift_share * from_pot;
        let glass_w = to_glass * (self.base_c - glass_c);
        let over_room_k = self.base_c - self.room_c;
        if self.contents == PotContents::Food {
            let by_glass = 1.0 / (1.0 / to_glass + 1.0 / (to_air + to_coil));
            let room_w = (LUMP_W_PER_K - by_glass) * over_room_k;
            self.base_c += (power_w - glass_w - room_w) * dt_s / LUMP_J_PER_K;
            return glass_w;
        }
        let up_w = if self.mass_kg > 0.0 {
            self.settle_face();
            self.body.through_w_per_k * (self.base_c - self.face_c)
        } else {
            self.dry_w()
        };
        // The face below a lifted base.
        let air = (1.0 - self.lift_share) * TO_ROOM_W_PER_M2K * self.body.area_m2;
        let net_w = power_w - glass_w - up_w - air * over_room_k;
        self.base_c += net_w * dt_s / self.body.base_j_per_k;
        if self.mass_kg > 0.0 {
            self.warm_bulk(up_w, dt_s);
        }
        glass_w
    }

    /// Heat from a dry base to air and wall, radiation included, in watt.
    fn dry_w(&self) -> f64 {
        let fourth = |c: f64| (c + 273.15).powi(4);
        let radiated = EMISSIVITY * STEFAN_BOLTZMANN * (fourth(self.base_c) - fourth(self.room_c));
        let area_m2 = self.body.area_m2;
        area_m2 * (0.5 * TO_ROOM_W_PER_M2K * (self.base_c - self.room_c) + radiated)
    }

    fn warm_bulk(&mut self, up_w: f64, dt_s: f64) {
        let is_water = matches!(self.contents, PotContents::Water(_));
        let j_per_kgk = if is_water { WATER.0 } else { OIL.1 };
        let net_w = up_w - self.body.outside_w_per_k * (self.bulk_c - self.room_c);
        let j_per_k = self.mass_kg * j_per_kgk + self.body.wall_j_per_k;
        self.bulk_c += net_w * dt_s / j_per_k;
        if is_water && self.bulk_c > BOILING_C {
            // Excess heat leaves as steam.
            let steam_j = (self.bulk_c - BOILING_C) * j_per_k;
            self.bulk_c = BOILING_C;
            self.mass_kg = (self.mass_kg - steam_j / WATER.1).max(0.0);
        }
    }

    /// Heat flux from the inner face into the contents in W/m², and its slope in W/m²K.
    fn flux(&self, face_c: f64) -> (f64, f64) {
        let rise_k = face_c - self.bulk_c;
        if rise_k <= 0.0 {
            return (STRATIFIED_W_PER_M2K * rise_k, STRATIFIED_W_PER_M2K);
        }
        // Turbulent natural convection over a hot plate, Nu = 0.15 Ra^(1/3) (Incropera, eq. 9.31); the factor of
        // rise^(4/3) over the film's temperature, from tables of water and of sunflower oil.
        let film_k = 0.5 * (face_c + self.bulk_c) - 20.0;
        let is_water = matches!(self.contents, PotContents::Water(_));
        let (n, n_per_k) = if is_water {
            (218.0, 4.05)
        } else {
            (26.0, 0.32)
        };
        let root = rise_k.cbrt();
        let factor = n + n_per_k * film_k;
        let convection = factor * rise_k * root;
        let slope = 4.0 / 3.0 * factor * root + 0.5 * n_per_k * rise_k * root;
        if !is_water {
            return (convection, slope);
        }
        let (boiling, boiling_slope) = bubbles(face_c);
        (convection + boiling, slope + boiling_slope)
    }

    /// Solves for the inner face's temperature, at which the base supplies the heat that the contents take: Newton's method on a
    /// monotone function, from the last value.
    fn settle_face(&mut self) {
        let per_m2 = self.body.through_w_per_k / self.body.area_m2;
        for _ in 0..20 {
            let (q, slope) = self.flux(self.face_c);
            let off = per_m2 * (self.base_c - self.face_c) - q;
            let change_k = off / (per_m2 + slope);
            self.face_c += change_k;
            if change_k.abs() < 1e-6 {
                break;
            }
        }
    }
}

/// Runs steps of the explicit integration over a time in seconds, each with its length.
fn in_steps(dt_s: f64, mut step: impl FnMut(f64)) {
    let steps = (dt_s / STEP_S).ceil().max(1.0);
    for _ in 0..steps as u32 {
        step(dt_s / steps);
    }
}

/// Conductance in W/K from a pot to the glass at a lift in metre; `contact` is that of [`ThermalModel::with_contact`].
pub fn glass_w_per_k(contact: f64, lift_m: f64) -> f64 {
    contact * lift_share(lift_m) * GLASS_W_PER_K.0
}

/// Share of a base's contact that is left at a lift in metre.
fn lift_share(lift_m: f64) -> f64 {
    1.0 / (1.0 + lift_m / CONTACT_GAP_M)
}

/// Heat flux that bubbles carry from a face, in W/m², and its slope in W/m²K.
fn bubbles(face_c: f64) -> (f64, f64) {
    let over_k = (face_c - BOILING_C).max(0.0);
    let squared = NUCLEATE_W_PER_M2K3 * over_k * over_k;
    (squared * over_k, 3.0 * squared)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pot() -> SimulatedPot {
        SimulatedPot::new(PotBase::Ferritic, 0.21)
    }

    /// Seconds until `is` holds, at most an hour.
    fn until(model: &mut ThermalModel, power_w: f64, is: impl Fn(&ThermalModel) -> bool) -> f64 {
        let mut t_s = 0.0;
        while !is(model) && t_s < 3600.0 {
            model.advance(power_w, 0.1);
            t_s += 0.1;
        }
        t_s
    }

    #[test]
    fn the_lump_settles_where_heating_and_cooling_balance() {
        let mut w = ThermalModel::default();
        let tau_s = LUMP_J_PER_K / LUMP_W_PER_K;
        (0..(tau_s * 100.0) as u32).for_each(|_| w.advance(2000.0, 0.01));
        let rise = 2000.0 / LUMP_W_PER_K * (1.0 - (-1f64).exp());
        assert!((w.temperature_c() - ROOM_C - rise).abs() < 0.1);
    }

    #[test]
    fn water_boils_when_it_has_the_energy_for_it_and_stays_there() {
        let mut m = ThermalModel::new(PotContents::Water(1.5), &pot());
        let t_s = until(&mut m, 2000.0, ThermalModel::is_boiling);
        // 1.5 kg · 4186 J/kgK · 80 K are 251 s at 2 kW. Base and fin 730 J/K · 98 K, wall 180 J/K · 80 K, glass
        // 280 J/K · 75 K, room 1.2 W/K · 45 K and the glass's 1.5 W/K · 50 K: 130 kJ more.
        assert!((305.0..340.0).contains(&t_s), "{t_s} s");
        let base_c = m.temperature_c();
        // Through 5 mm of steel and the bubbles' superheat: 56 kW/m² · 5 mm / 26 W/mK + (56e3/131)^(1/3).
        assert!((base_c - 100.0 - 10.8 - 7.5).abs() < 2.0, "{base_c}");
        let before_kg = m.mass_kg;
        m.advance(2000.0, 100.0);
        assert!((m.temperature_c() - base_c).abs() < 0.5);
        // Of 2 kW the wall and lid take 1.2 W/K · 80 K, the glass some 1.5 W/K · 80 K; the rest leaves as steam.
        let steam_kg = before_kg - m.mass_kg;
        assert!(
            (0.87..0.92).contains(&(steam_kg * WATER.1 / 200e3)),
            "{steam_kg}"
        );
    }

    #[test]
    fn bubbles_come_before_the_boil_and_the_base_is_flat_from_then_on() {
        let mut m = ThermalModel::new(PotContents::Water(1.5), &pot());
        let bubbles_s = until(&mut m, 2000.0, |m| m.bubble_share() > 0.5);
        let (bulk_c, base_c) = (m.bulk_c().unwrap(), m.temperature_c());
        let boil_s = until(&mut m, 2000.0, ThermalModel::is_boiling);
        let rise_k = m.temperature_c() - base_c;
        println!("{bubbles_s} s at {bulk_c} °C, {boil_s} s later boil, base {base_c} + {rise_k} K");
        assert!((75.0..95.0).contains(&bulk_c), "{bulk_c}");
        assert!(boil_s > 20.0 && (0.0..4.0).contains(&rise_k));
    }

    #[test]
    fn water_that_is_gone_leaves_a_base_that_heats_up() {
        let mut m = ThermalModel::new(PotContents::Water(0.1), &pot());
        let t_s = until(&mut m, 1500.0, |m| m.bulk_c().is_none());
        // Heating and evaporating 0.1 kg: 33 kJ and 226 kJ, and the base's 80 kJ.
        assert!((180.0..300.0).contains(&t_s), "{t_s}");
        let before_c = m.temperature_c();
        m.advance(1500.0, 10.0);
        assert!(m.temperature_c() - before_c > 10.0);
        assert!(!m.is_boiling() && m.bubble_share() == 0.0);
    }

    #[test]
    fn oil_passes_the_boiling_point_of_water() {
        let mut m = ThermalModel::new(PotContents::Oil(1.0), &pot());
        let t_s = until(&mut m, 1000.0, |m| m.bulk_c().unwrap() > 170.0);
        // 0.91 kg · 2 kJ/kgK · 150 K and the base's share, at 1 kW.
        assert!((300.0..700.0).contains(&t_s), "{t_s}");
        assert!(m.temperature_c() > 180.0 && !m.is_boiling());
    }

    #[test]
    fn an_empty_pot_is_hot_within_minutes() {
        let mut m = ThermalModel::new(PotContents::Empty, &pot());
        let t_s = until(&mut m, 1000.0, |m| m.temperature_c() > 300.0);
        // 730 J/K · 280 K are 204 s at 1 kW; glass (280 J/K · 240 K), radiation and air take some 40 % more.
        assert!((250.0..400.0).contains(&t_s), "{t_s}");
    }

    #[test]
    fn energy_is_kept_however_long_the_steps() {
        let at = |dt_s: f64| {
            let mut m = ThermalModel::new(PotContents::Water(1.0), &pot());
            (0..(60.0 / dt_s) as u32).for_each(|_| m.advance(1200.0, dt_s));
            m.temperature_c()
        };
        assert!((at(1e-3) - at(0.5)).abs() < 0.2, "{} {}", at(1e-3), at(0.5));
    }

    /// A pot of 200 °C on cold glass: what base, glass and coil hold falls by what goes to the room.
    #[test]
    fn what_the_base_loses_the_glass_gains() {
        use crate::temperatures::{COIL_J_PER_K, Heat, LumpTemperatures};

        let mut m = ThermalModel::new(
            PotContents::Empty,
            &SimulatedPot {
                temperature_c: 200.0,
                ..pot()
            },
        );
        m.set_room(25.0);
        let mut below = LumpTemperatures::at(25.0);
        let held_j = |m: &ThermalModel, below: &LumpTemperatures| {
            m.body.base_j_per_k * m.base_c
                + GLASS_J_PER_K * below.glass_c
                + COIL_J_PER_K * below.coil_c
        };
        let (before_j, dt_s) = (held_j(&m, &below), 0.01);
        let mut room_j = 0.0;
        for _ in 0..6_000 {
            room_j += dt_s * (m.dry_w() + GLASS_W_PER_K.1 * (below.glass_c - 25.0));
            // Conductance from the coil to the air without a fan.
            room_j += dt_s * 0.4 * (below.coil_c - 25.0);
            let heat = Heat {
                glass_j: m.advance_on(0.0, dt_s, below.glass_c),
                ..Heat::default()
            };
            below.advance(dt_s, &heat, false);
        }
        let lost_j = before_j - held_j(&m, &below);
        assert!(below.glass_c > 120.0 && lost_j > 5e3, "{below:?} {lost_j}");
        assert!(
            (lost_j - room_j).abs() < 1e-6 * before_j,
            "{lost_j} {room_j}"
        );
    }
}
