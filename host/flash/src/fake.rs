//! Fake chip for tests of screens and of the steps before and after flashing, without a probe: it holds memory and option bytes,
//! and fails on request. Also images to flash.

use std::ops::Range;

use ihd_shared::image::{
    DEVICE_ID, FLASH_ADDRESS, FLASH_BYTES, HEADER_ADDRESS, Header, MAGIC, NOTE_ADDRESS, NOTE_HEAD,
    PAGE_BYTES,
};
use ihd_shared::wire::frame::CRC32;

use crate::image::Image;
use crate::options::{OptionBytes, ReadProtection};
use crate::programmer::{Chip, Erase, FlashStep, ProgramError, Programmer, Progress};

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

    /// Parses it with [`Image::parse`].
    ///
    /// # Panics
    /// If the fields make it invalid.
    pub fn image(&self) -> Image {
        Image::parse(&self.elf(), None).expect("a sample that is not spoilt")
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

/// Single failure of a [`FakeProgrammer`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// The probe disconnects in the middle of this step.
    Lost(FlashStep),
    /// The flash's controller reports an error at this step.
    Refused(FlashStep),
    /// One bit keeps its old value.
    Bit,
}

/// Fake chip.
#[derive(Clone, Debug)]
pub struct FakeProgrammer {
    /// `DBGMCU_IDCODE`.
    pub id_code: u32,
    /// The flash, from its first address.
    pub flash: Vec<u8>,
    /// Option bytes.
    pub options: OptionBytes,
    /// `true` if the outputs are on; `None` if this access cannot see it.
    pub switching: Option<bool>,
    /// Next failure.
    pub failure: Option<Failure>,
    /// Number of resets.
    pub resets: u32,
    /// Names of the calls, in order.
    pub calls: Vec<&'static str>,
}

impl Default for FakeProgrammer {
    fn default() -> Self {
        Self {
            id_code: 0x2003_6000 | DEVICE_ID,
            flash: vec![0xFF; FLASH_BYTES as usize],
            options: OptionBytes::default().with_requirements(),
            switching: Some(false),
            failure: None,
            resets: 0,
            calls: Vec::new(),
        }
    }
}

impl FakeProgrammer {
    /// Creates a chip with this image.
    pub fn with(image: &Image) -> Self {
        let mut fake = Self::default();
        fake.write(FLASH_ADDRESS, &image.flat());
        fake
    }

    /// Bytes at an address of the flash.
    pub fn at(&self, address: u32, bytes: usize) -> &[u8] {
        let at = (address - FLASH_ADDRESS) as usize;
        &self.flash[at..at + bytes]
    }

    /// Writes the flash without the rules of a real chip.
    pub fn write(&mut self, address: u32, bytes: &[u8]) {
        let at = (address - FLASH_ADDRESS) as usize;
        self.flash[at..at + bytes.len()].copy_from_slice(bytes);
    }

    fn fails(&mut self, failure: Failure) -> bool {
        let fails = self.failure == Some(failure);
        if fails {
            self.failure = None;
        }
        fails
    }

    fn lose(&mut self, doing: FlashStep) -> Result<(), ProgramError> {
        if self.fails(Failure::Lost(doing)) {
            return Err(ProgramError::Lost {
                doing,
                why: "the fake probe was pulled".into(),
            });
        }
        if self.fails(Failure::Refused(doing)) {
            return Err(ProgramError::Failed {
                doing,
                address: FLASH_ADDRESS,
                why: "the fake flash refuses".into(),
            });
        }
        Ok(())
    }

    fn erase(&mut self, range: Range<usize>) -> Result<(), ProgramError> {
        let middle = (range.start + range.end) / 2;
        self.flash[range.start..middle].fill(0xFF);
        self.lose(FlashStep::Erasing)?;
        self.flash[middle..range.end].fill(0xFF);
        Ok(())
    }
}

impl Programmer for FakeProgrammer {
    fn describe(&self) -> String {
        "fake probe".into()
    }

    fn identify(&mut self) -> Result<Chip, ProgramError> {
        self.calls.push("identify");
        self.lose(FlashStep::Reading)?;
        if self.id_code & 0xFFF != DEVICE_ID {
            let id_code = self.id_code;
            return Err(ProgramError::WrongChip { id_code });
        }
        match self.options.read_protection() {
            ReadProtection::None => Ok(Chip {
                id_code: Some(self.id_code),
                flash_kib: 512,
                unique_id: Some(*b"fake chip 01"),
            }),
            level => Err(ProgramError::ReadProtected { level }),
        }
    }

    fn is_switching(&mut self) -> Result<Option<bool>, ProgramError> {
        self.calls.push("is_switching");
        Ok(self.switching)
    }

    fn read(&mut self, address: u32, out: &mut [u8]) -> Result<(), ProgramError> {
        let at = address.checked_sub(FLASH_ADDRESS).map(|at| at as usize);
        match at.and_then(|at| self.flash.get(at..at + out.len())) {
            Some(bytes) => out.copy_from_slice(bytes),
            None => out.fill(0),
        }
        Ok(())
    }

    fn option_bytes(&mut self) -> Result<OptionBytes, ProgramError> {
        self.calls.push("option_bytes");
        Ok(self.options)
    }

    fn set_option_bytes(&mut self, target: &OptionBytes) -> Result<(), ProgramError> {
        self.calls.push("set_option_bytes");
        self.lose(FlashStep::SettingOptions)?;
        self.options = *target;
        self.resets += 1;
        Ok(())
    }

    fn flash(
        &mut self,
        image: &Image,
        erase: Erase,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<(), ProgramError> {
        self.calls.push("flash");
        let (flat, total) = (image.flat(), image.bytes);
        let pages = flat.len().next_multiple_of(PAGE_BYTES as usize);
        self.erase(match erase {
            Erase::Image => 0..pages,
            Erase::All => 0..self.flash.len(),
        })?;
        let half = flat.len() / 2;
        for (done, part) in [(0, 0..half), (half as u32, half..flat.len())] {
            progress(Progress::Programming { done, total });
            if done > 0 {
                self.lose(FlashStep::Programming)?;
            }
            self.flash[part.clone()].copy_from_slice(&flat[part]);
        }
        progress(Progress::Programming { done: total, total });
        if self.fails(Failure::Bit) {
            self.flash[1_000] ^= 1;
        }
        self.lose(FlashStep::Verifying)?;
        let actual = &self.flash[..flat.len()];
        if let Some(at) = (0..flat.len()).find(|&at| actual[at] != flat[at]) {
            return Err(ProgramError::Verify {
                address: FLASH_ADDRESS + at as u32,
                expected: vec![flat[at]],
                actual: vec![actual[at]],
            });
        }
        progress(Progress::Verifying { done: total, total });
        Ok(())
    }

    fn reset(&mut self) -> Result<(), ProgramError> {
        self.calls.push("reset");
        self.lose(FlashStep::Resetting)?;
        self.resets += 1;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ihd_shared::image::LOOKUP_ADDRESS;

    #[test]
    fn what_is_flashed_is_there_and_the_lookup_stays() {
        let mut fake = FakeProgrammer::default();
        fake.write(LOOKUP_ADDRESS, b"lookup");
        let image = SampleImage::default().image();
        fake.flash(&image, Erase::Image, &mut |_| ()).unwrap();
        assert_eq!(fake.at(FLASH_ADDRESS, 5_000), image.flat());
        assert_eq!(fake.at(LOOKUP_ADDRESS, 6), b"lookup");
        fake.flash(&image, Erase::All, &mut |_| ()).unwrap();
        assert_eq!(fake.at(LOOKUP_ADDRESS, 6), [0xFF; 6]);
    }

    #[test]
    fn a_failure_comes_once() {
        let image = SampleImage::default().image();
        let steps = [
            FlashStep::Erasing,
            FlashStep::Programming,
            FlashStep::Verifying,
        ];
        for failure in steps.map(Failure::Lost) {
            let mut fake = FakeProgrammer {
                failure: Some(failure),
                ..Default::default()
            };
            let why = fake.flash(&image, Erase::Image, &mut |_| ()).unwrap_err();
            assert!(matches!(why, ProgramError::Lost { .. }), "{why}");
            fake.flash(&image, Erase::Image, &mut |_| ()).unwrap();
            assert_eq!(fake.at(FLASH_ADDRESS, 5_000), image.flat());
        }
    }
}
