//! USB of the image in process: a host without an operating system, in emulated time. `cargo xtask test --only board` sets the
//! image's path.

use std::path::PathBuf;
use std::sync::mpsc;
use std::time::Duration;

use ihd_link::{Client, Transport};
use ihd_shared::sampling::ANTI_ALIAS_HZ;
use ihd_shared::usb::{PRODUCT, PRODUCT_ID, TRANSFER, VENDOR_ID};
use ihd_sim::adc::{ConverterNoise, SimulatedAdc};
use ihd_sim::behavioural::PotKind;
use ihd_sim::mains::SimulatedMains;
use ihd_sim::plant::Plant;
use ihd_stm32g474::bench::Bench;
use ihd_stm32g474::usb::{Board, Cable, Request, Status};

/// Board that runs freely, and its cable.
fn powered() -> (Bench, Cable) {
    let path = std::env::var_os("IHD_STM32G474_IMAGE")
        .expect("`cargo xtask test --only board` names the image");
    let plant = || {
        let adc = SimulatedAdc::of_board(ConverterNoise::default(), 1, f64::from(ANTI_ALIAS_HZ));
        Plant::new(SimulatedMains::of_board(), PotKind::Ferromagnetic, adc)
    };
    let bench = Bench::power_up(&PathBuf::from(path), plant).expect("the image is built");
    let cable = bench.with(|machine| machine.cable.clone());
    bench.run_freely(true);
    (bench, cable)
}

/// Asserts that the image neither violated the manual nor was reset.
fn is_clean(bench: &Bench) {
    let violations = bench.with(|machine| machine.violations());
    let violations: Vec<_> = violations.iter().map(ToString::to_string).collect();
    assert!(violations.is_empty(), "{violations:#?}");
    let resets = bench.with(|machine| machine.resets.clone());
    assert!(resets.is_empty(), "{resets:?}");
}

#[test]
fn it_is_enumerated_with_the_descriptors_that_hosts_look_for() {
    let (bench, cable) = powered();
    let board = Board::enumerate(&cable, 5).unwrap();
    let told = &board.description;
    let [vendor, product] = [VENDOR_ID, PRODUCT_ID].map(u16::to_le_bytes);
    assert_eq!(told.device[8..12], [vendor, product].concat());
    assert!(told.strings[1].starts_with(PRODUCT));
    // The chip's unique number in the emulated factory data.
    assert_eq!(told.strings[2], "123456789ABCDEF011223344");
    // Vendor-specific interface with 64 bytes each way.
    assert_eq!(told.configuration[9..18], [9, 4, 0, 0, 2, 0xFF, 0, 0, 0]);
    assert_eq!(told.configuration[18..25], [7, 5, 0x01, 2, 64, 0, 0]);
    assert_eq!(told.configuration[25..32], [7, 5, 0x81, 2, 64, 0, 0]);
    assert!(
        told.microsoft
            .windows(8)
            .any(|bytes| bytes == b"WINUSB\0\0")
    );
    assert!(
        bench.now_s() < 1.0,
        "enumerated {} s after power-on",
        bench.now_s()
    );
    is_clean(&bench);
}

#[test]
fn it_answers_hello_and_streams_windows_without_a_gap() {
    let (bench, cable) = powered();
    let board = Board::enumerate(&cable, 5).unwrap();
    let mut client = Client::connect(Box::new(board.link())).unwrap();
    assert_eq!(client.hello().board.as_str(), "stm32g474");
    client.set_power(1000).unwrap();
    client.stream(1, 20).unwrap();
    let from = bench.now_s();
    while bench.now_s() < from + 1.5 {
        client.next_event(Duration::from_millis(100)).unwrap();
    }
    let counters = client.counters();
    let rate = f64::from(u32::try_from(counters.bytes).unwrap()) / (bench.now_s() - from);
    println!("{rate:.0} bytes/s: {counters:?}");
    assert!(counters.windows.received >= 5, "{counters:?}");
    assert_eq!(
        (counters.windows.missing, counters.frames_bad),
        (0, 0),
        "{counters:?}"
    );
    is_clean(&bench);
}

/// Sixteen transfers a frame cost a host sixteen times as much.
#[test]
fn a_frame_is_one_transfer() {
    let (bench, cable) = powered();
    let board = Board::enumerate(&cable, 5).unwrap();
    let mut client = Client::connect(Box::new(board.link())).unwrap();
    client.set_power(1000).unwrap();
    client.stream(1, 20).unwrap();
    drop(client);
    let (sender, transfers) = mpsc::channel();
    for _ in 0..100 {
        let request = Request::In {
            endpoint: 1,
            length: TRANSFER,
        };
        let sender = sender.clone();
        cable.submit(request, move |outcome| drop(sender.send(outcome)));
    }
    drop(sender);
    let mut longest = 0;
    // The dropped link may have taken the beginning of the first frame.
    for outcome in transfers.iter().skip(1) {
        assert_eq!(outcome.status, Status::Done);
        // A frame begins and ends with the only two zeros in it.
        let zeros: Vec<usize> = (0..outcome.data.len())
            .filter(|k| outcome.data[*k] == 0)
            .collect();
        assert_eq!(zeros, [0, outcome.data.len() - 1], "{outcome:?}");
        longest = longest.max(outcome.data.len());
    }
    assert!(
        longest > 900,
        "no piece of a window: {longest} bytes at most"
    );
    is_clean(&bench);
}

#[test]
fn windows_asked_for_faster_than_usb_carries_them_are_dropped_whole() {
    let (bench, cable) = powered();
    let board = Board::enumerate(&cable, 5).unwrap();
    let mut client = Client::connect(Box::new(board.link())).unwrap();
    client.set_power(1000).unwrap();
    client.stream(1, 1).unwrap();
    let from = bench.now_s();
    while bench.now_s() < from + 1.0 {
        client.next_event(Duration::from_millis(100)).unwrap();
    }
    let counters = client.counters();
    let rate = f64::from(u32::try_from(counters.bytes).unwrap()) / (bench.now_s() - from);
    println!("{rate:.0} bytes/s: {counters:?}");
    assert_eq!(counters.frames_bad, 0, "{counters:?}");
    assert!(counters.windows_rejected.is_empty(), "{counters:?}");
    is_clean(&bench);
}

#[test]
fn it_comes_back_each_time_that_it_is_plugged_in_again() {
    let (bench, cable) = powered();
    for address in 1..=5 {
        let board = Board::enumerate(&cable, address).unwrap();
        let mut link = board.link();
        // Half of a frame, and a cable that is pulled while the board sends.
        link.send(&[3, 1, 2]).unwrap();
        drop(link);
        let mut client = Client::connect(Box::new(board.link())).unwrap();
        client.stream(1, 20).unwrap();
        client.next_event(Duration::from_millis(50)).unwrap();
        cable.unplug();
        bench.run_s(0.01);
    }
    is_clean(&bench);
}

#[test]
fn what_it_does_not_know_it_refuses_and_goes_on() {
    let (bench, cable) = powered();
    let board = Board::enumerate(&cable, 5).unwrap();
    // Unknown request of the vendor, unknown interface, unknown type of descriptor.
    for setup in [
        [0xC0, 0x77, 0, 0, 0, 0, 8, 0],
        [0x01, 11, 0, 0, 9, 0, 0, 0],
        [0x80, 6, 0, 0x77, 0, 0, 8, 0],
    ] {
        assert!(board.control("nonsense", setup).is_err(), "{setup:02x?}");
    }
    let client = Client::connect(Box::new(board.link())).unwrap();
    assert_eq!(client.hello().board.as_str(), "stm32g474");
    is_clean(&bench);
}
