//! The power stage with its load and ADC, one ADC block at a time.

use ihd_firmware::realtime::Drive;
use ihd_shared::hob::EDGE_NS;
use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q, Pair};

use super::adc::Adc;
use super::behavioural::PotKind;
use super::inverter::bridge::HalfBridge;
use super::inverter::bus::Bus;
use super::inverter::harmonic_analyser::HarmonicAnalyser;
use super::inverter::{Inverter, InverterError};
use super::load_library::{LoadLibrary, described};
use super::mains::Mains;
use super::recording::settings::LoadKind;
use super::thermal_model::ThermalModel;

/// Integration steps between two ADC samples: 45 ns at 45 kHz. A multiple of q, so that a switching
/// period is a whole number of steps too.
pub const STEPS_PER_SAMPLE: usize = 24;

/// Integration steps of one switching period.
pub const STEPS_PER_PERIOD: usize = STEPS_PER_SAMPLE * ADC_LOCK_P / ADC_LOCK_Q as usize;

const _: () = assert!(STEPS_PER_SAMPLE.is_multiple_of(ADC_LOCK_Q as usize));

/// Load and envelope at one ADC sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LoadPoint {
    /// Time of the sample since the simulation's start, in seconds.
    pub t_s: f64,
    /// Resistance in ohm.
    pub r_ohm: f64,
    /// Inductance in henry.
    pub l_h: f64,
    /// Amplitude of the current's fundamental in ampere.
    pub i_a: f64,
}

/// Mains, half-bridge, capacitor, load and ADC.
#[derive(Clone, Debug)]
pub struct Plant {
    adc: Adc,
    pot: PotKind,
    load_library: LoadLibrary,
    drive: Drive,
    inverter: Inverter,
    analyser: HarmonicAnalyser,
    measured: LoadPoint,
    warming: Option<ThermalModel>,
}

impl Plant {
    /// A plant at rest, at a mains zero crossing, with a behavioural load.
    pub fn new(mains: Mains, pot: PotKind, adc: Adc) -> Self {
        Self::with_load(mains, pot, LoadKind::Behavioural, adc)
    }

    /// The same with a load model of choice.
    ///
    /// # Panics
    /// Never by anything from outside: all pots and the bridge are constants of this file, and the
    /// tests put every pot on the coil.
    pub fn with_load(mains: Mains, pot: PotKind, load: LoadKind, adc: Adc) -> Self {
        Self::assemble(mains, pot, load, adc).expect("the pots of this file are valid")
    }

    fn assemble(
        mains: Mains,
        pot: PotKind,
        load: LoadKind,
        adc: Adc,
    ) -> Result<Self, InverterError> {
        let drive = Drive::OFF;
        let f_sw_hz = f64::from(drive.f_sw_hz);
        let load_library = LoadLibrary::new(load)?;
        let inverter = Inverter::new(
            Bus::new(mains, 0.0, 0.0)?,
            HalfBridge::new(0.0, f64::from(EDGE_NS) * 1e-9)?,
            load_library.take(pot, f_sw_hz, STEPS_PER_PERIOD, None)?,
            f_sw_hz,
            STEPS_PER_PERIOD,
            0.0,
        );
        Ok(Self {
            adc,
            pot,
            load_library,
            drive,
            inverter,
            analyser: HarmonicAnalyser::new(STEPS_PER_PERIOD),
            measured: LoadPoint::default(),
            warming: None,
        })
    }

    /// Lets the pot warm up from room temperature by the power it takes.
    pub fn enable_warming(&mut self) {
        self.warming = Some(ThermalModel::default());
    }

    /// Temperature of the pot in °C, if it warms up.
    pub fn temperature_c(&self) -> Option<f64> {
        self.warming.map(|w| w.temperature_c())
    }

    /// Time since the start, in seconds.
    pub fn t_s(&self) -> f64 {
        self.inverter.now_s()
    }

    /// The mains.
    pub fn mains(&self) -> Mains {
        self.inverter.bus.mains()
    }

    /// What stands on the coil.
    pub fn pot(&self) -> PotKind {
        self.pot
    }

    /// Puts another pot on the coil, or takes it away. The current flows on.
    pub fn set_pot(&mut self, pot: PotKind) {
        let load = self.load_library.take(
            pot,
            self.inverter.f_sw_hz(),
            STEPS_PER_PERIOD,
            Some(&self.inverter.load),
        );
        // The library was checked when it was made; a pot that cannot be put on stays away.
        if let Ok(load) = load {
            self.inverter.load = load;
            self.pot = pot;
            // The new pot comes from the cupboard.
            self.warming = self.warming.map(|_| ThermalModel::default());
        }
    }

    /// Takes effect with the next block; with another frequency the carrier starts anew.
    pub fn set_drive(&mut self, drive: Drive) {
        if drive.f_sw_hz != self.drive.f_sw_hz {
            let f_sw_hz = f64::from(drive.f_sw_hz);
            let dt_s = 1.0 / (f_sw_hz * STEPS_PER_PERIOD as f64);
            let mut load = self.inverter.load.clone();
            if !load.set_dt(dt_s).unwrap_or(false)
                && let Ok(law) =
                    self.load_library
                        .take(self.pot, f_sw_hz, STEPS_PER_PERIOD, Some(&load))
            {
                load = law;
            }
            self.inverter.restart(load, f_sw_hz, STEPS_PER_PERIOD);
            self.apply_temperature();
        }
        self.drive = drive;
    }

    /// Simulates one block; `seen` gets the load at every ADC sample. With the bridge open
    /// the current freewheels into the bus or ground until it is gone, and the coil floats.
    ///
    /// A law is known at the sample itself; of the field model `seen` gets what the last whole
    /// switching period showed.
    pub fn block(&mut self, mut seen: impl FnMut(&LoadPoint)) -> [Pair; ADC_LOCK_P] {
        let mut pairs = [Pair::default(); ADC_LOCK_P];
        for pair in &mut pairs {
            seen(&self.load_point());
            *pair = self.sample(|_| ());
        }
        self.warm_up();
        pairs
    }

    /// Duration of an integration step, in seconds.
    pub fn dt_s(&self) -> f64 {
        self.inverter.dt_s()
    }

    /// Takes one sample and simulates until the next; `current` gets the coil's current in ampere after every
    /// integration step, as a comparator sees it. The pot does not warm up.
    pub fn sample(&mut self, mut current: impl FnMut(f64)) -> Pair {
        let pair = self.adc.sample();
        for _ in 0..STEPS_PER_SAMPLE {
            current(self.step());
        }
        pair
    }

    /// One block's heat.
    fn warm_up(&mut self) {
        let Some(warming) = &mut self.warming else {
            return;
        };
        let (r_ohm, i_a) = match self.inverter.load.law_point() {
            Some((r_ohm, _, i_a)) => (r_ohm, i_a),
            None => (self.measured.r_ohm, self.measured.i_a),
        };
        let block_s = f64::from(ADC_LOCK_Q) / self.inverter.f_sw_hz();
        warming.advance(0.5 * r_ohm * i_a * i_a, block_s);
        self.apply_temperature();
    }

    fn apply_temperature(&mut self) {
        let (Some(warming), Some(metal)) = (&self.warming, described(self.pot).metal) else {
            return;
        };
        let winding_r_ohm = self.load_library.winding_r_ohm();
        let (hot_c, f_sw_hz) = (warming.temperature_c(), self.inverter.f_sw_hz());
        // Refused only far beyond the temperatures that the cooling allows.
        let set = self
            .inverter
            .load
            .set_temperature(metal, hot_c, winding_r_ohm, f_sw_hz);
        debug_assert!(set.is_ok(), "{set:?}");
    }

    fn load_point(&self) -> LoadPoint {
        let t_s = self.t_s();
        match self.inverter.load.law_point() {
            Some((r_ohm, l_h, i_a)) => LoadPoint {
                t_s,
                r_ohm,
                l_h,
                i_a,
            },
            None => LoadPoint {
                t_s,
                ..self.measured
            },
        }
    }

    /// One integration step; the current after it.
    fn step(&mut self) -> f64 {
        let dt_s = 1.0 / (self.inverter.f_sw_hz() * STEPS_PER_PERIOD as f64);
        if !self.inverter.load.is_field() {
            let now = self.inverter.advance(self.drive.bridge);
            self.adc.advance(now.coil_v, now.i_a, dt_s);
            return now.i_a;
        }
        let n = self.inverter.step_in_period();
        if n == 0 {
            let start = self.inverter.instant();
            self.analyser.push(0, start.coil_v, start.i_a);
        }
        let now = self.inverter.advance(self.drive.bridge);
        self.adc.advance(now.coil_v, now.i_a, dt_s);
        self.analyser.push(n + 1, now.coil_v, now.i_a);
        if n + 1 == STEPS_PER_PERIOD {
            let truth = self
                .analyser
                .truth(now.t_s, self.inverter.f_sw_hz(), now.i_a);
            self.measured = LoadPoint {
                t_s: now.t_s,
                r_ohm: truth.r_ohm[0],
                l_h: truth.l_h[0],
                i_a: truth.i_a,
            };
        }
        now.i_a
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adc::Noise;
    use crate::behavioural::BehaviouralLoad;

    fn at_full_power(load: LoadKind) -> Plant {
        let adc = Adc::new(Noise::default(), 1);
        let mut plant = Plant::with_load(Mains::new(50.0), PotKind::Ferromagnetic, load, adc);
        plant.set_drive(Drive::switching(50_000));
        while plant.t_s() < 5e-3 {
            plant.block(|_| ());
        }
        plant
    }

    #[test]
    fn the_load_point_is_the_law_at_the_envelope() {
        let point = at_full_power(LoadKind::Behavioural).load_point();
        let (r, l) = BehaviouralLoad::new(PotKind::Ferromagnetic, 50e3).r_l(point.i_a);
        assert!(point.i_a > 30.0, "{point:?}");
        assert_eq!((point.r_ohm, point.l_h), (r, l));
    }

    #[test]
    fn the_table_stands_for_the_field() {
        let field = at_full_power(LoadKind::Field).load_point();
        let table = at_full_power(LoadKind::Surrogate).load_point();
        println!("{field:?} {table:?}");
        assert!((table.l_h / field.l_h - 1.0).abs() < 0.03);
        assert!((table.r_ohm / field.r_ohm - 1.0).abs() < 0.06);
        assert!((table.i_a / field.i_a - 1.0).abs() < 0.1);
    }

    #[test]
    fn r_drifts_upwards_as_the_pot_warms() {
        for load in [LoadKind::Behavioural, LoadKind::Field] {
            let mut plant = at_full_power(load);
            plant.enable_warming();
            plant.warming.as_mut().unwrap().advance(9e4, 1.0);
            let hot_c = plant.temperature_c().unwrap();
            assert!((hot_c - 120.0).abs() < 1e-9, "{hot_c}");
            let cold = plant.load_point();
            let then_s = plant.t_s() + 1e-4;
            while plant.t_s() < then_s {
                plant.block(|_| ());
            }
            let hot = plant.load_point();
            let ratio = hot.r_ohm / cold.r_ohm;
            assert!(
                (ratio / 1.11f64.sqrt() - 1.0).abs() < 0.03,
                "{load:?} {ratio}"
            );
        }
    }

    #[test]
    fn pots_are_exchanged_and_frequency_changed_in_operation() {
        for load in [LoadKind::Behavioural, LoadKind::Field] {
            let mut plant = at_full_power(load);
            let before = plant.load_point();
            plant.set_pot(PotKind::None);
            plant.set_drive(Drive::switching(60_000));
            while plant.t_s() < 6e-3 {
                plant.block(|_| ());
            }
            let after = plant.load_point();
            assert!(after.l_h > 1.5 * before.l_h, "{before:?} {after:?}");
            assert!(after.r_ohm < 0.2 * before.r_ohm, "{before:?} {after:?}");
        }
    }
}
