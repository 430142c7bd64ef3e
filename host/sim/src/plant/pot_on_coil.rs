//! Pot on the coil: its load at each frequency and temperature.

use ihd_shared::sampling::ADC_LOCK_Q;

use super::load_observer::LoadPoint;
use crate::contents::PotContents;
use crate::inverter::load::{LoadState, Warmth};
use crate::inverter::{Inverter, InverterError, STEPS_PER_PERIOD};
use crate::load_library::LoadLibrary;
use crate::pot::SimulatedPot;
use crate::recording::settings::LoadKind;
use crate::thermal_model::ThermalModel;

/// Step in kelvin in which R and L follow the temperature: 0.001 % of either.
const TEMPERATURE_STEP_K: f64 = 0.02;

/// Pot on the coil, with its warming and the models of all pots so far.
#[derive(Clone, Debug)]
pub struct PotOnCoil {
    pub pot: SimulatedPot,
    pub load_library: LoadLibrary,
    /// State of pot and contents; `None` if they do not warm up.
    pub warming: Option<ThermalModel>,
    /// Present temperature of the load, in °C.
    load_c: f64,
}

impl PotOnCoil {
    /// Puts a pot on the coil, which does not warm up.
    pub fn new(pot: SimulatedPot, load: LoadKind) -> Self {
        Self {
            pot,
            load_library: LoadLibrary::new(load),
            warming: None,
            load_c: pot.temperature_c,
        }
    }

    /// Enables warming from the pot's temperature; `contact` is that of [`ThermalModel::with_contact`].
    pub fn enable_warming(&mut self, contents: PotContents, contact: f64) {
        self.warming = Some(ThermalModel::new(contents, &self.pot).with_contact(contact));
    }

    /// Exchanges the pot; the inverter's current continues.
    ///
    /// # Errors
    /// If there is no model of that pot; the old one stays.
    pub fn exchange(
        &mut self,
        pot: SimulatedPot,
        inverter: &mut Inverter,
    ) -> Result<(), InverterError> {
        inverter.load = self.load_library.take(
            &pot,
            inverter.f_sw_hz(),
            STEPS_PER_PERIOD,
            Some(&inverter.load),
        )?;
        if pot.base != self.pot.base || pot.diameter_m != self.pot.diameter_m {
            // A new pot has the same contents, at its own temperature.
            self.warming = self.warming.map(|old| old.exchanged(&pot));
        }
        self.pot = pot;
        self.load_c = pot.temperature_c;
        self.apply_temperature(inverter);
        Ok(())
    }

    /// Returns the load at another switching frequency, to replace the inverter's.
    pub fn load_at(&mut self, f_sw_hz: f64, before: &LoadState) -> LoadState {
        let dt_s = 1.0 / (f_sw_hz * STEPS_PER_PERIOD as f64);
        let mut load = before.clone();
        if !load.set_dt(dt_s).unwrap_or(false)
            && let Ok(law) =
                self.load_library
                    .take(&self.pot, f_sw_hz, STEPS_PER_PERIOD, Some(&load))
        {
            load = law;
        }
        load
    }

    /// Adds the heat of one ADC block, at whose end the load is `now`.
    pub fn warm_up(&mut self, now: &LoadPoint, inverter: &mut Inverter) {
        let Some(warming) = &mut self.warming else {
            return;
        };
        let block_s = f64::from(ADC_LOCK_Q) / inverter.f_sw_hz();
        warming.advance(0.5 * now.r_ohm * now.i_a * now.i_a, block_s);
        self.apply_temperature(inverter);
    }

    /// Adapts the load to the pot's temperature.
    fn apply_temperature(&mut self, inverter: &mut Inverter) {
        let (Some(warming), Some(_)) = (&self.warming, self.pot.base) else {
            return;
        };
        let hot_c = warming.temperature_c();
        if (hot_c - self.load_c).abs() >= TEMPERATURE_STEP_K {
            self.load_c = hot_c;
            self.heat_load(inverter);
        }
    }

    /// Sets the load's temperature.
    pub fn heat_load(&self, inverter: &mut Inverter) {
        let (Some(_), Some(base)) = (&self.warming, self.pot.base) else {
            return;
        };
        // The law is that of the pot at the temperature at which it was put on.
        let heated_c = (self.pot.temperature_c, self.load_c);
        let warmth = Warmth::from_temperatures(base, heated_c, self.load_library.winding_r_ohm());
        let law_hz = warmth.law_hz(inverter.f_sw_hz());
        if let Some(law) = self.load_library.law(&self.pot, law_hz) {
            inverter.load.set_hot_law(law, warmth);
            return;
        }
        // An error only occurs far beyond the temperatures of a metal.
        let set = inverter.load.set_temperature(&self.pot, self.load_c);
        debug_assert!(set.is_ok(), "{set:?}");
    }
}
