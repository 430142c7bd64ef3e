//! Heat of the pot on the coil, and of pots that were taken away and may come back.

use crate::contents::PotContents;
use crate::pot::SimulatedPot;
use crate::temperatures::AMBIENT_C;
use crate::thermal_model::{ThermalModel, glass_w_per_k};

/// Pot that was taken from the coil.
#[derive(Clone, Debug)]
struct RemovedPot {
    pot: SimulatedPot,
    state: ThermalModel,
    since_s: f64,
}

/// Pots with their heat, beside the hob's glass and room.
#[derive(Clone, Debug)]
pub struct WarmPots {
    /// Contents of every pot; `None` if they keep their temperature.
    contents: Option<PotContents>,
    /// Conductance from a pot to the glass over that of a flat base.
    contact: f64,
    /// State of the pot on the coil; `None` without one, or if pots keep their temperature.
    on_coil: Option<ThermalModel>,
    away: Vec<RemovedPot>,
    glass_c: f64,
    room_c: f64,
    /// Heat that the pot has given to the glass since that was taken, in joule.
    given_j: f64,
}

impl Default for WarmPots {
    /// Creates pots that keep their temperature.
    fn default() -> Self {
        Self {
            contents: None,
            contact: 1.0,
            on_coil: None,
            away: Vec::new(),
            glass_c: AMBIENT_C,
            room_c: AMBIENT_C,
            given_j: 0.0,
        }
    }
}

impl WarmPots {
    /// Lets `pot`, the one on the coil, warm up with these contents from its own temperature.
    pub fn enable(&mut self, contents: PotContents, pot: &SimulatedPot) {
        self.contents = Some(contents);
        self.on_coil = self.fresh(pot);
    }

    /// Sets the conductance from a pot to the glass, over that of a flat base.
    pub fn set_contact(&mut self, contact: f64) {
        self.contact = contact;
        self.on_coil = self.on_coil.map(|pot| pot.with_contact(contact));
    }

    /// State of the pot on the coil; `None` without one, or if pots keep their temperature.
    pub fn on_coil(&self) -> Option<&ThermalModel> {
        self.on_coil.as_ref()
    }

    /// Sets the temperatures of glass and room in °C.
    pub fn set_surroundings(&mut self, glass_c: f64, room_c: f64) {
        (self.glass_c, self.room_c) = (glass_c, room_c);
        if let Some(pot) = &mut self.on_coil {
            pot.set_room(room_c);
        }
    }

    /// Heats the pot on the coil with an energy in joule over a time in seconds.
    pub fn heat(&mut self, heat_j: f64, dt_s: f64) {
        if let Some(pot) = &mut self.on_coil {
            self.given_j += pot.advance_on(heat_j / dt_s, dt_s, self.glass_c);
        }
    }

    /// Takes the heat in joule that `pot`, the one on the coil, has given to the glass in the last `dt_s`.
    pub fn take_given_j(&mut self, pot: &SimulatedPot, dt_s: f64) -> f64 {
        if self.contents.is_none() && pot.base.is_some() {
            let w_per_k = glass_w_per_k(self.contact, pot.lift_m);
            self.given_j += w_per_k * (pot.temperature_c - self.glass_c) * dt_s;
        }
        std::mem::take(&mut self.given_j)
    }

    /// Exchanges the pot on the coil, `before`, for another at `now_s`. One that was there before comes back as it is after that time in
    /// the air; a new one has the same contents, at its own temperature. The same pot elsewhere keeps its state.
    pub fn exchange(&mut self, before: &SimulatedPot, pot: &SimulatedPot, now_s: f64) {
        if pot.base != before.base || pot.diameter_m != before.diameter_m {
            if let Some(mut state) = self.on_coil.take() {
                state.lift(f64::INFINITY);
                self.away.push(RemovedPot {
                    pot: *before,
                    state,
                    since_s: now_s,
                });
            }
            self.on_coil = self.returned(pot, now_s).or_else(|| self.fresh(pot));
        }
        if let Some(state) = &mut self.on_coil {
            state.lift(pot.lift_m);
        }
    }

    /// State of a pot that was away until `now_s`, if there is one of that metal, size and first temperature.
    fn returned(&mut self, pot: &SimulatedPot, now_s: f64) -> Option<ThermalModel> {
        let is_it = |away: &RemovedPot| {
            let was = &away.pot;
            (was.base, was.diameter_m, was.temperature_c)
                == (pot.base, pot.diameter_m, pot.temperature_c)
        };
        let at = self.away.iter().rposition(is_it)?;
        let RemovedPot {
            mut state, since_s, ..
        } = self.away.swap_remove(at);
        state.set_room(self.room_c);
        state.advance_on(0.0, now_s - since_s, self.glass_c);
        Some(state)
    }

    /// State of a new pot; `None` without one, or if pots keep their temperature.
    fn fresh(&self, pot: &SimulatedPot) -> Option<ThermalModel> {
        let contents = self.contents.filter(|_| pot.base.is_some())?;
        let mut state = ThermalModel::new(contents, pot).with_contact(self.contact);
        state.lift(pot.lift_m);
        state.set_room(self.room_c);
        Some(state)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pot::PotBase;

    fn warm(contents: PotContents, pot: &SimulatedPot) -> WarmPots {
        let mut pots = WarmPots::default();
        pots.enable(contents, pot);
        pots
    }

    /// A body of heat capacity C that loses G to the room keeps exp(−G t/C) of its excess.
    #[test]
    fn a_pot_that_comes_back_is_the_one_that_was_taken_cooled_in_the_air() {
        let pot = SimulatedPot::new(PotBase::Ferritic, 0.21);
        let mut pots = warm(PotContents::Food, &pot);
        pots.set_surroundings(20.0, 20.0);
        pots.heat(900.0 * 150.0, 0.01);
        let hot_c = pots.on_coil().unwrap().temperature_c();
        assert!((hot_c - 170.0).abs() < 0.5, "{hot_c}");
        pots.exchange(&pot, &SimulatedPot::NONE, 10.0);
        assert!(pots.on_coil().is_none());
        let other = SimulatedPot::new(PotBase::Ferritic, 0.18);
        pots.exchange(&SimulatedPot::NONE, &other, 11.0);
        assert_eq!(pots.on_coil().unwrap().temperature_c(), 20.0);
        pots.exchange(&other, &SimulatedPot::NONE, 12.0);
        pots.exchange(&SimulatedPot::NONE, &pot, 42.0);
        let expected_c = 20.0 + (hot_c - 20.0) * (-32.0 * 14.0 / 900.0f64).exp();
        let back_c = pots.on_coil().unwrap().temperature_c();
        assert!((back_c - expected_c).abs() < 0.5, "{back_c} {expected_c}");
    }

    #[test]
    fn water_that_has_boiled_away_does_not_come_back() {
        let pot = SimulatedPot::new(PotBase::Ferritic, 0.21);
        let mut pots = warm(PotContents::Water(0.1), &pot);
        (0..8_000).for_each(|_| pots.heat(150.0, 0.1));
        assert_eq!(pots.on_coil().unwrap().bulk_c(), None);
        pots.exchange(&pot, &SimulatedPot::NONE, 1.0);
        pots.exchange(&SimulatedPot::NONE, &pot, 2.0);
        assert_eq!(pots.on_coil().unwrap().bulk_c(), None);
    }

    /// 8 W/K on the glass; 100 mm of air conduct 0.03 W/mK · 0.0346 m² / 0.1 m = 0.01 W/K.
    #[test]
    fn a_lifted_pot_leaves_the_glass_cold() {
        let given_j = |lift_m, warms| {
            let pot = SimulatedPot {
                temperature_c: 200.0,
                lift_m,
                ..SimulatedPot::new(PotBase::Ferritic, 0.21)
            };
            let mut pots = WarmPots::default();
            if warms {
                pots.enable(PotContents::Oil(5.0), &pot);
                pots.heat(0.0, 1.0);
            }
            pots.take_given_j(&pot, 1.0)
        };
        for warms in [false, true] {
            let (on_glass_j, lifted_j) = (given_j(0.0, warms), given_j(0.1, warms));
            assert!((1_300.0..=1_400.0).contains(&on_glass_j), "{on_glass_j}");
            assert!((1.5..2.0).contains(&lifted_j), "{lifted_j}");
        }
    }
}
