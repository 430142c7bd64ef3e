//! Layout of the firmware's image in the STM32G474's flash, and the marks that identify it to a probe or a bootloader.
//!
//! Behind the vectors lies the linker's note with the image's build id, and behind that a [`Header`]. The image's last
//! word is the CRC-32 (as on the wire) of all before it, from [`FLASH_ADDRESS`] on.

/// First address of the flash.
pub const FLASH_ADDRESS: u32 = 0x0800_0000;

/// Bytes of the flash of an STM32G474xE.
pub const FLASH_BYTES: u32 = 512 * 1024;

/// The same in KiB, the unit of the chip's `FLASHSIZE` register.
pub const FLASH_KIB: u16 = (FLASH_BYTES / 1024) as u16;

/// Bytes of a page, the least that can be erased, with two banks (option byte DBANK = 1).
pub const PAGE_BYTES: u32 = 2_048;

/// First address of the two pages of the last good lookup, which end with the flash: no image reaches here.
pub const LOOKUP_ADDRESS: u32 = FLASH_ADDRESS + FLASH_BYTES - 2 * PAGE_BYTES;

/// `DBGMCU_IDCODE`, bits 11:0, of an STM32G474 (RM0440, 47.6.1: category 3).
pub const DEVICE_ID: u32 = 0x469;

/// The note `.note.gnu.build-id`: behind the 16 + 102 vectors.
pub const NOTE_ADDRESS: u32 = FLASH_ADDRESS + 0x1D8;

/// Bytes of a build id: a SHA-1 of what was linked.
pub const BUILD_ID_BYTES: usize = 20;

/// Bytes of the note: length of the name, of the id, type, `GNU\0`, the id.
pub const NOTE_BYTES: usize = 16 + BUILD_ID_BYTES;

/// Head of the note: 4 bytes of name, 20 of id, type NT_GNU_BUILD_ID, the name.
pub const NOTE_HEAD: [u8; 16] = *b"\x04\0\0\0\x14\0\0\0\x03\0\0\0GNU\0";

/// The header, behind the note.
pub const HEADER_ADDRESS: u32 = NOTE_ADDRESS + NOTE_BYTES as u32;

/// Magic number of the header.
pub const MAGIC: [u8; 4] = *b"IHDI";

/// The header's layout, as below.
pub const FORMAT: u16 = 1;

/// Bytes of the header.
pub const HEADER_BYTES: usize = 32;

/// Bytes of the package's version in the header, filled up with zeros.
pub const VERSION_BYTES: usize = 16;

/// Description of the image. In flash, little-endian:
///
/// | offset | bytes | |
/// |---:|---:|---|
/// | 0 | 4 | [`MAGIC`] |
/// | 4 | 2 | [`FORMAT`] |
/// | 6 | 2 | protocol, major |
/// | 8 | 2 | protocol, minor |
/// | 10 | 2 | 0 |
/// | 12 | 4 | address of the image's CRC: its last word |
/// | 16 | 16 | version of the package `ihd-firmware`, filled up with zeros |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Major version of the protocol that the image speaks.
    pub protocol_major: u16,
    /// Minor version of the same.
    pub protocol_minor: u16,
    /// Address of the CRC, the image's last word.
    pub crc_address: u32,
    /// Version of the package, filled up with zeros.
    pub version: [u8; VERSION_BYTES],
}

impl Header {
    /// The header in the bytes at [`HEADER_ADDRESS`]; `None` where there is none of this format.
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        let (bytes, _) = bytes.split_first_chunk::<HEADER_BYTES>()?;
        let half = |at: usize| Some(u16::from_le_bytes([*bytes.get(at)?, *bytes.get(at + 1)?]));
        if !bytes.starts_with(&MAGIC) || half(4)? != FORMAT {
            return None;
        }
        let (&crc_address, version) = bytes.get(12..)?.split_first_chunk()?;
        Some(Self {
            protocol_major: half(6)?,
            protocol_minor: half(8)?,
            crc_address: u32::from_le_bytes(crc_address),
            version: version.try_into().ok()?,
        })
    }

    /// Encodes as in flash.
    pub fn to_bytes(&self) -> [u8; HEADER_BYTES] {
        let mut bytes = [0; HEADER_BYTES];
        let fields = [
            &MAGIC[..],
            &FORMAT.to_le_bytes(),
            &self.protocol_major.to_le_bytes(),
            &self.protocol_minor.to_le_bytes(),
            &[0; 2],
            &self.crc_address.to_le_bytes(),
            &self.version,
        ];
        for (to, from) in bytes.iter_mut().zip(fields.into_iter().flatten()) {
            *to = *from;
        }
        bytes
    }

    /// The package's version; what is no text is none.
    pub fn version(&self) -> &str {
        let text = self.version.split(|&byte| byte == 0).next();
        text.and_then(|text| core::str::from_utf8(text).ok())
            .unwrap_or_default()
    }
}

/// The build id in the bytes at [`NOTE_ADDRESS`]; `None` where there is no such note.
pub fn build_id(note: &[u8]) -> Option<[u8; BUILD_ID_BYTES]> {
    let id = note.strip_prefix(&NOTE_HEAD)?;
    id.first_chunk().copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_comes_back_and_another_is_none() {
        let header = Header {
            protocol_major: 2,
            protocol_minor: 0x0304,
            crc_address: 0x0801_F534,
            version: *b"0.1.0\0\0\0\0\0\0\0\0\0\0\0",
        };
        let bytes = header.to_bytes();
        assert_eq!(bytes[..12], *b"IHDI\x01\0\x02\0\x04\x03\0\0");
        assert_eq!(bytes[12..16], [0x34, 0xF5, 0x01, 0x08]);
        assert_eq!(Header::parse(&bytes), Some(header));
        assert_eq!(header.version(), "0.1.0");
        assert_eq!(Header::parse(&bytes[..31]), None);
        let mut newer = bytes;
        newer[4] = 2;
        assert_eq!(Header::parse(&newer), None);
        assert_eq!(Header::parse(&[0xFF; 32]), None);
    }

    #[test]
    fn a_build_id_is_read_from_its_note_alone() {
        let mut note = [0x5A; NOTE_BYTES];
        assert_eq!(build_id(&note), None);
        note[..16].copy_from_slice(&NOTE_HEAD);
        assert_eq!(build_id(&note), Some([0x5A; 20]));
        assert_eq!(build_id(&note[..35]), None);
    }

    #[test]
    fn the_header_lies_behind_the_note_and_the_lookups_end_the_flash() {
        assert_eq!(HEADER_ADDRESS, 0x0800_01FC);
        assert_eq!(LOOKUP_ADDRESS, 0x0807_F000);
    }
}
