//! Installation of an image on a board: identification of the chip and its contents, check that it does not heat, option bytes,
//! flash, reset, hello.

use std::thread;
use std::time::{Duration, Instant};

use ihd_shared::image::{
    FLASH_ADDRESS, HEADER_ADDRESS, HEADER_BYTES, Header, LOOKUP_ADDRESS, NOTE_ADDRESS, NOTE_BYTES,
    build_id,
};
use ihd_shared::wire::frame::CRC32;
use serde::Serialize;

use crate::image::{BuildId, Image};
use crate::options::{OptionBytes, OptionDeviation};
use crate::programmer::{Chip, Erase, ProgramError, Programmer, WriteProgress};

/// Pause between two attempts to reach the board after its reset.
const HELLO_RETRY_PERIOD: Duration = Duration::from_millis(200);

/// Identity and state of a running board, read over its link.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RunningBoard {
    /// Link in words.
    pub link: String,
    /// Package and version, from its hello.
    pub build: String,
    /// Build id; `None` for firmware before protocol 2.2.
    pub build_id: Option<BuildId>,
    /// Major and minor version of its protocol.
    pub protocol: (u16, u16),
    /// Unique number of its chip; `None` for firmware before protocol 2.2.
    pub chip: Option<[u8; 12]>,
    /// Set if power is requested or the inverter is on.
    pub heats: bool,
    /// Number and name of the active fault.
    pub fault: Option<(u16, String)>,
}

/// Link of the board, opened for each request: the board is reset in between.
pub trait BoardAccess {
    /// Reads the board's identity and state.
    ///
    /// # Errors
    /// The reason in words if nothing answers.
    fn ask(&mut self) -> Result<RunningBoard, String>;
}

/// Program in a chip's flash.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct StoredProgram {
    /// Package and version.
    pub build: String,
    /// Its build id.
    pub build_id: Option<BuildId>,
    /// Major and minor version of its protocol.
    pub protocol: (u16, u16),
    /// `true` if its CRC is right, which it is not after an interrupted installation.
    pub whole: bool,
}

/// Contents of the flash at the place of the program.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FlashContents {
    /// Erased flash.
    Empty,
    /// An ihd firmware.
    Firmware(StoredProgram),
    /// Another program, or a firmware before protocol 2.2.
    Other,
    /// This access cannot read the flash.
    Unknown,
}

impl FlashContents {
    /// Describes it for `… is replaced by …`.
    pub fn describe(&self) -> String {
        match self {
            Self::Empty => "an empty flash".into(),
            Self::Other => "a program that does not say what it is".into(),
            Self::Unknown => "a program that was not looked at".into(),
            Self::Firmware(on) => {
                let id = on.build_id.map_or("none".into(), |id| id.short());
                let (major, minor) = on.protocol;
                let cut = if on.whole { "" } else { ", incomplete" };
                format!("{} (build {id}, protocol {major}.{minor}{cut})", on.build)
            }
        }
    }
}

/// Options of an installation.
#[derive(Clone, Copy, Debug)]
pub struct InstallPlan<'a> {
    /// The image.
    pub image: &'a Image,
    /// Extent of the erasure; the lookup stays with [`Erase::Image`].
    pub erase: Erase,
    /// `true` to set option bytes that deviate.
    pub set_options: bool,
    /// Time limit of the board for its hello.
    pub hello_within: Duration,
    /// `true` if a missing hello is an error; `false` if the user named no link.
    pub hello_required: bool,
}

/// Step of an installation, for display.
#[derive(Clone, Debug)]
pub enum InstallStep<'a> {
    /// The chip and its contents.
    Identified(&'a Chip, &'a FlashContents),
    /// Deviating option bytes, and `true` if they are set now.
    Options(&'a [OptionDeviation], bool),
    /// Progress of erasing, programming and verifying.
    Flash(WriteProgress),
    /// The image is written; the board starts.
    Waiting,
}

/// Result of an installation.
#[derive(Clone, Debug, Serialize)]
pub struct InstallReport {
    /// Access to the chip in words.
    pub way: String,
    /// The chip.
    pub chip: Chip,
    /// Contents before.
    pub before: FlashContents,
    /// Option bytes at the end.
    pub options: OptionBytes,
    /// Option bytes that still deviate.
    pub deviations: Vec<OptionDeviation>,
    /// `true` if the pages of the lookup were kept.
    pub lookup_kept: bool,
    /// Board's identity after its reset; `None` if it did not answer.
    pub heard: Option<RunningBoard>,
    /// Reason if the board did not answer.
    pub silence: Option<String>,
}

/// Error of an installation.
#[derive(Debug, thiserror::Error)]
pub enum InstallError {
    /// Error of the chip or the access to it.
    #[error(transparent)]
    Program(#[from] ProgramError),
    /// The board heats.
    #[error(
        "the board heats ({seen}); {written}. Switch it off, at its panel or by the host that heats it, and run this again"
    )]
    Heats {
        /// Source of this finding.
        seen: String,
        /// What was written until then.
        written: &'static str,
    },
    /// The image is on the chip, but the board does not answer.
    #[error(
        "the image was written and verified, but no hello came within {} s ({why}). Check the link's cable; look at the LED \
         and at `ihd log`; docs/bring-up.md says what they mean",
        after.as_secs()
    )]
    Silent {
        /// Time waited.
        after: Duration,
        /// Reason of the last attempt.
        why: String,
    },
    /// Another board or program answers.
    #[error(
        "the image was written and verified, but what answers on {link} has another {what}: {actual} instead of {expected}. Is it another board?"
    )]
    Other {
        /// Link in words.
        link: String,
        /// Name of the difference: build, build id or protocol.
        what: &'static str,
        /// Value of the image.
        expected: String,
        /// Value of the board.
        actual: String,
    },
}

/// Installs an image. Afterwards the chip runs its program, or holds an incomplete one and drives nothing.
///
/// # Errors
/// [`InstallError`]; nothing was written unless its text says so.
pub fn install(
    programmer: &mut dyn Programmer,
    mut link: Option<&mut dyn BoardAccess>,
    plan: InstallPlan<'_>,
    report: &mut dyn FnMut(InstallStep<'_>),
) -> Result<InstallReport, InstallError> {
    let chip = programmer.identify()?;
    let before = read_contents(programmer)?;
    report(InstallStep::Identified(&chip, &before));
    let heard = link.as_mut().and_then(|link| link.ask().ok());
    let heard = heard.filter(|heard| is_of(&chip, heard));
    refuse_while_heating(programmer, heard.as_ref(), "nothing was written")?;
    let mut options = programmer.option_bytes()?;
    let mut deviations = options.deviations();
    report(InstallStep::Options(&deviations, plan.set_options));
    if plan.set_options && !deviations.is_empty() {
        programmer.set_option_bytes(&options.with_requirements())?;
        // The chip was reset, and its old program runs again.
        let written = "its option bytes were set, the image was not written";
        refuse_while_heating(programmer, None, written)?;
        options = programmer.option_bytes()?;
        deviations = options.deviations();
    }
    programmer.flash(plan.image, plan.erase, &mut |progress| {
        report(InstallStep::Flash(progress))
    })?;
    programmer.reset()?;
    let (heard, silence) = match link {
        None => (None, Some("there is no link to it".into())),
        Some(link) => {
            report(InstallStep::Waiting);
            match await_hello(link, &chip, plan) {
                Err(InstallError::Silent { why, .. }) if !plan.hello_required => (None, Some(why)),
                heard => (Some(heard?), None),
            }
        }
    };
    Ok(InstallReport {
        way: programmer.describe(),
        chip,
        before,
        options,
        deviations,
        lookup_kept: plan.erase == Erase::Image,
        heard,
        silence,
    })
}

/// Returns `true` if the answering board may have this chip: another board may be connected as well.
fn is_of(chip: &Chip, heard: &RunningBoard) -> bool {
    match (chip.unique_id, heard.chip) {
        (Some(this), Some(that)) => this == that,
        _ => true,
    }
}

fn refuse_while_heating(
    programmer: &mut dyn Programmer,
    heard: Option<&RunningBoard>,
    written: &'static str,
) -> Result<(), InstallError> {
    if let Some(heard) = heard.filter(|heard| heard.heats) {
        let seen = format!("as it says over {}", heard.link);
        return Err(InstallError::Heats { seen, written });
    }
    match programmer.is_switching()? {
        Some(true) => Err(InstallError::Heats {
            seen: "the timer's outputs are on, as the probe reads".into(),
            written,
        }),
        _ => Ok(()),
    }
}

/// Reads the contents of the chip's flash.
///
/// # Errors
/// Any error of an access.
pub fn read_contents(programmer: &mut dyn Programmer) -> Result<FlashContents, ProgramError> {
    let mut head = vec![0; (HEADER_ADDRESS - FLASH_ADDRESS) as usize + HEADER_BYTES];
    match programmer.read(FLASH_ADDRESS, &mut head) {
        Err(ProgramError::Unsupported { .. }) => return Ok(FlashContents::Unknown),
        read => read?,
    }
    if head.iter().all(|&byte| byte == 0xFF) {
        return Ok(FlashContents::Empty);
    }
    let at = |address: u32| (address - FLASH_ADDRESS) as usize;
    let header = head.get(at(HEADER_ADDRESS)..).and_then(Header::parse);
    let Some(header) = header else {
        return Ok(FlashContents::Other);
    };
    let note = head.get(at(NOTE_ADDRESS)..at(NOTE_ADDRESS) + NOTE_BYTES);
    Ok(FlashContents::Firmware(StoredProgram {
        build: format!("ihd-firmware {}", header.version()),
        build_id: note.and_then(build_id).map(BuildId),
        protocol: (header.protocol_major, header.protocol_minor),
        whole: is_whole(programmer, &header)?,
    }))
}

/// Returns `true` if the program's last word is the CRC of the bytes before it.
fn is_whole(programmer: &mut dyn Programmer, header: &Header) -> Result<bool, ProgramError> {
    let covered = FLASH_ADDRESS + 4..LOOKUP_ADDRESS - 3;
    if !covered.contains(&header.crc_address) {
        return Ok(false);
    }
    let mut program = vec![0; (header.crc_address - FLASH_ADDRESS) as usize + 4];
    programmer.read(FLASH_ADDRESS, &mut program)?;
    let crc = program.split_off(program.len() - 4);
    Ok(CRC32.checksum(&program).to_le_bytes() == crc[..])
}

fn await_hello(
    link: &mut dyn BoardAccess,
    chip: &Chip,
    plan: InstallPlan<'_>,
) -> Result<RunningBoard, InstallError> {
    let begun = Instant::now();
    loop {
        let why = match link.ask() {
            Ok(heard) if is_of(chip, &heard) => return fits(heard, plan.image),
            Ok(heard) => format!("only another board answers, on {}", heard.link),
            Err(why) => why,
        };
        if begun.elapsed() >= plan.hello_within {
            let after = plan.hello_within;
            return Err(InstallError::Silent { after, why });
        }
        thread::sleep(HELLO_RETRY_PERIOD.min(plan.hello_within / 8));
    }
}

/// Checks that the answering board runs the image.
fn fits(heard: RunningBoard, image: &Image) -> Result<RunningBoard, InstallError> {
    let versions = |(major, minor): (u16, u16)| format!("{major}.{minor}");
    // A firmware without a build id is not this image.
    let id = heard.build_id.map_or("none".into(), |id| id.to_string());
    let facts = [
        ("build", image.build.clone(), heard.build.clone()),
        ("build id", image.build_id.to_string(), id),
        (
            "protocol",
            versions(image.protocol),
            versions(heard.protocol),
        ),
    ];
    match facts
        .into_iter()
        .find(|(_, expected, actual)| expected != actual)
    {
        None => Ok(heard),
        Some((what, expected, actual)) => Err(InstallError::Other {
            link: heard.link,
            what,
            expected,
            actual,
        }),
    }
}

#[cfg(test)]
mod tests;
