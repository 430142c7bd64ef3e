//! A SW-DP with one AHB-AP (Arm Debug Interface v5, IHI 0031), in front of a core.

use crate::cortex_m::CortexM;
use crate::target::{Contact, Target};

/// Answer to an access.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// FAULT: an error is sticky, from this access or one before.
    Fault,
    /// Nothing at all: the target has no power.
    NoAnswer,
    /// The probe is not there.
    NoProbe,
}

const DPIDR: u32 = 0x2BA0_1477;
/// AMBA AHB3.
const AP_IDR: u32 = 0x2477_0011;
const STICKYERR: u32 = 1 << 5;
const POWER_REQUESTS: u32 = 1 << 28 | 1 << 30;

/// Debug port and access port.
#[derive(Debug)]
pub struct DebugPort<T> {
    /// The core behind the access port.
    pub core: CortexM<T>,
    control: u32,
    sticky_error: bool,
    select: u32,
    csw: u32,
    tar: u32,
    last_read: u32,
}

impl<T: Target> DebugPort<T> {
    /// Creates a port as after power-on.
    pub fn new(target: T) -> Self {
        Self {
            core: CortexM::new(target),
            control: 0,
            sticky_error: false,
            select: 0,
            csw: 0x4300_0042,
            tar: 0,
            last_read: 0,
        }
    }

    fn contact(&mut self) -> Result<(), Refusal> {
        match self.core.target.contact() {
            Contact::Good => Ok(()),
            Contact::NoProbe => Err(Refusal::NoProbe),
            Contact::NoPower => {
                // What it held is gone with the supply.
                (self.control, self.sticky_error) = (0, false);
                Err(Refusal::NoAnswer)
            }
        }
    }

    /// Reads a register of the debug port.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn read_dp(&mut self, address: u8) -> Result<u32, Refusal> {
        self.contact()?;
        Ok(match address & 0xF {
            0x0 => DPIDR,
            0x4 if self.select & 0xF == 0 => self.status(),
            0xC => self.last_read,
            _ => 0,
        })
    }

    fn status(&self) -> u32 {
        let sticky = if self.sticky_error { STICKYERR } else { 0 };
        // What is asked for is there at once.
        self.control | (self.control & POWER_REQUESTS) << 1 | sticky
    }

    /// Writes a register of the debug port.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn write_dp(&mut self, address: u8, value: u32) -> Result<(), Refusal> {
        self.contact()?;
        match address & 0xF {
            // ABORT: STKERRCLR.
            0x0 if value & 1 << 2 != 0 => self.sticky_error = false,
            0x4 if self.select & 0xF == 0 => {
                self.control = value & !(STICKYERR | POWER_REQUESTS << 1)
            }
            0x8 => self.select = value,
            _ => {}
        }
        Ok(())
    }

    /// Returns the selected access port and register; an error without power, or while an error stands.
    fn ap_register(&mut self, address: u8) -> Result<Option<u32>, Refusal> {
        self.contact()?;
        if self.sticky_error || self.control & POWER_REQUESTS != POWER_REQUESTS {
            self.sticky_error = true;
            return Err(Refusal::Fault);
        }
        let here = self.select >> 24 == 0;
        Ok(here.then_some(self.select & 0xF0 | u32::from(address & 0xC)))
    }

    /// Reads a register of the access port; the answer is that of this read, as a probe gives it.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn read_ap(&mut self, address: u8) -> Result<u32, Refusal> {
        let value = match self.ap_register(address)? {
            Some(0x00) => self.csw,
            Some(0x04) => self.tar,
            Some(0x0C) => self.read_memory()?,
            // BASE: no ROM table is followed.
            Some(0xF8) => 0xE00F_F003,
            Some(0xFC) => AP_IDR,
            _ => 0,
        };
        self.last_read = value;
        Ok(value)
    }

    /// Writes a register of the access port.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn write_ap(&mut self, address: u8, value: u32) -> Result<(), Refusal> {
        match self.ap_register(address)? {
            // DeviceEn stays set.
            Some(0x00) => self.csw = value | 1 << 6,
            Some(0x04) => self.tar = value,
            Some(0x0C) => self.write_memory(value)?,
            _ => {}
        }
        Ok(())
    }

    /// Bytes of an access, and how far it lies within the word.
    fn lane(&self) -> (u32, u32) {
        (1 << (self.csw & 0b11), (self.tar & 0b11) * 8)
    }

    fn read_memory(&mut self) -> Result<u32, Refusal> {
        let (bytes, shift) = self.lane();
        match self.core.read(self.tar, bytes) {
            Ok(value) => {
                self.advance(bytes);
                Ok(value << shift)
            }
            Err(_) => Err(self.fault()),
        }
    }

    fn write_memory(&mut self, value: u32) -> Result<(), Refusal> {
        let (bytes, shift) = self.lane();
        let mask = u32::MAX >> (32 - 8 * bytes);
        match self.core.write(self.tar, bytes, value >> shift & mask) {
            Ok(()) => {
                self.advance(bytes);
                // Power may have gone with this very access.
                self.contact()
            }
            Err(_) => Err(self.fault()),
        }
    }

    fn fault(&mut self) -> Refusal {
        self.sticky_error = true;
        Refusal::Fault
    }

    /// The address counts within 1 KiB, as probe-rs and the architecture have it.
    fn advance(&mut self, bytes: u32) {
        if self.csw >> 4 & 0b11 != 0 {
            self.tar = self.tar & !0x3FF | self.tar.wrapping_add(bytes) & 0x3FF;
        }
    }

    /// The reset pin.
    pub fn reset_pin(&mut self) {
        self.core.reset();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::Chip;

    fn powered() -> DebugPort<Chip> {
        let mut port = DebugPort::new(Chip::default());
        port.write_dp(0x4, POWER_REQUESTS).unwrap();
        port
    }

    #[test]
    fn power_is_acknowledged_and_needed() {
        let mut port = DebugPort::new(Chip::default());
        assert_eq!(port.read_dp(0x0), Ok(DPIDR));
        assert_eq!(port.read_ap(0x0), Err(Refusal::Fault));
        port.write_dp(0x0, 1 << 2).unwrap();
        port.write_dp(0x4, POWER_REQUESTS).unwrap();
        assert_eq!(port.read_dp(0x4), Ok(0xF000_0000));
        assert!(port.read_ap(0x0).is_ok());
    }

    #[test]
    fn a_fault_stands_until_it_is_cleared() {
        let mut port = powered();
        port.write_ap(0x4, 0x9000_0000).unwrap();
        assert_eq!(port.read_ap(0xC), Err(Refusal::Fault));
        port.write_ap(0x4, 0x2000_0000).unwrap_err();
        assert_eq!(port.read_dp(0x4).unwrap() & STICKYERR, STICKYERR);
        port.write_dp(0x0, 1 << 2).unwrap();
        port.write_ap(0x4, 0x2000_0000).unwrap();
        assert_eq!(port.read_ap(0xC), Ok(0));
    }

    #[test]
    fn bytes_travel_in_their_lane() {
        let mut port = powered();
        port.write_ap(0x0, 0x10).unwrap();
        port.write_ap(0x4, 0x2000_0001).unwrap();
        port.write_ap(0xC, 0xAABB_CCDD).unwrap();
        port.write_ap(0x0, 0x12).unwrap();
        port.write_ap(0x4, 0x2000_0000).unwrap();
        assert_eq!(port.read_ap(0xC), Ok(0x0000_CC00));
    }
}
