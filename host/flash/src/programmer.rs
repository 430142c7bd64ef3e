//! Interface to a chip: a debug probe, the chip's bootloader over USB, or a fake in tests.

use serde::Serialize;

use crate::image::Image;
use crate::options::{OptionBytes, ReadProtection};

/// Identity of a chip, read before anything is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Chip {
    /// `DBGMCU_IDCODE`: device in bits 11:0, revision in 31:16; `None` through a bootloader.
    pub id_code: Option<u32>,
    /// Size of its flash.
    pub flash_kib: u16,
    /// Unique number; `None` if it cannot be read.
    pub unique_id: Option<[u8; 12]>,
}

/// Extent of an erasure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Erase {
    /// Pages that the image needs: the lookup stays.
    Image,
    /// All pages.
    All,
}

/// Progress of flashing, in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "step")]
pub enum WriteProgress {
    /// Erasing pages.
    Erasing {
        /// Bytes so far.
        done: u32,
        /// Total.
        total: u32,
    },
    /// Writing the image.
    Programming {
        /// Bytes so far.
        done: u32,
        /// Total.
        total: u32,
    },
    /// Reading back and comparing.
    Verifying {
        /// Bytes so far.
        done: u32,
        /// Total.
        total: u32,
    },
}

/// Operation that an error interrupted, for messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FlashStep {
    /// Connecting to the chip.
    Attaching,
    /// Reading the chip's identity and contents.
    Reading,
    /// Writing option bytes.
    SettingOptions,
    /// Erasing.
    Erasing,
    /// Writing the image.
    Programming,
    /// Reading the image back.
    Verifying,
    /// Starting the program.
    Resetting,
}

impl FlashStep {
    /// Text for `the connection was lost while {}`.
    pub fn describe(self) -> &'static str {
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

    /// State of the chip after an interruption of this operation.
    fn chip_state(self) -> &'static str {
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

/// Error of reaching, reading or writing a chip. Every message ends with a remedy.
#[derive(Debug, thiserror::Error)]
pub enum ProgramError {
    /// No probe or no bootloader was found.
    #[error("{what}")]
    NotFound {
        /// Description of the search, with a remedy.
        what: String,
    },
    /// Several were found, and none was chosen.
    #[error("there are {}: {}; choose one with {option}", choices.len(), choices.join(", "))]
    Several {
        /// Descriptions.
        choices: Vec<String>,
        /// Option that chooses one.
        option: &'static str,
    },
    /// The system denies access, or another program uses it.
    #[error(
        "cannot open {what}: {why}; another program (an IDE, OpenOCD, a second ihd) may hold it, or this user lacks the rights to the USB device: `ihd doctor` says which and what to do"
    )]
    Open {
        /// Description of the device.
        what: String,
        /// Reason.
        why: String,
    },
    /// The probe works, but the chip does not answer.
    #[error(
        "{probe} works, but no chip answers behind it: {why}. Power the board, check SWDIO, SWCLK and GND; where a program switches the debug pins off, hold the reset button while this command starts"
    )]
    NoChip {
        /// Description of the probe.
        probe: String,
        /// Reason.
        why: String,
    },
    /// It is another chip.
    #[error("this chip is no STM32G474: DBGMCU_IDCODE is {id_code:#010x}, device {:#05x} instead of {:#05x}; nothing was written. Is this the right board?", id_code & 0xFFF, ihd_shared::image::DEVICE_ID)]
    WrongChip {
        /// Its `DBGMCU_IDCODE`.
        id_code: u32,
    },
    /// The chip has too little flash.
    #[error(
        "this chip has {flash_kib} KiB of flash, and the firmware's pages of the lookup end at 512: an STM32G474xE is needed; nothing was written"
    )]
    SmallChip {
        /// Size of its flash.
        flash_kib: u16,
    },
    /// The chip is protected against reading.
    #[error("{}", read_protected(*level))]
    ReadProtected {
        /// Level of the protection.
        level: ReadProtection,
    },
    /// Pages are protected against writing.
    #[error(
        "pages {first} to {last} of bank {} are write-protected by option bytes (WRP{}A or B); nothing was written. To \
         lift the protection: STM32_Programmer_CLI -c port=SWD -ob WRP{}A_STRT=0x7F WRP{}A_END=0, the same with B, then \
         run this again",
        bank + 1, bank + 1, bank + 1, bank + 1
    )]
    WriteProtected {
        /// Bank, 0 or 1.
        bank: usize,
        /// First page.
        first: u32,
        /// Last page.
        last: u32,
    },
    /// The flash is in one bank of 4 KiB pages, which is not supported.
    #[error(
        "the chip's flash is one bank (option byte DBANK = 0), and the firmware needs two: run `ihd flash --set-option-bytes`; nothing was written"
    )]
    OneBank,
    /// The flash's controller stays busy.
    #[error("the flash's controller stays busy while {} at {address:#010x} (FLASH_SR = {status:#010x}): power the board off and on and run this again; if it comes back, the chip is broken", doing.describe())]
    Stuck {
        /// Operation.
        doing: FlashStep,
        /// Address.
        address: u32,
        /// `FLASH_SR`.
        status: u32,
    },
    /// The flash's controller reports an error.
    #[error("{} failed at {address:#010x}: {why}. Run this again; if it fails at the same place, the flash there is worn out or protected", doing.describe())]
    Failed {
        /// Operation.
        doing: FlashStep,
        /// Address.
        address: u32,
        /// Reason given by the controller or the algorithm.
        why: String,
    },
    /// The flash differs from the image after writing.
    #[error(
        "verifying failed at {address:#010x}: {expected:02x?} was written, {actual:02x?} is there. Check the supply and the wires of the probe and run this again; if it fails at the same place, the flash there is worn out"
    )]
    Verify {
        /// Address of the first difference.
        address: u32,
        /// Bytes of the image.
        expected: Vec<u8>,
        /// Bytes of the chip.
        actual: Vec<u8>,
    },
    /// Probe, cable or power was disconnected.
    #[error("the connection was lost while {}: {why}; {}. Check cable and power, and run the same command again: it begins anew", doing.describe(), doing.chip_state())]
    Lost {
        /// Operation.
        doing: FlashStep,
        /// Reason.
        why: String,
    },
    /// The option bytes differ from those written.
    #[error(
        "option bytes were written but are {actual:#010x} instead of {expected:#010x}: power the board off and on and run this again"
    )]
    Options {
        /// Value written.
        expected: u32,
        /// Value read back.
        actual: u32,
    },
    /// This access does not support the operation.
    #[error("{what} is not possible {way}; {instead}")]
    Unsupported {
        /// Operation.
        what: &'static str,
        /// Access: `by USB bootloader`.
        way: &'static str,
        /// Remedy.
        instead: &'static str,
    },
    /// The device on USB is not the bootloader of an STM32G474.
    #[error(
        "this is no bootloader of an STM32G474: it {why}; nothing was written. Is this the right board?"
    )]
    OtherBootloader {
        /// Reason.
        why: String,
    },
    /// Any other error of the bootloader.
    #[error("{} failed at {address:#010x}: {why}; {}. Hold BOOT0 high, press reset, and run this again: it begins anew", doing.describe(), doing.chip_state())]
    Bootloader {
        /// Operation.
        doing: FlashStep,
        /// Address.
        address: u32,
        /// Reason given by the bootloader or USB.
        why: String,
    },
    /// The chip restarted, as it must, but did not return to its bootloader.
    #[error(
        "the option bytes were written and the chip restarted with them, into its program and not its bootloader ({seconds} s). Run the same command again, where no program runs with BOOT0 held high through a reset: it reads what they are now and goes on"
    )]
    NotBack {
        /// Time waited.
        seconds: u64,
    },
    /// Any other error of a probe.
    #[error("{} failed: {why}; {}. Run this again; if it comes back, unplug the probe and plug it in", doing.describe(), doing.chip_state())]
    Probe {
        /// Operation.
        doing: FlashStep,
        /// Reason.
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

/// Access to a chip. Implementations reject unsuitable chips in [`Programmer::identify`], which is called first.
pub trait Programmer {
    /// Description: `ST-LINK V3 (0483:374e, 0042…)`.
    fn describe(&self) -> String;

    /// Reads the identity of the chip.
    ///
    /// # Errors
    /// [`ProgramError::WrongChip`], [`ProgramError::SmallChip`], [`ProgramError::ReadProtected`].
    fn identify(&mut self) -> Result<Chip, ProgramError>;

    /// Returns `true` if the inverter's outputs are on; `None` if that cannot be seen.
    ///
    /// # Errors
    /// Any error of an access.
    fn is_switching(&mut self) -> Result<Option<bool>, ProgramError>;

    /// Reads memory of any length at any address.
    ///
    /// # Errors
    /// Any error of an access.
    fn read(&mut self, address: u32, out: &mut [u8]) -> Result<(), ProgramError>;

    /// Reads the option bytes.
    ///
    /// # Errors
    /// Any error of an access.
    fn option_bytes(&mut self) -> Result<OptionBytes, ProgramError>;

    /// Writes the option bytes, has the chip load them, which resets it, and reads them back.
    ///
    /// # Errors
    /// [`ProgramError::Options`], or any error of an access.
    fn set_option_bytes(&mut self, target: &OptionBytes) -> Result<(), ProgramError>;

    /// Erases, programs and verifies. The chip stays halted until [`Programmer::reset`].
    ///
    /// # Errors
    /// [`ProgramError::Failed`], [`ProgramError::Stuck`], [`ProgramError::Verify`], or any error of an access.
    fn flash(
        &mut self,
        image: &Image,
        erase: Erase,
        progress: &mut dyn FnMut(WriteProgress),
    ) -> Result<(), ProgramError>;

    /// Resets the chip, which starts its program.
    ///
    /// # Errors
    /// Any error of an access.
    fn reset(&mut self) -> Result<(), ProgramError>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_name_the_place_and_the_remedy() {
        let lost = ProgramError::Lost {
            doing: FlashStep::Programming,
            why: "USB device gone".into(),
        };
        let text = lost.to_string();
        assert!(text.contains("no whole program"), "{text}");
        assert!(text.contains("run the same command again"), "{text}");
        let wrong = ProgramError::WrongChip {
            id_code: 0x2003_6468,
        }
        .to_string();
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
