//! The power stage with its load and ADC, one ADC block at a time.

use ihd_firmware::drive::bridge::Bridge;
use ihd_firmware::drive::bridge::Drive;
use ihd_firmware::drive::pwm::DEAD_TIME_NS;
use ihd_firmware::sense::bus::bus_places;
use ihd_firmware::sense::mains::mains_place;
use ihd_shared::hob::NODE_CAPACITANCE_NF;
use ihd_shared::sampling::{ADC_LOCK_P, Pair};
use ihd_signal::truth::MapTruth;

use super::adc::SimulatedAdc;
use super::circuit::Circuit;
use super::comparator::{FAULT_FILTER_S, FilteredComparator, TRIP_DELAY_S};
use super::contents::PotContents;
use super::dividers::{DividedVoltages, Dividers};
use super::injection::CurrentSensor;
use super::inverter::bridge::SwitchedHalfBridge;
use super::inverter::bus::Bus;
use super::inverter::supply::SupplyParts;
use super::inverter::{Instant, Inverter, InverterError, STEPS_PER_PERIOD, STEPS_PER_SAMPLE};
use super::mains::SimulatedMains;
use super::map_truth::TrueLoad;
use super::meter::MeterReading;
use super::pot::SimulatedPot;
use super::recording::settings::LoadKind;
use super::thermal_model::ThermalModel;

mod half_cycle_meter;
mod hardware_opening;
mod load_observer;
mod pot_on_coil;
mod warm_pots;

use half_cycle_meter::HalfCycleMeter;
use hardware_opening::HardwareOpening;
use load_observer::LoadObserver;
use pot_on_coil::PotOnCoil;

pub use load_observer::LoadPoint;

/// Mains, half-bridge, capacitor, load and ADC.
#[derive(Clone, Debug)]
pub struct Plant {
    adc: SimulatedAdc,
    dividers: Dividers,
    divided: DividedVoltages,
    /// Half of the double buffer that the next block fills, 0 or 1.
    half: usize,
    coil: PotOnCoil,
    /// Time from the beginning of a sampling period to the hold of both channels, in seconds.
    hold_delay_s: f64,
    drive: Drive,
    inverter: Inverter,
    /// Output of the current sensor in ampere at which the comparator opens both switches; infinite without one.
    trip_a: f64,
    comparator: FilteredComparator,
    current_sensor: CurrentSensor,
    /// Time at which the comparator's trip opens the bridge, in seconds; `None` while it is not tripped.
    tripped_s: Option<f64>,
    /// Set if it tripped before the drive opened the bridge, until that is read.
    has_tripped: bool,
    /// Sampling watchdog and system faults.
    opening: HardwareOpening,
    /// Time at which both switches opened, in seconds; `None` while one may be closed.
    open_since_s: Option<f64>,
    meter: HalfCycleMeter,
    observer: LoadObserver,
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
        let mut coil = PotOnCoil::new(pot, load);
        let inverter = Inverter::new(
            Bus::new(mains, supply, 0.0)?,
            SwitchedHalfBridge::with_node(
                f64::from(DEAD_TIME_NS) * 1e-9,
                f64::from(NODE_CAPACITANCE_NF) * 1e-9,
            )?,
            coil.load_library
                .take(&pot, f_sw_hz, STEPS_PER_PERIOD, None)?,
            f_sw_hz,
            STEPS_PER_PERIOD,
            0.0,
        );
        Ok(Self {
            adc,
            dividers: Dividers::default(),
            divided: DividedVoltages::default(),
            half: 0,
            coil,
            hold_delay_s: 0.0,
            drive,
            inverter,
            trip_a: f64::INFINITY,
            comparator: FilteredComparator::default(),
            current_sensor: CurrentSensor::default(),
            tripped_s: None,
            has_tripped: false,
            opening: HardwareOpening::default(),
            open_since_s: Some(0.0),
            meter: HalfCycleMeter::default(),
            observer: LoadObserver::default(),
        })
    }

    /// Sets the coil current in ampere at which a comparator behind the anti-alias filter opens both switches; infinite for none.
    /// They stay open until the drive has requested that too.
    pub fn set_comparator(&mut self, trip_a: f64) {
        self.trip_a = trip_a;
    }

    /// Sets the current sensor that the comparator sees.
    pub fn set_current_sensor(&mut self, sensor: CurrentSensor) {
        self.current_sensor = sensor;
    }

    /// Sets the time from the beginning of a sampling period to the hold of both channels, in seconds; less than the period.
    pub fn set_hold_delay(&mut self, delay_s: f64) {
        self.hold_delay_s = delay_s;
    }

    /// Returns `true` while the comparator holds open what the drive closes, and once if it had tripped before the drive opened.
    pub fn take_trip(&mut self) -> bool {
        let is_held = self.comparator_since_s().is_some() && self.drive.bridge != Bridge::Open;
        std::mem::take(&mut self.has_tripped) || is_held
    }

    /// Time in seconds since when the comparator holds both switches open; `None` while it does not.
    fn comparator_since_s(&self) -> Option<f64> {
        self.tripped_s.filter(|at_s| *at_s <= self.t_s())
    }

    /// Feeds the sampling watchdog, which opens both switches at `due_s` if it is not fed again; returns `true` if it has bitten
    /// meanwhile. Like a trip, an opening holds until the drive has opened the bridge too.
    pub fn feed_sampling_watchdog(&mut self, due_s: f64) -> bool {
        self.opening.feed(self.t_s(), due_s)
    }

    /// Opens both switches as a system fault does: at once, and until the drive has opened the bridge too.
    pub fn open_in_hardware(&mut self) {
        self.opening.open(self.t_s());
    }

    /// Returns `true` while hardware holds both switches open: comparator, sampling watchdog or system fault.
    pub fn is_tripped(&self) -> bool {
        self.comparator_since_s().is_some() || self.opening.since_s(self.t_s()).is_some()
    }

    /// Time in seconds since when hardware holds both switches open; `None` while it does not.
    fn held_since_s(&self) -> Option<f64> {
        let by_others_s = self.opening.since_s(self.t_s());
        let all = [self.comparator_since_s(), by_others_s];
        all.into_iter().flatten().reduce(f64::min)
    }

    /// Time in seconds since when both switches are open; `None` while one may be closed.
    pub fn open_since_s(&self) -> Option<f64> {
        self.open_since_s.or(self.held_since_s())
    }

    /// Readings of the last complete half-cycle, once.
    pub fn take_reading(&mut self) -> Option<MeterReading> {
        self.meter.last.take()
    }

    /// Enables warming of the pot with these contents, from its temperature, by the power it takes.
    pub fn enable_warming(&mut self, contents: PotContents) {
        self.coil.heat.enable(contents, &self.coil.pot);
    }

    /// Sets the conductance from a pot to the glass, over that of a flat base.
    pub fn set_glass_contact(&mut self, contact: f64) {
        self.coil.heat.set_contact(contact);
    }

    /// Sets the temperatures in °C of the glass below the pot and of the room.
    pub fn set_surroundings(&mut self, glass_c: f64, room_c: f64) {
        self.coil.heat.set_surroundings(glass_c, room_c);
    }

    /// Sets the temperature of the coil's winding in °C, by which its resistance goes.
    pub fn set_winding_temperature(&mut self, coil_c: f64) {
        self.coil.set_winding(coil_c, &mut self.inverter);
    }

    /// Takes the heat in joule that the pot has given to the glass in the last `dt_s`.
    pub fn take_glass_heat_j(&mut self, dt_s: f64) -> f64 {
        self.coil.heat.take_given_j(&self.coil.pot, dt_s)
    }

    /// Temperature of the pot's base in °C; `None` without a pot, or if it does not warm up.
    pub fn temperature_c(&self) -> Option<f64> {
        self.thermal().map(ThermalModel::temperature_c)
    }

    /// Present state of pot and contents; `None` without a pot, or if they do not warm up.
    pub fn thermal(&self) -> Option<&ThermalModel> {
        self.coil.heat.on_coil()
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

    /// Sets voltage in volt rms (0 for none) and frequency in hertz of the mains; the phase continues.
    pub fn change_mains(&mut self, v_rms_v: f64, frequency_hz: f64) {
        let changed = self.mains().changed(self.t_s(), v_rms_v, frequency_hz);
        self.set_mains(changed);
    }

    /// Opens the line of the mains, or closes it again; its phase goes on.
    pub fn set_line_open(&mut self, is_open: bool) {
        let mut mains = self.mains();
        mains.is_open = is_open;
        self.set_mains(mains);
    }

    /// Feeds the bus from a bench supply of this voltage from now on; the mains only feeds its detector.
    pub fn set_bench_supply(&mut self, supply_v: f64) {
        self.inverter.bus.set_supply(supply_v);
    }

    /// Voltage of that supply in volt, if there is one.
    pub fn bench_supply_v(&self) -> Option<f64> {
        self.inverter.bus.supply_v()
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
        self.coil.pot
    }

    /// Truth of the present load; `progress` is called with the share done.
    ///
    /// # Errors
    /// If there is no model of it.
    pub fn map_truth(&self, progress: &mut dyn FnMut(f64)) -> Result<MapTruth, InverterError> {
        let load = TrueLoad::new(
            self.coil.load_library.kind(),
            &self.coil.pot,
            self.temperature_c(),
        )?;
        load.fed_by(*self.inverter.bus.parts()).map(progress)
    }

    /// Prepares a pot, so that putting it on later takes no time.
    ///
    /// # Errors
    /// If there is no model of that pot.
    pub fn prepare(&mut self, pot: &SimulatedPot) -> Result<(), InverterError> {
        self.coil.load_library.prepare(pot).map(|_| ())
    }

    /// Puts another pot on the coil, or removes it. The current continues.
    ///
    /// # Errors
    /// If there is no model of that pot; the old one stays.
    pub fn set_pot(&mut self, pot: impl Into<SimulatedPot>) -> Result<(), InverterError> {
        self.coil.exchange(pot.into(), &mut self.inverter)
    }

    /// Sets the drive from the next block on; with another frequency the carrier starts again.
    pub fn set_drive(&mut self, drive: Drive) {
        if drive.f_sw_hz != self.drive.f_sw_hz {
            let f_sw_hz = f64::from(drive.f_sw_hz);
            let load = self.coil.load_at(f_sw_hz, &self.inverter.load);
            self.inverter.restart(load, f_sw_hz, STEPS_PER_PERIOD);
            self.coil.heat_load(&mut self.inverter);
        }
        match drive.bridge {
            Bridge::Open => {
                self.open_since_s = self.open_since_s().or(Some(self.t_s()));
                let has_tripped = self.tripped_s.take().is_some();
                self.has_tripped |= has_tripped && self.drive.bridge != Bridge::Open;
                self.opening.release();
            }
            Bridge::LowerOn | Bridge::Switching => {
                // The first switch that closes clears a trip with both open.
                if self.drive.bridge == Bridge::Open {
                    self.tripped_s = None;
                }
                self.open_since_s = None;
            }
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

    /// Simulates one block; `seen` is called at every ADC sample. With the bridge open the current freewheels into the bus or ground
    /// until it ends, and the coil floats.
    pub fn block(&mut self, mut seen: impl FnMut(&Self)) -> [Pair; ADC_LOCK_P] {
        let mut pairs = [Pair::default(); ADC_LOCK_P];
        let mut taken_v = [(0.0, 0.0); ADC_LOCK_P];
        for (pair, taken_v) in pairs.iter_mut().zip(&mut taken_v) {
            seen(self);
            *taken_v = (self.dividers.bus_v(), self.dividers.mains_v());
            *pair = self.sample(|_| ());
        }
        let at = |place: usize| taken_v[place % ADC_LOCK_P];
        self.divided = DividedVoltages {
            bus_v: bus_places(self.half).map(|place| at(place).0),
            half: self.half,
            mains_v: at(mains_place(self.half)).1,
        };
        self.half = 1 - self.half;
        let now = self.load_point();
        self.coil.warm_up(&now, &mut self.inverter);
        pairs
    }

    /// Present load: a law's as it is now, that of the field model over the last complete switching period.
    pub fn load_point(&self) -> LoadPoint {
        self.observer.point(&self.inverter)
    }

    /// Duration of an integration step, in seconds.
    pub fn dt_s(&self) -> f64 {
        self.inverter.dt_s()
    }

    /// Takes one sample and simulates until the next; `current` is called with the coil's current in ampere behind its sensor's
    /// filters after every integration step, as a comparator sees it. The pot does not warm up.
    pub fn sample(&mut self, mut current: impl FnMut(f64)) -> Pair {
        self.adc.filters.end_decay();
        let start = self.adc.filters.outputs();
        self.inverter.end_decay();
        let sample_s = STEPS_PER_SAMPLE as f64 * self.inverter.dt_s();
        let mut is_open = self.is_tripped() || self.drive.bridge == Bridge::Open;
        if !is_open && self.drive.bridge == Bridge::Switching {
            self.meter.running.switching_s += sample_s;
        }
        let mut crest = (0f64, 0f64);
        if is_open && self.inverter.is_at_rest() {
            let now = self.inverter.rest(STEPS_PER_SAMPLE);
            self.adc.filters.set_step(sample_s);
            self.adc.filters.step(&now);
            let i_a = self.adc.filters.outputs()[1];
            // With both switches open a trip opens nothing, and the first switch that closes clears it.
            let excess_a = self.current_sensor.output_a(i_a).abs() - self.trip_a;
            self.comparator.advance(excess_a, FAULT_FILTER_S, sample_s);
            current(i_a);
            self.end_sample(crest, sample_s);
            return self.adc.convert(start[0], start[1]);
        }
        let mut outputs = [start; STEPS_PER_SAMPLE + 1];
        let mut done = 0;
        while done < STEPS_PER_SAMPLE {
            is_open |= self.is_tripped();
            let bridge = match is_open {
                false => self.drive.bridge,
                true => Bridge::Open,
            };
            let mut places = outputs[done + 1..].iter_mut();
            done += self.advance(bridge, STEPS_PER_SAMPLE - done, &mut |now, pins| {
                let (i_a, coil_v) = (now.i_a.abs(), now.coil_v.abs());
                // `f64::max` minds NaN, at every step.
                if i_a > crest.0 {
                    crest.0 = i_a;
                }
                if coil_v > crest.1 {
                    crest.1 = coil_v;
                }
                if let Some(place) = places.next() {
                    *place = pins;
                }
                current(pins[1]);
            });
        }
        self.end_sample(crest, sample_s);
        // Whole steps before the hold, and the share of the step in which it comes.
        let hold = self.hold_delay_s / self.inverter.dt_s();
        let whole = (hold as usize).min(STEPS_PER_SAMPLE - 1);
        let share = hold - whole as f64;
        let (before, after) = (outputs[whole], outputs[whole + 1]);
        let [v_v, i_a] = [0, 1].map(|k| before[k] + share * (after[k] - before[k]));
        self.adc.convert(v_v, i_a)
    }

    /// Meters the sample, and brings the dividers to its end, where the next pair is taken.
    fn end_sample(&mut self, crest: (f64, f64), sample_s: f64) {
        self.meter.sample(&mut self.inverter, crest);
        let bus = &self.inverter.bus;
        let terminal_v = bus.terminal_v(self.inverter.now_s());
        self.dividers.advance(bus.v(), terminal_v, sample_s);
    }

    /// Advances by up to `steps` integration steps, until a trip opens the bridge; returns the number done. `seen` gets the
    /// quantities after each and the outputs of the sensors' filters.
    fn advance(
        &mut self,
        bridge: Bridge,
        steps: usize,
        seen: &mut impl FnMut(&Instant, [f64; 2]),
    ) -> usize {
        let is_field = self.inverter.load.is_field();
        if is_field {
            self.observer.start(&self.inverter);
        }
        let dt_s = self.inverter.dt_s();
        let (trip_a, sensor) = (self.trip_a, self.current_sensor);
        // Beside the loop, so that they stay in registers.
        let (mut filters, mut comparator) = (self.adc.filters, self.comparator);
        filters.set_step(dt_s);
        let mut tripped_s = self.tripped_s;
        let steps = match is_field {
            true => 1,
            false => steps,
        };
        let done = self.inverter.run(bridge, steps, |now| {
            filters.step(now);
            let pins = filters.outputs();
            let excess_a = sensor.output_a(pins[1]).abs() - trip_a;
            let lasted = comparator.advance(excess_a, FAULT_FILTER_S, dt_s);
            if let Some(before_s) = lasted
                && tripped_s.is_none()
            {
                tripped_s = Some(now.t_s - before_s + TRIP_DELAY_S);
            }
            seen(now, pins);
            tripped_s.is_none_or(|at_s| at_s > now.t_s)
        });
        (self.adc.filters, self.comparator, self.tripped_s) = (filters, comparator, tripped_s);
        if is_field {
            self.observer.push(&self.inverter);
        }
        done
    }

    /// Charge that the DC link has given to the bridge since the start, in coulomb.
    pub fn link_charge_c(&self) -> f64 {
        self.inverter.link_charge_c()
    }
}

#[cfg(test)]
mod tests;
