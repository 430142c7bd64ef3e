//! `ihd flash --dfu` under Linux, against the model of the chip's bootloader.

use std::sync::{Arc, Mutex};
use std::time::Instant;

use ihd_rom_bootloader::chip::PAGE;
use ihd_rom_bootloader::{Bootloader, Chip, Fault, Left};
use ihd_stm32g474::image::{FLASH, Image};
use ihd_stm32g474::usb::RomDevice;

use super::{DEVICE, Desk, MINUTES, image};

/// Command that flashes the image. No device responds after it: the model starts no program.
const FLASH_COMMAND: &str = "ihd flash --dfu --image /image.elf";

/// Desk with a used chip in its bootloader plugged in.
fn plugged_in() -> (Desk, Arc<Mutex<Bootloader>>) {
    let mut chip = Chip::default();
    chip.flash.fill(0x11);
    let began = Instant::now();
    let rom = Bootloader::new(chip, move || began.elapsed());
    let rom = Arc::new(Mutex::new(rom));
    let cable = RomDevice::new(Arc::clone(&rom)).on_a_cable();
    let mut desk = Desk::with_cables([cable]).unwrap();
    let serial = desk.plug(0).unwrap();
    assert_eq!(serial, rom.lock().unwrap().serial());
    (desk, rom)
}

/// Asserts that the flash holds the image up to the end of its last page, and its old content after that.
fn assert_flashed(rom: &Mutex<Bootloader>) {
    let image = Image::read(&image()).unwrap();
    let used = image.flash.iter().rposition(|byte| *byte != 0xFF).unwrap() + 1;
    let behind = used.next_multiple_of(PAGE);
    let rom = rom.lock().unwrap();
    assert!(rom.chip.flash[..behind] == image.flash[..behind]);
    assert!(rom.chip.flash[behind..].iter().all(|byte| *byte == 0x11));
    assert_eq!(rom.left(), Some(Left::Program(FLASH as u32)));
}

#[test]
#[ignore = "full tier: the model of the bootloader, which host/flash and the unit tests drive too"]
fn the_image_goes_through_the_bootloader_over_usb() {
    let (mut desk, rom) = plugged_in();
    let began = Instant::now();
    let flashed = desk.guest.run(FLASH_COMMAND, MINUTES).unwrap();
    println!(
        "flashed in {:.1} s: {}",
        began.elapsed().as_secs_f64(),
        flashed.text
    );
    // No hello: the model runs no program, and the command names no link of the board.
    assert_eq!(flashed.status, 0, "{}", flashed.text);
    assert_flashed(&rom);
    assert_eq!(rom.lock().unwrap().early, 0);
    desk.end();
}

#[test]
#[ignore = "full tier: the model of the bootloader, which host/flash and the unit tests drive too"]
fn a_cable_pulled_while_flashing_is_told_and_the_next_run_mends_it() {
    let (mut desk, rom) = plugged_in();
    rom.lock().unwrap().expect(Fault::PowerLost {
        after_operations: 100,
    });
    let lost = desk.guest.run(FLASH_COMMAND, MINUTES).unwrap();
    assert_eq!(lost.status, DEVICE, "{}", lost.text);
    assert!(lost.text.contains("no whole program"), "{}", lost.text);
    desk.until("dmesg | grep -q 'USB disconnect'", MINUTES)
        .unwrap();
    let none = desk.guest.run(FLASH_COMMAND, MINUTES).unwrap();
    assert_eq!(none.status, DEVICE, "{}", none.text);
    assert!(none.text.contains("BOOT0"), "{}", none.text);
    rom.lock().unwrap().restart();
    desk.plug(0).unwrap();
    let flashed = desk.guest.run(FLASH_COMMAND, MINUTES).unwrap();
    assert_eq!(flashed.status, 0, "{}", flashed.text);
    assert_flashed(&rom);
    desk.end();
}
