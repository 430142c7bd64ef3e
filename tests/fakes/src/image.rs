//! Images to flash that are no programs.

use ihd_shared::image::{FLASH_ADDRESS, HEADER_ADDRESS, Header, MAGIC, NOTE_ADDRESS, NOTE_HEAD};
use ihd_shared::wire::frame::CRC32;

/// Small image that passes all checks but is no program; tests change its fields.
#[derive(Clone, Debug)]
pub struct SampleImage {
    /// Address of its beginning.
    pub place: u32,
    /// Size in bytes, a multiple of 4.
    pub bytes: usize,
    /// Version of the package.
    pub version: &'static str,
    /// First bytes of the header.
    pub magic: [u8; 4],
    /// Protocol version.
    pub protocol: (u16, u16),
    /// Every byte of the build id.
    pub build_id: u8,
    /// The second vector.
    pub entry: u32,
    /// ELF's number of the processor.
    pub machine: u16,
    /// Bytes by which the second half lies too far on.
    pub gap: u32,
}

impl Default for SampleImage {
    fn default() -> Self {
        Self {
            place: FLASH_ADDRESS,
            bytes: 5_000,
            version: "9.8.7",
            magic: MAGIC,
            protocol: (2, 2),
            build_id: 0xB1,
            entry: FLASH_ADDRESS + 0x301,
            machine: 40,
            gap: 0,
        }
    }
}

impl SampleImage {
    /// First bytes of the program, once in the image.
    pub const CODE: [u8; 8] = *b"\x12program";

    /// Returns the ELF file: two segments.
    pub fn elf(&self) -> Vec<u8> {
        let flat = self.flat();
        let (first, second) = flat.split_at(flat.len() / 8 * 4);
        let next = self.place + first.len() as u32 + self.gap;
        let headers = 52 + 2 * 32;
        let mut elf = b"\x7fELF\x01\x01\x01\0\0\0\0\0\0\0\0\0".to_vec();
        let push_halves = |elf: &mut Vec<u8>, values: &[u16]| {
            elf.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        };
        let push_words = |elf: &mut Vec<u8>, values: &[u32]| {
            elf.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        };
        push_halves(&mut elf, &[2, self.machine]);
        push_words(&mut elf, &[1, self.entry, 52, 0, 0x0500_0200]);
        push_halves(&mut elf, &[52, 32, 2, 0, 0, 0]);
        let mut offset = headers as u32;
        for (address, bytes) in [(self.place, first), (next, second)] {
            let length = bytes.len() as u32;
            push_words(
                &mut elf,
                &[1, offset, address, address, length, length, 5, 4],
            );
            offset += length;
        }
        elf.extend_from_slice(first);
        elf.extend_from_slice(second);
        elf
    }

    fn flat(&self) -> Vec<u8> {
        let mut flat: Vec<u8> = (0..self.bytes).map(|at| (at / 7 + at) as u8).collect();
        let mut version = [0; 16];
        version[..self.version.len()].copy_from_slice(self.version.as_bytes());
        let header = Header {
            protocol_major: self.protocol.0,
            protocol_minor: self.protocol.1,
            crc_address: FLASH_ADDRESS + self.bytes as u32 - 4,
            version,
        };
        let mut put = |address: u32, bytes: &[u8]| {
            let at = (address - FLASH_ADDRESS) as usize;
            flat[at..at + bytes.len()].copy_from_slice(bytes);
        };
        put(FLASH_ADDRESS, &0x2000_4000_u32.to_le_bytes());
        put(FLASH_ADDRESS + 4, &self.entry.to_le_bytes());
        put(NOTE_ADDRESS, &NOTE_HEAD);
        put(NOTE_ADDRESS + 16, &[self.build_id; 20]);
        put(HEADER_ADDRESS, &header.to_bytes());
        put(HEADER_ADDRESS, &self.magic);
        put(FLASH_ADDRESS + 0x300, &Self::CODE);
        let covered = self.bytes - 4;
        let crc = CRC32.checksum(&flat[..covered]);
        flat[covered..].copy_from_slice(&crc.to_le_bytes());
        flat
    }
}
