//! LSI, the separate oscillator of the watchdog, and TIM16, which captures its edges (RM0440, 7.2.5 and 29).
//!
//! Time here is the processor's: a main clock that is 10 % too fast is modelled by an LSI, and all else outside, that is 10 %
//! too slow.

use crate::registers::{rcc, tim16};
use crate::time::{TICKS_PER_S, Ticks};
use crate::violation::Log;

use super::register_file::RegisterFile;

/// Frequency of the LSI in hertz (DS12288: 31.04 to 32.96 kHz at 30 °C; the middle).
pub const LSI_HZ: u64 = 32_000;

/// Value of TISEL that selects the LSI (stm32g4xx_hal_tim_ex.h, `TIM_TIM16_TI1_LSI`).
const TI1_LSI: u32 = 6;

/// Low-speed oscillator: its frequency, and its edges so far.
#[derive(Clone, Copy, Debug)]
pub struct Lsi {
    hz: u64,
    since: Ticks,
    edges: u64,
}

impl Default for Lsi {
    fn default() -> Self {
        Self {
            hz: LSI_HZ,
            since: 0,
            edges: 0,
        }
    }
}

impl Lsi {
    /// Frequency in hertz.
    pub fn hz(&self) -> u64 {
        self.hz
    }

    /// Sets another frequency from now on, in hertz, for fault injection.
    pub fn set_hz(&mut self, hz: u64, now: Ticks) {
        self.edges = self.edges_at(now);
        (self.hz, self.since) = (hz, now);
    }

    /// Number of rising edges until a time.
    fn edges_at(&self, now: Ticks) -> u64 {
        self.edges + now.saturating_sub(self.since) * self.hz / TICKS_PER_S
    }

    /// Time of an edge by its number, for edges after the last change of the frequency.
    fn time_of(&self, edge: u64) -> Ticks {
        let from_here = edge.saturating_sub(self.edges);
        self.since + (from_here * TICKS_PER_S).div_ceil(self.hz.max(1))
    }
}

/// TIM16 with channel 1 as an input capture.
#[derive(Clone, Debug, Default)]
pub struct Capture {
    /// Time at which the counter was 0; `enabled_at_edge` is the edge at which channel 1 was enabled.
    counts_since: Ticks,
    enabled_at_edge: u64,
    /// Active prescaler: an update event loads it from PSC (RM0440 29.4.1).
    prescaler: u32,
    captures: u64,
}

impl Capture {
    /// Processes captures that are due: sets CC1IF, and CC1OF if a capture was overwritten.
    pub fn advance(
        &mut self,
        lsi: &Lsi,
        ticks_per_cycle: Ticks,
        file: &mut RegisterFile,
        now: Ticks,
    ) {
        use tim16::{tim16_ccer, tim16_ccmr1, tim16_ccr1, tim16_cr1, tim16_sr, tim16_tisel};
        let runs = file.is(tim16_cr1::CEN) && file.is(tim16_ccer::CC1E);
        let input = file.get(tim16_tisel::TI1SEL) == TI1_LSI && file.get(tim16_ccmr1::CC1S) == 1;
        if !runs || !input || !file.is(rcc::rcc_csr::LSION) {
            return;
        }
        let every = 1u64 << file.get(tim16_ccmr1::IC1PSC);
        let captures = lsi.edges_at(now).saturating_sub(self.enabled_at_edge) / every;
        let new = captures.saturating_sub(self.captures);
        if new == 0 {
            return;
        }
        self.captures = captures;
        if new > 1 || file.is(tim16_sr::CC1IF) {
            file.set(tim16_sr::CC1OF, 1);
        }
        file.set(tim16_sr::CC1IF, 1);
        let at = lsi.time_of(self.enabled_at_edge + captures * every);
        let counts = at.saturating_sub(self.counts_since)
            / (ticks_per_cycle * Ticks::from(self.prescaler + 1));
        let length = Ticks::from(file.word(tim16::tim16_arr::ADDRESS) & 0xFFFF) + 1;
        file.set_word(tim16_ccr1::ADDRESS, (counts % length) as u32);
    }

    /// Handles a write before it is stored; returns the word to store.
    pub fn write(
        &mut self,
        address: u32,
        value: u32,
        lsi: &Lsi,
        file: &RegisterFile,
        log: &mut Log,
    ) -> u32 {
        use tim16::{tim16_ccer, tim16_ccmr1, tim16_cr1, tim16_egr, tim16_sr};
        let before = file.word(address);
        let rises = |field: crate::registers::Field| {
            field.extract(value) == 1 && field.extract(before) == 0
        };
        match address {
            // Flags are cleared by writing 0.
            tim16_sr::ADDRESS => before & value,
            tim16_egr::ADDRESS => {
                self.prescaler = file.get(tim16::tim16_psc::PSC);
                self.counts_since = log.now;
                0
            }
            tim16_cr1::ADDRESS => {
                if rises(tim16_cr1::CEN) {
                    self.counts_since = log.now;
                }
                value
            }
            tim16_ccer::ADDRESS => {
                if rises(tim16_ccer::CC1E) {
                    (self.enabled_at_edge, self.captures) = (lsi.edges_at(log.now), 0);
                }
                value
            }
            tim16_ccmr1::ADDRESS if file.is(tim16_ccer::CC1E) => {
                if tim16_ccmr1::CC1S.extract(value ^ before) != 0 {
                    log.broken("TIM16 CC1S written while CC1E is 1 (RM0440 29.6.7)");
                }
                value
            }
            _ => value,
        }
    }
}
