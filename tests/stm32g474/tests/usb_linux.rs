//! Boards driven by Linux over USB: a guest under QEMU with the host program in it, and the image on an emulated chip
//! plugged into it over USB/IP. `cargo xtask test --only usb` runs this.

#[path = "usb_linux/boards.rs"]
mod boards;
#[path = "usb_linux/desk.rs"]
mod desk;
#[path = "usb_linux/guest.rs"]
mod guest;
#[path = "usb_linux/initramfs.rs"]
mod initramfs;
#[path = "usb_linux/rom.rs"]
mod rom;

use std::path::PathBuf;
use std::time::Duration;

use boards::Board;
use desk::{Desk, number};
use ihd_stm32g474::usb::Board as Host;

/// Exit status of `ihd` when the device or the link to it fails.
const DEVICE: i32 = 3;
const MINUTES: Duration = Duration::from_secs(180);

fn image() -> PathBuf {
    let path = std::env::var_os("IHD_STM32G474_IMAGE")
        .expect("`cargo xtask test --only usb` names the image");
    path.into()
}

/// Desk with the image plugged in, and its serial number.
fn plugged_in() -> (Desk, String) {
    let board = Board::emulated(&image(), 0x12).unwrap();
    let mut desk = Desk::new(vec![board]).unwrap();
    let serial = desk.plug(0).unwrap();
    (desk, serial)
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[test]
fn linux_sees_the_descriptors_that_the_image_gives() {
    // First without an operating system, which also shows that the board accepts a second host after the first.
    let board = Board::emulated(&image(), 0x12).unwrap();
    let host = Host::enumerate(&board.cable, 9).unwrap();
    let told = host.description.clone();
    board.cable.unplug();
    let mut desk = Desk::new(vec![board]).unwrap();
    let serial = desk.plug(0).unwrap();
    assert_eq!(serial, told.strings[2]);
    let seen = desk
        .guest
        .shell(&format!("usb-descriptors {serial}"))
        .unwrap();
    for (name, bytes) in [
        ("device", &told.device),
        ("configuration", &told.configuration),
        ("bos", &told.bos),
        ("microsoft", &told.microsoft),
    ] {
        let wanted = format!("{name} {}", hexadecimal(bytes));
        assert!(seen.contains(&wanted), "{wanted}\n{seen}");
    }
    // Windows binds its driver by this descriptor.
    assert!(told.microsoft.windows(6).any(|bytes| bytes == b"WINUSB"));
    // No standard class, so no driver of the kernel binds to it.
    let driver = desk
        .guest
        .shell("cat /sys/bus/usb/devices/1-1:1.0/uevent")
        .unwrap();
    assert!(!driver.contains("DRIVER="), "{driver}");
    desk.end();
}

#[test]
fn whole_windows_are_recorded_over_usb() {
    let (mut desk, _) = plugged_in();
    // By size, as a recording of some seconds of the guest's clock has fewer windows on a slow machine, whose device drops most.
    let report = desk
        .record("a.mcap", "--max-size 300000 --power 1000", MINUTES)
        .unwrap();
    assert!(number(&report, "windows") >= 1.0, "{report}");
    for damage in ["windows_rejected", "frames_bad", "frames_lost"] {
        assert_eq!(number(&report, damage), 0.0, "{damage}: {report}");
    }
    // With a host that reads slowly the device drops some, and counts them: every loss is reported.
    for what in ["windows", "telemetry"] {
        let missing = number(&report, &format!("{what}_missing"));
        let dropped = number(&report, &format!("{what}_dropped"));
        assert_eq!(missing, dropped, "{what}: {report}");
    }
    let surveyed = desk.guest.shell("ihd inspect a.mcap").unwrap();
    assert!(surveyed.contains("whole half-cycles"), "{surveyed}");
    desk.end();
}

#[test]
#[ignore = "full tier: the trainer, over another link than in the tests of the workspace"]
fn the_trainer_identifies_the_load_over_usb() {
    let (mut desk, serial) = plugged_in();
    let line = "ihd trainer --device usb --power 1000 --store none --json 2>trainer.log || cat trainer.log";
    let answer = desk.guest.run(line, MINUTES).unwrap().text;
    println!("{answer}");
    assert!(answer.contains(&format!("usb ({serial})")), "{answer}");
    assert!(number(&answer, "lookup_version") >= 1.0);
    assert_eq!(number(&answer, "rejected"), 0.0);
    let (asked, delivered) = (number(&answer, "asked_w"), number(&answer, "delivered_w"));
    assert!(
        (delivered - asked).abs() < 0.05 * asked,
        "{delivered} W for {asked} W"
    );
    desk.end();
}

#[test]
fn a_cable_pulled_while_streaming_ends_the_recording_and_put_back_works_again() {
    let (mut desk, _) = plugged_in();
    desk.guest
        .shell("ihd record --device usb --out pulled.mcap --power 1000 >record.log 2>&1 & echo $!")
        .unwrap();
    // In the guest, and seldom: each poll starts two processes, which slow down the program under test. A whole window needs about
    // 55 kB, and a slow machine loses some.
    let written = "test $(stat -c %s pulled.mcap 2>/dev/null || echo 0) -gt 200000";
    let wait = format!("while kill -0 $! && ! {written}; do sleep 1; done");
    desk.guest.run(&wait, MINUTES).unwrap();
    desk.boards[0].cable.unplug();
    let ended = desk.guest.run("wait $!", MINUTES).unwrap();
    let said = desk.guest.shell("cat record.log").unwrap();
    assert_eq!(ended.status, DEVICE, "{said}");
    assert!(said.contains("closed the link"), "{said}");
    desk.until("dmesg | grep -q 'USB disconnect'", MINUTES)
        .unwrap();
    let surveyed = desk.guest.shell("ihd inspect pulled.mcap").unwrap();
    assert!(surveyed.contains("whole half-cycles"), "{surveyed}");
    desk.plug(0).unwrap();
    let report = desk
        .record("again.mcap", "--max-size 30000", MINUTES)
        .unwrap();
    assert!(number(&report, "telemetry") > 0.0, "{report}");
    // The pull cut one frame in two, and the window that it belonged to; the second halves come now.
    for cut in ["frames_bad", "windows_rejected"] {
        assert!(number(&report, cut) <= 1.0, "{cut}: {report}");
    }
    desk.end();
}

#[test]
#[ignore = "full tier: as a pulled cable, by the kernel"]
fn linux_lets_go_of_a_board_and_takes_it_again() {
    let (mut desk, serial) = plugged_in();
    desk.guest
        .shell("echo 0 >/sys/devices/platform/vhci_hcd.0/detach")
        .unwrap();
    desk.until("dmesg | grep -q 'USB disconnect'", MINUTES)
        .unwrap();
    let nothing = desk
        .guest
        .run("ihd record --device usb --out none.mcap", MINUTES)
        .unwrap();
    assert_eq!(nothing.status, DEVICE, "{}", nothing.text);
    assert!(
        nothing.text.contains("no ihd controller is plugged in"),
        "{}",
        nothing.text
    );
    assert_eq!(desk.plug(0).unwrap(), serial);
    desk.record("again.mcap", "--duration 2", MINUTES).unwrap();
    desk.end();
}

#[test]
#[ignore = "full tier: two boards and a guest on two cores"]
fn two_boards_at_once_are_told_apart_by_their_serial_numbers() {
    let boards = [0x12, 0x34].map(|unique| Board::emulated(&image(), unique).unwrap());
    let mut desk = Desk::new(boards.into()).unwrap();
    let first = desk.plug(0).unwrap();
    let second = desk.plug(1).unwrap();
    assert_ne!(first, second);
    let either = desk
        .guest
        .run("ihd record --device usb --out either.mcap", MINUTES)
        .unwrap();
    assert_eq!(either.status, DEVICE, "{}", either.text);
    assert!(
        either.text.contains("more than one ihd controller"),
        "{}",
        either.text
    );
    let listed = format!("usb:{first}, usb:{second}");
    let turned = format!("usb:{second}, usb:{first}");
    let text = &either.text;
    assert!(text.contains(&listed) || text.contains(&turned), "{text}");
    // Both at the same time, each by its number.
    let start = |serial: &str| {
        let options = "--duration 20 --power 1000 --json";
        let file = format!("{serial}.mcap");
        format!(
            "ihd record --device usb:{serial} --out {file} {options} >{serial}.json 2>{serial}.log &"
        )
    };
    let line = format!("{} {} wait", start(&first), start(&second));
    desk.guest.run(&line, MINUTES).unwrap();
    for serial in [first, second] {
        let report = desk
            .guest
            .shell(&format!("cat {serial}.json {serial}.log"))
            .unwrap();
        assert!(report.contains(&format!("usb ({serial})")), "{report}");
        assert!(number(&report, "windows") >= 2.0, "{report}");
        assert_eq!(number(&report, "frames_bad"), 0.0, "{report}");
        // Two emulated boards and a guest on one machine: with a late host the boards drop windows, and count them. No others are
        // missing.
        let missing = number(&report, "windows_missing");
        assert_eq!(missing, number(&report, "windows_dropped"), "{report}");
    }
    desk.end();
}
