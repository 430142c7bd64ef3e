//! `ihd flash` and `ihd log` through a probe; everything above the probe is the product.

use ihd_debug_port::chip::Mishap;
use ihd_debug_port::probe::Desk;
use ihd_debug_port::{Chip, Contact};
use ihd_fakes::SampleImage;
use ihd_flash::install::{FlashContents, InstallError, InstallPlan, InstallReport, install};
use ihd_flash::probe::{ProbeProgrammer, Probes};
use ihd_flash::{Erase, FlashStep, Image, OptionBytes, ProgramError, Programmer, WriteProgress};
use ihd_shared::image::{FLASH_ADDRESS, LOOKUP_ADDRESS, PAGE_BYTES};
use std::time::Duration;

fn attach(desk: &Desk<Chip>) -> Result<ProbeProgrammer, ProgramError> {
    Probes::with(desk.lister()).attach(None)
}

fn desk() -> Desk<Chip> {
    Desk::new(Chip::default())
}

/// Image of the firmware's size, which is no multiple of a page.
fn image() -> Image {
    let sample = SampleImage {
        bytes: 90_012,
        ..Default::default()
    };
    Image::parse(&sample.elf(), None).unwrap()
}

fn plan(image: &Image) -> InstallPlan<'_> {
    InstallPlan {
        image,
        erase: Erase::Image,
        set_options: false,
        hello_within: Duration::ZERO,
        hello_required: false,
    }
}

fn flash(desk: &Desk<Chip>, plan: InstallPlan<'_>) -> Result<InstallReport, InstallError> {
    let mut programmer = attach(desk)?;
    install(&mut programmer, None, plan, &mut |_| ())
}

fn in_flash(desk: &Desk<Chip>, address: u32, bytes: usize) -> Vec<u8> {
    let at = (address - FLASH_ADDRESS) as usize;
    desk.with(|chip| chip.flash.bytes[at..at + bytes].to_vec())
}

fn put(desk: &Desk<Chip>, address: u32, bytes: &[u8]) {
    let at = (address - FLASH_ADDRESS) as usize;
    desk.with(|chip| chip.flash.bytes[at..at + bytes.len()].copy_from_slice(bytes));
}

#[test]
fn an_image_is_flashed_verified_and_started_and_the_lookup_stays() {
    let (desk, image) = (desk(), image());
    put(&desk, LOOKUP_ADDRESS, b"a learned lookup");
    let mut programmer = attach(&desk).unwrap();
    let chip = programmer.identify().unwrap();
    assert_eq!(
        (chip.flash_kib, chip.unique_id),
        (512, Some(*b"model chip 1"))
    );
    let mut seen = Vec::new();
    programmer
        .flash(&image, Erase::Image, &mut |progress| seen.push(progress))
        .unwrap();
    assert_eq!(in_flash(&desk, FLASH_ADDRESS, 90_012), image.flat());
    assert_eq!(in_flash(&desk, LOOKUP_ADDRESS, 16), b"a learned lookup");
    // 43.95 pages, each once.
    desk.with(|chip| assert_eq!(chip.flash.erased, (0..44).collect::<Vec<_>>()));
    let last =
        |of: fn(&WriteProgress) -> Option<(u32, u32)>| seen.iter().filter_map(of).next_back();
    let erased = last(|step| match *step {
        WriteProgress::Erasing { done, total } => Some((done, total)),
        _ => None,
    });
    assert_eq!(erased, Some((44 * PAGE_BYTES, 44 * PAGE_BYTES)));
    let programmed = last(|step| match *step {
        WriteProgress::Programming { done, total } => Some((done, total)),
        _ => None,
    });
    assert_eq!(programmed, Some((90_012, 90_012)));
    assert_eq!(
        seen.last(),
        Some(&WriteProgress::Verifying {
            done: 90_012,
            total: 90_012
        })
    );
    let resets = desk.with(|chip| chip.resets);
    programmer.reset().unwrap();
    desk.with(|chip| {
        assert_eq!(chip.resets, resets + 1);
        assert_eq!(
            ihd_debug_port::Target::stopped(chip),
            None,
            "the program runs"
        );
    });
    // What is waited for afterwards is not disturbed.
    let halts = desk.with(|chip| chip.halts);
    drop(programmer);
    desk.with(|chip| assert_eq!(chip.halts, halts));
}

#[test]
fn erase_all_takes_the_lookup_too() {
    let (desk, image) = (desk(), image());
    put(&desk, LOOKUP_ADDRESS, b"a learned lookup");
    let all = InstallPlan {
        erase: Erase::All,
        ..plan(&image)
    };
    flash(&desk, all).unwrap();
    assert_eq!(in_flash(&desk, LOOKUP_ADDRESS, 16), [0xFF; 16]);
    assert_eq!(in_flash(&desk, FLASH_ADDRESS, 90_012), image.flat());
}

#[test]
fn what_is_on_the_chip_is_named() {
    let (desk, image) = (desk(), image());
    assert_eq!(
        flash(&desk, plan(&image)).unwrap().before,
        FlashContents::Empty
    );
    let again = flash(&desk, plan(&image)).unwrap().before;
    assert_eq!(
        again.describe(),
        "ihd-firmware 9.8.7 (build b1b1b1b1, protocol 2.2)"
    );
}

/// Looking neither resets nor halts: nobody protects a bridge that switches while the core stands.
#[test]
fn a_running_chip_is_read_and_not_halted() {
    let desk = desk();
    desk.with(|chip| (chip.timer_clocked, chip.outputs) = (true, 0b11));
    put(&desk, FLASH_ADDRESS + 0x1_0001, b"unaligned");
    let mut programmer = attach(&desk).unwrap();
    let mut found = [0; 9];
    programmer
        .read(FLASH_ADDRESS + 0x1_0001, &mut found)
        .unwrap();
    assert_eq!(&found, b"unaligned");
    programmer.identify().unwrap();
    assert_eq!(programmer.is_switching().unwrap(), Some(true));
    drop(programmer);
    desk.with(|chip| {
        assert_eq!((chip.resets, chip.halts), (0, 0));
        assert_eq!(ihd_debug_port::Target::stopped(chip), None);
    });
}

#[test]
fn a_bridge_that_switches_is_seen() {
    let (desk, image) = (desk(), image());
    desk.with(|chip| (chip.timer_clocked, chip.outputs) = (true, 0b11));
    let why = flash(&desk, plan(&image)).unwrap_err();
    assert!(matches!(why, InstallError::Heats { .. }), "{why}");
    desk.with(|chip| assert_eq!((chip.resets, chip.halts, chip.outputs), (0, 0, 0b11)));
    // Without its clock the timer reads as nothing.
    desk.with(|chip| chip.timer_clocked = false);
    flash(&desk, plan(&image)).unwrap();
}

/// A program that begins to switch after it was looked at is not halted with its bridge on.
#[test]
fn the_bridge_is_opened_before_the_core_is_halted() {
    let (desk, image) = (desk(), image());
    let mut programmer = attach(&desk).unwrap();
    desk.with(|chip| (chip.timer_clocked, chip.outputs) = (true, 0b01));
    programmer.flash(&image, Erase::Image, &mut |_| ()).unwrap();
    desk.with(|chip| assert!(chip.halts > 0 && !chip.halted_switching));
}

/// probe-rs attaches to an STM32G431 all the same.
#[test]
fn another_chip_is_refused() {
    let (desk, image) = (desk(), image());
    desk.with(|chip| chip.id_code = 0x2003_6468);
    let why = flash(&desk, plan(&image)).unwrap_err();
    assert!(
        matches!(
            why,
            InstallError::Program(ProgramError::WrongChip {
                id_code: 0x2003_6468
            })
        ),
        "{why}"
    );
    desk.with(|chip| assert_eq!((chip.resets, &chip.flash.erased[..]), (0, &[][..])));
}

#[test]
fn protections_are_told_before_anything_is_erased() {
    let image = image();
    let none = [0xFF00_FFFF; 4];
    let with = |optr, wrp| {
        let desk = desk();
        desk.with(|chip| chip.flash = std::mem::take(&mut chip.flash).with_options(optr, wrp));
        let why = flash(&desk, plan(&image)).unwrap_err();
        desk.with(|chip| assert!(chip.flash.erased.is_empty()));
        why.to_string()
    };
    let why = with(0xFEEF_FCBB, none);
    assert!(
        why.contains("RDP level 1") && why.contains("nothing was written"),
        "{why}"
    );
    let why = with(
        0xFEEF_FCAA,
        [0xFF02_FF01, 0xFF00_FFFF, 0xFF00_FFFF, 0xFF00_FFFF],
    );
    assert!(
        why.contains("pages 1 to 2 of bank 1 are write-protected"),
        "{why}"
    );
    let why = with(0xFEAF_FCAA, none);
    assert!(
        why.contains("DBANK = 0") && why.contains("--set-option-bytes"),
        "{why}"
    );
}

/// Protection of pages that the image does not need is not in its way, but in that of erasing everything.
#[test]
fn protection_elsewhere_is_no_matter() {
    let (desk, image) = (desk(), image());
    let wrp = [0xFF00_FFFF, 0xFF00_FFFF, 0xFF7F_FF7E, 0xFF00_FFFF];
    desk.with(|chip| chip.flash = std::mem::take(&mut chip.flash).with_options(0xFEEF_FCAA, wrp));
    flash(&desk, plan(&image)).unwrap();
    let all = InstallPlan {
        erase: Erase::All,
        ..plan(&image)
    };
    let why = flash(&desk, all).unwrap_err();
    assert!(
        matches!(
            why,
            InstallError::Program(ProgramError::WriteProtected { bank: 1, .. })
        ),
        "{why}"
    );
}

#[test]
fn option_bytes_are_set_loaded_and_read_back() {
    let (desk, image) = (desk(), image());
    let delivered = OptionBytes::default();
    desk.with(|chip| {
        chip.flash = std::mem::take(&mut chip.flash).with_options(delivered.optr, delivered.wrp)
    });
    let asked = InstallPlan {
        set_options: true,
        ..plan(&image)
    };
    let done = flash(&desk, asked).unwrap();
    assert_eq!(done.options, delivered.with_requirements());
    desk.with(|chip| assert_eq!(chip.flash.optr, 0xFEEF_FCAA));
    // Protection against reading is not this program's to change.
    let mut programmer = attach(&desk).unwrap();
    let protected = OptionBytes {
        optr: 0xFEEF_FCCC,
        ..done.options
    };
    let why = programmer.set_option_bytes(&protected).unwrap_err();
    assert!(matches!(why, ProgramError::Unsupported { .. }), "{why}");
    desk.with(|chip| assert_eq!(chip.flash.optr, 0xFEEF_FCAA));
}

/// Fault at the flash operation of this number (44 erasures, then double words), and the result of a second run.
fn mishap(after: u64, mishap: Mishap) -> ProgramError {
    let (desk, image) = (desk(), image());
    put(&desk, LOOKUP_ADDRESS, b"a learned lookup");
    desk.with(|chip| chip.mishap = Some((after, mishap)));
    let why = match flash(&desk, plan(&image)).unwrap_err() {
        InstallError::Program(why) => why,
        other => panic!("{other}"),
    };
    desk.with(Chip::restore);
    flash(&desk, plan(&image)).unwrap();
    assert_eq!(in_flash(&desk, FLASH_ADDRESS, 90_012), image.flat());
    assert_eq!(in_flash(&desk, LOOKUP_ADDRESS, 16), b"a learned lookup");
    why
}

#[test]
fn a_probe_that_is_pulled_is_told_and_a_second_run_mends_it() {
    for (after, doing) in [
        (0, FlashStep::Erasing),
        (20, FlashStep::Erasing),
        (44, FlashStep::Programming),
        (5_000, FlashStep::Programming),
    ] {
        let why = mishap(after, Mishap::ProbePulled);
        assert!(
            matches!(why, ProgramError::Lost { doing: at, .. } if at == doing),
            "{after}: {why}"
        );
        assert!(why.to_string().contains("no whole program"), "{why}");
    }
}

#[test]
fn a_loss_of_power_is_told_and_a_second_run_mends_it() {
    for (after, doing) in [
        (0, FlashStep::Erasing),
        (43, FlashStep::Erasing),
        (44, FlashStep::Programming),
        (9_000, FlashStep::Programming),
    ] {
        let why = mishap(after, Mishap::PowerLost);
        assert!(
            matches!(why, ProgramError::Lost { doing: at, .. } if at == doing),
            "{after}: {why}"
        );
    }
}

/// The vectors come last: a chip that was cut off does not begin with half a program.
#[test]
fn half_a_program_does_not_start() {
    // Before the last page of 1 KiB: 11 252 double words are programmed in all, filled up to whole pages of the algorithm.
    for after in [43, 44, 1_000, 11_000, 44 + 88 * 128 - 2 * 128] {
        let desk = desk();
        desk.with(|chip| chip.mishap = Some((after, Mishap::PowerLost)));
        flash(&desk, plan(&image())).unwrap_err();
        assert_eq!(in_flash(&desk, FLASH_ADDRESS, 8), [0xFF; 8], "{after}");
    }
}

#[test]
fn a_controller_that_stays_busy_is_told() {
    let why = mishap(10, Mishap::Stuck);
    assert!(
        matches!(
            why,
            ProgramError::Stuck {
                doing: FlashStep::Erasing,
                address: 0x0800_5000,
                ..
            }
        ),
        "{why}"
    );
    // Double word 100 lies in the algorithm's first page of 1 KiB.
    let why = mishap(144, Mishap::Stuck);
    assert!(
        matches!(
            why,
            ProgramError::Stuck {
                doing: FlashStep::Programming,
                ..
            }
        ),
        "{why}"
    );
    assert!(
        why.to_string().contains("power the board off and on"),
        "{why}"
    );
}

#[test]
fn a_bit_that_stays_is_found_and_its_place_is_told() {
    let why = mishap(44 + 1_000, Mishap::BitStays);
    let ProgramError::Verify {
        address,
        expected,
        actual,
    } = &why
    else {
        panic!("{why}");
    };
    // The first page comes last.
    assert_eq!(*address, FLASH_ADDRESS + PAGE_BYTES + 8_003);
    assert_eq!(expected[0] ^ actual[0], 0x10);
}

#[test]
fn probes_are_chosen_and_their_absence_is_told() {
    let (one, two) = (desk(), desk());
    let probes = Probes::with(Desk::list(&[(&one, "A1"), (&two, "B2")]));
    let why = probes.attach(None).unwrap_err();
    assert!(
        why.to_string()
            .contains("Model probe (1209:0001:A1), Model probe (1209:0001:B2)"),
        "{why}"
    );
    let chosen = probes.attach(Some("1209:0001:B2")).unwrap();
    assert_eq!(chosen.probe().serial.as_deref(), Some("B2"));
    let why = probes.attach(Some("1209:0001:C3")).unwrap_err();
    assert!(matches!(why, ProgramError::NotFound { .. }), "{why}");
    one.with(|chip| chip.cut(Contact::NoProbe));
    two.with(|chip| chip.cut(Contact::NoProbe));
    let why = probes.attach(None).unwrap_err();
    assert!(
        why.to_string().contains("no debug probe is plugged in"),
        "{why}"
    );
}

#[test]
fn a_board_without_power_is_told_apart_from_a_missing_probe() {
    let desk = desk();
    desk.with(|chip| chip.cut(Contact::NoPower));
    let why = attach(&desk).unwrap_err();
    assert!(matches!(why, ProgramError::NoChip { .. }), "{why}");
    assert!(why.to_string().contains("Power the board"), "{why}");
}

/// SEGGER's control block with one ring to the host, as defmt-rtt lays it out.
struct Ring {
    desk: Desk<Chip>,
    written: u32,
}

impl Ring {
    const BLOCK: u32 = 0x2000_4100;
    const NAME: u32 = 0x2000_4200;
    const BUFFER: u32 = 0x2000_4300;
    const BYTES: u32 = 1_024;

    fn begin(desk: &Desk<Chip>) -> Self {
        let ring = Self {
            desk: desk.clone(),
            written: 0,
        };
        ring.put(Self::NAME, b"defmt\0");
        ring.put_words(
            Self::BLOCK + 16,
            &[1, 0, Self::NAME, Self::BUFFER, Self::BYTES, 0, 0, 0],
        );
        ring.put(Self::BLOCK, b"SEGGER RTT\0\0\0\0\0\0");
        ring
    }

    fn put(&self, address: u32, bytes: &[u8]) {
        self.desk
            .with(|chip| chip.ram(address, bytes.len()).copy_from_slice(bytes));
    }

    fn put_words(&self, address: u32, words: &[u32]) {
        let bytes: Vec<_> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        self.put(address, &bytes);
    }

    /// Log of the program.
    fn log(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.put(Self::BUFFER + self.written, &[byte]);
            self.written = (self.written + 1) % Self::BYTES;
        }
        self.put_words(Self::BLOCK + 36, &[self.written]);
    }
}

#[test]
fn a_log_is_read_while_the_program_runs_and_survives_resets_and_plugs() {
    let desk = desk();
    let mut source = Probes::with(desk.lister()).log(None, None).unwrap();
    let mut log = Vec::new();
    // The program has not come as far.
    assert_eq!(source.read(&mut log).unwrap(), 0);
    let mut ring = Ring::begin(&desk);
    ring.log(b"first\0");
    assert_eq!(source.read(&mut log).unwrap(), 6);
    // Round the end of the ring.
    ring.log(&[b'x'; 1_000]);
    assert_eq!(source.read(&mut log).unwrap(), 1_000);
    ring.log(b"a line across the ring's end\0");
    source.read(&mut log).unwrap();
    assert!(log.ends_with(b"a line across the ring's end\0"));
    // The button: the program clears its variables and sets the ring up anew.
    desk.reset_button();
    desk.with(|chip| chip.ram(Ring::BLOCK, 1_024).fill(0));
    log.clear();
    assert_eq!(source.read(&mut log).unwrap(), 0);
    let mut ring = Ring::begin(&desk);
    ring.log(b"after the reset\0");
    for _ in 0..3 {
        source.read(&mut log).unwrap();
    }
    assert_eq!(log, b"after the reset\0");
    // The cable.
    for contact in [Contact::NoProbe, Contact::NoPower] {
        desk.with(|chip| chip.cut(contact));
        let why = source.read(&mut log).unwrap_err();
        assert!(source.resume().is_err(), "{why}");
        desk.with(Chip::restore);
        let mut ring = Ring::begin(&desk);
        ring.log(b"after the cable\0");
        source.resume().unwrap();
        log.clear();
        source.read(&mut log).unwrap();
        assert_eq!(log, b"after the cable\0");
    }
    desk.with(|chip| {
        assert_eq!(
            (chip.resets, chip.halts),
            (2, 0),
            "the button, and the supply"
        )
    });
}

/// The firmware itself, where `cargo xtask firmware` has built it.
#[test]
fn the_firmwares_own_image_is_flashed_and_named() {
    let Some(image) = Image::of_checkout() else {
        eprintln!("skipped: no image was built here");
        return;
    };
    let (desk, image) = (desk(), image.unwrap());
    flash(&desk, plan(&image)).unwrap();
    let again = flash(&desk, plan(&image)).unwrap();
    assert_eq!(again.before.describe(), image.describe());
    let FlashContents::Firmware(found) = again.before else {
        panic!("{:?}", again.before);
    };
    assert!(found.whole);
    assert_eq!(found.build_id, Some(image.build_id));
}
