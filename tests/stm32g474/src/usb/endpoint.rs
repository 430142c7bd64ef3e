//! Endpoint register USB_EPnR (RM0440, 45.6.1): half of its bits are toggled by a write, not written.

use crate::registers::Field;
use crate::registers::usb_fs_device::ep0r::{
    CTR_RX, CTR_TX, DTOG_RX, DTOG_TX, EA, EP_KIND, EP_TYPE, SETUP, STAT_RX, STAT_TX,
};

/// Value of STAT_TX and STAT_RX: no packet is answered.
pub const DISABLED: u32 = 0;
/// Every packet is answered with STALL.
pub const STALL: u32 = 1;
/// Every packet is answered with NAK.
pub const NAK: u32 = 2;
/// The next packet is accepted or sent.
pub const VALID: u32 = 3;

/// EP_TYPE of a bulk endpoint.
pub const BULK: u32 = 0;
/// EP_TYPE of a control endpoint.
pub const CONTROL: u32 = 1;
/// EP_TYPE of an isochronous endpoint.
pub const ISOCHRONOUS: u32 = 2;

/// Bits that report a complete transaction.
const COMPLETE: u32 = CTR_RX.mask() | CTR_TX.mask();
/// Bits that a written 1 toggles.
const TOGGLED: u32 = STAT_RX.mask() | STAT_TX.mask() | DTOG_RX.mask() | DTOG_TX.mask();
/// Bits written as in any register.
const WRITTEN: u32 = EA.mask() | EP_KIND.mask() | EP_TYPE.mask();

/// Endpoint register.
#[derive(Clone, Copy, Debug, Default)]
pub struct Endpoint {
    value: u32,
    /// CTR bits that the program has read as set.
    seen: u32,
}

impl Endpoint {
    /// Reads the register for the program.
    pub fn read(&mut self) -> u32 {
        self.seen = self.value & COMPLETE;
        self.value
    }

    /// Reads a field without effect on the program.
    pub fn get(&self, field: Field) -> u32 {
        field.extract(self.value)
    }

    /// Sets a field for the hardware.
    pub fn put(&mut self, field: Field, value: u32) {
        self.value = field.put(self.value, value);
    }

    /// Returns `true` if the program has not acknowledged a complete transaction.
    pub fn complete(&self) -> bool {
        self.value & COMPLETE != 0
    }

    /// Handles a reset of the bus: only the bits of complete transactions stay.
    pub fn bus_reset(&mut self) {
        self.value &= COMPLETE;
    }

    /// Writes the register for the program; returns the program's error, if any.
    pub fn write(&mut self, value: u32) -> Option<&'static str> {
        let old = self.value;
        let kept = old & SETUP.mask();
        let toggled = (old ^ value) & TOGGLED;
        self.value = (value & WRITTEN) | toggled | (old & value & COMPLETE) | kept;
        let lost = old & !value & COMPLETE & !self.seen;
        let enabled = self.get(STAT_RX) != DISABLED || self.get(STAT_TX) != DISABLED;
        let was_enabled = STAT_RX.extract(old) != DISABLED || STAT_TX.extract(old) != DISABLED;
        let differs = |field: Field| field.extract(old) != field.extract(value);
        if value >> 16 != 0 {
            Some("writes reserved bits")
        } else if lost != 0 {
            Some("clears a CTR bit that it has not read: that transaction is lost")
        } else if was_enabled && (differs(EA) || differs(EP_TYPE)) {
            Some("changes address or type of an enabled endpoint")
        } else if enabled && self.get(EP_TYPE) == ISOCHRONOUS {
            Some("isochronous endpoints are not modelled")
        } else if enabled && self.get(EP_TYPE) == BULK && self.get(EP_KIND) != 0 {
            Some("double-buffered endpoints are not modelled")
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_written_one_toggles_and_a_written_zero_clears_only_ctr() {
        let mut endpoint = Endpoint::default();
        // Control, STAT_RX VALID, STAT_TX NAK.
        assert_eq!(endpoint.write(0x3220), None);
        assert_eq!(endpoint.read(), 0x3220);
        // Nothing toggles; the type is written again.
        assert_eq!(endpoint.write(0x8280), None);
        assert_eq!(endpoint.read(), 0x3220);
        // VALID ^ STALL, NAK ^ VALID.
        assert_eq!(endpoint.write(0x8280 | 0x2000 | 0x0010), None);
        assert_eq!(endpoint.read(), 0x1230);
    }

    #[test]
    fn ctr_is_cleared_by_a_zero_and_never_set_by_a_one() {
        let mut endpoint = Endpoint::default();
        endpoint.write(0x8280);
        assert_eq!(endpoint.read(), 0x0200);
        endpoint.put(CTR_RX, 1);
        endpoint.put(CTR_TX, 1);
        assert_eq!(endpoint.read(), 0x8280);
        assert_eq!(endpoint.write(0x0280), None);
        assert_eq!(endpoint.read(), 0x0280);
    }

    #[test]
    fn clearing_what_was_not_read_is_reported() {
        let mut endpoint = Endpoint::default();
        endpoint.write(0x3220);
        endpoint.read();
        endpoint.put(CTR_RX, 1);
        assert!(endpoint.write(0x0200).is_some());
    }

    #[test]
    fn an_enabled_endpoint_keeps_address_and_type() {
        let mut endpoint = Endpoint::default();
        assert_eq!(endpoint.write(0x0001 | 0x3000), None);
        assert!(endpoint.write(0x8082).is_some());
        endpoint.bus_reset();
        assert_eq!(endpoint.read(), 0);
    }
}
