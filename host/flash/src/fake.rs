//! Fake chip for tests of the steps before and after flashing: it holds memory and option bytes, and fails on request.

use std::ops::Range;

use ihd_fakes::SampleImage;
use ihd_shared::image::{DEVICE_ID, FLASH_ADDRESS, FLASH_BYTES, PAGE_BYTES};

use crate::image::Image;
use crate::options::{OptionBytes, ReadProtection};
use crate::programmer::{Chip, Erase, FlashStep, ProgramError, Programmer, WriteProgress};

/// Returns the parsed image of a sample whose fields are valid.
pub fn image(sample: &SampleImage) -> Image {
    Image::parse(&sample.elf(), None).expect("a sample that is not spoilt")
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
    /// `true` if the outputs are on after the reset by which option bytes are loaded.
    pub switches_after_options: bool,
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
            switches_after_options: false,
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
        if self.switches_after_options {
            self.switching = Some(true);
        }
        Ok(())
    }

    fn flash(
        &mut self,
        image: &Image,
        erase: Erase,
        progress: &mut dyn FnMut(WriteProgress),
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
            progress(WriteProgress::Programming { done, total });
            if done > 0 {
                self.lose(FlashStep::Programming)?;
            }
            self.flash[part.clone()].copy_from_slice(&flat[part]);
        }
        progress(WriteProgress::Programming { done: total, total });
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
        progress(WriteProgress::Verifying { done: total, total });
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
        let image = image(&SampleImage::default());
        fake.flash(&image, Erase::Image, &mut |_| ()).unwrap();
        assert_eq!(fake.at(FLASH_ADDRESS, 5_000), image.flat());
        assert_eq!(fake.at(LOOKUP_ADDRESS, 6), b"lookup");
        fake.flash(&image, Erase::All, &mut |_| ()).unwrap();
        assert_eq!(fake.at(LOOKUP_ADDRESS, 6), [0xFF; 6]);
    }

    #[test]
    fn a_failure_comes_once() {
        let image = image(&SampleImage::default());
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
