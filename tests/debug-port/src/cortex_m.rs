//! The debug registers of an Armv7-M core (Armv7-M Architecture Reference Manual, C1.6, C1.11), in front of any [`Target`].

use crate::target::{BusFault, Stop, Target};

const AIRCR: u32 = 0xE000_ED0C;
const CPUID: u32 = 0xE000_ED00;
const DFSR: u32 = 0xE000_ED30;
const DHCSR: u32 = 0xE000_EDF0;
const DCRSR: u32 = 0xE000_EDF4;
const DCRDR: u32 = 0xE000_EDF8;
const DEMCR: u32 = 0xE000_EDFC;
const MVFR0: u32 = 0xE000_EF40;
const FP_CTRL: u32 = 0xE000_2000;

/// Private peripherals of the core: what of them is not here reads as 0.
const PRIVATE: std::ops::Range<u32> = 0xE000_0000..0xE004_0000;

const C_DEBUGEN: u32 = 1;
const C_HALT: u32 = 1 << 1;
const C_STEP: u32 = 1 << 2;
const CONTROL: u32 = 0b1111;
const S_REGRDY: u32 = 1 << 16;
const S_HALT: u32 = 1 << 17;
const S_LOCKUP: u32 = 1 << 19;
const S_RESET_ST: u32 = 1 << 25;
const DEBUG_KEY: u32 = 0xA05F;

const DFSR_HALTED: u32 = 1;
const DFSR_BKPT: u32 = 1 << 1;
const DFSR_VCATCH: u32 = 1 << 3;
const VC_CORERESET: u32 = 1;

/// A core's debug registers, and the target behind them.
#[derive(Debug)]
pub struct CortexM<T> {
    /// Target under debug.
    pub target: T,
    control: u32,
    dfsr: u32,
    dcrdr: u32,
    was_reset: bool,
    stood: bool,
}

impl<T: Target> CortexM<T> {
    /// Registers as after power-on.
    pub fn new(target: T) -> Self {
        Self {
            target,
            control: 0,
            dfsr: 0,
            dcrdr: 0,
            was_reset: false,
            stood: false,
        }
    }

    /// Reads a word through the AHB-AP.
    ///
    /// # Errors
    /// [`BusFault`] where nothing answers.
    pub fn read(&mut self, address: u32, bytes: u32) -> Result<u32, BusFault> {
        let stop = self.look();
        match address {
            DHCSR => Ok(self.dhcsr(stop)),
            DFSR => Ok(self.dfsr),
            DEMCR => self.target.read(DEMCR, 4),
            DCRDR => Ok(self.dcrdr),
            // Cortex-M4 r0p1, single-precision unit; six breakpoints of revision 0.
            CPUID => Ok(0x410F_C241),
            MVFR0 => Ok(0x1011_0021),
            FP_CTRL => Ok(0x0000_0260),
            other if PRIVATE.contains(&other) => Ok(0),
            other => self.target.read(other, bytes),
        }
    }

    /// Writes a word through the AHB-AP.
    ///
    /// # Errors
    /// [`BusFault`] where nothing answers.
    pub fn write(&mut self, address: u32, bytes: u32, value: u32) -> Result<(), BusFault> {
        self.look();
        match address {
            DHCSR => self.set_dhcsr(value),
            DFSR => self.dfsr &= !value,
            DEMCR => return self.target.write(DEMCR, 4, value),
            DCRDR => self.dcrdr = value,
            DCRSR => self.transfer(value),
            AIRCR if value >> 16 == 0x05FA && value & 1 << 2 != 0 => self.reset(),
            other if PRIVATE.contains(&other) => {}
            other => return self.target.write(other, bytes, value),
        }
        Ok(())
    }

    /// Resets as the pin or the core's own request does.
    pub fn reset(&mut self) {
        self.target.reset();
        self.was_reset = true;
        self.stood = false;
        self.control &= !(C_HALT | C_STEP);
        let catches = self.target.read(DEMCR, 4).unwrap_or(0);
        if catches & VC_CORERESET != 0 && self.control & C_DEBUGEN != 0 {
            self.target.halt();
            self.stood = true;
            self.dfsr |= DFSR_VCATCH;
        }
    }

    /// Notes whether and why the core has stopped since the last look.
    fn look(&mut self) -> Option<Stop> {
        let stop = self.target.stopped();
        if stop.is_some() && !self.stood {
            self.dfsr |= match stop {
                Some(Stop::Breakpoint) => DFSR_BKPT,
                _ => DFSR_HALTED,
            };
        }
        self.stood = stop.is_some();
        if matches!(stop, Some(Stop::Asked | Stop::Breakpoint)) {
            // Entering debug state sets the request as well.
            self.control |= C_HALT;
        }
        stop
    }

    fn dhcsr(&mut self, stop: Option<Stop>) -> u32 {
        let mut value = self.control | S_REGRDY;
        match stop {
            Some(Stop::LockedUp) => value |= S_LOCKUP,
            Some(_) => value |= S_HALT,
            None => {}
        }
        if std::mem::take(&mut self.was_reset) {
            value |= S_RESET_ST;
        }
        value
    }

    fn set_dhcsr(&mut self, value: u32) {
        if value >> 16 != DEBUG_KEY {
            return;
        }
        self.control = value & CONTROL;
        if value & C_DEBUGEN == 0 {
            self.control = 0;
            self.target.run();
        } else if value & C_HALT != 0 {
            self.target.halt();
        } else if value & C_STEP != 0 {
            self.target.step();
            self.dfsr |= DFSR_HALTED;
            self.stood = true;
        } else {
            self.stood = false;
            self.target.run();
        }
    }

    fn transfer(&mut self, value: u32) {
        let number = value & 0x7F;
        if value & 1 << 16 != 0 {
            self.target.set_register(number, self.dcrdr);
        } else {
            self.dcrdr = self.target.register(number);
        }
    }
}
