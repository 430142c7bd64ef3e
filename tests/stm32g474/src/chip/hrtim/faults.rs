//! HRTIM's fault inputs and the system fault (RM0440, 27.3.17).

use super::Hrtim;
use crate::chip::register_file::RegisterFile;
use crate::registers::{Field, hrtim_common, hrtim_tima};
use crate::time::Ticks;
use crate::violation::Log;

/// Enable, polarity, source, filter and lock fields of the fault inputs 1 to 4 in FLTINR1.
pub(super) const INPUTS: [[Field; 5]; 4] = {
    use hrtim_common::fltinr1::*;
    [
        [FLT1E, FLT1P, FLT1SRC, FLT1F, FLT1LCK],
        [FLT2E, FLT2P, FLT2SRC, FLT2F, FLT2LCK],
        [FLT3E, FLT3P, FLT3SRC, FLT3F, FLT3LCK],
        [FLT4E, FLT4P, FLT4SRC, FLT4F, FLT4LCK],
    ]
};

/// Upper bits of their sources, in FLTINR2.
const UPPER_SOURCES: [Field; 4] = {
    use hrtim_common::fltinr2::*;
    [FLT1SRC_1, FLT2SRC_1, FLT3SRC_1, FLT4SRC_1]
};

/// Handles a write to FLTINR2; returns the word to store.
pub(super) fn sources_written(before: u32, value: u32, file: &RegisterFile, log: &mut Log) -> u32 {
    for (source, [enable, ..]) in UPPER_SOURCES.into_iter().zip(INPUTS) {
        if (value ^ before) & source.mask() != 0 && file.is(enable) {
            log.broken("HRTIM FLTINR2: a source changes only while FLTxE is 0 (RM0440 27.5.51)");
        }
    }
    value
}

/// Returns `true` if a fault input is on, is active high and has one of the sources: 0 for its pin, 1 for a comparator, 2 for an
/// external event (RM0440, 27.5.50).
fn takes(input: usize, from: u32, file: &RegisterFile) -> bool {
    let [enable, polarity, source, ..] = INPUTS[input];
    let selected = file.get(UPPER_SOURCES[input]) << 1 | file.get(source);
    file.is(enable) && file.is(polarity) && selected == from
}

/// Returns `true` if a fault input follows its comparator.
pub fn takes_comparator(input: usize, file: &RegisterFile) -> bool {
    takes(input, 1, file)
}

/// Returns `true` if fault input 2 follows external event 2.
pub fn takes_event_2(file: &RegisterFile) -> bool {
    takes(1, 2, file)
}

/// Faults whose cause is there, independent of their flags.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ActiveFaults {
    /// Bit of each fault input, as in HRTIM_FLTAR.
    pub inputs: u32,
    /// System fault.
    pub system: bool,
}

impl Hrtim {
    /// Returns `true` if external event 2 has no effect: fault input 2 does not use it, or has tripped already.
    pub fn is_event_2_taken(&self, file: &RegisterFile) -> bool {
        !takes_event_2(file) || file.is(hrtim_common::isr::FLT2)
    }

    /// Handles a comparator's trip at its fault input, which may follow something else.
    pub fn comparator_tripped(&mut self, input: usize, file: &mut RegisterFile, now: Ticks) {
        if takes_comparator(input, file) {
            self.fault_input(input, file, now);
        }
    }

    /// Handles an active fault input: switches the outputs off if it is armed.
    pub fn fault_input(&mut self, input: usize, file: &mut RegisterFile, now: Ticks) {
        let flags = file.word(hrtim_common::isr::ADDRESS) | 1 << input;
        file.set_word(hrtim_common::isr::ADDRESS, flags);
        if file.word(hrtim_tima::fltar::ADDRESS) & 1 << input != 0 {
            self.switch_off(now);
        }
    }

    /// Duration from which a pulse on a fault input trips, in seconds: FLTxF samples in a row of f_HRTIM or of f_FLTS divided
    /// (RM0440, 27.5.50; FLTSD 27.5.51).
    pub fn fault_filter_s(&self, input: usize, file: &RegisterFile) -> f64 {
        let [_, _, _, filter, _] = INPUTS[input];
        let divided = f64::from(1u32 << file.get(hrtim_common::fltinr2::FLTSD));
        let (samples, cycles) = match file.get(filter) {
            0 => return 0.0,
            1 => (2.0, 1.0),
            2 => (4.0, 1.0),
            3 => (8.0, 1.0),
            4 => (6.0, 2.0 * divided),
            5 => (8.0, 2.0 * divided),
            6 => (6.0, 4.0 * divided),
            7 => (8.0, 4.0 * divided),
            8 => (6.0, 8.0 * divided),
            9 => (8.0, 8.0 * divided),
            10 => (5.0, 16.0 * divided),
            11 => (6.0, 16.0 * divided),
            12 => (8.0, 16.0 * divided),
            13 => (5.0, 32.0 * divided),
            14 => (6.0, 32.0 * divided),
            _ => (8.0, 32.0 * divided),
        };
        // One more period of the filter's clock may pass before the first sample.
        (samples + 1.0) * cycles / 170e6
    }

    /// Handles SYSCFG's system fault: switches the outputs off in any case.
    pub fn system_fault(&mut self, file: &mut RegisterFile, now: Ticks) {
        file.set(hrtim_common::isr::SYSFLT, 1);
        self.switch_off(now);
    }

    pub(super) fn fault_input_written(&mut self, before: u32, value: u32, log: &mut Log) -> u32 {
        let mut kept = value;
        for [enable, polarity, source, filter, lock] in INPUTS {
            let settings = polarity.mask() | source.mask() | filter.mask();
            if lock.extract(before) == 1 {
                let all = settings | enable.mask() | lock.mask();
                if (value ^ before) & all != 0 {
                    log.broken("HRTIM FLTINR1 written after FLTxLCK (RM0440 27.5.50)");
                }
                kept = (kept & !all) | (before & all);
            } else if enable.extract(before) == 1 && (value ^ before) & settings != 0 {
                log.broken("HRTIM FLTINR1: polarity, source and filter change only while FLTxE is 0 (RM0440 27.5.50)");
            }
        }
        kept
    }
}
