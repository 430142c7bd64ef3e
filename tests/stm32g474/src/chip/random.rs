//! RNG: words of noise, one every 40 cycles of HSI48 (RM0440, 26).

use crate::registers::rng;
use crate::time::{TICKS_PER_S, Ticks};
use crate::violation::Log;

use super::clocks;
use super::register_file::RegisterFile;

/// Time between two words.
const WORD: Ticks = 40 * TICKS_PER_S / 48_000_000;

/// Generator, whose noise goes on over resets and power cycles.
#[derive(Clone, Debug)]
pub struct Random {
    noise: u64,
    ready_at: Option<Ticks>,
    /// Fault injection: the noise source stands still, and SR reports it.
    pub broken: bool,
}

impl Random {
    /// Generator with noise of its own for each seed.
    pub fn new(seed: u64) -> Self {
        Self {
            noise: seed,
            ready_at: None,
            broken: false,
        }
    }

    /// Generator after a reset.
    pub fn after_reset(&self) -> Self {
        Self {
            ready_at: None,
            ..self.clone()
        }
    }

    /// Handles a write of CR.
    pub fn enable(&mut self, file: &RegisterFile, log: &mut Log) {
        let on = file.is(rng::cr::RNGEN) && clocks::check_48_mhz("RNG", file, log);
        self.ready_at = on.then_some(log.now + WORD);
    }

    /// Reads SR or DR.
    pub fn read(&mut self, address: u32, file: &RegisterFile, log: &mut Log) -> u32 {
        let ready = !self.broken && self.ready_at.is_some_and(|at| at <= log.now);
        match address {
            rng::sr::ADDRESS if self.broken => rng::sr::SECS.mask() | rng::sr::SEIS.mask(),
            rng::sr::ADDRESS => rng::sr::DRDY.put(0, ready.into()),
            rng::dr::ADDRESS if ready => {
                self.ready_at = Some(log.now + WORD);
                self.draw()
            }
            rng::dr::ADDRESS => {
                log.broken("RNG DR read without DRDY in SR (RM0440 26.3.4)");
                0
            }
            _ => file.word(address),
        }
    }

    /// Next word, by SplitMix64.
    fn draw(&mut self) -> u32 {
        self.noise = self.noise.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.noise ^ self.noise >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        (mixed >> 32) as u32
    }
}
