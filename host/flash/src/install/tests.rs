use std::collections::VecDeque;

use ihd_fakes::SampleImage;

use super::*;
use crate::fake::{Failure, FakeProgrammer, image};
use crate::programmer::FlashStep;

/// Says one thing after the other, the last for ever.
struct Script(VecDeque<Result<RunningBoard, String>>);

impl Script {
    fn new(said: impl IntoIterator<Item = Result<RunningBoard, String>>) -> Self {
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
    let mut link = Script::new([Ok(said(&old)), nothing(), nothing(), Ok(said(&new))]);
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
    let mut link = Script::new([Ok(heating)]);
    let why = run(&mut fake, Some(&mut link), plan(&new)).unwrap_err();
    assert!(matches!(why, InstallError::Heats { .. }), "{why}");
    // Without a link the timer's outputs tell.
    fake.switching = Some(true);
    let mut link = Script::new([nothing()]);
    for link in [Some(&mut link as &mut dyn BoardAccess), None] {
        let why = run(&mut fake, link, plan(&new)).unwrap_err();
        assert!(why.to_string().contains("outputs are on"), "{why}");
    }
    assert_eq!(
        (fake.at(FLASH_ADDRESS, 5_000), fake.resets),
        (&old.flat()[..], 0)
    );
}

/// It was said that nothing was written.
#[test]
fn a_board_that_heats_after_its_option_bytes_were_set_is_told_as_it_is() {
    let image = image(&SampleImage::default());
    let mut fake = FakeProgrammer {
        options: OptionBytes::default(),
        switches_after_options: true,
        ..Default::default()
    };
    let asked = InstallPlan {
        set_options: true,
        ..plan(&image)
    };
    let why = run(&mut fake, None, asked).unwrap_err().to_string();
    assert!(why.contains("option bytes were set"), "{why}");
    assert!(!fake.calls.contains(&"flash"));
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
    let mut link = Script::new([nothing()]);
    let why = run(&mut fake, Some(&mut link), plan(&new)).unwrap_err();
    assert!(matches!(why, InstallError::Silent { .. }), "{why}");
    let mut link = Script::new([nothing(), Ok(said(&old))]);
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
    let mut link = Script::new([nothing()]);
    let done = run(&mut fake, Some(&mut link), patient).unwrap();
    assert_eq!(done.silence.as_deref(), Some("nobody there"));
    // Another board on the same desk: neither does its heating count, nor is it what was flashed.
    let mut neighbour = said(&old);
    (neighbour.chip, neighbour.heats) = (Some(*b"fake chip 02"), true);
    let mut link = Script::new([Ok(neighbour)]);
    let why = run(&mut fake, Some(&mut link), plan(&new)).unwrap_err();
    assert!(why.to_string().contains("only another board"), "{why}");
    // The same version, built from something else.
    let mut other = said(&new);
    other.build_id = None;
    let mut link = Script::new([nothing(), Ok(other)]);
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
