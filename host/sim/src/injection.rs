//! Faults of sensors, sampling and crossings, put in between plant and firmware.

use std::collections::VecDeque;
use std::fmt;

use ihd_shared::sampling::{
    ADC_LOCK_P, AMPERE_PER_CODE, CODE_HALF_RANGE, CODE_MAX, CODE_MIN, Pair, VOLT_PER_CODE,
};
use serde::{Deserialize, Serialize};

/// What is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum InjectionKind {
    /// Current codes times the value.
    CurrentGain,
    /// Voltage codes times the value.
    VoltageGain,
    /// Current plus the value, in ampere.
    CurrentOffset,
    /// Voltage plus the value, in volt.
    VoltageOffset,
    /// Codes of the bus voltage times the value.
    BusScale,
    /// Current codes stay where they are.
    CurrentStuck,
    /// Voltage codes stay where they are.
    VoltageStuck,
    /// The bit of the value, 0 to 11, of the offset binary code is always one.
    AdcBitStuck,
    /// Voltage is read as current and current as voltage.
    ChannelsSwapped,
    /// The same block comes again and again.
    FrozenSamples,
    /// Every block whose number is a multiple of the value does not arrive.
    LostBlocks,
    /// Every zero crossing whose number is a multiple of the value is not seen.
    LostCrossings,
    /// Zero crossings are seen later by the value, in milliseconds.
    LateCrossings,
    /// The comparator on the coil current does nothing.
    ComparatorDead,
    /// The wire of a temperature sensor is broken.
    NtcOpen,
    /// A temperature sensor has a short circuit.
    NtcShort,
}

/// Where it is wrong, for kinds that leave a choice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Channel {
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

/// One of them, with its number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Injection {
    /// What.
    pub kind: InjectionKind,
    /// How much, in the unit of the kind; 0 for those that need none.
    pub value: f64,
    /// Where.
    pub channel: Channel,
}

impl fmt::Display for InjectionKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

impl InjectionKind {
    /// Values that make sense, and how to say so; `None` for kinds without a value.
    pub fn range(self) -> Option<(f64, f64, &'static str)> {
        match self {
            Self::CurrentGain | Self::VoltageGain | Self::BusScale => {
                Some((0.0, 10.0, "a factor from 0 to 10"))
            }
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

    /// The channel that is meant when none is named.
    pub fn default_channel(self) -> Channel {
        match self {
            Self::NtcOpen | Self::NtcShort => Channel::HeatSink,
            _ => Channel::Current,
        }
    }
}

/// One that is in force.
#[derive(Clone, Debug)]
struct Active {
    number: u32,
    injection: Injection,
    /// Block of the first moment, for what sticks.
    held: Option<[Pair; ADC_LOCK_P]>,
    /// Blocks or crossings since its start.
    count: u64,
}

/// All that are in force.
#[derive(Clone, Debug, Default)]
pub struct Injections {
    active: Vec<Active>,
    started: u32,
    /// Late crossings under way: when they are due, in seconds.
    late_s: VecDeque<f64>,
}

impl Injections {
    /// Puts one in force; returns the number that ends it.
    pub fn start(&mut self, injection: Injection) -> u32 {
        self.started += 1;
        self.active.push(Active {
            number: self.started,
            injection,
            held: None,
            count: 0,
        });
        self.started
    }

    /// Ends the one with a number.
    pub fn end(&mut self, number: u32) {
        self.active.retain(|a| a.number != number);
    }

    /// Whether a kind is in force.
    pub fn has(&self, kind: InjectionKind) -> bool {
        self.active.iter().any(|a| a.injection.kind == kind)
    }

    /// The kinds in force on a temperature channel, the last one counts.
    pub fn ntc(&self, channel: Channel) -> Option<InjectionKind> {
        let on = |a: &&Active| {
            let kind = a.injection.kind;
            let ntc = matches!(kind, InjectionKind::NtcOpen | InjectionKind::NtcShort);
            ntc && a.injection.channel == channel
        };
        self.active.iter().rev().find(on).map(|a| a.injection.kind)
    }

    /// What becomes of a block's samples.
    pub fn on_pairs(&mut self, pairs: &mut [Pair; ADC_LOCK_P]) {
        for a in &mut self.active {
            a.on_pairs(pairs);
        }
    }

    /// What becomes of a code of the bus voltage.
    pub fn on_bus(&self, code: u16) -> u16 {
        let scales = self
            .active
            .iter()
            .filter(|a| a.injection.kind == InjectionKind::BusScale);
        let scale: f64 = scales.map(|a| a.injection.value).product();
        (f64::from(code) * scale).round().min(4095.0) as u16
    }

    /// Whether this block gets lost.
    pub fn on_block(&mut self) -> bool {
        let mut lost = false;
        for a in &mut self.active {
            lost |= a.is_turn(InjectionKind::LostBlocks);
        }
        lost
    }

    /// What becomes of a crossing seen before pair `at` of a block from `start_s` to `end_s`.
    pub fn on_crossing(&mut self, at: Option<u8>, start_s: f64, end_s: f64) -> Option<u8> {
        let mut seen = at;
        if at.is_some() {
            for a in &mut self.active {
                if a.is_turn(InjectionKind::LostCrossings) {
                    seen = None;
                }
            }
        }
        let late = |a: &&Active| a.injection.kind == InjectionKind::LateCrossings;
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

impl Active {
    /// Counts, for kinds that act every so often; whether it is this one's turn.
    fn is_turn(&mut self, kind: InjectionKind) -> bool {
        if self.injection.kind != kind {
            return false;
        }
        self.count += 1;
        self.count
            .is_multiple_of((self.injection.value as u64).max(1))
    }

    fn on_pairs(&mut self, pairs: &mut [Pair; ADC_LOCK_P]) {
        let Injection {
            kind,
            value,
            channel,
        } = self.injection;
        let held = *self.held.get_or_insert(*pairs);
        let first = held[0];
        for (pair, frozen) in pairs.iter_mut().zip(held) {
            match kind {
                InjectionKind::CurrentGain => pair.i = code(f64::from(pair.i) * value),
                InjectionKind::VoltageGain => pair.v = code(f64::from(pair.v) * value),
                InjectionKind::CurrentOffset => {
                    pair.i = code(f64::from(pair.i) + value / AMPERE_PER_CODE);
                }
                InjectionKind::VoltageOffset => {
                    pair.v = code(f64::from(pair.v) + value / VOLT_PER_CODE);
                }
                InjectionKind::CurrentStuck => pair.i = first.i,
                InjectionKind::VoltageStuck => pair.v = first.v,
                InjectionKind::AdcBitStuck if channel == Channel::Voltage => {
                    pair.v = with_bit(pair.v, value);
                }
                InjectionKind::AdcBitStuck => pair.i = with_bit(pair.i, value),
                InjectionKind::ChannelsSwapped => {
                    *pair = Pair {
                        v: pair.i,
                        i: pair.v,
                    };
                }
                InjectionKind::FrozenSamples => *pair = frozen,
                InjectionKind::BusScale
                | InjectionKind::LostBlocks
                | InjectionKind::LostCrossings
                | InjectionKind::LateCrossings
                | InjectionKind::ComparatorDead
                | InjectionKind::NtcOpen
                | InjectionKind::NtcShort => return,
            }
        }
    }
}

/// A code of the 12-bit range.
fn code(value: f64) -> i16 {
    value
        .round()
        .clamp(f64::from(CODE_MIN), f64::from(CODE_MAX)) as i16
}

/// The converter's code is offset binary: a bit of it is always one.
fn with_bit(signed: i16, bit: f64) -> i16 {
    ((signed + CODE_HALF_RANGE) | (1 << (bit as u32).min(11))) - CODE_HALF_RANGE
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAIR: Pair = Pair { v: 800, i: -512 };

    fn after(kind: InjectionKind, value: f64, channel: Channel) -> Pair {
        let mut injections = Injections::default();
        injections.start(Injection {
            kind,
            value,
            channel,
        });
        let mut first = [PAIR; ADC_LOCK_P];
        first[0] = Pair { v: 5, i: 6 };
        injections.on_pairs(&mut first);
        let mut pairs = [PAIR; ADC_LOCK_P];
        injections.on_pairs(&mut pairs);
        assert!(pairs[1..].iter().all(|p| *p == pairs[1]));
        pairs[1]
    }

    #[test]
    fn each_kind_does_to_the_codes_what_it_says() {
        use InjectionKind as K;
        let current = |kind, value| after(kind, value, Channel::Current);
        assert_eq!(current(K::CurrentGain, 0.8), Pair { v: 800, i: -410 });
        assert_eq!(current(K::VoltageGain, 1.25), Pair { v: 1000, i: -512 });
        assert_eq!(current(K::VoltageGain, 5.0).v, CODE_MAX);
        let amperes = 100.0 * AMPERE_PER_CODE;
        assert_eq!(current(K::CurrentOffset, amperes), Pair { v: 800, i: -412 });
        let volts = -100.0 * VOLT_PER_CODE;
        assert_eq!(current(K::VoltageOffset, volts), Pair { v: 700, i: -512 });
        assert_eq!(current(K::CurrentStuck, 0.0), Pair { v: 800, i: 6 });
        assert_eq!(current(K::VoltageStuck, 0.0), Pair { v: 5, i: -512 });
        assert_eq!(current(K::ChannelsSwapped, 0.0), Pair { v: -512, i: 800 });
        // −512 + 2048 = 0b110_0000_0000: bit 3 is new, bit 10 is there.
        assert_eq!(current(K::AdcBitStuck, 3.0), Pair { v: 800, i: -504 });
        assert_eq!(current(K::AdcBitStuck, 10.0), PAIR);
        assert_eq!(after(K::AdcBitStuck, 0.0, Channel::Voltage).v, 801);
        assert_eq!(current(K::ComparatorDead, 0.0), PAIR);
    }

    fn one(kind: InjectionKind, value: f64) -> Injections {
        let mut injections = Injections::default();
        injections.start(Injection {
            kind,
            value,
            channel: Channel::Current,
        });
        injections
    }

    #[test]
    fn frozen_samples_repeat_the_first_block_and_end_with_their_number() {
        let mut injections = Injections::default();
        let number = injections.start(Injection {
            kind: InjectionKind::FrozenSamples,
            value: 0.0,
            channel: Channel::Current,
        });
        let mut blocks = [[Pair { v: 1, i: 2 }; ADC_LOCK_P], [PAIR; ADC_LOCK_P]];
        blocks.iter_mut().for_each(|b| injections.on_pairs(b));
        assert_eq!(blocks[1], blocks[0]);
        injections.end(number);
        let mut block = [PAIR; ADC_LOCK_P];
        injections.on_pairs(&mut block);
        assert_eq!(block, [PAIR; ADC_LOCK_P]);
    }

    #[test]
    fn every_second_block_and_every_third_crossing_is_lost() {
        let mut blocks = one(InjectionKind::LostBlocks, 2.0);
        let lost: Vec<bool> = (0..4).map(|_| blocks.on_block()).collect();
        assert_eq!(lost, [false, true, false, true]);
        let mut crossings = one(InjectionKind::LostCrossings, 3.0);
        let seen: Vec<Option<u8>> = (0..6)
            .map(|_| crossings.on_crossing(Some(7), 0.0, 1e-4))
            .collect();
        assert_eq!(seen, [Some(7), Some(7), None, Some(7), Some(7), None]);
        assert_eq!(crossings.on_crossing(None, 0.0, 1e-4), None);
    }

    #[test]
    fn a_late_crossing_comes_in_the_block_in_which_it_is_due() {
        let mut late = one(InjectionKind::LateCrossings, 0.2505);
        let block_s = 61e-6;
        let seen: Vec<Option<u8>> = (0..6)
            .map(|n| {
                let at = (n == 0).then_some(10);
                late.on_crossing(at, f64::from(n) * block_s, f64::from(n + 1) * block_s)
            })
            .collect();
        // 10 µs + 250.5 µs are 16.5 µs into the fifth block of 61 µs.
        assert_eq!(seen, [None, None, None, None, Some(17), None]);
    }

    #[test]
    fn the_bus_is_scaled() {
        assert_eq!(one(InjectionKind::BusScale, 0.5).on_bus(2600), 1300);
        assert_eq!(one(InjectionKind::BusScale, 3.0).on_bus(2600), 4095);
        assert_eq!(Injections::default().on_bus(2600), 2600);
    }
}
