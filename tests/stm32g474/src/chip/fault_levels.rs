//! Levels that hold HRTIM's outputs in FAULT state: fault inputs and the supply's detector.

use super::hrtim::ActiveFaults;
use super::{COMPARATOR_INPUTS, Chip};
use crate::registers::{exti, pwr, syscfg};

/// EXTI line of the supply's detector (RM0440, table "EXTI lines connections").
const PVD_LINE: u32 = 1 << 16;

impl Chip {
    /// Lowers the supply below the detector's level, or brings it back.
    pub fn set_supply_low(&mut self, low: bool) {
        self.supply_is_low = low;
        self.update_supply_detector();
    }

    /// Sets PVDO by the supply, and applies its rising edge: EXTI_PR1, HRTIM's system fault.
    pub(super) fn update_supply_detector(&mut self) {
        let low = self.supply_is_low && self.file.is(pwr::pwr_cr2::PVDE);
        let rises = low && !self.file.is(pwr::pwr_sr2::PVDO);
        self.file.set(pwr::pwr_sr2::PVDO, u32::from(low));
        if rises {
            let watched =
                self.file.word(exti::rtsr1::ADDRESS) & self.file.word(exti::imr1::ADDRESS);
            let pending = self.file.word(exti::pr1::ADDRESS) | watched & PVD_LINE;
            self.file.set_word(exti::pr1::ADDRESS, pending);
            self.system_fault(syscfg::cfgr2::PVDL);
        }
    }

    /// Faults whose cause is there now, whatever HRTIM_ISR says. Of the system fault's causes only the supply lasts: the
    /// others end in a reset, or the processor is locked up.
    pub(super) fn active_faults(&self) -> ActiveFaults {
        let above = self.pins.comparators_above();
        let comparators = COMPARATOR_INPUTS
            .iter()
            .filter(|(comparator, _)| above[*comparator])
            .fold(0, |all, (_, input)| all | 1 << input);
        let event_2 = self.event_2_from().is_some_and(|at| self.log.now >= at);
        ActiveFaults {
            inputs: comparators | u32::from(event_2) << 1,
            system: self.file.is(pwr::pwr_sr2::PVDO) && self.file.is(syscfg::cfgr2::PVDL),
        }
    }
}
