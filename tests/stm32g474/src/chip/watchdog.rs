//! IWDG, with its separate oscillator (RM0440, 44).

use crate::registers::{Field, iwdg};
use crate::time::{TICKS_PER_S, Ticks};
use crate::violation::Log;

use super::register_file::RegisterFile;

/// Reload value from a reset on, and the counter's first one, whatever IWDG_RLR holds (RM0440, 44.3).
const FIRST_RELOAD: u32 = 0xFFF;

/// Periods of the LSI in which a new prescaler or reload value reaches the counter, 5 at most (RM0440, 44.4.5: PVU, RVU).
const UPDATE_PERIODS: u64 = 5;

/// Register whose value reaches the counter later than its write.
#[derive(Clone, Copy, Debug, Default)]
struct Delayed {
    in_force: u32,
    next: u32,
    until: Ticks,
}

impl Delayed {
    fn set(&mut self, value: u32, lsi_hz: u64, log: &mut Log) {
        let now = log.now;
        if now < self.until {
            log.broken("IWDG written while PVU or RVU is set (RM0440 44.4.5)");
        }
        self.in_force = self.at(now);
        (self.next, self.until) = (value, now + UPDATE_PERIODS * TICKS_PER_S / lsi_hz.max(1));
    }

    fn at(self, now: Ticks) -> u32 {
        if now < self.until {
            self.in_force
        } else {
            self.next
        }
    }
}

/// Independent watchdog.
#[derive(Clone, Debug)]
pub struct Watchdog {
    /// Time at which it resets the chip; `None` before its start.
    pub bites_at: Option<Ticks>,
    fed_at: Option<Ticks>,
    /// Longest time between two feeds.
    pub longest_gap: Ticks,
    unlocked: bool,
    prescaler: Delayed,
    reload: Delayed,
    /// Fault injection: the watchdog never resets the chip.
    pub broken: bool,
}

impl Default for Watchdog {
    fn default() -> Self {
        Self {
            bites_at: None,
            fed_at: None,
            longest_gap: 0,
            unlocked: false,
            prescaler: Delayed::default(),
            reload: Delayed {
                next: FIRST_RELOAD,
                ..Delayed::default()
            },
            broken: false,
        }
    }
}

impl Watchdog {
    /// Watchdog after a reset; `broken` is kept.
    pub fn after_reset(&self) -> Self {
        Self {
            broken: self.broken,
            ..Self::default()
        }
    }

    /// Reads a register: IWDG_SR is set while a value is on its way.
    pub fn read(&self, address: u32, file: &RegisterFile, now: Ticks) -> u32 {
        let flag = |of: Delayed, flag: Field| flag.put(0, u32::from(now < of.until));
        match address {
            iwdg::sr::ADDRESS => {
                flag(self.prescaler, iwdg::sr::PVU) | flag(self.reload, iwdg::sr::RVU)
            }
            _ => file.word(address),
        }
    }

    /// Handles a write; returns `true` if it is stored.
    pub fn write(&mut self, address: u32, value: u32, lsi_hz: u64, log: &mut Log) -> bool {
        let now = log.now;
        match (address, value) {
            (iwdg::kr::ADDRESS, 0xCCCC) => {
                if self.fed_at.is_none() {
                    self.count_from(FIRST_RELOAD, lsi_hz, now);
                }
            }
            (iwdg::kr::ADDRESS, 0xAAAA) => {
                self.unlocked = false;
                if self.fed_at.is_some() {
                    self.count_from(self.reload.at(now), lsi_hz, now);
                }
            }
            (iwdg::kr::ADDRESS, 0x5555) => self.unlocked = true,
            (iwdg::kr::ADDRESS, _) => self.unlocked = false,
            _ if !self.unlocked => {
                log.broken("IWDG written without 0x5555 in KR (RM0440 44.3.6)");
                return false;
            }
            (iwdg::pr::ADDRESS, _) => self.prescaler.set(value & 7, lsi_hz, log),
            (iwdg::rlr::ADDRESS, _) => self.reload.set(value & 0xFFF, lsi_hz, log),
            _ => return true,
        }
        address != iwdg::kr::ADDRESS
    }

    fn count_from(&mut self, from: u32, lsi_hz: u64, now: Ticks) {
        if let Some(last) = self.fed_at {
            self.longest_gap = self.longest_gap.max(now - last);
        }
        self.fed_at = Some(now);
        let counts = (u64::from(from) + 1) * (4u64 << self.prescaler.at(now).min(6));
        self.bites_at = (!self.broken).then(|| now + counts * TICKS_PER_S / lsi_hz.max(1));
    }
}
