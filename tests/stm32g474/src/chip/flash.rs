//! Flash controller, and the pages at the end of the flash that the program writes: program, erase, ECC (RM0440, 3.3).
//!
//! Callbacks serve those pages, so a read of a double word with two wrong bits has its effect on the chip. The pages that hold
//! the program are plain memory.

use std::collections::BTreeSet;

use crate::registers::flash;
use crate::time::{Ticks, us};
use crate::violation::Log;

use super::register_file::RegisterFile;

/// First address of the pages that the program may write, the last two of bank 2.
pub const PAGES: u32 = 0x0807_F000;
/// Size of the pages from [`PAGES`] on, in bytes.
pub const PAGES_BYTES: usize = 0x1000;
/// Size of a page in bytes.
pub const PAGE_BYTES: u32 = 2048;
const BANK_2: u32 = 0x0804_0000;

/// Time to program a double word and to erase a page (DS12288, table "Flash memory characteristics": 81.7 µs, 22.02 ms).
const PROGRAM: Ticks = us(82);
const ERASE: Ticks = us(22_020);

/// Flags of FLASH_ECCR, cleared by writing 1.
const ECC_FLAGS: u32 = {
    use flash::flash_eccr::{ECCC, ECCC2, ECCD, ECCD2};
    ECCC.mask() | ECCC2.mask() | ECCD.mask() | ECCD2.mask()
};

const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];

/// Operation of the controller.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Operation {
    Program {
        offset: u32,
        value: u64,
    },
    Erase {
        offset: u32,
    },
    /// Programming of the program's own part by a debugger's flash algorithm; the machine writes that memory.
    ProgramElsewhere,
    EraseElsewhere {
        first: u32,
        pages: u32,
    },
}

/// Content of the pages, which is kept without power.
#[derive(Clone, Debug)]
pub struct Pages {
    bytes: Vec<u8>,
    /// Double words with two wrong bits.
    damaged: BTreeSet<u32>,
    /// Double words with one wrong bit, which a read corrects.
    corrected: BTreeSet<u32>,
    /// Double words programmed since the last erasure.
    programmed: BTreeSet<u32>,
}

impl Default for Pages {
    fn default() -> Self {
        Self {
            bytes: vec![0xFF; PAGES_BYTES],
            damaged: BTreeSet::new(),
            corrected: BTreeSet::new(),
            programmed: BTreeSet::new(),
        }
    }
}

impl Pages {
    /// Damages a double word with two wrong bits, at an offset from [`PAGES`].
    pub fn damage(&mut self, offset: u32) {
        self.damaged.insert(offset & !7);
    }

    /// Content of the pages.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }
}

/// Flash controller.
#[derive(Clone, Debug, Default)]
pub struct FlashController {
    /// Pages that the program may write.
    pub pages: Pages,
    keys: usize,
    busy: Option<(Operation, Ticks)>,
    first_half: Option<(u32, u32)>,
    /// Number of operations begun since power-on; `cut_at_operation` refers to it.
    pub operations: u64,
    /// Number of the operation at whose beginning the power is cut.
    pub cut_at_operation: Option<u64>,
    /// Set when the power is to be cut now.
    pub power_gone: bool,
    /// Set once a debugger is attached: it may change the program, the program itself must not.
    pub is_debugged: bool,
    /// Addresses of erased pages of the program; the machine clears that memory.
    pub erased: Vec<u32>,
    /// Address and previous value of each word of the program whose store was refused; the machine restores it.
    pub refused: Vec<(u32, u32)>,
}

impl FlashController {
    /// Controller of pages with this content.
    pub fn with(pages: Pages) -> Self {
        Self {
            pages,
            ..Self::default()
        }
    }

    /// End of the operation in progress.
    pub fn next(&self) -> Option<Ticks> {
        self.busy.map(|(_, until)| until)
    }

    /// Level of the interrupt line: the end of an operation, or an error (RM0440, 3.6).
    pub fn line(file: &RegisterFile) -> bool {
        use flash::{flash_cr, flash_sr};
        const ERRORS: u32 = 0xC3FA;
        let errors = file.word(flash_sr::ADDRESS) & ERRORS != 0;
        (file.is(flash_cr::EOPIE) && file.is(flash_sr::EOP)) || (file.is(flash_cr::ERRIE) && errors)
    }

    /// Completes the operation in progress if it is due. EOP is set only if its interrupt is enabled (RM0440, 3.7.5).
    pub fn advance(&mut self, now: Ticks, file: &mut RegisterFile) {
        if let Some((operation, until)) = self.busy
            && now >= until
        {
            self.complete(operation);
            self.busy = None;
            if file.is(flash::flash_cr::EOPIE) {
                file.set(flash::flash_sr::EOP, 1);
            }
        }
    }

    fn complete(&mut self, operation: Operation) {
        match operation {
            Operation::Program { offset, value } => {
                self.pages.bytes[offset as usize..][..8].copy_from_slice(&value.to_le_bytes());
                self.pages.programmed.insert(offset);
            }
            Operation::Erase { offset } => {
                let words = (offset..offset + PAGE_BYTES).step_by(8);
                self.pages.bytes[offset as usize..][..PAGE_BYTES as usize].fill(0xFF);
                for word in words {
                    self.pages.programmed.remove(&word);
                    self.pages.damaged.remove(&word);
                    self.pages.corrected.remove(&word);
                }
            }
            Operation::ProgramElsewhere => {}
            Operation::EraseElsewhere { first, pages } => {
                let pages = (0..pages).map(|k| first + k * PAGE_BYTES);
                self.erased.extend(pages);
            }
        }
    }

    /// Cuts the power: an operation in progress is left half done.
    pub fn cut_power(&mut self) {
        match self.busy.take() {
            Some((Operation::Program { offset, value }, _)) => {
                // Some of the 72 cells are programmed.
                let half = value | 0xFFFF_FFFF_0000_0000;
                self.pages.bytes[offset as usize..][..8].copy_from_slice(&half.to_le_bytes());
                self.pages.damage(offset);
                self.pages.programmed.insert(offset);
            }
            Some((Operation::Erase { offset }, _)) => {
                for word in (offset..offset + PAGE_BYTES).step_by(8) {
                    // Neither erased nor as before.
                    if word % 24 == 0 {
                        self.pages.damage(word);
                    } else if word % 40 == 8 {
                        self.pages.corrected.insert(word);
                    } else if word % 16 == 0 {
                        self.pages.bytes[word as usize..][..8].fill(0xFF);
                    }
                    self.pages.programmed.insert(word);
                }
            }
            // Interrupted erasure: only the first page is erased.
            Some((Operation::EraseElsewhere { first, .. }, _)) => self.erased.push(first),
            Some((Operation::ProgramElsewhere, _)) | None => {}
        }
        let pages = std::mem::take(&mut self.pages);
        *self = Self::with(pages);
    }

    fn begin(&mut self, operation: Operation, duration: Ticks, now: Ticks) {
        self.busy = Some((operation, now + duration));
        self.operations += 1;
        if self.cut_at_operation == Some(self.operations) {
            self.power_gone = true;
        }
    }

    /// Reads from the pages without effects on the controller: by a debugger, or from its buffer.
    pub fn peek(&self, offset: u32, bytes: usize) -> u32 {
        let mut word = [0; 4];
        word[..bytes].copy_from_slice(&self.pages.bytes[offset as usize..][..bytes]);
        u32::from_le_bytes(word)
    }

    /// Reads from the pages. The second value is `true` if the double word has two wrong bits. FLASH_ECCR reports the first wrong word
    /// until its flags are cleared (RM0440, 3.3.2).
    pub fn read_page(&mut self, offset: u32, bytes: usize, file: &mut RegisterFile) -> (u32, bool) {
        use flash::flash_eccr::{ADDR_ECC, ADDRESS, BK_ECC, ECCC, ECCD};
        let mut word = [0; 4];
        word[..bytes].copy_from_slice(&self.pages.bytes[offset as usize..][..bytes]);
        let double_word = offset & !7;
        let damaged = self.pages.damaged.contains(&double_word);
        let flag = if damaged { ECCD } else { ECCC };
        let eccr = file.word(ADDRESS);
        if (damaged || self.pages.corrected.contains(&double_word)) && eccr & ECC_FLAGS == 0 {
            let eccr = ADDR_ECC.put(eccr, PAGES + double_word - BANK_2);
            file.set_word(ADDRESS, flag.put(BK_ECC.put(eccr, 1), 1));
        }
        (u32::from_le_bytes(word), damaged)
    }

    /// Writes to the pages: the two halves of a double word, in order, with PG set.
    pub fn write_page(
        &mut self,
        offset: u32,
        value: u32,
        bytes: usize,
        file: &mut RegisterFile,
        log: &mut Log,
    ) {
        if !file.is(flash::flash_cr::PG)
            || file.is(flash::flash_cr::LOCK)
            || bytes != 4
            || self.busy.is_some()
        {
            log.broken("flash written without PG, locked, busy, or not by words (RM0440 3.3.7)");
            file.set(flash::flash_sr::PGSERR, 1);
            return;
        }
        match self.first_half.take() {
            None if offset.is_multiple_of(8) => self.first_half = Some((offset, value)),
            Some((first, low)) if first + 4 == offset => {
                let value = u64::from(value) << 32 | u64::from(low);
                if self.pages.programmed.contains(&first) && value != 0 {
                    log.broken("flash programmed twice without erasure (RM0440 3.3.7: PROGERR)");
                    file.set(flash::flash_sr::PROGERR, 1);
                    return;
                }
                self.begin(
                    Operation::Program {
                        offset: first,
                        value,
                    },
                    PROGRAM,
                    log.now,
                );
            }
            _ => {
                log.broken("flash: the halves of a double word out of order (RM0440 3.3.7)");
                file.set(flash::flash_sr::PGAERR, 1);
            }
        }
    }

    /// Handles a write to the program's part of the flash; returns `true` if it is programmed. `was` is the word before the write.
    pub fn write_elsewhere(
        &mut self,
        address: u32,
        value: u32,
        was: u32,
        file: &mut RegisterFile,
        log: &mut Log,
    ) -> bool {
        use flash::{flash_cr, flash_sr};
        let allowed = self.is_debugged
            && file.is(flash_cr::PG)
            && !file.is(flash_cr::LOCK)
            && self.busy.is_none();
        if !allowed {
            log.broken("the program's flash written without PG, locked or busy (RM0440 3.3.7)");
            file.set(flash_sr::PGSERR, 1);
            return false;
        }
        if was != u32::MAX && value != 0 {
            log.broken("the program's flash programmed twice without erasure (RM0440 3.3.7)");
            file.set(flash_sr::PROGERR, 1);
            return false;
        }
        match self.first_half.take() {
            None if address.is_multiple_of(8) => self.first_half = Some((address, value)),
            Some((first, _)) if first + 4 == address => {
                self.begin(Operation::ProgramElsewhere, PROGRAM, log.now);
            }
            _ => {
                log.broken("flash: the halves of a double word out of order (RM0440 3.3.7)");
                file.set(flash_sr::PGAERR, 1);
                return false;
            }
        }
        true
    }

    /// Reads a register.
    pub fn read(&self, address: u32, file: &RegisterFile) -> u32 {
        let word = file.word(address);
        match address {
            flash::flash_sr::ADDRESS => {
                flash::flash_sr::BSY.put(word, u32::from(self.busy.is_some()))
            }
            flash::flash_cr::ADDRESS => flash::flash_cr::START.put(word, 0),
            _ => word,
        }
    }

    /// Handles a write before it is stored; returns the word to store.
    pub fn write(
        &mut self,
        address: u32,
        value: u32,
        file: &mut RegisterFile,
        log: &mut Log,
    ) -> u32 {
        let before = file.word(address);
        match address {
            flash::flash_keyr::ADDRESS => {
                self.keys = if KEYS.get(self.keys) == Some(&value) {
                    self.keys + 1
                } else {
                    0
                };
                if self.keys == KEYS.len() {
                    self.keys = 0;
                    file.set(flash::flash_cr::LOCK, 0);
                }
                0
            }
            // Flags are cleared by writing 1.
            flash::flash_sr::ADDRESS => before & !value,
            flash::flash_eccr::ADDRESS => {
                let enable = flash::flash_eccr::ECCCIE.mask();
                (before & !(value & ECC_FLAGS) & !enable) | (value & enable)
            }
            flash::flash_cr::ADDRESS => self.control(before, value, log),
            _ => value,
        }
    }

    fn control(&mut self, before: u32, value: u32, log: &mut Log) -> u32 {
        use flash::flash_cr::{BKER, LOCK, MER1, MER2, PER, PNB, START};
        if LOCK.extract(before) == 1 {
            if value != before {
                log.broken("FLASH_CR written while locked (RM0440 3.3.6)");
            }
            return before;
        }
        if self.busy.is_some() {
            log.broken("FLASH_CR written while BSY (RM0440 3.7.5)");
            return before;
        }
        if START.extract(value) == 1 && PER.extract(value) == 1 {
            let address = if BKER.extract(value) == 1 {
                BANK_2
            } else {
                0x0800_0000
            } + PNB.extract(value) * PAGE_BYTES;
            if (PAGES..PAGES + PAGES_BYTES as u32).contains(&address) {
                self.begin(
                    Operation::Erase {
                        offset: address - PAGES,
                    },
                    ERASE,
                    log.now,
                );
            } else if self.is_debugged {
                let erase = Operation::EraseElsewhere {
                    first: address,
                    pages: 1,
                };
                self.begin(erase, ERASE, log.now);
            } else {
                log.broken(format!(
                    "erasure of the page at {address:#010x}, which holds the program"
                ));
            }
        }
        let banks = [MER1.extract(value), MER2.extract(value)];
        if START.extract(value) == 1 && banks != [0, 0] {
            self.erase_banks(banks.map(|bank| bank == 1), log);
        }
        START.put(value, 0)
    }

    /// Starts the mass erasure of one bank or both; bank 2 includes the pages that the program may write.
    fn erase_banks(&mut self, banks: [bool; 2], log: &mut Log) {
        if !self.is_debugged {
            log.broken("mass erasure by the program");
            return;
        }
        let first = if banks[0] { 0x0800_0000 } else { BANK_2 };
        let end = if banks[1] { PAGES } else { BANK_2 };
        if banks[1] {
            self.pages = Pages::default();
        }
        let pages = (end - first) / PAGE_BYTES;
        self.begin(Operation::EraseElsewhere { first, pages }, ERASE, log.now);
    }
}
