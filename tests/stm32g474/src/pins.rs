//! What is wired to the chip's pins: the project's own power stage with a load, and the other end of the USB cable.

use std::collections::VecDeque;

use ihd_firmware::drive::bridge;
use ihd_firmware::sense::mains::MAINS_FULL_SCALE_V;
use ihd_shared::board::{self, BUS_FULL_SCALE_DV, Pin};
use ihd_shared::sampling::{
    AMPERE_PER_CODE, CODE_HALF_RANGE, CODE_MAX, CODE_MIN, Pair, VOLT_PER_CODE,
};
use ihd_sim::adc::SimulatedAdc;
use ihd_sim::hob::HobConfig;
use ihd_sim::plant::Plant;
use ihd_sim::temperatures::NTCS;

use crate::chip::hrtim::Bridge;
use crate::processor::REFERENCE_CALIBRATION;
use crate::usb::host::HostController;

/// Volt of the bus over the range of 12 bit (docs/board.md: PB1).
const BUS_RANGE_V: f64 = BUS_FULL_SCALE_DV as f64 / 10.0;

/// Supply by which the front end's scales are given, in volt (docs/board.md).
const NOMINAL_VDDA_V: f64 = 3.3;

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

/// The analogue front end that `ihd hob` has: half an LSB of noise, with this seed, behind its anti-alias filter.
pub fn front_end(seed: u64) -> SimulatedAdc {
    let hob = HobConfig::default();
    SimulatedAdc::new(hob.noise, seed).with_filter(hob.anti_alias_hz)
}

/// What the converters find at a trigger.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    pair: Pair,
    bus_v: f64,
    mains_v: f64,
    /// The supply over the nominal one.
    supply: f64,
}

impl Sample {
    /// The 12-bit code of a channel of an ADC (docs/board.md, "Pins").
    pub fn code(&self, adc: u32, channel: u32) -> u32 {
        let code = |value: f64| value.round().clamp(0.0, CODES - 1.0) as u32;
        // The front end's zero is half the supply.
        let from_middle = |signed: f64| code(MIDDLE + signed / self.supply);
        match (adc, channel) {
            (1, 1) => from_middle(self.pair.v.into()),
            (2, 2) => from_middle(self.pair.i.into()),
            (3, 1) => code(self.bus_v / BUS_RANGE_V * CODES / self.supply),
            (3, 12) => from_middle(self.mains_v / MAINS_FULL_SCALE_V * MIDDLE),
            // A pin that nothing is wired to.
            _ => 0,
        }
    }
}

/// The world outside the chip.
pub struct Pins {
    /// The power stage.
    pub plant: Plant,
    /// What is at the other end of the USB cable.
    pub usb: HostController,
    bridge: Bridge,
    /// The comparators' settings: PA1 and PA7, the latter inverted. `None` does not compare.
    pub comparators: [Option<Comparator>; 2],
    /// Time for which each comparator has been above its threshold, in seconds.
    above_s: [f64; 2],
    /// Comparators that never trip: a test's interference.
    pub dead_comparators: [bool; 2],
    /// Temperatures of heat sink, glass and coil in °C.
    pub temperatures_c: [f64; 3],
    /// The analogue supply, in volt, which every channel is a ratio of.
    pub vdda_v: f64,
    /// The chip's reference voltage over what it should be.
    pub reference_ratio: f64,
    /// Buttons of the panel that are pressed, on/off, plus, minus, timer.
    pub pressed: [bool; 4],
    /// The wire to a second zone is there with its resistor, and that zone does not pull it.
    pub share_wire_high: bool,
    /// Added to every pair's codes: offsets of the two sensors.
    pub offset: Pair,
    /// Added to what the current sensor shows, in ampere: a test's surge.
    pub surge_a: f64,
    /// Pairs that the converters find in place of the power stage's, while there are any.
    pub fed: VecDeque<Pair>,
    /// Energy that the pairs have carried, in joule, and the time that took, in seconds: a wattmeter.
    pub wattmeter: (f64, f64),
    /// What the converters found, if somebody wants it.
    pub taken: Option<Vec<Pair>>,
}

impl Pins {
    /// A power stage on the pins, and one end of a USB cable.
    pub fn new(plant: Plant, usb: HostController) -> Self {
        Self {
            plant,
            usb,
            bridge: Bridge::Open,
            comparators: [None; 2],
            above_s: [0.0; 2],
            dead_comparators: [false; 2],
            temperatures_c: [25.0; 3],
            vdda_v: NOMINAL_VDDA_V,
            reference_ratio: 1.0,
            pressed: [false; 4],
            share_wire_high: false,
            offset: Pair::default(),
            surge_a: 0.0,
            fed: VecDeque::new(),
            wattmeter: (0.0, 0.0),
            taken: None,
        }
    }

    /// What the bridge does from now on.
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

    /// The 12-bit code of a channel of ADC4: a thermistor at PB12, PB14 or PB15.
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
            NTCS[place].code(self.temperatures_c[place]).into()
        })
    }

    /// The 12-bit code of the reference voltage, 1.2122 V, at this supply.
    pub fn reference_code(&self) -> u32 {
        let code = f64::from(REFERENCE_CALIBRATION) * 3.0 / self.vdda_v * self.reference_ratio;
        code.round() as u32
    }

    /// Levels of a port, 0 for A, of which the panel's lines are high where a pull-up holds them and no button closes them, and the
    /// wire to a second zone where neither zone pulls it: `released` are the lines that the program does not.
    pub fn levels(&self, port: u8, pulled_up: u32, released: u32) -> u32 {
        let buttons = BUTTONS.iter().zip(self.pressed);
        let closed: u32 = buttons
            .filter(|(pin, pressed)| *pressed && pin.port == port)
            .map(|(pin, _)| 1 << pin.line)
            .sum();
        let wire = match board::SHARE_WIRE_PIN {
            pin if pin.port == port && self.share_wire_high => (1 << pin.line) & released,
            _ => 0,
        };
        pulled_up & !closed | wire
    }

    /// What the bridge does.
    pub fn bridge(&self) -> Bridge {
        self.bridge
    }

    /// Lets the power stage go on for one sampling period, and takes what stands at its beginning. Also returns which
    /// comparators tripped, and how long after the beginning, in seconds.
    pub fn sample(&mut self) -> (Sample, [Option<f64>; 2]) {
        let t_s = self.plant.t_s();
        let dividers = self.plant.dividers();
        let (bus_v, mains_v) = (dividers.bus_v(), dividers.mains_v());
        let supply = self.vdda_v / NOMINAL_VDDA_V;
        let (comparators, above_s, surge_a) = (self.comparators, &mut self.above_s, self.surge_a);
        let dead = self.dead_comparators;
        let mut tripped = [None; 2];
        let mut step = 0;
        let dt_s = self.plant.dt_s();
        let pair = self.plant.sample(|i_a| {
            step += 1;
            for (k, sign) in [(0, 1.0), (1, -1.0)] {
                let Some(comparator) = comparators[k].filter(|_| !dead[k]) else {
                    continue;
                };
                let code = MIDDLE + sign * (i_a + surge_a) / AMPERE_PER_CODE;
                let threshold = MIDDLE + (comparator.threshold_code - MIDDLE) * supply;
                above_s[k] = if code > threshold {
                    above_s[k] + dt_s
                } else {
                    0.0
                };
                if above_s[k] > comparator.filter_s {
                    tripped[k].get_or_insert(f64::from(step) * dt_s);
                }
            }
        });
        let sampling_s = self.plant.t_s() - t_s;
        self.wattmeter.0 +=
            f64::from(pair.v) * VOLT_PER_CODE * f64::from(pair.i) * AMPERE_PER_CODE * sampling_s;
        self.wattmeter.1 += sampling_s;
        let pair = self.fed.pop_front().unwrap_or(Pair {
            v: (pair.v + self.offset.v).clamp(CODE_MIN, CODE_MAX),
            i: (pair.i + self.offset.i).clamp(CODE_MIN, CODE_MAX),
        });
        if let Some(taken) = &mut self.taken {
            taken.push(pair);
        }
        (
            Sample {
                pair,
                bus_v,
                mains_v,
                supply,
            },
            tripped,
        )
    }
}

/// A comparator of the chip with the filter behind it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparator {
    /// The DAC's code at its other input.
    pub threshold_code: f64,
    /// What is shorter than this does not trip, in seconds.
    pub filter_s: f64,
}
