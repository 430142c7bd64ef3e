//! The chip's USB bootloader, by its model: what is flashed is there, what goes wrong is told, and a second run mends it.

mod desk;
mod liar;

use desk::{Desk, GIVEN_TIME};
use ihd_fakes::SampleImage;
use ihd_flash::programmer::WriteProgress;
use ihd_flash::{Erase, Image, OptionBytes, ProgramError, Programmer};
use ihd_rom_bootloader::chip::{FACTORY_OPTR, FLASH, PAGE};
use ihd_rom_bootloader::{Fault, Left};
use ihd_shared::image::LOOKUP_ADDRESS;
use liar::Liar;

fn parsed(sample: &SampleImage) -> Image {
    Image::parse(&sample.elf(), None).unwrap()
}

/// One of several blocks, with a short last one of 5 double words.
fn image() -> Image {
    let sample = SampleImage {
        bytes: 5 * PAGE + 36,
        ..SampleImage::default()
    };
    parsed(&sample)
}

fn lookup() -> usize {
    (LOOKUP_ADDRESS - FLASH) as usize
}

/// An older program everywhere, and a lookup in its pages.
fn used() -> Desk {
    let desk = Desk::default();
    desk.with(|rom| {
        rom.chip.flash.fill(0x11);
        rom.chip.flash[lookup()..].fill(0x22);
    });
    desk
}

/// The flash holds the image and nothing of what was before, as far as pages go.
fn assert_flashed(desk: &Desk, image: &Image) {
    let flat = image.flat();
    let pages = flat.len().next_multiple_of(PAGE);
    desk.with(|rom| {
        assert!(rom.chip.flash[..flat.len()] == flat, "not the image");
        assert!(rom.chip.flash[flat.len()..pages].iter().all(|b| *b == 0xFF));
        assert_eq!(rom.early, 0, "asked before its time");
    });
}

fn flash(desk: &Desk, image: &Image) -> Result<(), ProgramError> {
    let mut dfu = desk.programmer();
    dfu.identify()?;
    dfu.flash(image, Erase::Image, &mut |_| {})?;
    dfu.reset()
}

/// It fails with these words, the chip does not start what is on it, and a second run mends it.
fn fails_and_is_mended(fault: Fault, words: &[&str]) {
    let (desk, image) = (used(), image());
    desk.with(|rom| rom.expect(fault));
    let error = flash(&desk, &image).expect_err("it must fail");
    let text = error.to_string();
    for word in words {
        assert!(text.contains(word), "{fault:?}: {word}: {text}");
    }
    // Neither the old program, once part of it is gone, nor the new one has its vectors.
    desk.with(|rom| {
        let vectors = &rom.chip.flash[..8];
        assert!(*vectors != image.flat()[..8], "{fault:?}: starts");
        let whole = rom.chip.flash[..lookup()].iter().all(|b| *b == 0x11);
        assert!(
            whole || *vectors != [0x11; 8],
            "{fault:?}: starts the old one"
        );
        assert_eq!(rom.chip.flash[lookup()], 0x22);
        rom.restart();
    });
    flash(&desk, &image).unwrap();
    assert_flashed(&desk, &image);
}

#[test]
fn an_image_is_written_into_its_pages_and_started_and_the_lookup_stays() {
    let (desk, image) = (used(), image());
    let mut dfu = desk.programmer();
    let chip = dfu.identify().unwrap();
    assert_eq!((chip.flash_kib, chip.id_code), (512, None));
    assert_eq!(dfu.is_switching().unwrap(), Some(false));
    let mut steps = Vec::new();
    dfu.flash(&image, Erase::Image, &mut |step| steps.push(step))
        .unwrap();
    assert_flashed(&desk, &image);
    desk.with(|rom| {
        let behind = 6 * PAGE;
        assert!(rom.chip.flash[behind..lookup()].iter().all(|b| *b == 0x11));
        assert!(rom.chip.flash[lookup()..].iter().all(|b| *b == 0x22));
        // Six pages; five blocks, the rest of the first one, its first double word.
        assert_eq!(rom.operations, 13);
        assert_eq!(rom.left(), None);
    });
    let ends = [
        WriteProgress::Erasing {
            done: 6 * PAGE as u32,
            total: 6 * PAGE as u32,
        },
        WriteProgress::Programming {
            done: 5 * PAGE as u32 + 40,
            total: 5 * PAGE as u32 + 40,
        },
        WriteProgress::Verifying {
            done: 5 * PAGE as u32 + 40,
            total: 5 * PAGE as u32 + 40,
        },
    ];
    for end in ends {
        assert!(steps.contains(&end), "{end:?} in {steps:?}");
    }
    dfu.reset().unwrap();
    assert_eq!(desk.with(|rom| rom.left()), Some(Left::Program(FLASH)));
}

#[test]
fn images_of_every_length_arrive() {
    for bytes in [PAGE - 4, PAGE, PAGE + 4, PAGE + 8, 2 * PAGE, 1000] {
        let image = SampleImage {
            bytes,
            ..SampleImage::default()
        };
        let (desk, image) = (used(), parsed(&image));
        flash(&desk, &image).unwrap();
        assert_flashed(&desk, &image);
    }
}

#[test]
fn everything_is_erased_where_that_is_wanted() {
    let (desk, image) = (used(), image());
    let mut dfu = desk.programmer();
    dfu.flash(&image, Erase::All, &mut |_| {}).unwrap();
    assert_flashed(&desk, &image);
    desk.with(|rom| assert!(rom.chip.flash[6 * PAGE..].iter().all(|b| *b == 0xFF)));
}

#[test]
fn any_memory_is_read_at_any_address() {
    let desk = Desk::default();
    desk.with(|rom| {
        for (place, byte) in rom.chip.flash.iter_mut().enumerate() {
            *byte = (place / 7) as u8;
        }
    });
    let mut dfu = desk.programmer();
    for (offset, length) in [
        (0, 8),
        (1, 1),
        (0x1D8, 68),
        (5, 2 * PAGE + 11),
        (PAGE, PAGE),
    ] {
        let mut out = vec![0; length];
        dfu.read(FLASH + offset as u32, &mut out).unwrap();
        let wanted = desk.with(|rom| rom.chip.flash[offset..offset + length].to_vec());
        assert_eq!(out, wanted, "{offset} {length}");
    }
    let mut once = [0; 16];
    dfu.read(0x1FFF_7000, &mut once).unwrap();
    assert_eq!(once, [0xFF; 16]);
    let nowhere = dfu.read(0x2000_0000, &mut once).unwrap_err().to_string();
    assert!(nowhere.contains("debug probe"), "{nowhere}");
}

#[test]
fn a_cable_that_is_pulled_anywhere_is_told_and_the_next_run_mends_it() {
    let image = image();
    let requests = {
        let desk = used();
        flash(&desk, &image).unwrap();
        desk.requests()
    };
    // Behind the last but two, the program is told to start and nothing can be lost any more.
    for after_requests in 0..requests - 2 {
        let desk = used();
        desk.with(|rom| rom.expect(Fault::Unplugged { after_requests }));
        let error = flash(&desk, &image).expect_err("it was unplugged");
        assert!(
            matches!(error, ProgramError::Lost { .. }),
            "{after_requests}: {error}"
        );
        desk.with(|rom| rom.restart());
        flash(&desk, &image).unwrap_or_else(|error| panic!("{after_requests}: {error}"));
        assert_flashed(&desk, &image);
    }
}

#[test]
fn power_lost_at_any_operation_leaves_nothing_that_starts() {
    for after_operations in 0..13 {
        let words = ["connection was lost", "no whole program", "begins anew"];
        fails_and_is_mended(Fault::PowerLost { after_operations }, &words);
    }
}

#[test]
fn a_flash_that_stays_busy_is_given_up() {
    for after_operations in [0, 3, 6, 11, 12] {
        let words = ["still busy after 1", "BOOT0", "run this again"];
        fails_and_is_mended(Fault::StuckBusy { after_operations }, &words);
    }
}

#[test]
fn an_operation_that_fails_is_told_with_its_place() {
    let words = ["erasing failed at 0x08001000", "erase", "Run this again"];
    fails_and_is_mended(
        Fault::Fails {
            after_operations: 2,
        },
        &words,
    );
    // The blocks from the second on come before the first.
    let words = ["programming failed at 0x08001000"];
    fails_and_is_mended(
        Fault::Fails {
            after_operations: 7,
        },
        &words,
    );
}

#[test]
fn a_bit_that_does_not_take_is_found_with_its_place() {
    let image = image();
    for offset in [0, 9, PAGE - 1, PAGE, 5 * PAGE, 5 * PAGE + 31] {
        let fault = Fault::BadBits {
            address: FLASH + offset as u32,
            mask: 0x40,
        };
        let place = format!("verifying failed at {:#010x}", FLASH + offset as u32);
        let byte = format!("{:02x}", image.flat()[offset] ^ 0x40);
        fails_and_is_mended(fault, &[&place, &byte]);
    }
}

#[test]
fn writes_that_are_acknowledged_and_dropped_are_found() {
    fails_and_is_mended(
        Fault::SilentlyDropped,
        &["verifying failed at 0x08000000", "ff, ff"],
    );
}

#[test]
fn another_chip_is_refused_before_anything_is_written() {
    for (layout, words) in [
        ("@Internal Flash   /0x08000000/128*02Kg", "256 KiB"),
        ("@Internal Flash  /0x90000000/256*02Kg", "other memories"),
        ("\u{1b}[2Jnothing", "other memories"),
    ] {
        let desk = used();
        desk.with(|rom| rom.flash_layout = Some(layout.to_owned()));
        let text = flash(&desk, &image()).unwrap_err().to_string();
        assert!(text.contains(words), "{text}");
        assert!(text.contains("nothing was written"), "{text}");
        assert!(!text.contains('\u{1b}'), "{text}");
        assert_eq!(desk.with(|rom| rom.operations), 0);
    }
}

#[test]
fn a_protected_chip_is_refused_before_anything_is_written() {
    let desk = used();
    desk.with(|rom| rom.chip.set_option(0, 0, FACTORY_OPTR & !0xFF | 0xBB));
    let text = flash(&desk, &image()).unwrap_err().to_string();
    assert!(text.contains("RDP level 1"), "{text}");
    // The last page of the image; the one behind it does not matter.
    for (area, hit) in [(0xFF05_FF05, true), (0xFF7F_FF06, false)] {
        let desk = used();
        desk.with(|rom| rom.chip.set_option(0, 4, area));
        let result = flash(&desk, &image());
        assert_eq!(result.is_err(), hit);
        if let Err(error) = result {
            let text = error.to_string();
            assert!(text.contains("pages 5 to 5 of bank 1"), "{text}");
            assert_eq!(desk.with(|rom| rom.operations), 0);
        }
    }
    let desk = used();
    desk.with(|rom| rom.chip.set_option(0, 0, FACTORY_OPTR & !(1 << 22)));
    let text = flash(&desk, &image()).unwrap_err().to_string();
    assert!(text.contains("DBANK = 0"), "{text}");
}

#[test]
fn option_bytes_are_read_written_and_read_back_from_a_chip_that_comes_back() {
    let desk = Desk::default();
    desk.comes_back(true);
    let mut dfu = desk.programmer();
    let present = dfu.option_bytes().unwrap();
    assert_eq!(present, OptionBytes::default());
    let wanted = present.with_requirements();
    dfu.set_option_bytes(&wanted).unwrap();
    assert_eq!(dfu.option_bytes().unwrap(), wanted);
    assert_eq!(desk.with(|rom| rom.chip.optr()), wanted.optr);
    // Nothing to write: nothing restarts.
    desk.comes_back(false);
    dfu.set_option_bytes(&wanted).unwrap();
    // Areas of the second bank have option bytes of their own.
    desk.comes_back(true);
    let mut other = wanted;
    other.wrp[3] = 0xFF03_FF02;
    dfu.set_option_bytes(&other).unwrap();
    assert_eq!(desk.with(|rom| rom.chip.option(1, 4)), 0xFF03_FF02);
    assert_eq!(desk.with(|rom| rom.chip.option(0, 4)), 0xFF00_FFFF);
}

#[test]
fn a_chip_that_starts_its_program_with_new_option_bytes_is_told() {
    let desk = Desk::default();
    let mut dfu = desk.programmer();
    let wanted = OptionBytes::default().with_requirements();
    let text = dfu.set_option_bytes(&wanted).unwrap_err().to_string();
    assert!(text.contains("BOOT0"), "{text}");
    // The second run finds them as they are wanted.
    desk.with(|rom| rom.restart());
    let mut dfu = desk.programmer();
    assert_eq!(dfu.option_bytes().unwrap(), wanted);
    dfu.set_option_bytes(&wanted).unwrap();
    let protected = OptionBytes {
        optr: wanted.optr & !0xFF | 0xBB,
        ..wanted
    };
    let text = dfu.set_option_bytes(&protected).unwrap_err().to_string();
    assert!(text.contains("protection against reading"), "{text}");
    assert_eq!(desk.with(|rom| rom.chip.optr()), wanted.optr);
}

#[test]
fn a_bootloader_that_was_left_in_the_middle_is_taken_as_it_is() {
    // Another program ended after a block, after a failed one, in an upload, before it asked for the status.
    for (what, data) in [(2, vec![1; 8]), (0, vec![0x99]), (2, vec![])] {
        let (desk, image) = (used(), image());
        desk.with(|rom| {
            let _ = rom.class_out(1, what, &data);
            if data.is_empty() {
                rom.restart();
                let _ = rom.class_in(2, 2, 64);
            }
        });
        flash(&desk, &image).unwrap();
        assert_flashed(&desk, &image);
    }
}

#[test]
fn it_waits_as_long_as_the_bootloader_asks_for() {
    let (desk, image) = (used(), image());
    flash(&desk, &image).unwrap();
    // Six pages of 23 ms, five blocks of 256 double words of 90 us, 5 more double words.
    let least = 6 * 23 + 5 * 23 + 1;
    let took = desk.now().as_millis();
    assert!(took >= least && took < least + 100, "{took} ms");
    assert!(desk.now() > GIVEN_TIME);
}

proptest::proptest! {
    /// Nothing that a device answers makes it panic, go on for ever, or believe that the image is there.
    #[test]
    fn a_device_that_lies_is_not_believed(
        answers in proptest::collection::vec(proptest::collection::vec(0u8..12, 0..8), 1..40),
        transfer in proptest::prelude::any::<u16>(),
    ) {
        let liar = Liar::new(answers, transfer);
        let mut dfu = ihd_flash::dfu::Dfu::new(liar, Box::new(|_| Ok(None)));
        let _ = dfu.identify();
        let _ = dfu.set_option_bytes(&OptionBytes::default().with_requirements());
        let flashed = dfu.flash(&image(), Erase::Image, &mut |_| {});
        proptest::prop_assert!(flashed.is_err());
        let _ = dfu.reset();
    }
}
