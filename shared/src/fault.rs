//! The table of faults: number, name, meaning, and what to do about it. There is no other.
//!
//! A fault travels as its number, a varint of a `u16`, so a host decodes numbers that its table does
//! not know, shows "fault 120", and loses nothing else of the message. Therefore a new fault raises
//! only [`crate::wire::PROTOCOL_MINOR`]. Its number is the next free one: a number, once given, keeps
//! its meaning for ever. 1 to 3 were those of protocol 1.x.

use core::fmt;

use serde::{Deserialize, Serialize};

/// Reason of the safe state. Service manuals quote the number.
#[derive(Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fault(u16);

/// Consequence of a fault for the next start of the bridge (firmware/src/control/restart.rs).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RestartClass {
    /// It passes by itself (mains, temperature, a sensor's wire): a short pause.
    Passing,
    /// It counts a try: a pause that doubles, then lock-out.
    Trip,
    /// The controller itself is at fault: lock-out at once.
    Standing,
}

/// A row of the table.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// The fault.
    pub fault: Fault,
    /// Its name, as in captures.
    pub name: &'static str,
    /// Meaning.
    pub doc: &'static str,
    /// Message to a person: the event, and what to do about it.
    pub text: &'static str,
}

macro_rules! fault_table {
    ($($(#[doc = $doc:literal])+ $constant:ident = $number:literal $name:literal $class:ident: $text:literal;)+) => {
        impl Fault {
            $($(#[doc = $doc])+ pub const $constant: Self = Self($number);)+

            /// Its consequence for the next start; a number that this version does not know counts as a trip.
            pub const fn class(self) -> RestartClass {
                // Not from the table, whose texts the controller does not carry.
                match self.0 {
                    $($number => RestartClass::$class,)+
                    _ => RestartClass::Trip,
                }
            }

            /// Every fault of this version, in order of its number.
            pub const TABLE: &'static [Row] = &[$(Row {
                fault: Self($number),
                name: $name,
                doc: concat!($($doc),+),
                text: $text,
            }),+];
        }
    };
}

fault_table! {
    /// No fault.
    NONE = 0 "None" Trip:
        "no fault";
    /// Coil current reached the trip level, seen in the samples.
    OVER_CURRENT = 4 "OverCurrent" Trip:
        "coil current at the trip level; ask for less power, or check the current sensor";
    /// Bus voltage above its limit.
    BUS_OVER_VOLTAGE = 5 "BusOverVoltage" Passing:
        "bus voltage above its limit; check the mains";
    /// Sample blocks were lost (DMA overrun, trigger stopped).
    SAMPLES_LOST = 6 "SamplesLost" Trip:
        "sample blocks were lost; check the ADC trigger and DMA";
    /// Too many samples at the end of the ADC's range.
    SENSOR_SATURATED = 7 "SensorSaturated" Trip:
        "samples at the end of the ADC's range; check probes and gains";
    /// The inverter was about to run at or below resonance.
    BELOW_RESONANCE = 8 "BelowResonance" Trip:
        "the inverter was about to run below resonance; ask for less power";
    /// The R, L estimate left its plausible range.
    ESTIMATOR_DIVERGED = 9 "EstimatorDiverged" Trip:
        "the R, L estimate left its plausible range; check polarity and gain of both sensors";
    /// No mains zero crossing for longer than three half-cycles.
    MAINS_LOST = 10 "MainsLost" Passing:
        "no mains zero crossing for 30 ms; check mains and crossing detector";
    /// A comparator saw the coil current at the trip level and opened the bridge in hardware.
    HARDWARE_OVER_CURRENT = 11 "HardwareOverCurrent" Trip:
        "a comparator saw coil current at the trip level; check the load and the power stage";
    /// The processor locked up: a fault inside the handler of a fault.
    CORE_LOCKUP = 12 "CoreLockup" Standing:
        "the processor locked up; flash the firmware again, and report it if it comes back";
    /// The RAM's parity was wrong.
    RAM_PARITY = 13 "RamParity" Standing:
        "parity error in the controller's RAM; replace the controller if it comes back";
    /// The flash's error correction found two wrong bits in a word.
    FLASH_ECC = 14 "FlashEcc" Standing:
        "uncorrectable error in the controller's flash; flash the firmware again";
    /// The controller's supply fell below its detector's threshold.
    SUPPLY_LOW = 15 "SupplyLow" Trip:
        "the controller's supply is too low; check it";
    /// The controller's option bytes are not those that the firmware needs. Clearing does not end it.
    OPTION_BYTES = 16 "OptionBytes" Standing:
        "the controller's option bytes are wrong (one flash bank, or RAM parity off); set DBANK=1 and \
         SRAM_PE=0 with a debug probe (docs/board.md), then reset it";
    /// Coil voltage, coil current and bus voltage contradict each other or the bare coil's inductance, or a gain has drifted.
    BRIDGE_BALANCE = 17 "BridgeBalance" Trip:
        "coil voltage, coil current and bus voltage contradict each other or the bare coil's inductance, or a gain has \
         drifted; lift the pot once, check gain and wiring of the three sensors, and the resonance capacitor";
    /// A channel's mean over whole periods is not zero, or a bit of its converter sticks.
    SENSOR_OFFSET = 18 "SensorOffset" Trip:
        "coil voltage or current has an offset, which the capacitor allows none of, or a bit of its converter sticks; \
         check the sensor, and replace the controller if it is right";
    /// The samples repeat themselves to the last bit.
    SAMPLES_FROZEN = 19 "SamplesFrozen" Trip:
        "the same samples come again and again; check the ADC trigger and DMA";
    /// Mains frequency outside 44 to 66 Hz, or zero crossings that are missing or misplaced.
    MAINS_IRREGULAR = 20 "MainsIrregular" Passing:
        "mains outside 44 to 66 Hz, or its zero crossings are missing or late; check mains and crossing \
         detector";
    /// The bridge switches and no current flows.
    NO_COIL_CURRENT = 21 "NoCoilCurrent" Trip:
        "the bridge switches and no coil current flows; check coil, capacitor and current sensor";
    /// A temperature sensor's wire is broken.
    NTC_OPEN = 22 "NtcOpen" Passing:
        "a temperature sensor is not connected; check the wires of heat sink, glass and coil sensor";
    /// A temperature sensor is shorted.
    NTC_SHORT = 23 "NtcShort" Passing:
        "a temperature sensor is shorted; check the wires of heat sink, glass and coil sensor";
    /// Heat sink, glass or coil too hot for any power.
    OVER_TEMPERATURE = 24 "OverTemperature" Passing:
        "heat sink, glass or coil is too hot; let it cool down, and check fan and air inlets";
    /// Power from the DC link and into the coil differ.
    POWER_BALANCE = 25 "PowerBalance" Trip:
        "the power from the DC link and the power into the coil differ; check gain of the sensors";
    /// Zero crossings come and the bus has no voltage.
    BUS_RANGE = 26 "BusRange" Trip:
        "the mains is there and the bus reads no voltage; check fuse, rectifier and bus divider";
    /// The analogue supply is outside what readings can be corrected for, or the chip's reference voltage is.
    SUPPLY_RANGE = 27 "SupplyRange" Passing:
        "the controller's supply is not 3.3 V within 2.4 %, or the chip's reference voltage is wrong; measure 3V3, \
         and replace the controller if it is right";
    /// The CRC of the program in flash is wrong, at start or while it runs. Clearing does not end it.
    FLASH_CRC = 40 "FlashCrc" Standing:
        "the program in the controller's flash is damaged, or was not flashed as built; flash \
         target/firmware/images/stm32g474.elf again, and replace the controller if it comes back";
    /// A cell of the RAM does not keep what is written to it. Found at start, nothing runs until a start finds none; found
    /// later, clearing does not end it.
    RAM_TEST = 41 "RamTest" Standing:
        "the controller's RAM is broken; replace the controller";
    /// The processor's clock and the watchdog's do not agree. Clearing does not end it.
    CLOCK = 42 "Clock" Standing:
        "the controller's two clocks disagree by more than their tolerances; replace the controller";
    /// One of the two watchdogs, of the program or of its sampling, did not bite when it was tried at start. Clearing does
    /// not end it.
    WATCHDOG_TEST = 43 "WatchdogTest" Standing:
        "a watchdog of the controller does not work; replace the controller";
    /// The end of the stack was written to. Clearing does not end it.
    STACK_CANARY = 44 "StackCanary" Standing:
        "the controller's stack was used to its end; switch it off and on, and report it if it comes back";
    /// A task runs too often or too seldom. Clearing does not end it.
    PROGRAM_FLOW = 45 "ProgramFlow" Standing:
        "a task of the controller runs at the wrong rate; switch it off and on, and report it if it comes back";
    /// The active lookup, a table, or the program's copy in RAM has changed by itself. Clearing does not end it.
    DATA_CRC = 46 "DataCrc" Standing:
        "data in the controller's RAM has changed by itself; switch it off and on, and replace the controller if \
         it comes back";
    /// A comparator did not trip when it was tried at start, or trips without a reason. Clearing does not end it.
    COMPARATOR_TEST = 47 "ComparatorTest" Standing:
        "the trip of the coil current in hardware does not work; check the front end at PA1 and PA7";
}

/// Text of a number that [`Fault::TABLE`] lacks.
const UNKNOWN: &str = "unknown to this version: update ihd";

impl Fault {
    /// The fault with a number, known to this version or not.
    pub const fn from_number(number: u16) -> Self {
        Self(number)
    }

    /// The fault's number.
    pub const fn number(self) -> u16 {
        self.0
    }

    /// Its row; `None` when it is newer than this version.
    pub fn row(self) -> Option<&'static Row> {
        Self::TABLE.iter().find(|row| row.fault == self)
    }

    /// Its name; `None` when it is newer than this version.
    pub fn name(self) -> Option<&'static str> {
        self.row().map(|row| row.name)
    }

    /// Event and advice, without the number.
    pub fn text(self) -> &'static str {
        self.row().map_or(UNKNOWN, |row| row.text)
    }
}

/// Number and text.
impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.0, self.row()) {
            (0, _) => f.write_str(self.text()),
            (number, Some(row)) => write!(f, "fault {number}: {}", row.text),
            (number, None) => write!(f, "fault {number} ({UNKNOWN})"),
        }
    }
}

/// The name, or the number of one that has no name here.
impl fmt::Debug for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.name() {
            Some(name) => f.write_str(name),
            None => write!(f, "fault {}", self.0),
        }
    }
}

// Ascending, so unique; the first is none, as the default is.
const _: () = {
    assert!(Fault::TABLE[0].fault.0 == 0);
    let mut k = 1;
    while k < Fault::TABLE.len() {
        assert!(Fault::TABLE[k - 1].fault.0 < Fault::TABLE[k].fault.0);
        k += 1;
    }
};

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::{format, string::ToString};

    use super::*;

    #[test]
    fn an_unknown_number_is_shown_as_its_number() {
        let fault = Fault::from_number(120);
        assert_eq!(
            fault.to_string(),
            "fault 120 (unknown to this version: update ihd)"
        );
        assert_eq!(format!("{fault:?}"), "fault 120");
        assert_eq!((fault.name(), fault.number()), (None, 120));
    }

    #[test]
    fn a_known_one_is_shown_with_number_and_text() {
        assert_eq!(
            Fault::BUS_OVER_VOLTAGE.to_string(),
            "fault 5: bus voltage above its limit; check the mains"
        );
        assert_eq!(format!("{:?}", Fault::BUS_OVER_VOLTAGE), "BusOverVoltage");
        assert_eq!(Fault::NONE.to_string(), "no fault");
        assert_eq!(Fault::default(), Fault::NONE);
    }

    #[test]
    fn each_has_a_name_and_a_text_of_its_own() {
        let names: BTreeSet<&str> = Fault::TABLE.iter().map(|row| row.name).collect();
        let texts: BTreeSet<&str> = Fault::TABLE.iter().map(|row| row.text).collect();
        assert_eq!(names.len(), Fault::TABLE.len());
        assert_eq!(texts.len(), Fault::TABLE.len());
    }

    /// On the wire a fault is its number, of variable length.
    #[test]
    fn a_number_below_128_is_one_byte() {
        for number in 0..128 {
            let mut bytes = [0; 4];
            let used = postcard::to_slice(&Fault::from_number(number), &mut bytes);
            assert_eq!(used, Ok(&mut [number as u8][..]));
        }
        for number in [128, 300, u16::MAX] {
            let mut bytes = [0; 4];
            let fault = Fault::from_number(number);
            let used = postcard::to_slice(&fault, &mut bytes).expect("at most three bytes");
            assert_eq!(postcard::from_bytes(used), Ok(fault));
        }
    }
}
