//! Pot on the coil: its load at each frequency and temperature.

use ihd_shared::hob::WINDING_R_OHM;
use ihd_shared::sampling::ADC_LOCK_Q;

use super::load_observer::LoadPoint;
use super::warm_pots::WarmPots;
use crate::inverter::load::{LoadState, Warmth};
use crate::inverter::{Inverter, InverterError, STEPS_PER_PERIOD};
use crate::load_library::LoadLibrary;
use crate::pot::SimulatedPot;
use crate::recording::settings::LoadKind;
use crate::temperatures::{AMBIENT_C, winding_r_ohm};

/// Step in kelvin in which R and L follow the temperature: 0.001 % of either.
const TEMPERATURE_STEP_K: f64 = 0.02;

/// Step in kelvin in which the winding's R follows its temperature: 0.2 % of that.
const WINDING_STEP_K: f64 = 0.5;

/// Pot on the coil, with its warming and the models of all pots so far.
#[derive(Clone, Debug)]
pub struct PotOnCoil {
    pub pot: SimulatedPot,
    pub load_library: LoadLibrary,
    /// Heat of this pot and of those that were there before.
    pub heat: WarmPots,
    /// Energy into the load until the last block, in joule.
    energy_j: f64,
    /// Present temperature of the load, in °C.
    load_c: f64,
    /// Temperature of the winding that its resistance is of, in °C.
    winding_c: f64,
}

impl PotOnCoil {
    /// Puts a pot on the coil, which does not warm up.
    pub fn new(pot: SimulatedPot, load: LoadKind) -> Self {
        Self {
            pot,
            load_library: LoadLibrary::new(load),
            heat: WarmPots::default(),
            energy_j: 0.0,
            load_c: pot.temperature_c,
            winding_c: AMBIENT_C,
        }
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
        self.heat.exchange(&self.pot, &pot, inverter.now_s());
        self.pot = pot;
        self.load_c = pot.temperature_c;
        self.apply_temperature(inverter);
        self.heat_winding(inverter);
        Ok(())
    }

    /// Sets the temperature of the winding in °C.
    pub fn set_winding(&mut self, coil_c: f64, inverter: &mut Inverter) {
        if (coil_c - self.winding_c).abs() >= WINDING_STEP_K {
            self.winding_c = coil_c;
            self.heat_winding(inverter);
        }
    }

    fn heat_winding(&self, inverter: &mut Inverter) {
        let rise_ohm = winding_r_ohm(self.winding_c) - WINDING_R_OHM;
        inverter.load.set_winding_rise(rise_ohm);
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

    /// Adds the heat of one ADC block, at whose end the load is `now`: what the load took, less what is lost in the winding.
    pub fn warm_up(&mut self, now: &LoadPoint, inverter: &mut Inverter) {
        let energy_j = inverter.load_energy_j();
        let taken_j = energy_j - std::mem::replace(&mut self.energy_j, energy_j);
        let block_s = f64::from(ADC_LOCK_Q) / inverter.f_sw_hz();
        let winding_j = 0.5 * winding_r_ohm(self.winding_c) * now.i_a * now.i_a * block_s;
        self.heat.heat(taken_j - winding_j, block_s);
        self.apply_temperature(inverter);
    }

    /// Adapts the load to the pot's temperature.
    fn apply_temperature(&mut self, inverter: &mut Inverter) {
        let Some(on_coil) = self.heat.on_coil() else {
            return;
        };
        let hot_c = on_coil.temperature_c();
        if (hot_c - self.load_c).abs() >= TEMPERATURE_STEP_K {
            self.load_c = hot_c;
            self.heat_load(inverter);
        }
    }

    /// Sets the temperatures of the load and of its winding.
    pub fn heat_load(&self, inverter: &mut Inverter) {
        self.heat_pot(inverter);
        self.heat_winding(inverter);
    }

    fn heat_pot(&self, inverter: &mut Inverter) {
        let (Some(_), Some(base)) = (self.heat.on_coil(), self.pot.base) else {
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
