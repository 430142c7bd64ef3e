//! Identity of the device: its chip, its program and how it started.

use ihd_shared::wire::messages::{Board, Raw};

/// Identity of the device, as far as its chip and its program know.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceIdentity {
    /// DBGMCU_IDCODE; 0 where there is no chip.
    pub id_code: u32,
    /// Flash, in KiB.
    pub flash_kib: u16,
    /// FLASH_OPTR.
    pub option_bytes: u32,
    /// RCC_CSR as the program found it.
    pub reset_flags: u32,
    /// Starts since power came on, this one included; 255 for that many or more.
    pub starts: u8,
    /// Bytes of the program in flash before its CRC.
    pub image_bytes: u32,
    /// Their CRC-32 as worked out at start.
    pub image_crc: u32,
    /// The CRC-32 that the program was sealed with.
    pub sealed_crc: u32,
    /// GNU build id.
    pub build_id: Option<[u8; 20]>,
    /// The chip's unique number.
    pub chip: Option<[u8; 12]>,
}

impl DeviceIdentity {
    /// The message of it.
    pub fn message(&self) -> Board<'_> {
        Board {
            id_code: self.id_code,
            flash_kib: self.flash_kib,
            option_bytes: self.option_bytes,
            reset_flags: self.reset_flags,
            starts: self.starts,
            image_bytes: self.image_bytes,
            image_crc: self.image_crc,
            sealed_crc: self.sealed_crc,
            build_id: Raw(self.build_id.as_ref().map_or(&[], |id| id.as_slice())),
            chip: Raw(self.chip.as_ref().map_or(&[], |id| id.as_slice())),
        }
    }
}
