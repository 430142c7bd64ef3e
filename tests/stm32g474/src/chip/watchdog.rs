//! IWDG, with its separate oscillator (RM0440, 44).

use crate::registers::iwdg;
use crate::time::{TICKS_PER_S, Ticks};
use crate::violation::Log;

use super::register_file::RegisterFile;

/// Independent watchdog.
#[derive(Clone, Debug, Default)]
pub struct Watchdog {
    /// Time at which it resets the chip; `None` before its start.
    pub bites_at: Option<Ticks>,
    fed_at: Option<Ticks>,
    /// Longest time between two feeds.
    pub longest_gap: Ticks,
    unlocked: bool,
    /// Fault injection: the watchdog never resets the chip.
    pub broken: bool,
}

impl Watchdog {
    /// Watchdog after a reset; `broken` is kept.
    pub fn after_reset(&self) -> Self {
        Self {
            broken: self.broken,
            ..Self::default()
        }
    }

    fn period(lsi_hz: u64, file: &RegisterFile) -> Ticks {
        let prescaler = 4u64 << file.get(iwdg::pr::PR).min(6);
        (u64::from(file.get(iwdg::rlr::RL)) + 1) * prescaler * TICKS_PER_S / lsi_hz.max(1)
    }

    /// Handles a write; returns `true` if it is stored.
    pub fn write(
        &mut self,
        address: u32,
        value: u32,
        lsi_hz: u64,
        file: &RegisterFile,
        log: &mut Log,
    ) -> bool {
        match (address, value) {
            (iwdg::kr::ADDRESS, 0xCCCC) => self.feed(lsi_hz, file, log.now),
            (iwdg::kr::ADDRESS, 0xAAAA) => {
                self.unlocked = false;
                if self.fed_at.is_some() {
                    self.feed(lsi_hz, file, log.now);
                }
            }
            (iwdg::kr::ADDRESS, 0x5555) => self.unlocked = true,
            (iwdg::kr::ADDRESS, _) => self.unlocked = false,
            _ if !self.unlocked => {
                log.broken("IWDG written without 0x5555 in KR (RM0440 44.3.6)");
                return false;
            }
            _ => return true,
        }
        false
    }

    fn feed(&mut self, lsi_hz: u64, file: &RegisterFile, now: Ticks) {
        if let Some(last) = self.fed_at {
            self.longest_gap = self.longest_gap.max(now - last);
        }
        self.fed_at = Some(now);
        self.bites_at = (!self.broken).then(|| now + Self::period(lsi_hz, file));
    }
}
