//! Causes that open the bridge in hardware: comparators and external event 2 at HRTIM's fault inputs, and the system fault.

use super::Chip;
use super::hrtim::{ActiveFaults, takes_comparator, takes_event_2};
use crate::pins::Comparator;
use crate::registers::{self as reg, Field, exti, pwr, syscfg};
use crate::time::Ticks;

/// Pairs of comparator and fault input of HRTIM, both from 0 (RM0440, table 221): COMP2 on input 1, COMP1 on input 4.
const COMPARATOR_INPUTS: [(usize, usize); 2] = [(0, 3), (1, 0)];

/// Levels of the supply's detector in volt, by PVDLS (RM0440, PWR_CR2). The last one compares a pin, which is not wired.
const DETECTOR_LEVELS_V: [f64; 8] = [2.0, 2.2, 2.4, 2.5, 2.6, 2.8, 2.9, 0.0];

/// EXTI line of the supply's detector (RM0440, table "EXTI lines connections").
const PVD_LINE: u32 = 1 << 16;

impl Chip {
    /// Sets the supply that the detector sees, in volt.
    pub fn set_supply_v(&mut self, supply_v: f64) {
        self.supply_v = supply_v;
        self.update_supply_detector();
    }

    /// Sets PVDO by the supply, and applies its rising edge: EXTI_PR1, HRTIM's system fault.
    pub(super) fn update_supply_detector(&mut self) {
        let level_v = DETECTOR_LEVELS_V[self.file.get(pwr::pwr_cr2::PVDLS) as usize];
        let low = self.supply_v < level_v && self.file.is(pwr::pwr_cr2::PVDE);
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
            .filter(|(comparator, input)| {
                above[*comparator] && takes_comparator(*input, &self.file)
            })
            .fold(0, |all, (_, input)| all | 1 << input);
        let event_2 =
            takes_event_2(&self.file) && self.event_2_from().is_some_and(|at| self.log.now >= at);
        ActiveFaults {
            inputs: comparators | u32::from(event_2) << 1,
            system: self.file.is(pwr::pwr_sr2::PVDO) && self.file.is(syscfg::cfgr2::PVDL),
        }
    }

    /// Sets threshold and filter of the comparators at the pins.
    pub(super) fn set_comparators(&mut self) {
        use reg::comp::comp_c1csr::{EN, INMSEL, INPSEL, POL};
        use reg::dac1::{dac_cr, dac_dhr12r1, dac_dhr12r2, dac_mcr};
        let on = [self.file.is(dac_cr::EN1), self.file.is(dac_cr::EN2)];
        let thresholds = [
            self.file.get(dac_dhr12r1::DACC1DHR),
            self.file.get(dac_dhr12r2::DACC2DHR),
        ];
        // MODE 1 and 3 lead a channel to the comparators (RM0440, DAC_MCR).
        let is_inside =
            [dac_mcr::MODE1, dac_mcr::MODE2].map(|mode| matches!(self.file.get(mode), 1 | 3));
        for (comparator, input) in COMPARATOR_INPUTS {
            let csr = self.file.word(reg::comp::BASE + 4 * comparator as u32);
            // INMSEL 5 is DAC1_CH1 on COMP1 and DAC1_CH2 on COMP2, INPSEL 0 is PA1 and PA7 (RM0440, 24.3.2).
            let wired = INMSEL.extract(csr) == 5 && INPSEL.extract(csr) == 0;
            let is_on = EN.extract(csr) == 1 && POL.extract(csr) == 0;
            let compares = wired && is_on && on[comparator] && is_inside[comparator];
            self.pins.comparators[comparator] = compares.then(|| Comparator {
                threshold_code: f64::from(thresholds[comparator]),
                filter_s: self.hrtim.fault_filter_s(input, &self.file),
            });
        }
    }

    /// Applies comparator trips to HRTIM's fault inputs, each at its time.
    pub(super) fn trip(&mut self, tripped: [Option<f64>; 2]) {
        for (comparator, input) in COMPARATOR_INPUTS {
            if let Some(after_s) = tripped[comparator] {
                let at = self.log.now + (after_s * crate::time::TICKS_PER_S as f64) as Ticks;
                self.hrtim.comparator_tripped(input, &mut self.file, at);
            }
        }
        self.drive_pins();
    }

    /// Time from which HRTIM's external event 2 is active: TIM2's trigger output, active high.
    fn event_2_from(&self) -> Option<Ticks> {
        use reg::hrtim_common::eecr1::{EE2POL, EE2SRC};
        const TIM2_TRGO: u32 = 2;
        let wired = self.file.get(EE2SRC) == TIM2_TRGO && !self.file.is(EE2POL);
        let from = self.timer_2.high_from(self.ticks_per_cycle, &self.file);
        from.filter(|_| wired)
    }

    /// Next time at which external event 2 becomes active with an effect.
    pub(super) fn next_event_2(&self) -> Option<Ticks> {
        let from = self.event_2_from();
        from.filter(|_| !self.hrtim.is_event_2_taken(&self.file))
    }

    /// Applies external event 2: a level on fault input 2, if that input uses it (RM0440, table 221).
    pub(super) fn check_event_2(&mut self) {
        let now = self.log.now;
        if self.event_2_from().is_some_and(|at| now >= at)
            && !self.hrtim.is_event_2_taken(&self.file)
        {
            self.hrtim.fault_input(1, &mut self.file, now);
            self.drive_pins();
        }
    }

    /// Applies a system fault if its bit in SYSCFG_CFGR2 connects it to HRTIM.
    pub fn system_fault(&mut self, connected_by: Field) {
        if self.file.is(connected_by) {
            let now = self.log.now;
            self.hrtim.system_fault(&mut self.file, now);
            self.drive_pins();
        }
    }
}
