//! The power stage with its load and ADC, one ADC block at a time.

use ihd_firmware::drive::bridge::Bridge;
use ihd_firmware::drive::bridge::Drive;
use ihd_firmware::drive::pwm::DEAD_TIME_NS;
use ihd_firmware::sense::mains::{bus_places, mains_place};
use ihd_shared::hob::NODE_CAPACITANCE_NF;
use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q, Pair};
use ihd_signal::truth::MapTruth;

use super::adc::SimulatedAdc;
use super::circuit::Circuit;
use super::contents::PotContents;
use super::dividers::{DividedVoltages, Dividers};
use super::inverter::bridge::SwitchedHalfBridge;
use super::inverter::bus::Bus;
use super::inverter::harmonic_analyser::HarmonicAnalyser;
use super::inverter::load::Warmth;
use super::inverter::supply::SupplyParts;
use super::inverter::{Instant, Inverter, InverterError, STEPS_PER_PERIOD, STEPS_PER_SAMPLE};
use super::load_library::LoadLibrary;
use super::mains::SimulatedMains;
use super::map_truth::TrueLoad;
use super::meter::MeterReading;
use super::pot::SimulatedPot;
use super::recording::settings::LoadKind;
use super::thermal_model::ThermalModel;

/// Step in kelvin in which R and L follow the temperature: 0.001 % of either.
const TEMPERATURE_STEP_K: f64 = 0.02;

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

/// Accumulator of a [`MeterReading`].
#[derive(Clone, Debug, Default)]
struct Meter {
    half_cycle: u32,
    samples: u32,
    energy_before_j: f64,
    running: MeterReading,
    last: Option<MeterReading>,
}

/// Mains, half-bridge, capacitor, load and ADC.
#[derive(Clone, Debug)]
pub struct Plant {
    adc: SimulatedAdc,
    dividers: Dividers,
    divided: DividedVoltages,
    /// Half of the double buffer that the next block fills, 0 or 1.
    half: usize,
    pot: SimulatedPot,
    load_library: LoadLibrary,
    drive: Drive,
    inverter: Inverter,
    /// Coil current in ampere at which the comparator opens both switches; infinite without one.
    comparator_a: f64,
    /// Time from the comparator's threshold to open switches, in seconds.
    comparator_delay_s: f64,
    /// Time at which the comparator's trip opens the bridge, in seconds; `None` while it is not tripped.
    tripped_s: Option<f64>,
    /// Time at which both switches opened, in seconds; `None` while one may be closed.
    open_since_s: Option<f64>,
    meter: Meter,
    analyser: HarmonicAnalyser,
    measured: LoadPoint,
    warming: Option<ThermalModel>,
    /// Present temperature of the load, in °C.
    load_c: f64,
}

impl Plant {
    /// Creates a plant with the schematic's parts at rest, at a mains zero crossing, with a behavioural load.
    pub fn new(mains: SimulatedMains, pot: impl Into<SimulatedPot>, adc: SimulatedAdc) -> Self {
        Self::with_load(mains, pot, LoadKind::Behavioural, adc)
    }

    /// Creates a plant with the schematic's parts and a given load model.
    ///
    /// # Panics
    /// If the pot has no model; [`Plant::assemble`] returns that as an error.
    pub fn with_load(
        mains: SimulatedMains,
        pot: impl Into<SimulatedPot>,
        load: LoadKind,
        adc: SimulatedAdc,
    ) -> Self {
        Self::assemble(mains, pot.into(), load, SupplyParts::SCHEMATIC, adc)
            .expect("a pot that has a model")
    }

    /// Creates a plant with these parts between mains and bridge.
    ///
    /// # Errors
    /// If there is no model of that pot, or no such parts.
    pub fn assemble(
        mains: SimulatedMains,
        pot: SimulatedPot,
        load: LoadKind,
        supply: SupplyParts,
        adc: SimulatedAdc,
    ) -> Result<Self, InverterError> {
        let drive = Drive::OFF;
        let f_sw_hz = f64::from(drive.f_sw_hz);
        let mut load_library = LoadLibrary::new(load);
        let inverter = Inverter::new(
            Bus::new(mains, supply, 0.0)?,
            SwitchedHalfBridge::with_node(
                f64::from(DEAD_TIME_NS) * 1e-9,
                f64::from(NODE_CAPACITANCE_NF) * 1e-9,
            )?,
            load_library.take(&pot, f_sw_hz, STEPS_PER_PERIOD, None)?,
            f_sw_hz,
            STEPS_PER_PERIOD,
            0.0,
        );
        Ok(Self {
            adc,
            dividers: Dividers::default(),
            divided: DividedVoltages::default(),
            half: 0,
            pot,
            load_library,
            drive,
            inverter,
            comparator_a: f64::INFINITY,
            comparator_delay_s: 0.0,
            tripped_s: None,
            open_since_s: Some(0.0),
            meter: Meter::default(),
            analyser: HarmonicAnalyser::new(STEPS_PER_PERIOD),
            measured: LoadPoint::default(),
            warming: None,
            load_c: pot.temperature_c,
        })
    }

    /// Sets the coil current in ampere from which on a comparator opens both switches `delay_s` later; infinite for none.
    /// They stay open until the drive has requested that too.
    pub fn set_comparator(&mut self, trip_a: f64, delay_s: f64) {
        (self.comparator_a, self.comparator_delay_s) = (trip_a, delay_s);
    }

    /// Returns `true` while the comparator holds both switches open.
    pub fn is_tripped(&self) -> bool {
        self.tripped_s.is_some_and(|at_s| at_s <= self.t_s())
    }

    /// Time in seconds since when both switches are open; `None` while one may be closed.
    pub fn open_since_s(&self) -> Option<f64> {
        self.tripped_s
            .filter(|_| self.is_tripped())
            .or(self.open_since_s)
    }

    /// Readings of the last complete half-cycle, once.
    pub fn take_reading(&mut self) -> Option<MeterReading> {
        self.meter.last.take()
    }

    /// Enables warming of the pot with these contents, from its temperature, by the power it takes; `contact` is that of
    /// [`ThermalModel::with_contact`].
    pub fn enable_warming(&mut self, contents: PotContents, contact: f64) {
        self.warming = Some(ThermalModel::new(contents, &self.pot).with_contact(contact));
    }

    /// Temperature of the pot's base in °C; `None` if it does not warm up.
    pub fn temperature_c(&self) -> Option<f64> {
        self.warming.map(|w| w.temperature_c())
    }

    /// Present state of pot and contents; `None` if they do not warm up.
    pub fn thermal(&self) -> Option<&ThermalModel> {
        self.warming.as_ref()
    }

    /// Time since the start, in seconds.
    pub fn t_s(&self) -> f64 {
        self.inverter.now_s()
    }

    /// The mains.
    pub fn mains(&self) -> SimulatedMains {
        self.inverter.bus.mains()
    }

    /// Replaces the mains.
    pub fn set_mains(&mut self, mains: SimulatedMains) {
        self.inverter.bus.set_mains(mains);
    }

    /// Feeds the bus from a bench supply of this voltage from now on; the mains only feeds its detector.
    pub fn set_bench_supply(&mut self, supply_v: f64) {
        self.inverter.bus.set_supply(supply_v);
    }

    /// Bus voltage in volt.
    pub fn bus_v(&self) -> f64 {
        self.inverter.bus.v()
    }

    /// Voltages that the slow converter took in the last block.
    pub fn divided(&self) -> &DividedVoltages {
        &self.divided
    }

    /// Voltages at the pins of the slow converter, as volt at the dividers' inputs.
    pub fn dividers(&self) -> &Dividers {
        &self.dividers
    }

    /// Pot on the coil.
    pub fn pot(&self) -> SimulatedPot {
        self.pot
    }

    /// Truth of the present load; `progress` is called with the share done.
    ///
    /// # Errors
    /// If there is no model of it.
    pub fn map_truth(&self, progress: &mut dyn FnMut(f64)) -> Result<MapTruth, InverterError> {
        let load = TrueLoad::new(self.load_library.kind(), &self.pot, self.temperature_c())?;
        load.fed_by(*self.inverter.bus.parts()).map(progress)
    }

    /// Prepares a pot, so that putting it on later takes no time.
    ///
    /// # Errors
    /// If there is no model of that pot.
    pub fn prepare(&mut self, pot: &SimulatedPot) -> Result<(), InverterError> {
        self.load_library.prepare(pot).map(|_| ())
    }

    /// Puts another pot on the coil, or removes it. The current continues.
    ///
    /// # Errors
    /// If there is no model of that pot; the old one stays.
    pub fn set_pot(&mut self, pot: impl Into<SimulatedPot>) -> Result<(), InverterError> {
        let pot = pot.into();
        self.inverter.load = self.load_library.take(
            &pot,
            self.inverter.f_sw_hz(),
            STEPS_PER_PERIOD,
            Some(&self.inverter.load),
        )?;
        if pot.base != self.pot.base || pot.diameter_m != self.pot.diameter_m {
            // A new pot has the same contents, at its own temperature.
            self.warming = self.warming.map(|old| old.exchanged(&pot));
        }
        self.pot = pot;
        self.load_c = pot.temperature_c;
        self.apply_temperature();
        Ok(())
    }

    /// Sets the drive from the next block on; with another frequency the carrier starts again.
    pub fn set_drive(&mut self, drive: Drive) {
        if drive.f_sw_hz != self.drive.f_sw_hz {
            let f_sw_hz = f64::from(drive.f_sw_hz);
            let dt_s = 1.0 / (f_sw_hz * STEPS_PER_PERIOD as f64);
            let mut load = self.inverter.load.clone();
            if !load.set_dt(dt_s).unwrap_or(false)
                && let Ok(law) =
                    self.load_library
                        .take(&self.pot, f_sw_hz, STEPS_PER_PERIOD, Some(&load))
            {
                load = law;
            }
            self.inverter.restart(load, f_sw_hz, STEPS_PER_PERIOD);
            self.heat_load();
        }
        match drive.bridge {
            Bridge::Open => {
                self.open_since_s = self.open_since_s().or(Some(self.t_s()));
                self.tripped_s = None;
            }
            Bridge::LowerOn | Bridge::Switching => self.open_since_s = None,
        }
        self.drive = drive;
    }

    /// Sets the resonance capacitor's capacitance, as a share of the schematic's, from now on; its voltage stays.
    pub fn set_resonance_share(&mut self, share: f64) {
        self.inverter.circuit.c_f = share * Circuit::default().c_f;
    }

    /// Sets the share of the period in which the upper switch is on, from now on.
    pub fn set_duty(&mut self, duty: f64) {
        self.inverter.bridge.set_duty(duty);
    }

    /// Simulates one block; `seen` is called with the load at every ADC sample. With the bridge open the current freewheels into
    /// the bus or ground until it ends, and the coil floats.
    ///
    /// A law is known at the sample itself; for the field model `seen` gets the values of the last complete switching period.
    pub fn block(&mut self, mut seen: impl FnMut(&LoadPoint)) -> [Pair; ADC_LOCK_P] {
        let mut pairs = [Pair::default(); ADC_LOCK_P];
        let mut taken_v = [(0.0, 0.0); ADC_LOCK_P];
        for (pair, taken_v) in pairs.iter_mut().zip(&mut taken_v) {
            seen(&self.load_point());
            *taken_v = (self.dividers.bus_v(), self.dividers.mains_v());
            *pair = self.sample(|_| ());
        }
        let at = |place: usize| taken_v[place % ADC_LOCK_P];
        self.divided = DividedVoltages {
            bus_v: bus_places(self.half).map(|place| at(place).0),
            mains_v: at(mains_place(self.half)).1,
        };
        self.half = 1 - self.half;
        self.warm_up();
        pairs
    }

    /// Duration of an integration step, in seconds.
    pub fn dt_s(&self) -> f64 {
        self.inverter.dt_s()
    }

    /// Takes one sample and simulates until the next; `current` is called with the coil's current in ampere after every integration
    /// step, as seen by a comparator. The pot does not warm up.
    pub fn sample(&mut self, mut current: impl FnMut(f64)) -> Pair {
        let pair = self.adc.sample();
        let bus = &self.inverter.bus;
        let terminal_v = bus.terminal_v(self.inverter.now_s());
        let sample_s = STEPS_PER_SAMPLE as f64 * self.inverter.dt_s();
        self.dividers.advance(bus.v(), terminal_v, sample_s);
        let bridge = match self.is_tripped() {
            false => self.drive.bridge,
            true => Bridge::Open,
        };
        if bridge == Bridge::Switching {
            self.meter.running.switching_s += sample_s;
        }
        let mut crest = (0f64, 0f64);
        if bridge == Bridge::Open && self.inverter.is_at_rest() {
            let now = self.inverter.rest(STEPS_PER_SAMPLE);
            self.adc.advance(&now, sample_s);
            current(now.i_a);
            self.read_meter(crest);
            return pair;
        }
        let mut left = STEPS_PER_SAMPLE;
        while left > 0 {
            let bridge = match self.is_tripped() {
                false => bridge,
                true => Bridge::Open,
            };
            left -= self.advance(bridge, left, &mut |now| {
                let (i_a, coil_v) = (now.i_a.abs(), now.coil_v.abs());
                // `f64::max` minds NaN, at every step.
                if i_a > crest.0 {
                    crest.0 = i_a;
                }
                if coil_v > crest.1 {
                    crest.1 = coil_v;
                }
                current(now.i_a);
            });
        }
        self.read_meter(crest);
        pair
    }

    /// Advances by up to `steps` integration steps, until the comparator trips; returns the number done.
    fn advance(&mut self, bridge: Bridge, steps: usize, seen: &mut impl FnMut(&Instant)) -> usize {
        if self.inverter.load.is_field() {
            self.analyse_start();
        }
        let dt_s = self.inverter.dt_s();
        let Self {
            adc,
            inverter,
            comparator_a,
            comparator_delay_s,
            tripped_s,
            ..
        } = self;
        let steps = match inverter.load.is_field() {
            true => 1,
            false => steps,
        };
        let done = inverter.run(bridge, steps, |now| {
            adc.advance(now, dt_s);
            if now.i_a.abs() >= *comparator_a && tripped_s.is_none() {
                *tripped_s = Some(now.t_s + *comparator_delay_s);
            }
            seen(now);
            tripped_s.is_none_or(|at_s| at_s > now.t_s)
        });
        if self.inverter.load.is_field() {
            self.analyse();
        }
        done
    }

    /// Charge that the DC link has given to the bridge since the start, in coulomb.
    pub fn link_charge_c(&self) -> f64 {
        self.inverter.link_charge_c()
    }

    /// Updates the meter after each sample, and completes the half-cycle's reading at the mains' zero crossing.
    fn read_meter(&mut self, (i_a, coil_v): (f64, f64)) {
        let meter = &mut self.meter;
        meter.running.i_peak_a = meter.running.i_peak_a.max(i_a);
        meter.running.v_coil_peak_v = meter.running.v_coil_peak_v.max(coil_v);
        let now_a = self.inverter.circuit.i_a;
        meter.running.i_mean_a += now_a.abs();
        meter.running.i_square_a2 += now_a * now_a;
        meter.samples += 1;
        let t_s = self.inverter.now_s();
        let half_cycle = self.inverter.bus.mains().half_cycle(t_s);
        if half_cycle == meter.half_cycle {
            return;
        }
        meter.half_cycle = half_cycle;
        let energy_j = self.inverter.load_energy_j();
        let edges = self.inverter.bridge.take_commutations();
        let next = MeterReading {
            t_s,
            ..MeterReading::default()
        };
        let running = std::mem::replace(&mut meter.running, next);
        let samples = f64::from(std::mem::take(&mut meter.samples));
        meter.last = Some(MeterReading {
            i_mean_a: running.i_mean_a / samples,
            i_square_a2: running.i_square_a2 / samples,
            duration_s: t_s - running.t_s,
            energy_j: energy_j - meter.energy_before_j,
            hard_edges: edges.hard_edges,
            i_turn_off_min_a: edges.turn_off_min_a,
            ..running
        });
        meter.energy_before_j = energy_j;
    }

    /// Adds one block's heat.
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

    /// Adapts the load to the pot's temperature.
    fn apply_temperature(&mut self) {
        let (Some(warming), Some(_)) = (&self.warming, self.pot.base) else {
            return;
        };
        let hot_c = warming.temperature_c();
        if (hot_c - self.load_c).abs() >= TEMPERATURE_STEP_K {
            self.load_c = hot_c;
            self.heat_load();
        }
    }

    /// Sets the load's temperature.
    fn heat_load(&mut self) {
        let (Some(_), Some(base)) = (&self.warming, self.pot.base) else {
            return;
        };
        // The law is that of the pot at the temperature at which it was put on.
        let heated_c = (self.pot.temperature_c, self.load_c);
        let warmth = Warmth::of(base, heated_c, self.load_library.winding_r_ohm());
        let law_hz = warmth.law_hz(self.inverter.f_sw_hz());
        if let Some(law) = self.load_library.law(&self.pot, law_hz) {
            self.inverter.load.set_hot_law(law, warmth);
            return;
        }
        // An error only occurs far beyond the temperatures of a metal.
        let set = self.inverter.load.set_temperature(&self.pot, self.load_c);
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

    /// Begins the truth of a switching period of the field model, at its first boundary.
    fn analyse_start(&mut self) {
        if self.inverter.step_in_period() == 0 {
            self.analyser.start(self.inverter.circuit.i_a);
        }
    }

    /// Adds the quantities after an integration step to the truth of the field model's period.
    fn analyse(&mut self) {
        let now = self.inverter.instant();
        let n = match self.inverter.step_in_period() {
            0 => STEPS_PER_PERIOD,
            n => n,
        };
        self.analyser.push_mean(n, now.coil_mean_v, now.i_a);
        if n == STEPS_PER_PERIOD {
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
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adc::ConverterNoise;
    use crate::behavioural::{BehaviouralLoad, PotKind};

    fn at_full_power(load: LoadKind) -> Plant {
        let adc = SimulatedAdc::new(ConverterNoise::default(), 1);
        let mut plant =
            Plant::with_load(SimulatedMains::new(50.0), PotKind::Ferromagnetic, load, adc);
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
    fn the_wattmeter_reads_r_i_squared() {
        let adc = SimulatedAdc::new(ConverterNoise::default(), 1);
        let mut plant = Plant::new(SimulatedMains::new(50.0), PotKind::Aluminium, adc);
        plant.set_drive(Drive::switching(60_000));
        let mut readings = Vec::new();
        while readings.len() < 3 {
            plant.block(|_| ());
            readings.extend(plant.take_reading());
        }
        let (last, r_ohm) = (readings[2], 0.22 * (60.0f64 / 45.0).sqrt());
        let expected_w = r_ohm * last.i_square_a2;
        assert!((last.t_s - 0.02).abs() < 2e-6 && (last.duration_s - 0.01).abs() < 2e-6);
        assert!(last.i_peak_a > 20.0 && last.bridge_on(), "{last:?}");
        assert!(
            (last.power_w() / expected_w - 1.0).abs() < 2e-3,
            "{last:?} {expected_w}"
        );
        // The bus gave what the load took: the capacitor is empty at each zero crossing.
        let link_c = plant.link_charge_c();
        assert!(link_c > 0.0, "{link_c}");
    }

    #[test]
    fn the_comparator_opens_within_a_step_until_the_drive_has_been_open() {
        let mut plant = at_full_power(LoadKind::Behavioural);
        let mut last_a = 40.0f64;
        while last_a.abs() > 20.0 {
            plant.sample(|i_a| last_a = i_a);
        }
        plant.set_comparator(30.0, 0.0);
        let mut most_a: f64 = 0.0;
        while !plant.is_tripped() {
            plant.sample(|i_a| most_a = most_a.max(i_a.abs()));
        }
        // 400 V on 16 µH for a step of 82 ns are 2 A.
        assert!((30.0..32.0).contains(&most_a), "{most_a}");
        let since_s = plant.open_since_s().unwrap();
        plant.set_comparator(f64::INFINITY, 0.0);
        for drive in [Drive::switching(50_000), Drive::switching(60_000)] {
            plant.set_drive(drive);
            plant.block(|_| ());
            assert!(plant.is_tripped());
            assert_eq!(plant.open_since_s(), Some(since_s));
        }
        plant.set_drive(Drive::OFF);
        assert_eq!(
            (plant.is_tripped(), plant.open_since_s()),
            (false, Some(since_s))
        );
        plant.set_drive(Drive::switching(50_000));
        assert_eq!(plant.open_since_s(), None);
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
            plant.enable_warming(PotContents::Food, 1.0);
            // 900 J/K, and 14 W/K of which little is lost in a tenth of a second.
            plant.warming.as_mut().unwrap().advance(9.007e5, 0.1);
            let hot_c = plant.temperature_c().unwrap();
            assert!((hot_c - 120.0).abs() < 0.1, "{hot_c}");
            let cold = plant.load_point();
            let then_s = plant.t_s() + 1e-4;
            while plant.t_s() < then_s {
                plant.block(|_| ());
            }
            let hot = plant.load_point();
            let ratio = hot.r_ohm / cold.r_ohm;
            // ρ B_s: 1.11 · (1 − (100/660)²).
            assert!(
                (ratio / 1.0845f64.sqrt() - 1.0).abs() < 0.015,
                "{load:?} {ratio}"
            );
        }
    }

    #[test]
    fn pots_are_exchanged_and_frequency_changed_in_operation() {
        for load in [LoadKind::Behavioural, LoadKind::Field] {
            let mut plant = at_full_power(load);
            let before = plant.load_point();
            plant.set_pot(PotKind::None).unwrap();
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
