//! Faults of sensors, sampling and crossings, injected between plant and firmware, and of the resonance capacitor.

use std::collections::VecDeque;
use std::fmt;

use ihd_shared::sampling::{
    ADC_LOCK_P, AMPERE_PER_CODE, CODE_HALF_RANGE, CODE_MAX, CODE_MIN, Pair, VOLT_PER_CODE,
};
use serde::{Deserialize, Serialize};

use crate::front_end::NOMINAL_SUPPLY_V;
use crate::slow_adc::SlowBlock;

/// Supply below which the chip's detector (PVD) opens the bridge, in volt (docs/board.md, "Protection").
pub const DETECTOR_V: f64 = 2.9;

/// Kind of fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum InjectionKind {
    /// The current sensor's gain is multiplied by the value: for converter and comparators.
    CurrentGain,
    /// Voltage codes are multiplied by the value.
    VoltageGain,
    /// The value is added to the current sensor's output, in ampere.
    CurrentOffset,
    /// The value is added to the voltage, in volt.
    VoltageOffset,
    /// Codes of the bus voltage are multiplied by the value.
    BusScale,
    /// Current codes are frozen.
    CurrentStuck,
    /// Voltage codes are frozen.
    VoltageStuck,
    /// The bit of the value, 0 to 11, of the offset binary code is always one.
    AdcBitStuck,
    /// Voltage and current are exchanged.
    ChannelsSwapped,
    /// The same block is repeated.
    FrozenSamples,
    /// Blocks whose number is a multiple of the value are lost.
    LostBlocks,
    /// Zero crossings whose number is a multiple of the value are lost.
    LostCrossings,
    /// Zero crossings are detected late by the value, in milliseconds.
    LateCrossings,
    /// The comparator on the coil current is dead.
    ComparatorDead,
    /// The wire of a temperature sensor is open.
    NtcOpen,
    /// A temperature sensor has a short circuit.
    NtcShort,
    /// The analogue supply is multiplied by the value: every code is divided by it.
    Supply,
    /// The chip's reference voltage is multiplied by the value.
    Reference,
    /// The resonance capacitor's capacitance is multiplied by the value; its voltage stays.
    ResonanceCapacitance,
}

/// Channel of the fault, for kinds that have a choice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultChannel {
    /// The coil's current.
    Current,
    /// The coil's voltage.
    Voltage,
    /// Temperature of the heat sink.
    HeatSink,
    /// Temperature under the glass.
    Glass,
    /// Temperature of the coil.
    Coil,
}

/// Fault of one kind.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Injection {
    /// Kind.
    pub kind: InjectionKind,
    /// Magnitude in the unit of the kind; 0 for kinds without one.
    pub value: f64,
    /// Channel.
    pub channel: FaultChannel,
}

impl fmt::Display for InjectionKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

impl InjectionKind {
    /// Range of the value with its text; `None` for kinds without a value.
    pub fn range(self) -> Option<(f64, f64, &'static str)> {
        match self {
            Self::CurrentGain | Self::VoltageGain | Self::BusScale => {
                Some((0.0, 10.0, "a factor from 0 to 10"))
            }
            Self::Supply | Self::Reference => Some((0.8, 1.2, "a factor from 0.8 to 1.2")),
            Self::ResonanceCapacitance => Some((0.1, 2.0, "a factor from 0.1 to 2")),
            Self::CurrentOffset => Some((-160.0, 160.0, "-160 to 160 A")),
            Self::VoltageOffset => Some((-1300.0, 1300.0, "-1300 to 1300 V")),
            Self::AdcBitStuck => Some((0.0, 11.0, "a bit from 0 to 11")),
            Self::LostBlocks => Some((1.0, 1e6, "1 for every block, 2 for every other, …")),
            Self::LostCrossings => Some((1.0, 1e6, "1 for every crossing, 2 for every other, …")),
            Self::LateCrossings => Some((0.0, 20.0, "0 to 20 ms")),
            Self::CurrentStuck
            | Self::VoltageStuck
            | Self::ChannelsSwapped
            | Self::FrozenSamples
            | Self::ComparatorDead
            | Self::NtcOpen
            | Self::NtcShort => None,
        }
    }

    /// Default channel.
    pub fn default_channel(self) -> FaultChannel {
        match self {
            Self::NtcOpen | Self::NtcShort => FaultChannel::HeatSink,
            _ => FaultChannel::Current,
        }
    }
}

/// Output of the current sensor, which feeds converter and comparators: gain times the coil current, plus an offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurrentSensor {
    /// Gain; 1 for a sensor that is right.
    pub gain: f64,
    /// Offset in ampere.
    pub offset_a: f64,
}

impl Default for CurrentSensor {
    /// Creates a sensor that is right.
    fn default() -> Self {
        Self {
            gain: 1.0,
            offset_a: 0.0,
        }
    }
}

impl CurrentSensor {
    /// Output at a coil current, both in ampere.
    #[inline]
    pub fn output_a(&self, i_a: f64) -> f64 {
        self.gain * i_a + self.offset_a
    }
}

/// Active fault.
#[derive(Clone, Debug)]
struct ActiveInjection {
    number: u32,
    injection: Injection,
    /// Samples at its start, for kinds that freeze.
    held: Vec<Pair>,
    /// Number of blocks or crossings since its start.
    count: u64,
}

/// All active faults.
#[derive(Clone, Debug, Default)]
pub struct Injections {
    active: Vec<ActiveInjection>,
    started: u32,
    /// Delayed crossings: times at which they are due, in seconds.
    late_s: VecDeque<f64>,
}

impl Injections {
    /// Starts a fault; returns the number that ends it.
    pub fn start(&mut self, injection: Injection) -> u32 {
        self.started += 1;
        self.active.push(ActiveInjection {
            number: self.started,
            injection,
            held: Vec::new(),
            count: 0,
        });
        self.started
    }

    /// Ends the fault with a number.
    pub fn end(&mut self, number: u32) {
        self.active.retain(|a| a.number != number);
    }

    /// Returns `true` if a fault of this kind is active.
    pub fn has(&self, kind: InjectionKind) -> bool {
        self.active.iter().any(|a| a.injection.kind == kind)
    }

    /// Kind of the latest active fault on a temperature channel.
    pub fn ntc(&self, channel: FaultChannel) -> Option<InjectionKind> {
        let on = |a: &&ActiveInjection| {
            let kind = a.injection.kind;
            let ntc = matches!(kind, InjectionKind::NtcOpen | InjectionKind::NtcShort);
            ntc && a.injection.channel == channel
        };
        self.active.iter().rev().find(on).map(|a| a.injection.kind)
    }

    /// Applies the faults to samples, as many in every call.
    pub fn on_pairs(&mut self, pairs: &mut [Pair]) {
        for a in &mut self.active {
            a.on_pairs(pairs);
        }
    }

    /// Supply of chip and front end, in volt.
    pub fn supply_v(&self) -> f64 {
        NOMINAL_SUPPLY_V * self.product(InjectionKind::Supply)
    }

    /// Returns `true` while the supply is so low that the chip's detector holds the bridge open.
    pub fn is_supply_low(&self) -> bool {
        self.supply_v() < DETECTOR_V
    }

    /// The current sensor with its faults, in the order in which [`Injections::on_pairs`] applies them.
    pub fn current_sensor(&self) -> CurrentSensor {
        let mut sensor = CurrentSensor::default();
        for Injection { kind, value, .. } in self.active.iter().map(|a| a.injection) {
            match kind {
                InjectionKind::CurrentGain => {
                    sensor.gain *= value;
                    sensor.offset_a *= value;
                }
                InjectionKind::CurrentOffset => sensor.offset_a += value,
                _ => {}
            }
        }
        sensor
    }

    /// Applies the faults to the codes of the slow converter.
    pub fn on_slow(&self, slow: SlowBlock) -> SlowBlock {
        let supply = self.product(InjectionKind::Supply);
        let mains = (f64::from(slow.mains) / supply).round();
        SlowBlock {
            bus: slow.bus.map(|code| self.on_bus(code)),
            mains: mains.clamp(f64::from(CODE_MIN), f64::from(CODE_MAX)) as i32,
        }
    }

    /// Applies the faults to a code of the bus voltage.
    pub fn on_bus(&self, code: u16) -> u16 {
        let scale = self.product(InjectionKind::BusScale) / self.product(InjectionKind::Supply);
        (f64::from(code) * scale).round().min(4095.0) as u16
    }

    /// Product of the values of all active faults of a kind; 1 if there is none.
    pub fn product(&self, kind: InjectionKind) -> f64 {
        let of_kind = self.active.iter().filter(|a| a.injection.kind == kind);
        of_kind.map(|a| a.injection.value).product()
    }

    /// Returns `true` if this block is lost.
    pub fn on_block(&mut self) -> bool {
        let mut lost = false;
        for a in &mut self.active {
            lost |= a.is_turn(InjectionKind::LostBlocks);
        }
        lost
    }

    /// Applies the faults to a crossing before pair `at` of a block from `start_s` to `end_s`.
    pub fn on_crossing(&mut self, at: Option<u8>, start_s: f64, end_s: f64) -> Option<u8> {
        let mut seen = at;
        if at.is_some() {
            for a in &mut self.active {
                if a.is_turn(InjectionKind::LostCrossings) {
                    seen = None;
                }
            }
        }
        let late = |a: &&ActiveInjection| a.injection.kind == InjectionKind::LateCrossings;
        let Some(late) = self.active.iter().find(late) else {
            self.late_s.clear();
            return seen;
        };
        let pair_s = (end_s - start_s) / ADC_LOCK_P as f64;
        if let Some(at) = seen {
            let due_s = start_s + f64::from(at) * pair_s + late.injection.value * 1e-3;
            self.late_s.push_back(due_s);
        }
        let due_s = *self.late_s.front().filter(|due_s| **due_s < end_s)?;
        self.late_s.pop_front();
        let pair = ((due_s - start_s) / pair_s).ceil().max(0.0);
        Some(pair.min(ADC_LOCK_P as f64 - 1.0) as u8)
    }
}

impl ActiveInjection {
    /// Counts for kinds that act periodically; returns `true` if the kind acts now.
    fn is_turn(&mut self, kind: InjectionKind) -> bool {
        if self.injection.kind != kind {
            return false;
        }
        self.count += 1;
        self.count
            .is_multiple_of((self.injection.value as u64).max(1))
    }

    fn on_pairs(&mut self, pairs: &mut [Pair]) {
        let Injection {
            kind,
            value,
            channel,
        } = self.injection;
        if self.held.is_empty() {
            self.held.extend_from_slice(pairs);
        }
        let first = self.held[0];
        for (pair, frozen) in pairs.iter_mut().zip(&self.held) {
            match kind {
                InjectionKind::CurrentGain => pair.i = code(f64::from(pair.i) * value),
                InjectionKind::VoltageGain => pair.v = code(f64::from(pair.v) * value),
                InjectionKind::Supply => {
                    pair.v = code(f64::from(pair.v) / value);
                    pair.i = code(f64::from(pair.i) / value);
                }
                InjectionKind::CurrentOffset => {
                    pair.i = code(f64::from(pair.i) + value / AMPERE_PER_CODE);
                }
                InjectionKind::VoltageOffset => {
                    pair.v = code(f64::from(pair.v) + value / VOLT_PER_CODE);
                }
                InjectionKind::CurrentStuck => pair.i = first.i,
                InjectionKind::VoltageStuck => pair.v = first.v,
                InjectionKind::AdcBitStuck if channel == FaultChannel::Voltage => {
                    pair.v = with_bit(pair.v, value);
                }
                InjectionKind::AdcBitStuck => pair.i = with_bit(pair.i, value),
                InjectionKind::ChannelsSwapped => {
                    *pair = Pair {
                        v: pair.i,
                        i: pair.v,
                    };
                }
                InjectionKind::FrozenSamples => *pair = *frozen,
                InjectionKind::BusScale
                | InjectionKind::LostBlocks
                | InjectionKind::LostCrossings
                | InjectionKind::LateCrossings
                | InjectionKind::ComparatorDead
                | InjectionKind::NtcOpen
                | InjectionKind::NtcShort
                | InjectionKind::Reference
                | InjectionKind::ResonanceCapacitance => return,
            }
        }
    }
}

/// Clamps to the 12-bit range.
fn code(value: f64) -> i16 {
    value
        .round()
        .clamp(f64::from(CODE_MIN), f64::from(CODE_MAX)) as i16
}

/// Sets a bit of the converter's offset binary code.
fn with_bit(signed: i16, bit: f64) -> i16 {
    ((signed + CODE_HALF_RANGE) | (1 << (bit as u32).min(11))) - CODE_HALF_RANGE
}

#[cfg(test)]
mod tests;
