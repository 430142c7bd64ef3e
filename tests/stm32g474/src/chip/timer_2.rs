//! TIM2: counter from 0 upwards, first compare and trigger output (RM0440, 29).

use crate::registers::tim2;
use crate::time::Ticks;
use crate::violation::Log;

use super::register_file::RegisterFile;

/// PWM mode 2 in OC1M: OC1REF is active from CCR1 on.
const PWM_MODE_2: u32 = 7;

/// OC1REF as trigger output in MMS.
const OC1REF: u32 = 4;

/// Counter of TIM2. Its clock is the processor's: APB1 is not divided in this image.
#[derive(Clone, Debug, Default)]
pub struct Timer2 {
    /// Time at which the counter was 0; `None` while it is stopped.
    zero_at: Option<Ticks>,
    /// Active prescaler: an update event loads it from PSC (RM0440 29.4.1).
    prescaler: u32,
}

impl Timer2 {
    fn ticks(&self, counts: u32, ticks_per_cycle: Ticks) -> Ticks {
        Ticks::from(counts) * Ticks::from(self.prescaler + 1) * ticks_per_cycle
    }

    fn count(&self, ticks_per_cycle: Ticks, now: Ticks) -> u32 {
        let elapsed = self.zero_at.map_or(0, |at| now.saturating_sub(at));
        (elapsed / self.ticks(1, ticks_per_cycle)) as u32
    }

    /// Time from which the trigger output is high, until the counter restarts; `None` if the counter is stopped or the output does
    /// not follow OC1REF in PWM mode 2. The wrap of the counter after 25 s is not modelled.
    pub fn high_from(&self, ticks_per_cycle: Ticks, file: &RegisterFile) -> Option<Ticks> {
        let follows = file.get(tim2::tim2_cr2::MMS) == OC1REF
            && file.get(tim2::tim2_ccmr1_alternate::OC1M) == PWM_MODE_2;
        let at = self.zero_at.filter(|_| follows)?;
        Some(at + self.ticks(file.word(tim2::tim2_ccr1::ADDRESS), ticks_per_cycle))
    }

    /// Reads a register.
    pub fn read(
        &self,
        address: u32,
        ticks_per_cycle: Ticks,
        file: &RegisterFile,
        now: Ticks,
    ) -> u32 {
        match address {
            tim2::tim2_cnt::ADDRESS => self.count(ticks_per_cycle, now),
            _ => file.word(address),
        }
    }

    /// Handles a write before it is stored; returns the word to store.
    pub fn write(
        &mut self,
        address: u32,
        value: u32,
        ticks_per_cycle: Ticks,
        file: &RegisterFile,
        log: &mut Log,
    ) -> u32 {
        use tim2::{tim2_cnt, tim2_cr1, tim2_egr};
        match address {
            tim2_cr1::ADDRESS => {
                if value & !(tim2_cr1::CEN.mask()) != 0 {
                    log.broken("TIM2: this emulator counts up, without preload");
                }
                let on = tim2_cr1::CEN.extract(value) == 1;
                self.zero_at = on.then(|| self.zero_at.unwrap_or(log.now));
                value
            }
            // UG: the counter restarts.
            tim2_egr::ADDRESS => {
                self.prescaler = file.word(tim2::tim2_psc::ADDRESS);
                self.zero_at = self.zero_at.map(|_| log.now);
                0
            }
            tim2_cnt::ADDRESS => {
                let counted = self.ticks(value, ticks_per_cycle);
                self.zero_at = self.zero_at.map(|_| log.now.saturating_sub(counted));
                value
            }
            _ => value,
        }
    }
}
