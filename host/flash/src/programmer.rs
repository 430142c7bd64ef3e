//! A way to a chip: a debug probe, the chip's bootloader over USB, or [`crate::fake::FakeProgrammer`].

use serde::Serialize;

use crate::image::Image;
use crate::options::{OptionBytes, ReadProtection};

/// What a chip says of itself, read before anything is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Chip {
    /// `DBGMCU_IDCODE`: device in bits 11:0, revision in 31:16. A bootloader does not tell it.
    pub id_code: Option<u32>,
    /// Its flash.
    pub flash_kib: u16,
    /// Its number, unique among all chips, where it can be read.
    pub unique_id: Option<[u8; 12]>,
}

/// How much is erased.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Erase {
    /// The pages that the image needs: the lookup stays.
    Image,
    /// Everything.
    All,
}

/// How far flashing is, in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "step")]
pub enum Progress {
    /// Pages become empty.
    Erasing {
        /// So far.
        done: u32,
        /// In all.
        total: u32,
    },
    /// The image is written.
    Programming {
        /// So far.
        done: u32,
        /// In all.
        total: u32,
    },
    /// It is read back and compared.
    Verifying {
        /// So far.
        done: u32,
        /// In all.
        total: u32,
    },
}

/// What an error interrupted, for messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Doing {
    /// Opening the way to the chip.
    Attaching,
    /// Reading what chip it is and what is on it.
    Reading,
    /// Writing option bytes.
    SettingOptions,
    /// Erasing.
    Erasing,
    /// Writing the image.
    Programming,
    /// Reading it back.
    Verifying,
    /// Starting the program.
    Resetting,
}

impl Doing {
    /// In words: `the connection was lost while {}`.
    pub fn words(self) -> &'static str {
        match self {
            Self::Attaching => "connecting",
            Self::Reading => "reading the chip",
            Self::SettingOptions => "setting option bytes",
            Self::Erasing => "erasing",
            Self::Programming => "programming",
            Self::Verifying => "verifying",
            Self::Resetting => "resetting",
        }
    }

    /// What the chip holds after an interruption here.
    fn left(self) -> &'static str {
        match self {
            Self::Attaching | Self::Reading => "the chip was not changed",
            Self::Resetting => "what was written before is complete",
            Self::SettingOptions => "the option bytes may be the old ones",
            Self::Erasing | Self::Programming | Self::Verifying => {
                "the chip holds no whole program now and drives no output"
            }
        }
    }
}

/// Why a chip was not reached, read or written. Every message ends with what to do.
#[derive(Debug, thiserror::Error)]
pub enum ProgramError {
    /// No probe, or no bootloader.
    #[error("{what}")]
    NotFound {
        /// What was looked for, where, and what to do.
        what: String,
    },
    /// More than one, and none was chosen.
    #[error("there are {}: {}; choose one with {option}", found.len(), found.join(", "))]
    Several {
        /// Them.
        found: Vec<String>,
        /// By which option one is chosen.
        option: &'static str,
    },
    /// The system does not let this user at it, or another program has it.
    #[error(
        "cannot open {what}: {why}; another program (an IDE, OpenOCD, a second ihd) may hold it, or the rights to the USB device lack: `ihd doctor` says which and what to do"
    )]
    Open {
        /// Which.
        what: String,
        /// Why.
        why: String,
    },
    /// The probe works, the chip does not answer.
    #[error(
        "{probe} works, but no chip answers behind it: {why}. Power the board, check SWDIO, SWCLK and GND; where a program switches the debug pins off, hold the reset button while this command starts"
    )]
    NoChip {
        /// Which.
        probe: String,
        /// Why.
        why: String,
    },
    /// Another chip.
    #[error("this chip is no STM32G474: DBGMCU_IDCODE is {found:#010x}, device {:#05x} instead of {:#05x}; nothing was written. Is this the right board?", found & 0xFFF, ihd_shared::image::DEVICE_ID)]
    WrongChip {
        /// Its `DBGMCU_IDCODE`.
        found: u32,
    },
    /// The right family, with too little flash.
    #[error(
        "this chip has {flash_kib} KiB of flash, and the firmware's pages of the lookup end at 512: an STM32G474xE is needed; nothing was written"
    )]
    SmallChip {
        /// Its flash.
        flash_kib: u16,
    },
    /// Protected against being read.
    #[error("{}", read_protected(*level))]
    ReadProtected {
        /// How.
        level: ReadProtection,
    },
    /// Protected against being written.
    #[error(
        "pages {first} to {last} of bank {} are write-protected by option bytes (WRP{}A or B); nothing was written. Somebody \
         wanted that; to lift it: STM32_Programmer_CLI -c port=SWD -ob WRP{}A_STRT=0x7F WRP{}A_END=0, the same with B, then \
         run this again",
        bank + 1, bank + 1, bank + 1, bank + 1
    )]
    WriteProtected {
        /// 0 or 1.
        bank: usize,
        /// First page.
        first: u32,
        /// Last page.
        last: u32,
    },
    /// The flash is in one bank of 4 KiB pages, which this program does not write.
    #[error(
        "the chip's flash is one bank (option byte DBANK = 0), and the firmware needs two: run `ihd flash --set-option-bytes`; nothing was written"
    )]
    OneBank,
    /// The flash's controller does not finish.
    #[error("the flash's controller stays busy while {} at {address:#010x} (FLASH_SR = {status:#010x}): power the board off and on and run this again; if it comes back, the chip is broken", doing.words())]
    Stuck {
        /// When.
        doing: Doing,
        /// Where.
        address: u32,
        /// `FLASH_SR`.
        status: u32,
    },
    /// The flash's controller refuses.
    #[error("{} failed at {address:#010x}: {why}. Run this again; if it fails at the same place, the flash there is worn out or protected", doing.words())]
    Failed {
        /// When.
        doing: Doing,
        /// Where.
        address: u32,
        /// What the controller or the algorithm said.
        why: String,
    },
    /// What was read back is not what was written.
    #[error(
        "verifying failed at {address:#010x}: {wanted:02x?} was written, {found:02x?} is there. Check the supply and the wires of the probe and run this again; if it fails at the same place, the flash there is worn out"
    )]
    Verify {
        /// The first difference.
        address: u32,
        /// The image's bytes there.
        wanted: Vec<u8>,
        /// The chip's.
        found: Vec<u8>,
    },
    /// Probe, cable or power went away.
    #[error("the connection was lost while {}: {why}; {}. Check cable and power, and run the same command again: it begins anew", doing.words(), doing.left())]
    Lost {
        /// When.
        doing: Doing,
        /// What was seen of it.
        why: String,
    },
    /// Option bytes that are not what was written.
    #[error(
        "option bytes were written but are {found:#010x} instead of {wanted:#010x}: power the board off and on and run this again"
    )]
    Options {
        /// What was written.
        wanted: u32,
        /// What was read back.
        found: u32,
    },
    /// This way does not go there.
    #[error("{what} is not possible {way}; {instead}")]
    Unsupported {
        /// What was wanted.
        what: &'static str,
        /// `by USB bootloader`.
        way: &'static str,
        /// What to do.
        instead: &'static str,
    },
    /// What is on USB is not the bootloader of an STM32G474.
    #[error(
        "this is no bootloader of an STM32G474: it {why}; nothing was written. Is this the right board?"
    )]
    OtherBootloader {
        /// What it says of itself.
        why: String,
    },
    /// What else the bootloader in ROM does.
    #[error("{} failed at {address:#010x}: the bootloader {why}; {}. Hold BOOT0 high, press reset, and run this again: it begins anew", doing.words(), doing.left())]
    Bootloader {
        /// When.
        doing: Doing,
        /// Where.
        address: u32,
        /// What it did.
        why: String,
    },
    /// A chip that restarted, as it had to, and is not in its bootloader any more.
    #[error(
        "the option bytes were written and the chip restarted with them, into its program and not its bootloader ({seconds} s). Run the same command again, where no program runs with BOOT0 held high through a reset: it reads what they are now and goes on"
    )]
    NotBack {
        /// How long the bootloader was waited for.
        seconds: u64,
    },
    /// What else a probe reports.
    #[error("{} failed: {why}; {}. Run this again; if it comes back, unplug the probe and plug it in", doing.words(), doing.left())]
    Probe {
        /// When.
        doing: Doing,
        /// What it said.
        why: String,
    },
}

fn read_protected(level: ReadProtection) -> &'static str {
    match level {
        ReadProtection::Level2 => {
            "the chip is protected for ever (RDP level 2): no probe and no bootloader reaches it; take another chip"
        }
        _ => {
            "the chip is protected against reading (RDP level 1); nothing was written. Lifting it erases everything on it, \
             lookup and calibration as well: STM32_Programmer_CLI -c port=SWD -ob RDP=0xAA, then power off and on and \
             run this again"
        }
    }
}

/// A way to a chip. Implementations refuse another chip in [`Programmer::identify`], which comes first.
pub trait Programmer {
    /// The way in words: `ST-LINK V3 (0483:374e, 0042…)`.
    fn describe(&self) -> String;

    /// What chip it is.
    ///
    /// # Errors
    /// [`ProgramError::WrongChip`], [`ProgramError::SmallChip`], [`ProgramError::ReadProtected`].
    fn identify(&mut self) -> Result<Chip, ProgramError>;

    /// Whether the inverter's outputs are on; `None` where that cannot be seen.
    ///
    /// # Errors
    /// As every access.
    fn is_switching(&mut self) -> Result<Option<bool>, ProgramError>;

    /// Reads memory; of any length, at any address.
    ///
    /// # Errors
    /// As every access.
    fn read(&mut self, address: u32, out: &mut [u8]) -> Result<(), ProgramError>;

    /// The option bytes.
    ///
    /// # Errors
    /// As every access.
    fn option_bytes(&mut self) -> Result<OptionBytes, ProgramError>;

    /// Writes them, has the chip load them, which resets it, and reads them back.
    ///
    /// # Errors
    /// [`ProgramError::Options`], and as every access.
    fn set_option_bytes(&mut self, wanted: &OptionBytes) -> Result<(), ProgramError>;

    /// Erases, programs, and compares what is read back. The chip stands still until [`Programmer::reset`].
    ///
    /// # Errors
    /// [`ProgramError::Failed`], [`ProgramError::Stuck`], [`ProgramError::Verify`], and as every access.
    fn flash(
        &mut self,
        image: &Image,
        erase: Erase,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<(), ProgramError>;

    /// Resets the chip, which begins its program.
    ///
    /// # Errors
    /// As every access.
    fn reset(&mut self) -> Result<(), ProgramError>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_name_the_place_and_the_remedy() {
        let lost = ProgramError::Lost {
            doing: Doing::Programming,
            why: "USB device gone".into(),
        };
        let text = lost.to_string();
        assert!(text.contains("no whole program"), "{text}");
        assert!(text.contains("run the same command again"), "{text}");
        let wrong = ProgramError::WrongChip { found: 0x2003_6468 }.to_string();
        assert!(wrong.contains("0x468 instead of 0x469"), "{wrong}");
        let protected = ProgramError::WriteProtected {
            bank: 0,
            first: 0,
            last: 3,
        }
        .to_string();
        assert!(
            protected.contains("bank 1") && protected.contains("WRP1A_STRT=0x7F"),
            "{protected}"
        );
    }
}
