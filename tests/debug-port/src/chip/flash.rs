//! Flash and its controller (RM0440, 3.3 and 3.7), two banks of 128 pages of 2 KiB.

use std::ops::Range;

use ihd_shared::image::{FLASH_ADDRESS, FLASH_BYTES, PAGE_BYTES};

use crate::target::BusFault;

/// The controller's registers.
pub const CONTROLLER: Range<u32> = 0x4002_2000..0x4002_2400;

const KEYR: u32 = CONTROLLER.start + 0x08;
const OPTKEYR: u32 = CONTROLLER.start + 0x0C;
const SR: u32 = CONTROLLER.start + 0x10;
const CR: u32 = CONTROLLER.start + 0x14;
const OPTR: u32 = CONTROLLER.start + 0x20;
const WRP: [u32; 4] = [
    CONTROLLER.start + 0x2C,
    CONTROLLER.start + 0x30,
    CONTROLLER.start + 0x4C,
    CONTROLLER.start + 0x50,
];

const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];
const OPTION_KEYS: [u32; 2] = [0x0819_2A3B, 0x4C5D_6E7F];

/// `FLASH_CR`.
pub mod cr {
    /// Programming.
    pub const PG: u32 = 1;
    /// Erasure of a page: PNB and BKER say which.
    pub const PER: u32 = 1 << 1;
    /// Erasure of both banks.
    pub const MER: u32 = 1 << 2 | 1 << 15;
    /// Position of the page's number.
    pub const PNB: u32 = 3;
    /// The second bank.
    pub const BKER: u32 = 1 << 11;
    /// Begins an erasure.
    pub const STRT: u32 = 1 << 16;
    /// Begins writing option bytes.
    pub const OPTSTRT: u32 = 1 << 17;
    /// Loads option bytes.
    pub const OBL_LAUNCH: u32 = 1 << 27;
    /// Option bytes are locked.
    pub const OPTLOCK: u32 = 1 << 30;
    /// Everything is locked.
    pub const LOCK: u32 = 1 << 31;
}

/// `FLASH_SR`.
pub mod sr {
    /// End of operation.
    pub const EOP: u32 = 1;
    /// A double word was not erased.
    pub const PROGERR: u32 = 1 << 3;
    /// A page is write-protected.
    pub const WRPERR: u32 = 1 << 4;
    /// A write that is no whole word.
    pub const SIZERR: u32 = 1 << 6;
    /// Out of sequence: PG not set, or an error before was not cleared.
    pub const PGSERR: u32 = 1 << 7;
    /// An operation goes on.
    pub const BSY: u32 = 1 << 16;
    /// All errors.
    pub const ERRORS: u32 = 0xC3FA;
}

/// A row of keys that opens a lock: a wrong one closes it until the next reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Lock {
    #[default]
    Closed,
    Half,
    Open,
    Jammed,
}

impl Lock {
    fn key(&mut self, keys: [u32; 2], key: u32) -> Result<(), BusFault> {
        *self = match (*self, key) {
            (Self::Closed, key) if key == keys[0] => Self::Half,
            (Self::Half, key) if key == keys[1] => Self::Open,
            _ => Self::Jammed,
        };
        match *self {
            Self::Jammed => Err(BusFault),
            _ => Ok(()),
        }
    }
}

/// The flash.
#[derive(Debug)]
pub struct Flash {
    /// Its bytes.
    pub bytes: Vec<u8>,
    /// `FLASH_OPTR` as it acts.
    pub optr: u32,
    /// Write protection as it acts: `WRP1A`, `WRP1B`, `WRP2A`, `WRP2B`.
    pub wrp: [u32; 4],
    /// The controller does not finish any more.
    pub stuck: bool,
    /// Pages that were erased since the beginning, in order.
    pub erased: Vec<u32>,
    status: u32,
    control: u32,
    lock: Lock,
    option_lock: Lock,
    /// Option bytes as they will act after they were loaded.
    written: (u32, [u32; 4]),
    next_optr: u32,
    next_wrp: [u32; 4],
    loads: bool,
}

impl Default for Flash {
    fn default() -> Self {
        // DBANK = 1, SRAM_PE = 0, BOR level 4; no write protection.
        let (optr, wrp) = (0xFEEF_FCAA, [0xFF00_FFFF; 4]);
        Self {
            bytes: vec![0xFF; FLASH_BYTES as usize],
            optr,
            wrp,
            stuck: false,
            erased: Vec::new(),
            status: 0,
            control: cr::LOCK | cr::OPTLOCK,
            lock: Lock::Closed,
            option_lock: Lock::Closed,
            written: (optr, wrp),
            next_optr: optr,
            next_wrp: wrp,
            loads: false,
        }
    }
}

impl Flash {
    /// Sets option bytes as if they had been loaded.
    pub fn with_options(mut self, optr: u32, wrp: [u32; 4]) -> Self {
        (self.optr, self.wrp, self.written) = (optr, wrp, (optr, wrp));
        (self.next_optr, self.next_wrp) = (optr, wrp);
        self
    }

    /// Protected against reading while a debugger is there.
    fn is_unreadable(&self) -> bool {
        self.optr & 0xFF != 0xAA
    }

    /// A reset locks the controller, and ends an operation.
    pub fn reset(&mut self) {
        (self.status, self.control) = (0, cr::LOCK | cr::OPTLOCK);
        (self.lock, self.option_lock) = (Lock::Closed, Lock::Closed);
        (self.optr, self.wrp) = self.written;
        (self.next_optr, self.next_wrp) = self.written;
        self.stuck = false;
    }

    /// Returns `true`, once, if option bytes are to be loaded.
    pub fn wants_reset(&mut self) -> bool {
        std::mem::take(&mut self.loads)
    }

    /// Reads memory.
    ///
    /// # Errors
    /// Where it is protected against that.
    pub fn read(&self, address: u32, bytes: u32) -> Result<u32, BusFault> {
        let at = (address - FLASH_ADDRESS) as usize;
        match self.bytes.get(at..at + bytes as usize) {
            Some(bytes) if !self.is_unreadable() => Ok(bytes
                .iter()
                .rev()
                .fold(0, |value, &byte| value << 8 | u32::from(byte))),
            _ => Err(BusFault),
        }
    }

    /// Reads a register.
    pub fn register(&self, address: u32) -> u32 {
        let busy = if self.stuck { sr::BSY } else { 0 };
        match address {
            SR => self.status | busy,
            CR => self.control,
            OPTR => self.optr,
            _ => match WRP.iter().position(|&wrp| wrp == address) {
                Some(area) => self.wrp[area],
                None => 0,
            },
        }
    }

    /// Writes a register.
    ///
    /// # Errors
    /// A wrong key.
    pub fn set_register(&mut self, address: u32, value: u32) -> Result<(), BusFault> {
        match address {
            KEYR => {
                self.lock.key(KEYS, value)?;
                if self.lock == Lock::Open {
                    self.control &= !cr::LOCK;
                }
            }
            OPTKEYR => {
                self.option_lock.key(OPTION_KEYS, value)?;
                if self.option_lock == Lock::Open {
                    self.control &= !cr::OPTLOCK;
                }
            }
            SR => self.status &= !(value & (sr::ERRORS | sr::EOP)),
            CR => self.set_control(value),
            // Writable once the options are unlocked; they act when loaded.
            OPTR if self.control & cr::OPTLOCK == 0 => self.next_optr = value,
            area if self.control & cr::OPTLOCK == 0 => {
                if let Some(area) = WRP.iter().position(|&wrp| wrp == area) {
                    self.next_wrp[area] = value;
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn set_control(&mut self, value: u32) {
        if self.control & cr::LOCK != 0 {
            return;
        }
        // The locks are opened by keys alone.
        let locks = self.control & (cr::LOCK | cr::OPTLOCK) | value & (cr::LOCK | cr::OPTLOCK);
        self.control = value & !(cr::LOCK | cr::OPTLOCK) | locks;
        if value & cr::LOCK != 0 {
            (self.lock, self.option_lock) = (Lock::Closed, Lock::Closed);
        }
        if value & cr::STRT != 0 {
            self.erase();
            self.control &= !cr::STRT;
        }
        if value & cr::OPTSTRT != 0 && self.control & cr::OPTLOCK == 0 {
            self.written = (self.next_optr, self.next_wrp);
            self.control &= !cr::OPTSTRT;
        }
        if value & cr::OBL_LAUNCH != 0 && self.control & cr::OPTLOCK == 0 {
            self.loads = true;
        }
    }

    fn is_protected(&self, page: u32) -> bool {
        let (bank, page) = (page / 128, page % 128);
        let areas = self
            .wrp
            .iter()
            .enumerate()
            .filter(|(at, _)| *at as u32 / 2 == bank);
        areas
            .map(|(_, area)| (area & 0x7F, area >> 16 & 0x7F))
            .any(|(first, last)| (first..=last).contains(&page))
    }

    fn erase(&mut self) {
        if self.status & sr::ERRORS != 0 {
            self.status |= sr::PGSERR;
            return;
        }
        let all = 0..FLASH_BYTES / PAGE_BYTES;
        let pages = if self.control & cr::MER != 0 {
            all
        } else if self.control & cr::PER != 0 {
            let bank = u32::from(self.control & cr::BKER != 0);
            let page = bank * 128 + (self.control >> cr::PNB & 0x7F);
            page..page + 1
        } else {
            self.status |= sr::PGSERR;
            return;
        };
        if pages.clone().any(|page| self.is_protected(page)) {
            self.status |= sr::WRPERR;
            return;
        }
        for page in pages {
            let at = (page * PAGE_BYTES) as usize;
            self.bytes[at..at + PAGE_BYTES as usize].fill(0xFF);
            self.erased.push(page);
        }
        self.status |= sr::EOP;
    }

    /// Half an erasure: what a loss of power leaves.
    pub fn tear(&mut self, page: u32) {
        let at = (page * PAGE_BYTES) as usize;
        for (offset, byte) in self.bytes[at..at + PAGE_BYTES as usize]
            .iter_mut()
            .enumerate()
        {
            *byte |= (offset as u8).wrapping_mul(0x35);
        }
    }

    /// Programs a double word.
    pub fn program(&mut self, address: u32, value: [u8; 8]) {
        let page = (address - FLASH_ADDRESS) / PAGE_BYTES;
        let at = (address - FLASH_ADDRESS) as usize;
        let is_open = self.control & cr::LOCK == 0 && self.control & cr::PG != 0;
        if !is_open || self.status & sr::ERRORS != 0 {
            self.status |= sr::PGSERR;
        } else if self.is_protected(page) {
            self.status |= sr::WRPERR;
        } else if !at.is_multiple_of(8) {
            self.status |= sr::SIZERR;
        } else if self.bytes[at..at + 8] != [0xFF; 8] && value != [0; 8] {
            self.status |= sr::PROGERR;
        } else {
            self.bytes[at..at + 8].copy_from_slice(&value);
            self.status |= sr::EOP;
        }
    }
}

#[cfg(test)]
mod tests;
