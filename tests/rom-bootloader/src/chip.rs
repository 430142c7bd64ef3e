//! The chip's memories (RM0440, chapter 3), two banks.

use crate::bootloader::Status;

/// Start of the main flash.
pub const FLASH: u32 = 0x0800_0000;
/// Bytes of it.
pub const FLASH_BYTES: usize = 512 * 1024;
/// Bytes of a page.
pub const PAGE: usize = 2048;
/// Start of each bank's option bytes.
pub const OPTIONS: [u32; 2] = [0x1FFF_7800, 0x1FFF_F800];
/// Bytes of a bank's option bytes: six words, each followed by its complement.
pub const OPTION_BYTES: usize = 48;
/// Start of the one-time programmable area.
pub const OTP: u32 = 0x1FFF_7000;
/// Bytes of it.
pub const OTP_BYTES: usize = 1024;
/// FLASH_OPTR as the factory leaves it.
pub const FACTORY_OPTR: u32 = 0xFFEF_F8AA;
/// RDP of a chip that is not protected.
const UNPROTECTED: u8 = 0xAA;
/// Bytes of which a write is made.
const DOUBLE_WORD: usize = 8;
/// Pages of a bank.
const BANK_PAGES: usize = 128;

/// The memories, which keep their contents without power.
#[derive(Clone, Debug)]
pub struct Chip {
    /// Main flash.
    pub flash: Vec<u8>,
    /// Option bytes of both banks, with complements.
    pub options: [[u8; OPTION_BYTES]; 2],
    /// One-time programmable area.
    pub otp: Vec<u8>,
    /// The factory's unique number.
    pub unique: [u32; 3],
}

impl Default for Chip {
    fn default() -> Self {
        let bank = |words: [u32; 6]| {
            let mut bytes = [0; OPTION_BYTES];
            for (place, word) in bytes.chunks_exact_mut(DOUBLE_WORD).zip(words) {
                place[..4].copy_from_slice(&word.to_le_bytes());
                place[4..].copy_from_slice(&(!word).to_le_bytes());
            }
            bytes
        };
        // FLASH_OPTR; PCROP from, to; WRP areas A and B, from beyond to; securable area.
        let first = [
            FACTORY_OPTR,
            0xFFFF_FFFF,
            0xFF00_0000,
            0xFF00_FFFF,
            0xFF00_FFFF,
            0xFF00_FF00,
        ];
        let second = [
            0xFFFF_FFFF,
            0xFFFF_FFFF,
            0xFF00_0000,
            first[3],
            first[4],
            first[5],
        ];
        Self {
            flash: vec![0xFF; FLASH_BYTES],
            options: [bank(first), bank(second)],
            otp: vec![0xFF; OTP_BYTES],
            unique: [0x0028_0051, 0x3539_5114, 0x2035_3933],
        }
    }
}

impl Chip {
    /// FLASH_OPTR, as the option bytes hold it.
    pub fn optr(&self) -> u32 {
        self.option(0, 0)
    }

    /// A word of a bank's option bytes.
    pub fn option(&self, bank: usize, word: usize) -> u32 {
        let at = word * DOUBLE_WORD;
        let bytes = self.options[bank][at..at + 4].try_into();
        u32::from_le_bytes(bytes.expect("four bytes"))
    }

    /// Sets a word of a bank's option bytes, and its complement.
    pub fn set_option(&mut self, bank: usize, word: usize, value: u32) {
        let at = word * DOUBLE_WORD;
        self.options[bank][at..at + 4].copy_from_slice(&value.to_le_bytes());
        self.options[bank][at + 4..at + 8].copy_from_slice(&(!value).to_le_bytes());
    }

    /// Returns `true` if reading is protected.
    pub fn protected(&self) -> bool {
        self.optr() as u8 != UNPROTECTED
    }

    /// Returns `true` if a page must not be written: within an area from page to page of its bank (words 3 and 4).
    fn write_protected(&self, page: usize) -> bool {
        let (bank, page) = (page / BANK_PAGES, page % BANK_PAGES);
        [3, 4].iter().any(|word| {
            let area = self.option(bank, *word);
            let (from, to) = (area & 0x7F, area >> 16 & 0x7F);
            (from..=to).contains(&(page as u32))
        })
    }

    /// Returns the offset of an address in the main flash.
    fn place(address: u32, length: usize) -> Result<usize, Status> {
        let place = address.checked_sub(FLASH).map(|place| place as usize);
        place
            .filter(|place| place + length <= FLASH_BYTES)
            .ok_or(Status::ErrTarget)
    }

    /// Bytes of any memory.
    ///
    /// # Errors
    /// `ErrVendor` while reading is protected, but for the option bytes; `ErrTarget` where there is no memory.
    pub fn read(&self, address: u32, length: usize) -> Result<Vec<u8>, Status> {
        let within = |start: u32, memory: &[u8]| {
            let from = address.checked_sub(start)? as usize;
            // The end of a memory ends the answer.
            let to = (from + length).min(memory.len());
            memory
                .get(from..to)
                .filter(|bytes| !bytes.is_empty())
                .map(<[u8]>::to_vec)
        };
        for (start, memory) in OPTIONS.iter().zip(&self.options) {
            if let Some(bytes) = within(*start, memory) {
                return Ok(bytes);
            }
        }
        if self.protected() {
            return Err(Status::ErrVendor);
        }
        within(FLASH, &self.flash)
            .or_else(|| within(OTP, &self.otp))
            .ok_or(Status::ErrTarget)
    }

    /// Erases the page that an address lies in; `whole` is false where power goes in the middle.
    ///
    /// # Errors
    /// Status of what refuses.
    pub fn erase(&mut self, address: u32, whole: bool) -> Result<(), Status> {
        let page = Self::place(address, 1)? / PAGE;
        if self.protected() {
            return Err(Status::ErrVendor);
        }
        if self.write_protected(page) {
            return Err(Status::ErrWrite);
        }
        let page = &mut self.flash[page * PAGE..(page + 1) * PAGE];
        if whole {
            page.fill(0xFF);
        } else {
            // Neither what it was nor erased.
            page.iter_mut().step_by(3).for_each(|byte| *byte |= 0x5A);
        }
        Ok(())
    }

    /// Erases all of the main flash.
    ///
    /// # Errors
    /// Status of what refuses.
    pub fn erase_all(&mut self) -> Result<(), Status> {
        if self.protected() {
            return Err(Status::ErrVendor);
        }
        let pages = FLASH_BYTES / PAGE;
        if (0..pages).any(|page| self.write_protected(page)) {
            return Err(Status::ErrWrite);
        }
        self.flash.fill(0xFF);
        Ok(())
    }

    /// Writes to the main flash, in double words, which must be erased; only half of it where power goes.
    ///
    /// # Errors
    /// Status of what refuses.
    pub fn program(&mut self, address: u32, bytes: &[u8], whole: bool) -> Result<(), Status> {
        let mut place = Self::place(address, bytes.len())?;
        if self.protected() {
            return Err(Status::ErrVendor);
        }
        if !place.is_multiple_of(DOUBLE_WORD) || !bytes.len().is_multiple_of(DOUBLE_WORD) {
            return Err(Status::ErrAddress);
        }
        let until = if whole { bytes.len() } else { bytes.len() / 2 };
        for word in bytes[..until].chunks(DOUBLE_WORD) {
            if self.write_protected(place / PAGE) {
                return Err(Status::ErrWrite);
            }
            let there = &mut self.flash[place..place + word.len()];
            if there.iter().any(|byte| *byte != 0xFF) {
                return Err(Status::ErrProg);
            }
            there.copy_from_slice(word);
            place += word.len();
        }
        Ok(())
    }

    /// Writes option bytes from the beginning of a bank on, as many as come, in pairs of a word and its complement.
    ///
    /// # Errors
    /// `ErrFile` where a complement is none, `ErrTarget` elsewhere.
    pub fn set_options(&mut self, address: u32, bytes: &[u8]) -> Result<(), Status> {
        let bank = OPTIONS.iter().position(|start| *start == address);
        let bank = bank.ok_or(Status::ErrTarget)?;
        if bytes.len() > OPTION_BYTES || !bytes.len().is_multiple_of(DOUBLE_WORD) {
            return Err(Status::ErrTarget);
        }
        let pairs = bytes.chunks_exact(DOUBLE_WORD);
        if pairs
            .clone()
            .any(|pair| (0..4).any(|i| pair[i] != !pair[i + 4]))
        {
            return Err(Status::ErrFile);
        }
        self.options[bank][..bytes.len()].copy_from_slice(bytes);
        Ok(())
    }

    /// Takes the read protection away, and with it all that the flash holds.
    pub fn unprotect(&mut self) {
        self.flash.fill(0xFF);
        let optr = self.optr() & !0xFF | u32::from(UNPROTECTED);
        self.set_option(0, 0, optr);
    }
}
