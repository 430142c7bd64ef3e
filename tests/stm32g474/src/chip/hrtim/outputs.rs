//! HRTIM's outputs: their dead time, their levels, and what must hold when they are enabled.

use super::faults::INPUTS;
use super::{Hrtim, OUTPUT_1, OUTPUT_2};
use crate::chip::register_file::RegisterFile;
use crate::registers::hrtim_tima;
use crate::violation::Log;

impl Hrtim {
    /// Handles a write to DTAR; returns the word to store.
    pub(super) fn dead_time_written(
        &mut self,
        before: u32,
        value: u32,
        file: &RegisterFile,
        log: &mut Log,
    ) -> u32 {
        use hrtim_tima::dtar::{DTFLKX, DTFSLKX, DTFX, DTPRSC, DTRLKX, DTRSLKX, DTRX};
        if self.dead_time_locked {
            let locked = DTRX.mask() | DTFX.mask() | DTPRSC.mask() | DTRLKX.mask() | DTFLKX.mask();
            if (value ^ before) & locked != 0 {
                log.broken("HRTIM DTAR written after DTRLK and DTFLK (RM0440 27.5.20)");
            }
            return before;
        }
        let locks = DTRLKX.mask() | DTFLKX.mask() | DTRSLKX.mask() | DTFSLKX.mask();
        if value & locks != 0 {
            self.dead_time_locked = true;
            if DTRX.extract(value) == 0 || DTFX.extract(value) == 0 {
                log.broken("HRTIM: a dead time of 0 locked (RM0440 27.5.20)");
            }
        }
        if file.is(hrtim_tima::outar::DTEN)
            && self.a.running
            && (value ^ before) & DTPRSC.mask() != 0
        {
            log.broken("HRTIM DTPRSC changed while the timer runs (RM0440 27.5.20)");
        }
        value
    }

    /// Handles a write to OENR: conditions for enabling an output (RM0440, 27.3.22).
    pub(super) fn enable(&mut self, value: u32, file: &RegisterFile, log: &mut Log) {
        if value & !(OUTPUT_1 | OUTPUT_2) != 0 {
            log.broken("HRTIM: an output enabled that is not wired");
        }
        let armed = file.word(hrtim_tima::fltar::ADDRESS);
        for input in [0, 1, 3] {
            let [enable, ..] = INPUTS[input];
            if armed & 1 << input == 0 || !file.is(enable) {
                log.broken(format!(
                    "outputs enabled before fault input {} is armed (RM0440 27.3.17)",
                    input + 1
                ));
            }
        }
        self.check_dead_time(file, log);
        check_levels(file, log);
        let active = self.active_faults;
        if active.inputs & armed != 0 || active.system {
            // FAULT state, whether its flag is set or cleared (RM0440, "HRTIM output states and transitions").
            return;
        }
        for (output, bit) in [(0, OUTPUT_1), (1, OUTPUT_2)] {
            self.enabled[output] |= value & bit != 0;
        }
    }

    /// Checks the dead time in force: of a negative one, or none, both switches conduct at once.
    fn check_dead_time(&self, file: &RegisterFile, log: &mut Log) {
        use hrtim_tima::dtar::{DTFX, DTRX, SDTFX, SDTRX};
        let in_force = self.in_force(0, hrtim_tima::dtar::ADDRESS);
        let is_missing = DTRX.extract(in_force) == 0 || DTFX.extract(in_force) == 0;
        if !file.is(hrtim_tima::outar::DTEN) || is_missing {
            log.broken("outputs enabled without dead time (RM0440 27.3.8)");
        }
        if SDTRX.extract(in_force) == 1 || SDTFX.extract(in_force) == 1 {
            log.broken("outputs enabled with a negative dead time (RM0440 27.3.8)");
        }
    }
}

/// Checks OUTAR: active is high, as the gate driver has it, and both outputs are low while idle or in FAULT state.
fn check_levels(file: &RegisterFile, log: &mut Log) {
    use hrtim_tima::outar::{FAULT1, FAULT2, IDLES1, IDLES2, POL1, POL2};
    if file.get(FAULT1) != 2 || file.get(FAULT2) != 2 {
        log.broken("outputs enabled whose fault state is not inactive (RM0440 27.5.28)");
    }
    let levels = [POL1, POL2, IDLES1, IDLES2];
    if levels.iter().any(|&high| file.is(high)) {
        log.broken("outputs enabled that are inverted, or active while idle (RM0440 27.5.28)");
    }
}
