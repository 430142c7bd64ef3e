//! Chip behind its bootloader: pages, blocks, verification, option bytes.

use std::time::Duration;

use dfu_core::Status;
use ihd_shared::image::{FLASH_ADDRESS, FLASH_BYTES, PAGE_BYTES};
use ihd_signal::printable;

use super::layout::MappedMemory;
use super::protocol::{BootloaderIo, DfuError, Protocol};
use crate::image::Image;
use crate::options::{OPTION_BYTES_ADDRESS, OptionBytes, ReadProtection, SECOND_BANK};
use crate::programmer::{Chip, Erase, FlashStep, ProgramError, Programmer, WriteProgress};

/// Alternate settings.
const MAIN_FLASH: u8 = 0;
const OPTIONS: u8 = 1;

/// Size of a bank's option bytes, and the smallest accepted size: some bootloaders report 40.
const OPTION_BYTES: usize = 48;
const OPTION_BYTES_NEEDED: usize = 40;
/// Offsets of FLASH_OPTR and of the two write-protected areas in them (RM0440, 3.4.1).
const OPTR: usize = 0;
const WRP: [usize; 2] = [24, 32];
/// FLASH_OPTR, bits 7:0.
const RDP: u32 = 0xFF;
/// Size of a double word: the unit of writing.
const DOUBLE_WORD: usize = 8;

/// Time limit from a reset until the chip's bootloader is on the bus again.
const RESET_TIMEOUT: Duration = Duration::from_secs(8);

/// Reopens the same chip's bootloader; `None` if it does not appear within this time.
pub type Reopen<IO> = Box<dyn FnMut(Duration) -> Result<Option<IO>, ProgramError>>;

/// Access to a chip through its bootloader over USB.
pub struct Dfu<IO: BootloaderIo> {
    protocol: Protocol<IO>,
    reopen: Reopen<IO>,
}

impl<IO: BootloaderIo> Dfu<IO> {
    /// Creates one from an open bootloader and a function that reopens it after the chip has restarted.
    pub fn new(io: IO, reopen: Reopen<IO>) -> Self {
        Self {
            protocol: Protocol::new(io),
            reopen,
        }
    }

    /// The bootloader.
    pub fn io(&self) -> &IO {
        self.protocol.io()
    }

    fn block_bytes(&self) -> Result<usize, ProgramError> {
        let bytes = self.protocol.block_bytes();
        bytes.ok_or_else(|| self.other("names no length of a block that could be used"))
    }

    /// Error for another chip's bootloader, or none.
    fn other(&self, why: &str) -> ProgramError {
        let layouts = self.io().layouts().join("; ");
        ProgramError::OtherBootloader {
            why: format!("{why} ({})", printable(&layouts)),
        }
    }

    /// Size of the flash in bytes. Only the layout of the STM32G47x and G48x is accepted: option bytes in two banks.
    fn flash_bytes(&self) -> Result<u64, ProgramError> {
        let memory = |alternate: u8| {
            let text = self.io().layouts().get(usize::from(alternate));
            text.and_then(|text| MappedMemory::parse(text).ok())
        };
        let flash = memory(MAIN_FLASH).and_then(|flash| {
            let regions = flash.regions.into_iter();
            let mut main = regions.filter(|region| region.address == FLASH_ADDRESS);
            main.next()
        });
        let two_banks = memory(OPTIONS).is_some_and(|options| {
            let second = OPTION_BYTES_ADDRESS + SECOND_BANK;
            options.begins_at(OPTION_BYTES_ADDRESS) && options.begins_at(second)
        });
        match flash {
            Some(flash) if two_banks => Ok(flash.bytes()),
            _ => Err(self.other("reports other memories")),
        }
    }

    /// Reads from one memory. Whole blocks are read in sequence; the rest is read from its own address, since a block's address
    /// depends on its length.
    fn read_from(
        &self,
        alternate: u8,
        address: u32,
        out: &mut [u8],
        read: &mut dyn FnMut(usize),
    ) -> Result<(), ProgramError> {
        let block = self.block_bytes()?;
        let place = |done: usize| address + done as u32;
        let fails = |done: usize| move |trouble| failed(FlashStep::Reading, place(done), trouble);
        self.protocol.begin(alternate).map_err(fails(0))?;
        let mut done = 0;
        for (index, part) in out.chunks_mut(block).enumerate() {
            let first = index == 0;
            if first || part.len() < block {
                self.protocol.make_idle().map_err(fails(done))?;
                let set = self.protocol.set_address(place(done));
                set.and_then(|()| self.protocol.make_idle())
                    .map_err(fails(done))?;
            }
            let index = if part.len() < block { 0 } else { index as u16 };
            let bytes = self.protocol.read_block(index, part).map_err(fails(done))?;
            if bytes != part.len() {
                let why = format!("the bootloader gave {bytes} bytes of {}", part.len());
                return Err(failed(
                    FlashStep::Reading,
                    place(done),
                    DfuError::Strange(why),
                ));
            }
            done += bytes;
            read(done);
        }
        self.protocol.make_idle().map_err(fails(done))
    }

    /// A bank's option bytes as stored in flash: words, each with its complement.
    fn bank_options(&self, bank: u32) -> Result<Vec<u8>, ProgramError> {
        let address = OPTION_BYTES_ADDRESS + bank * SECOND_BANK;
        let fails = |trouble| failed(FlashStep::Reading, address, trouble);
        let mut bytes = vec![0; OPTION_BYTES];
        let protocol = &self.protocol;
        protocol.begin(OPTIONS).map_err(fails)?;
        protocol.set_address(address).map_err(fails)?;
        protocol.make_idle().map_err(fails)?;
        let read = protocol.read_block(0, &mut bytes).map_err(fails)?;
        protocol.make_idle().map_err(fails)?;
        bytes.truncate(read / DOUBLE_WORD * DOUBLE_WORD);
        if bytes.len() < OPTION_BYTES_NEEDED {
            return Err(fails(DfuError::Strange(format!(
                "the bootloader gave {read} option bytes, of which {OPTION_BYTES_NEEDED} are needed"
            ))));
        }
        Ok(bytes)
    }

    /// Writes a bank's option bytes and waits for the bootloader: the chip loads them, which resets it.
    fn write_bank_options(&mut self, bank: u32, bytes: &[u8]) -> Result<(), ProgramError> {
        let address = OPTION_BYTES_ADDRESS + bank * SECOND_BANK;
        let fails = |trouble| failed(FlashStep::SettingOptions, address, trouble);
        self.protocol.begin(OPTIONS).map_err(fails)?;
        self.protocol.set_address(address).map_err(fails)?;
        match self.protocol.write_block(0, bytes) {
            // No restart: reading back shows the result.
            Ok(()) => Ok(()),
            // The restart may cut an answer; its error is ignored.
            Err(DfuError::Gone(_) | DfuError::Strange(_)) => {
                let reopened = (self.reopen)(RESET_TIMEOUT)?;
                let io = reopened.ok_or(ProgramError::NotBack {
                    seconds: RESET_TIMEOUT.as_secs(),
                })?;
                self.protocol = Protocol::new(io);
                Ok(())
            }
            Err(trouble) => Err(fails(trouble)),
        }
    }

    /// Checks that the flash can be written, before anything is.
    fn check_writable(&mut self, pages: u32) -> Result<(), ProgramError> {
        let options = self.option_bytes()?;
        if !options.has_two_banks() {
            return Err(ProgramError::OneBank);
        }
        let bank_pages = FLASH_BYTES / PAGE_BYTES / 2;
        let mut protected = options.protected_pages().into_iter();
        let hit = protected.find(|(bank, first, _)| *bank as u32 * bank_pages + first < pages);
        match hit {
            Some((bank, first, last)) => Err(ProgramError::WriteProtected { bank, first, last }),
            None => Ok(()),
        }
    }

    fn erase(
        &self,
        erase: Erase,
        pages: u32,
        progress: &mut dyn FnMut(WriteProgress),
    ) -> Result<(), ProgramError> {
        let fails = |address| move |trouble| failed(FlashStep::Erasing, address, trouble);
        if erase == Erase::All {
            let total = FLASH_BYTES;
            progress(WriteProgress::Erasing { done: 0, total });
            self.protocol.erase_all().map_err(fails(FLASH_ADDRESS))?;
            progress(WriteProgress::Erasing { done: total, total });
            return Ok(());
        }
        let total = pages * PAGE_BYTES;
        progress(WriteProgress::Erasing { done: 0, total });
        // The first page first: from then on no program starts.
        for page in 0..pages {
            let address = FLASH_ADDRESS + page * PAGE_BYTES;
            self.protocol.erase_page(address).map_err(fails(address))?;
            let done = (page + 1) * PAGE_BYTES;
            progress(WriteProgress::Erasing { done, total });
        }
        Ok(())
    }

    /// Programs the flash. The first double word, stack pointer and entry, comes last: an interrupted program does not start.
    fn program(
        &self,
        bytes: &[u8],
        progress: &mut dyn FnMut(WriteProgress),
    ) -> Result<(), ProgramError> {
        let block = self.block_bytes()?;
        let total = bytes.len() as u32;
        let mut done = 0;
        progress(WriteProgress::Programming { done, total });
        let mut parts: Vec<(usize, &[u8])> =
            (0..).step_by(block).zip(bytes.chunks(block)).collect();
        let (entry, first) = parts.remove(0).1.split_at(DOUBLE_WORD);
        parts.extend([(DOUBLE_WORD, first), (0, entry)]);
        parts.retain(|(_, part)| !part.is_empty());
        for (turn, (offset, part)) in parts.into_iter().enumerate() {
            let address = FLASH_ADDRESS + offset as u32;
            let fails = |trouble| failed(FlashStep::Programming, address, trouble);
            // A block's address depends on its length: a shorter one needs its own address.
            let whole = part.len() == block;
            if !whole {
                self.protocol.set_address(address).map_err(fails)?;
            } else if turn == 0 {
                self.protocol.set_address(FLASH_ADDRESS).map_err(fails)?;
            }
            let index = if whole { offset / block } else { 0 };
            let written = self.protocol.write_block(index as u16, part);
            written.map_err(fails)?;
            done += part.len() as u32;
            progress(WriteProgress::Programming { done, total });
        }
        Ok(())
    }

    fn verify(
        &self,
        bytes: &[u8],
        progress: &mut dyn FnMut(WriteProgress),
    ) -> Result<(), ProgramError> {
        let total = bytes.len() as u32;
        let mut actual = vec![0; bytes.len()];
        progress(WriteProgress::Verifying { done: 0, total });
        let mut read = |done: usize| {
            let done = done as u32;
            progress(WriteProgress::Verifying { done, total });
        };
        let all = self.read_from(MAIN_FLASH, FLASH_ADDRESS, &mut actual, &mut read);
        all.map_err(|error| match error {
            ProgramError::Lost { why, .. } => ProgramError::Lost {
                doing: FlashStep::Verifying,
                why,
            },
            other => other,
        })?;
        let differs = bytes.iter().zip(&actual).position(|(a, b)| a != b);
        let Some(place) = differs else {
            return Ok(());
        };
        // A wrong program must not start.
        let erased = self.protocol.erase_page(FLASH_ADDRESS);
        erased.map_err(|trouble| failed(FlashStep::Verifying, FLASH_ADDRESS, trouble))?;
        let shown = place..bytes.len().min(place + DOUBLE_WORD);
        Err(ProgramError::Verify {
            address: FLASH_ADDRESS + place as u32,
            expected: bytes[shown.clone()].to_vec(),
            actual: actual[shown].to_vec(),
        })
    }
}

impl<IO: BootloaderIo> Programmer for Dfu<IO> {
    fn describe(&self) -> String {
        let serial = printable(self.io().serial());
        format!("USB bootloader 0483:df11 ({serial})")
    }

    /// Identifies the chip by its memories: the bootloader reads neither `DBGMCU_IDCODE` nor the unique number.
    fn identify(&mut self) -> Result<Chip, ProgramError> {
        let flash_kib = u16::try_from(self.flash_bytes()? / 1024).unwrap_or(u16::MAX);
        if u32::from(flash_kib) * 1024 < FLASH_BYTES {
            return Err(ProgramError::SmallChip { flash_kib });
        }
        self.block_bytes()?;
        match self.option_bytes()?.read_protection() {
            ReadProtection::None => Ok(Chip {
                id_code: None,
                flash_kib,
                unique_id: None,
            }),
            level => Err(ProgramError::ReadProtected { level }),
        }
    }

    /// Returns `false`: the bootloader drives none of the inverter's pins.
    fn is_switching(&mut self) -> Result<Option<bool>, ProgramError> {
        Ok(Some(false))
    }

    fn read(&mut self, address: u32, out: &mut [u8]) -> Result<(), ProgramError> {
        let memories = self
            .io()
            .layouts()
            .iter()
            .map(|text| MappedMemory::parse(text));
        let holds = |memory: MappedMemory| memory.holds(address, out.len());
        let mut alternates = (0..).zip(memories);
        let holder = alternates.find(|(_, memory)| memory.clone().is_ok_and(holds));
        let Some((alternate, _)) = holder else {
            return Err(ProgramError::Unsupported {
                what: "reading there",
                way: "by USB bootloader",
                instead: "take a debug probe",
            });
        };
        self.read_from(alternate, address, out, &mut |_| {})
    }

    fn option_bytes(&mut self) -> Result<OptionBytes, ProgramError> {
        let banks = [self.bank_options(0)?, self.bank_options(1)?];
        let area = |bank: usize, which: usize| read_word(&banks[bank], WRP[which]);
        Ok(OptionBytes {
            optr: read_word(&banks[0], OPTR),
            wrp: [area(0, 0), area(0, 1), area(1, 0), area(1, 1)],
        })
    }

    fn set_option_bytes(&mut self, target: &OptionBytes) -> Result<(), ProgramError> {
        if (self.option_bytes()?.optr ^ target.optr) & RDP != 0 {
            return Err(ProgramError::Unsupported {
                what: "changing the protection against reading",
                way: "by USB bootloader",
                instead: "take a debug probe and ST's programmer",
            });
        }
        for bank in 0..2 {
            let present = self.bank_options(bank)?;
            let mut bytes = present.clone();
            if bank == 0 {
                set_word(&mut bytes, OPTR, target.optr);
            }
            for (which, at) in WRP.iter().enumerate() {
                set_word(&mut bytes, *at, target.wrp[2 * bank as usize + which]);
            }
            if bytes != present {
                self.write_bank_options(bank, &bytes)?;
            }
        }
        let read_back = self.option_bytes()?;
        let pairs = |options: &OptionBytes| {
            let [a, b, c, d] = options.wrp;
            [options.optr, a, b, c, d]
        };
        let mut values = pairs(target).into_iter().zip(pairs(&read_back));
        match values.find(|(expected, actual)| expected != actual) {
            Some((expected, actual)) => Err(ProgramError::Options { expected, actual }),
            None => Ok(()),
        }
    }

    fn flash(
        &mut self,
        image: &Image,
        erase: Erase,
        progress: &mut dyn FnMut(WriteProgress),
    ) -> Result<(), ProgramError> {
        let mut bytes = image.flat();
        bytes.resize(bytes.len().next_multiple_of(DOUBLE_WORD), 0xFF);
        let pages = (bytes.len() as u32).div_ceil(PAGE_BYTES);
        let touched = match erase {
            Erase::Image => pages,
            Erase::All => FLASH_BYTES / PAGE_BYTES,
        };
        self.check_writable(touched)?;
        let begun = self.protocol.begin(MAIN_FLASH);
        begun.map_err(|trouble| failed(FlashStep::Reading, FLASH_ADDRESS, trouble))?;
        self.erase(erase, pages, progress)?;
        self.program(&bytes, progress)?;
        self.verify(&bytes, progress)
    }

    /// Leaves the bootloader, which starts the program.
    fn reset(&mut self) -> Result<(), ProgramError> {
        let protocol = &self.protocol;
        let leave = || {
            protocol.begin(MAIN_FLASH)?;
            protocol.set_address(FLASH_ADDRESS)?;
            protocol.leave()
        };
        leave().map_err(|trouble| failed(FlashStep::Resetting, FLASH_ADDRESS, trouble))
    }
}

fn read_word(bytes: &[u8], at: usize) -> u32 {
    let word = bytes.get(at..).and_then(|bytes| bytes.first_chunk());
    word.map_or(u32::MAX, |word| u32::from_le_bytes(*word))
}

/// Sets a word of option bytes, and its complement after it.
fn set_word(bytes: &mut [u8], at: usize, value: u32) {
    let both = [value.to_le_bytes(), (!value).to_le_bytes()].concat();
    if let Some(place) = bytes.get_mut(at..at + DOUBLE_WORD) {
        place.copy_from_slice(&both);
    }
}

/// Converts the bootloader's error to that of all programmers.
fn failed(doing: FlashStep, address: u32, trouble: DfuError) -> ProgramError {
    let why = match trouble {
        DfuError::Gone(why) => return ProgramError::Lost { doing, why },
        DfuError::Refused(Status::ErrVendor) => {
            let level = ReadProtection::Level1;
            return ProgramError::ReadProtected { level };
        }
        DfuError::Refused(status) => {
            let why = format!("the bootloader says: {status}");
            return ProgramError::Failed {
                doing,
                address,
                why,
            };
        }
        DfuError::Stuck(time) => format!(
            "the bootloader is still busy after {:.0} s",
            time.as_secs_f64()
        ),
        DfuError::Strange(why) => why,
    };
    ProgramError::Bootloader {
        doing,
        address,
        why,
    }
}
