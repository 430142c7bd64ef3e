//! Circuits at the chip's pins: the project's own power stage with a load, and the other end of the USB cable.

use std::collections::VecDeque;

use ihd_firmware::drive::bridge;
use ihd_firmware::sense::mains::MAINS_FULL_SCALE_V;
use ihd_shared::board::{self, Pin};
use ihd_shared::sampling::{AMPERE_PER_CODE, CODE_HALF_RANGE, Pair, VOLT_PER_CODE};
use ihd_sim::adc::SimulatedAdc;
use ihd_sim::comparator::FilteredComparator;
use ihd_sim::front_end::{BUS_FULL_SCALE_V, REFERENCE_CALIBRATION};
use ihd_sim::hob::HobConfig;
use ihd_sim::injection::{InjectionKind, Injections};
use ihd_sim::plant::Plant;
use ihd_sim::scenario::surroundings::ChangeableHob;
use ihd_sim::temperatures::ntc_code;

use crate::chip::hrtim::Bridge;
use crate::usb::host::HostController;

/// Pins of the panel's buttons: on/off, plus, minus, timer.
const BUTTONS: [Pin; 4] = [
    board::BUTTON_ON_OFF_PIN,
    board::BUTTON_PLUS_PIN,
    board::BUTTON_MINUS_PIN,
    board::BUTTON_TIMER_PIN,
];

/// Pins of the thermistors of heat sink, glass and coil.
const THERMISTORS: [Pin; 3] = [
    board::HEAT_SINK_NTC_PIN,
    board::GLASS_NTC_PIN,
    board::COIL_NTC_PIN,
];

const CODES: f64 = 4096.0;
const MIDDLE: f64 = CODE_HALF_RANGE as f64;

/// Analogue front end of `ihd hob`: half an LSB of noise, with this seed, after its anti-alias filter.
pub fn front_end(seed: u64) -> SimulatedAdc {
    let hob = HobConfig::default();
    SimulatedAdc::of_board(hob.noise, seed, hob.anti_alias_hz)
}

/// Inputs of the converters at a trigger.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    pair: Pair,
    /// Code of the bus voltage.
    bus: u16,
    mains_v: f64,
    /// Supply over the nominal one.
    supply: f64,
}

impl Sample {
    /// 12-bit code of a channel of an ADC (docs/board.md, "Pins").
    pub fn code(&self, adc: u32, channel: u32) -> u32 {
        // The front end's zero is half the supply.
        let of_pair = |signed: i16| (CODE_HALF_RANGE + signed).max(0) as u32;
        match (adc, channel) {
            (1, 1) => of_pair(self.pair.v),
            (2, 2) => of_pair(self.pair.i),
            (3, 1) => self.bus.into(),
            (3, 12) => code(MIDDLE + self.mains_v / MAINS_FULL_SCALE_V * MIDDLE / self.supply),
            // Pin without a connection.
            _ => 0,
        }
    }
}

/// The nearest 12-bit code.
fn code(value: f64) -> u32 {
    value.round().clamp(0.0, CODES - 1.0) as u32
}

/// Circuits outside the chip.
pub struct Pins {
    /// Power stage with its load.
    pub plant: Plant,
    /// Other end of the USB cable.
    pub usb: HostController,
    bridge: Bridge,
    /// Settings of the comparators at PA1 and PA7, the latter inverted; `None` if off.
    pub comparators: [Option<Comparator>; 2],
    /// Time for which each comparator has been above its threshold.
    above: [FilteredComparator; 2],
    /// Fault injection: comparators that never trip.
    pub dead_comparators: [bool; 2],
    /// Temperatures of heat sink, glass and coil in °C.
    pub temperatures_c: [f64; 3],
    /// Faults of sensors, supply and reference.
    injections: Injections,
    /// Pressed buttons of the panel: on/off, plus, minus, timer.
    pub pressed: [bool; 4],
    /// Wire to a second zone, with its resistor: `true` while that zone does not pull it low. `None` without a wire.
    pub share_wire: Option<bool>,
    /// Fault injection: surge in ampere, added to the current at the comparators.
    pub surge_a: f64,
    /// Pairs that the converters return instead of the power stage's, while there are any.
    pub fed: VecDeque<Pair>,
    /// Wattmeter: energy of the pairs in joule, and its duration in seconds.
    pub wattmeter: (f64, f64),
    /// Pairs that the converters returned, if they are recorded.
    pub taken: Option<Vec<Pair>>,
}

impl Pins {
    /// Power stage at the pins, and one end of a USB cable.
    pub fn new(plant: Plant, usb: HostController) -> Self {
        Self {
            plant,
            usb,
            bridge: Bridge::Open,
            comparators: [None; 2],
            above: [FilteredComparator::default(); 2],
            dead_comparators: [false; 2],
            temperatures_c: [25.0; 3],
            injections: Injections::default(),
            pressed: [false; 4],
            share_wire: None,
            surge_a: 0.0,
            fed: VecDeque::new(),
            wattmeter: (0.0, 0.0),
            taken: None,
        }
    }

    /// Sets the state of the bridge.
    pub fn drive(&mut self, bridge: Bridge, f_sw_hz: f64) {
        self.bridge = bridge;
        let state = match bridge {
            Bridge::Open => bridge::Bridge::Open,
            Bridge::LowerClosed => bridge::Bridge::LowerOn,
            Bridge::Switching { .. } => bridge::Bridge::Switching,
        };
        self.plant.set_drive(bridge::Drive {
            f_sw_hz: f_sw_hz.round() as u32,
            bridge: state,
        });
        if let Bridge::Switching { period, on } = bridge {
            self.plant.set_duty(f64::from(on) / f64::from(period));
        }
    }

    /// 12-bit code of a channel of ADC4: a thermistor at PB12, PB14 or PB15.
    pub fn thermistor_code(&self, channel: u32) -> u32 {
        let line = match channel {
            3 => 12,
            4 => 14,
            5 => 15,
            _ => return 0,
        };
        let place = THERMISTORS
            .iter()
            .position(|pin| *pin == Pin { port: 1, line });
        place.map_or(0, |place| {
            ntc_code(place, self.temperatures_c[place], &self.injections).into()
        })
    }

    /// 12-bit code of the reference voltage, 1.2122 V, at this supply.
    pub fn reference_code(&self) -> u32 {
        let vdda_v = self.injections.supply_v();
        let ratio = self.injections.product(InjectionKind::Reference);
        (f64::from(REFERENCE_CALIBRATION) * 3.0 / vdda_v * ratio).round() as u32
    }

    /// Supply of the chip with its injected faults, in volt.
    pub fn supply_v(&self) -> f64 {
        self.injections.supply_v()
    }

    /// Levels of a port, 0 for A. A line of the panel is high if it is pulled up and no button closes it; the wire to a second zone
    /// is high if neither zone pulls it. `released` are the lines that the program does not pull.
    pub fn levels(&self, port: u8, pulled_up: u32, released: u32) -> u32 {
        let buttons = BUTTONS.iter().zip(self.pressed);
        let closed: u32 = buttons
            .filter(|(pin, pressed)| *pressed && pin.port == port)
            .map(|(pin, _)| 1 << pin.line)
            .sum();
        let pin = board::SHARE_WIRE_PIN;
        let wire = u32::from(pin.port == port) << pin.line;
        let levels = pulled_up & !closed;
        match self.share_wire {
            Some(true) => levels | wire & released,
            Some(false) => levels & !wire,
            None => levels & (released | !wire),
        }
    }

    /// Returns `true` for each comparator whose input has been above the threshold for longer than the filter.
    pub fn comparators_above(&self) -> [bool; 2] {
        [0, 1]
            .map(|k| self.comparators[k].is_some_and(|one| self.above[k].above_s() > one.filter_s))
    }

    /// State of the bridge.
    pub fn bridge(&self) -> Bridge {
        self.bridge
    }

    /// Samples the power stage and advances it by one sampling period. Also returns the times at which comparators tripped, in
    /// seconds from the beginning.
    pub fn sample(&mut self) -> (Sample, [Option<f64>; 2]) {
        let t_s = self.plant.t_s();
        let dividers = self.plant.dividers();
        let (bus_v, mains_v) = (dividers.bus_v(), dividers.mains_v());
        let supply = self.injections.product(InjectionKind::Supply);
        let bus = code(bus_v / BUS_FULL_SCALE_V * CODES) as u16;
        let (comparators, above, surge_a) = (self.comparators, &mut self.above, self.surge_a);
        let injected = self.injections.has(InjectionKind::ComparatorDead);
        let sensor = self.injections.current_sensor();
        let dead = self.dead_comparators.map(|dead| dead || injected);
        let mut tripped = [None; 2];
        let mut step = 0;
        let dt_s = self.plant.dt_s();
        let mut pair = self.plant.sample(|i_a| {
            step += 1;
            for (k, sign) in [(0, 1.0), (1, -1.0)] {
                let Some(comparator) = comparators[k].filter(|_| !dead[k]) else {
                    continue;
                };
                let code = MIDDLE + sign * (sensor.output_a(i_a) + surge_a) / AMPERE_PER_CODE;
                let threshold = MIDDLE + (comparator.threshold_code - MIDDLE) * supply;
                let lasted = above[k].advance(code - threshold, comparator.filter_s, dt_s);
                if let Some(before_s) = lasted {
                    tripped[k].get_or_insert((f64::from(step) * dt_s - before_s).max(0.0));
                }
            }
        });
        let sampling_s = self.plant.t_s() - t_s;
        self.wattmeter.0 +=
            f64::from(pair.v) * VOLT_PER_CODE * f64::from(pair.i) * AMPERE_PER_CODE * sampling_s;
        self.wattmeter.1 += sampling_s;
        self.injections.on_pairs(std::slice::from_mut(&mut pair));
        let pair = self.fed.pop_front().unwrap_or(pair);
        if let Some(taken) = &mut self.taken {
            taken.push(pair);
        }
        (
            Sample {
                pair,
                bus: self.injections.on_bus(bus),
                mains_v,
                supply,
            },
            tripped,
        )
    }
}

impl ChangeableHob for Pins {
    fn plant(&mut self) -> &mut Plant {
        &mut self.plant
    }

    fn inject(&mut self, change: impl FnOnce(&mut Injections)) {
        change(&mut self.injections);
        let share = self.injections.product(InjectionKind::ResonanceCapacitance);
        self.plant.set_resonance_share(share);
    }

    fn set_heat_sink(&mut self, celsius: f64) {
        self.temperatures_c[0] = celsius;
    }

    fn set_glass(&mut self, celsius: f64) {
        self.temperatures_c[1] = celsius;
    }
}

/// Comparator of the chip, with the filter after it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparator {
    /// DAC code at its other input.
    pub threshold_code: f64,
    /// Duration above which a pulse trips, in seconds.
    pub filter_s: f64,
}
