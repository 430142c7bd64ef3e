//! The whole of putting an image on a board: what chip, what is on it, whether it heats, option bytes, flash, reset, hello.

use std::thread;
use std::time::{Duration, Instant};

use ihd_shared::image::{
    FLASH_ADDRESS, HEADER_ADDRESS, HEADER_BYTES, Header, LOOKUP_ADDRESS, NOTE_ADDRESS, NOTE_BYTES,
    build_id,
};
use ihd_shared::wire::frame::CRC32;
use serde::Serialize;

use crate::image::{BuildId, Image};
use crate::options::{Deviation, OptionBytes};
use crate::programmer::{Chip, Erase, ProgramError, Programmer, Progress};

/// Between two tries to hear the board after its reset.
const ASK_EVERY: Duration = Duration::from_millis(200);

/// What a running board says over its link.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Heard {
    /// The link in words.
    pub link: String,
    /// Package and version, from its hello.
    pub build: String,
    /// Its build id; firmware before protocol 2.2 does not tell.
    pub build_id: Option<BuildId>,
    /// Major and minor version of its protocol.
    pub protocol: (u16, u16),
    /// The number of its chip, unique among all; firmware before protocol 2.2 does not tell.
    pub chip: Option<[u8; 12]>,
    /// Power is asked for, or the inverter is on.
    pub heats: bool,
    /// Number and name of the active fault.
    pub fault: Option<(u16, String)>,
}

/// The board's link, opened anew for each question: the board is reset in between.
pub trait Link {
    /// What answers; `Err` with the reason when nothing does.
    ///
    /// # Errors
    /// In words.
    fn ask(&mut self) -> Result<Heard, String>;
}

/// What a chip's flash holds.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct OnChip {
    /// Package and version.
    pub build: String,
    /// Its build id.
    pub build_id: Option<BuildId>,
    /// Major and minor version of its protocol.
    pub protocol: (u16, u16),
    /// Whether its CRC is right: not where flashing was cut short.
    pub whole: bool,
}

/// What is in flash where a program would be.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Before {
    /// Nothing.
    Empty,
    /// An ihd firmware.
    Firmware(OnChip),
    /// A program that does not say what it is: another one, or a firmware before protocol 2.2.
    Other,
    /// This way to the chip does not read.
    Unknown,
}

impl Before {
    /// In words, for `… is replaced by …`.
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

/// What is to be done.
#[derive(Clone, Copy, Debug)]
pub struct Plan<'a> {
    /// The image.
    pub image: &'a Image,
    /// How much is erased; the lookup stays with [`Erase::Image`].
    pub erase: Erase,
    /// Whether option bytes are set where they differ.
    pub set_options: bool,
    /// How long the board may take until its hello.
    pub heard_within: Duration,
    /// Whether silence is an error: not where nobody said which link there is.
    pub must_be_heard: bool,
}

/// What happens, for a screen.
#[derive(Clone, Debug)]
pub enum Step<'a> {
    /// The chip, and what is on it.
    Found(&'a Chip, &'a Before),
    /// What differs in its option bytes, and whether that is set now.
    Options(&'a [Deviation], bool),
    /// Erasing, programming, verifying.
    Flash(Progress),
    /// Flashed; the board starts.
    Waiting,
}

/// What was done.
#[derive(Clone, Debug, Serialize)]
pub struct Installed {
    /// The way to the chip.
    pub way: String,
    /// The chip.
    pub chip: Chip,
    /// What was on it.
    pub before: Before,
    /// The option bytes at the end.
    pub options: OptionBytes,
    /// What still differs in them.
    pub deviations: Vec<Deviation>,
    /// Whether the pages of the lookup were kept.
    pub lookup_kept: bool,
    /// What the board said after its reset; `None` where it was not heard.
    pub heard: Option<Heard>,
    /// Why it was not.
    pub silence: Option<String>,
}

/// Why it was not done, or not to the end.
#[derive(Debug, thiserror::Error)]
pub enum InstallError {
    /// The chip or the way to it.
    #[error(transparent)]
    Program(#[from] ProgramError),
    /// Power is on.
    #[error(
        "the board heats ({seen}); nothing was written. Switch it off, at its panel or by the host that heats it, and run this again"
    )]
    Heats {
        /// By what it was seen.
        seen: String,
    },
    /// The image is on the chip, and nothing is heard.
    #[error(
        "the image was written and verified, but no hello came within {} s ({why}). Check the link's cable; look at the LED \
         and at `ihd log`; docs/board.md says what they mean",
        after.as_secs()
    )]
    Silent {
        /// Time waited.
        after: Duration,
        /// What the last try said.
        why: String,
    },
    /// Something else answers.
    #[error(
        "the image was written and verified, but what answers on {link} has another {what}: {found} instead of {wanted}. Is it another board?"
    )]
    Other {
        /// Where.
        link: String,
        /// build, build id or protocol.
        what: &'static str,
        /// The image's.
        wanted: String,
        /// The board's.
        found: String,
    },
}

/// Does it. The chip runs its program afterwards, or holds no whole one and drives nothing.
///
/// # Errors
/// [`InstallError`]; nothing was written unless its text says so.
pub fn install(
    programmer: &mut dyn Programmer,
    mut link: Option<&mut dyn Link>,
    plan: Plan<'_>,
    tell: &mut dyn FnMut(Step<'_>),
) -> Result<Installed, InstallError> {
    let chip = programmer.identify()?;
    let before = look(programmer)?;
    tell(Step::Found(&chip, &before));
    let heard = link.as_mut().and_then(|link| link.ask().ok());
    let heard = heard.filter(|heard| is_of(&chip, heard));
    refuse_while_heating(programmer, heard.as_ref())?;
    let mut options = programmer.option_bytes()?;
    let mut deviations = options.deviations();
    tell(Step::Options(&deviations, plan.set_options));
    if plan.set_options && !deviations.is_empty() {
        programmer.set_option_bytes(&options.as_wanted())?;
        // The chip was reset and its old program runs again.
        refuse_while_heating(programmer, None)?;
        options = programmer.option_bytes()?;
        deviations = options.deviations();
    }
    programmer.flash(plan.image, plan.erase, &mut |progress| {
        tell(Step::Flash(progress))
    })?;
    programmer.reset()?;
    let (heard, silence) = match link {
        None => (None, Some("there is no link to it".into())),
        Some(link) => {
            tell(Step::Waiting);
            match await_hello(link, &chip, plan) {
                Err(InstallError::Silent { why, .. }) if !plan.must_be_heard => (None, Some(why)),
                heard => (Some(heard?), None),
            }
        }
    };
    Ok(Installed {
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

/// Whether what was heard may be this chip: another board on the same desk is not.
fn is_of(chip: &Chip, heard: &Heard) -> bool {
    match (chip.unique_id, heard.chip) {
        (Some(this), Some(that)) => this == that,
        _ => true,
    }
}

fn refuse_while_heating(
    programmer: &mut dyn Programmer,
    heard: Option<&Heard>,
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

/// What is in the chip's flash.
///
/// # Errors
/// As every access.
pub fn look(programmer: &mut dyn Programmer) -> Result<Before, ProgramError> {
    let mut head = vec![0; (HEADER_ADDRESS - FLASH_ADDRESS) as usize + HEADER_BYTES];
    match programmer.read(FLASH_ADDRESS, &mut head) {
        Err(ProgramError::Unsupported { .. }) => return Ok(Before::Unknown),
        read => read?,
    }
    if head.iter().all(|&byte| byte == 0xFF) {
        return Ok(Before::Empty);
    }
    let at = |address: u32| (address - FLASH_ADDRESS) as usize;
    let header = head.get(at(HEADER_ADDRESS)..).and_then(Header::parse);
    let Some(header) = header else {
        return Ok(Before::Other);
    };
    let note = head.get(at(NOTE_ADDRESS)..at(NOTE_ADDRESS) + NOTE_BYTES);
    Ok(Before::Firmware(OnChip {
        build: format!("ihd-firmware {}", header.version()),
        build_id: note.and_then(build_id).map(BuildId),
        protocol: (header.protocol_major, header.protocol_minor),
        whole: is_whole(programmer, &header)?,
    }))
}

/// Whether the program's last word is the CRC of what is before it.
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

fn await_hello(link: &mut dyn Link, chip: &Chip, plan: Plan<'_>) -> Result<Heard, InstallError> {
    let begun = Instant::now();
    loop {
        let why = match link.ask() {
            Ok(heard) if is_of(chip, &heard) => return fits(heard, plan.image),
            Ok(heard) => format!("only another board answers, on {}", heard.link),
            Err(why) => why,
        };
        if begun.elapsed() >= plan.heard_within {
            let after = plan.heard_within;
            return Err(InstallError::Silent { after, why });
        }
        thread::sleep(ASK_EVERY.min(plan.heard_within / 8));
    }
}

/// What was heard, if it is what was flashed.
fn fits(heard: Heard, image: &Image) -> Result<Heard, InstallError> {
    let versions = |(major, minor): (u16, u16)| format!("{major}.{minor}");
    // A firmware that does not tell its build id is not this one.
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
    match facts.into_iter().find(|(_, wanted, found)| wanted != found) {
        None => Ok(heard),
        Some((what, wanted, found)) => Err(InstallError::Other {
            link: heard.link,
            what,
            wanted,
            found,
        }),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use super::*;
    use crate::fake::{Failure, FakeProgrammer, SampleImage};
    use crate::programmer::Doing;

    /// Says one thing after the other, the last for ever.
    struct Script(VecDeque<Result<Heard, String>>);

    impl Script {
        fn of(said: impl IntoIterator<Item = Result<Heard, String>>) -> Self {
            Self(said.into_iter().collect())
        }
    }

    impl Link for Script {
        fn ask(&mut self) -> Result<Heard, String> {
            match self.0.len() {
                1 => self.0[0].clone(),
                _ => self.0.pop_front().unwrap(),
            }
        }
    }

    fn said(image: &Image) -> Heard {
        Heard {
            link: "usb".into(),
            build: image.build.clone(),
            build_id: Some(image.build_id),
            protocol: image.protocol,
            chip: Some(*b"fake chip 01"),
            heats: false,
            fault: None,
        }
    }

    fn nothing() -> Result<Heard, String> {
        Err("nobody there".into())
    }

    fn plan(image: &Image) -> Plan<'_> {
        Plan {
            image,
            erase: Erase::Image,
            set_options: false,
            heard_within: Duration::from_millis(40),
            must_be_heard: true,
        }
    }

    fn run(
        fake: &mut FakeProgrammer,
        link: Option<&mut dyn Link>,
        plan: Plan<'_>,
    ) -> Result<Installed, InstallError> {
        install(fake, link, plan, &mut |_| ())
    }

    fn old() -> Image {
        let sample = SampleImage {
            version: "9.8.6",
            build_id: 0xA0,
            ..Default::default()
        };
        sample.image()
    }

    #[test]
    fn the_new_goes_over_the_old_and_is_heard() {
        let (old, new) = (old(), SampleImage::default().image());
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
        let (old, new) = (old(), SampleImage::default().image());
        let mut heating = said(&old);
        heating.heats = true;
        let mut fake = FakeProgrammer::with(&old);
        let mut link = Script::of([Ok(heating)]);
        let why = run(&mut fake, Some(&mut link), plan(&new)).unwrap_err();
        assert!(matches!(why, InstallError::Heats { .. }), "{why}");
        // Without a link the timer's outputs tell.
        fake.switching = Some(true);
        let mut link = Script::of([nothing()]);
        for link in [Some(&mut link as &mut dyn Link), None] {
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
        let image = SampleImage::default().image();
        let mut fake = FakeProgrammer::default();
        assert_eq!(look(&mut fake).unwrap(), Before::Empty);
        fake.write(FLASH_ADDRESS, &[0; 2_048]);
        assert_eq!(look(&mut fake).unwrap(), Before::Other);
        let mut fake = FakeProgrammer::with(&image);
        fake.write(FLASH_ADDRESS + 4_096, &[0xFF; 8]);
        let cut = look(&mut fake).unwrap();
        assert!(
            cut.describe().ends_with("protocol 2.2, incomplete)"),
            "{cut:?}"
        );
        // A header that lies about its length reads nothing outside.
        let mut fake = FakeProgrammer::with(&image);
        fake.write(HEADER_ADDRESS + 12, &[0xFF; 4]);
        assert!(look(&mut fake).unwrap().describe().contains("incomplete"));
    }

    #[test]
    fn option_bytes_are_told_and_set_when_asked() {
        let image = SampleImage::default().image();
        let mut fake = FakeProgrammer {
            options: OptionBytes::default(),
            ..Default::default()
        };
        let done = run(&mut fake, None, plan(&image)).unwrap();
        let names: Vec<_> = done.deviations.iter().map(|one| one.name).collect();
        assert_eq!(names, ["SRAM_PE", "BOR_LEV"]);
        assert_eq!(fake.options, OptionBytes::default());
        let asked = Plan {
            set_options: true,
            ..plan(&image)
        };
        let done = run(&mut fake, None, asked).unwrap();
        assert_eq!(done.deviations, []);
        assert_eq!(fake.options, OptionBytes::default().as_wanted());
        let at = |name| fake.calls.iter().rposition(|call| *call == name);
        assert!(at("set_option_bytes") < at("flash"), "{:?}", fake.calls);
    }

    #[test]
    fn silence_and_another_board_are_told() {
        let (old, new) = (old(), SampleImage::default().image());
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
        let patient = Plan {
            must_be_heard: false,
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

    /// Whatever cuts it short, the same again mends it.
    #[test]
    fn a_second_run_mends_what_the_first_left() {
        let image = SampleImage::default().image();
        let steps = [
            Doing::Reading,
            Doing::SettingOptions,
            Doing::Erasing,
            Doing::Programming,
            Doing::Verifying,
            Doing::Resetting,
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
            let asked = Plan {
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
        let image = SampleImage::default().image();
        let mut fake = FakeProgrammer {
            id_code: 0x2003_6468,
            ..Default::default()
        };
        let why = run(&mut fake, None, plan(&image)).unwrap_err();
        assert!(why.to_string().contains("nothing was written"), "{why}");
        assert_eq!(fake.calls, ["identify"]);
    }
}
