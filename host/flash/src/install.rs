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
        "the board heats ({seen}); nothing was written. Switch it off, at its panel or by the host that heats it, and run this again"
    )]
    Heats {
        /// Source of this finding.
        seen: String,
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
    refuse_while_heating(programmer, heard.as_ref())?;
    let mut options = programmer.option_bytes()?;
    let mut deviations = options.deviations();
    report(InstallStep::Options(&deviations, plan.set_options));
    if plan.set_options && !deviations.is_empty() {
        programmer.set_option_bytes(&options.with_requirements())?;
        // The chip was reset, and its old program runs again.
        refuse_while_heating(programmer, None)?;
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
) -> Result<(), InstallError> {
    if let Some(heard) = heard.filter(|heard| heard.heats) {
        let seen = format!("as it says over {}", heard.link);
        return Err(InstallError::Heats { seen });
    }
    match programmer.is_switching()? {
        Some(true) => Err(InstallError::Heats {
            seen: "the timer's outputs are on, as the probe reads".into(),
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
mod tests {
    use std::collections::VecDeque;

    use ihd_fakes::SampleImage;

    use super::*;
    use crate::fake::{Failure, FakeProgrammer, image};
    use crate::programmer::FlashStep;

    /// Says one thing after the other, the last for ever.
    struct Script(VecDeque<Result<RunningBoard, String>>);

    impl Script {
        fn of(said: impl IntoIterator<Item = Result<RunningBoard, String>>) -> Self {
            Self(said.into_iter().collect())
        }
    }

    impl BoardAccess for Script {
        fn ask(&mut self) -> Result<RunningBoard, String> {
            match self.0.len() {
                1 => self.0[0].clone(),
                _ => self.0.pop_front().unwrap(),
            }
        }
    }

    fn said(image: &Image) -> RunningBoard {
        RunningBoard {
            link: "usb".into(),
            build: image.build.clone(),
            build_id: Some(image.build_id),
            protocol: image.protocol,
            chip: Some(*b"fake chip 01"),
            heats: false,
            fault: None,
        }
    }

    fn nothing() -> Result<RunningBoard, String> {
        Err("nobody there".into())
    }

    fn plan(image: &Image) -> InstallPlan<'_> {
        InstallPlan {
            image,
            erase: Erase::Image,
            set_options: false,
            hello_within: Duration::from_millis(40),
            hello_required: true,
        }
    }

    fn run(
        fake: &mut FakeProgrammer,
        link: Option<&mut dyn BoardAccess>,
        plan: InstallPlan<'_>,
    ) -> Result<InstallReport, InstallError> {
        install(fake, link, plan, &mut |_| ())
    }

    fn old() -> Image {
        let sample = SampleImage {
            version: "9.8.6",
            build_id: 0xA0,
            ..Default::default()
        };
        image(&sample)
    }

    #[test]
    fn the_new_goes_over_the_old_and_is_heard() {
        let (old, new) = (old(), image(&SampleImage::default()));
        let mut fake = FakeProgrammer::with(&old);
        fake.write(LOOKUP_ADDRESS, b"lookup");
        let mut link = Script::of([Ok(said(&old)), nothing(), nothing(), Ok(said(&new))]);
        let done = run(&mut fake, Some(&mut link), plan(&new)).unwrap();
        assert_eq!(
            done.before.describe(),
            "ihd-firmware 9.8.6 (build a0a0a0a0, protocol 2.2)"
        );
        assert_eq!(done.heard, Some(said(&new)));
        assert_eq!(fake.at(FLASH_ADDRESS, 5_000), new.flat());
        assert_eq!(fake.at(LOOKUP_ADDRESS, 6), b"lookup");
        assert_eq!(fake.resets, 1);
        assert!(done.lookup_kept);
    }

    #[test]
    fn a_board_that_heats_is_left_alone() {
        let (old, new) = (old(), image(&SampleImage::default()));
        let mut heating = said(&old);
        heating.heats = true;
        let mut fake = FakeProgrammer::with(&old);
        let mut link = Script::of([Ok(heating)]);
        let why = run(&mut fake, Some(&mut link), plan(&new)).unwrap_err();
        assert!(matches!(why, InstallError::Heats { .. }), "{why}");
        // Without a link the timer's outputs tell.
        fake.switching = Some(true);
        let mut link = Script::of([nothing()]);
        for link in [Some(&mut link as &mut dyn BoardAccess), None] {
            let why = run(&mut fake, link, plan(&new)).unwrap_err();
            assert!(why.to_string().contains("outputs are on"), "{why}");
        }
        assert_eq!(
            (fake.at(FLASH_ADDRESS, 5_000), fake.resets),
            (&old.flat()[..], 0)
        );
    }

    #[test]
    fn what_is_on_a_chip_is_told() {
        let image = image(&SampleImage::default());
        let mut fake = FakeProgrammer::default();
        assert_eq!(read_contents(&mut fake).unwrap(), FlashContents::Empty);
        fake.write(FLASH_ADDRESS, &[0; 2_048]);
        assert_eq!(read_contents(&mut fake).unwrap(), FlashContents::Other);
        let mut fake = FakeProgrammer::with(&image);
        fake.write(FLASH_ADDRESS + 4_096, &[0xFF; 8]);
        let cut = read_contents(&mut fake).unwrap();
        assert!(
            cut.describe().ends_with("protocol 2.2, incomplete)"),
            "{cut:?}"
        );
        // A header that lies about its length reads nothing outside.
        let mut fake = FakeProgrammer::with(&image);
        fake.write(HEADER_ADDRESS + 12, &[0xFF; 4]);
        assert!(
            read_contents(&mut fake)
                .unwrap()
                .describe()
                .contains("incomplete")
        );
    }

    #[test]
    fn option_bytes_are_told_and_set_when_asked() {
        let image = image(&SampleImage::default());
        let mut fake = FakeProgrammer {
            options: OptionBytes::default(),
            ..Default::default()
        };
        let done = run(&mut fake, None, plan(&image)).unwrap();
        let names: Vec<_> = done.deviations.iter().map(|one| one.name).collect();
        assert_eq!(names, ["SRAM_PE", "BOR_LEV"]);
        assert_eq!(fake.options, OptionBytes::default());
        let asked = InstallPlan {
            set_options: true,
            ..plan(&image)
        };
        let done = run(&mut fake, None, asked).unwrap();
        assert_eq!(done.deviations, []);
        assert_eq!(fake.options, OptionBytes::default().with_requirements());
        let at = |name| fake.calls.iter().rposition(|call| *call == name);
        assert!(at("set_option_bytes") < at("flash"), "{:?}", fake.calls);
    }

    #[test]
    fn silence_and_another_board_are_told() {
        let (old, new) = (old(), image(&SampleImage::default()));
        let mut fake = FakeProgrammer::default();
        let mut link = Script::of([nothing()]);
        let why = run(&mut fake, Some(&mut link), plan(&new)).unwrap_err();
        assert!(matches!(why, InstallError::Silent { .. }), "{why}");
        let mut link = Script::of([nothing(), Ok(said(&old))]);
        let why = run(&mut fake, Some(&mut link), plan(&new)).unwrap_err();
        assert!(
            why.to_string()
                .contains("9.8.6 instead of ihd-firmware 9.8.7"),
            "{why}"
        );
        let patient = InstallPlan {
            hello_required: false,
            ..plan(&new)
        };
        let mut link = Script::of([nothing()]);
        let done = run(&mut fake, Some(&mut link), patient).unwrap();
        assert_eq!(done.silence.as_deref(), Some("nobody there"));
        // Another board on the same desk: neither does its heating count, nor is it what was flashed.
        let mut neighbour = said(&old);
        (neighbour.chip, neighbour.heats) = (Some(*b"fake chip 02"), true);
        let mut link = Script::of([Ok(neighbour)]);
        let why = run(&mut fake, Some(&mut link), plan(&new)).unwrap_err();
        assert!(why.to_string().contains("only another board"), "{why}");
        // The same version, built from something else.
        let mut other = said(&new);
        other.build_id = None;
        let mut link = Script::of([nothing(), Ok(other)]);
        let why = run(&mut fake, Some(&mut link), plan(&new)).unwrap_err();
        assert!(why.to_string().contains("build id: none"), "{why}");
    }

    /// An installation that was interrupted anywhere is completed by a second one.
    #[test]
    fn a_second_run_mends_what_the_first_left() {
        let image = image(&SampleImage::default());
        let steps = [
            FlashStep::Reading,
            FlashStep::SettingOptions,
            FlashStep::Erasing,
            FlashStep::Programming,
            FlashStep::Verifying,
            FlashStep::Resetting,
        ];
        let failures = steps
            .into_iter()
            .flat_map(|doing| [Failure::Lost(doing), Failure::Refused(doing)]);
        for failure in failures.chain([Failure::Bit]) {
            let mut fake = FakeProgrammer {
                failure: Some(failure),
                options: OptionBytes::default(),
                ..FakeProgrammer::with(&old())
            };
            let asked = InstallPlan {
                set_options: true,
                ..plan(&image)
            };
            let why = run(&mut fake, None, asked).unwrap_err();
            assert!(
                matches!(why, InstallError::Program(_)),
                "{failure:?}: {why}"
            );
            run(&mut fake, None, asked).unwrap();
            assert_eq!(fake.at(FLASH_ADDRESS, 5_000), image.flat(), "{failure:?}");
        }
    }

    #[test]
    fn nothing_is_written_on_another_chip() {
        let image = image(&SampleImage::default());
        let mut fake = FakeProgrammer {
            id_code: 0x2003_6468,
            ..Default::default()
        };
        let why = run(&mut fake, None, plan(&image)).unwrap_err();
        assert!(why.to_string().contains("nothing was written"), "{why}");
        assert_eq!(fake.calls, ["identify"]);
    }
}
