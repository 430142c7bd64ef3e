//! Control transfers: the standard's requests, and the class's.

use crate::bootloader::{Bootloader, Refused};
use crate::descriptors::{self, ALTERNATES};

impl Bootloader {
    /// A control transfer, but for SET_ADDRESS: its setup packet, and the data that go to the device. Gives the data
    /// that come from it.
    ///
    /// # Errors
    /// A STALL, or no answer at all from a device that has gone.
    pub fn control(&mut self, setup: [u8; 8], data: &[u8]) -> Result<Vec<u8>, Refused> {
        let [kind, request, value_low, value_high, index, ..] = setup;
        let value = u16::from_le_bytes([value_low, value_high]);
        let length = u16::from_le_bytes([setup[6], setup[7]]);
        let mut answer = match (kind, request) {
            (0x80, 6) => descriptors::descriptor(
                value_high,
                value_low,
                &self.chip,
                self.flash_layout.as_deref(),
            )
            .ok_or(Refused::Stall)?,
            (0x80..=0x82, 0) => vec![1, 0],
            (0x80, 8) => vec![u8::from(self.configured)],
            (0x00, 9) => {
                self.configured = value == 1;
                Vec::new()
            }
            (0x81, 10) => vec![self.alternate],
            (0x01, 11) if index == 0 && value < u16::from(ALTERNATES) => {
                self.alternate = value_low;
                Vec::new()
            }
            (0x21, _) => self.class_out(request, value, data).map(|()| Vec::new())?,
            (0xA1, _) => self.class_in(request, value, length)?,
            _ => return Err(Refused::Stall),
        };
        answer.truncate(length.into());
        Ok(answer)
    }
}
