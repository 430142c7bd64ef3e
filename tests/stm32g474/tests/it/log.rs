//! Log of the image, decoded as by `ihd log`: over the link, and over RTT through a debug probe.

use std::time::Duration;

use ihd_debug_port::probe::Desk;
use ihd_firmware::limits::WATCHDOG_US;
use ihd_flash::Image;
use ihd_flash::log::decoder::{Decoded, Decoder};
use ihd_flash::log::find::Places;
use ihd_flash::log::follow::LogOpener;
use ihd_flash::log::message::{LogLevel, LogMessage};
use ihd_flash::log::over_link::LinkLogOpener;
use ihd_flash::log::over_probe::ProbeLogOpener;
use ihd_flash::probe::Probes;
use ihd_sim::behavioural::PotKind;
use ihd_stm32g474::debugged::DebuggedBoard;

use crate::board::{IMAGE, assert_no_violations, with_pot};

/// Source text at the place of a message.
fn line_of(message: &LogMessage) -> String {
    let place = message
        .place
        .as_ref()
        .expect("the image has debug information");
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
    let file = std::fs::read_to_string(format!("{root}/{}", place.file));
    let file = file.unwrap_or_else(|why| panic!("{place}: {why}"));
    let lines: Vec<&str> = file.lines().collect();
    // The statement and its text, which may be on the next line.
    lines[place.line as usize - 1..][..2].join(" ")
}

/// Reads the log ten times, with a timeout of 50 ms each.
fn listen(way: &mut dyn LogOpener) -> Vec<Decoded> {
    let mut log = way.open().expect("the log opens");
    let places = Places {
        given: Some(&IMAGE),
        cache: None,
    };
    let table = places.table(&log.running()).expect("the image runs");
    let mut decoder = Decoder::new(Some(table));
    let mut found = Vec::new();
    for _ in 0..10 {
        let chunk = log
            .read(Duration::from_millis(50))
            .expect("the log goes on");
        assert_eq!((chunk.lost_messages, chunk.lost_bytes), (0, 0));
        decoder.push(&chunk.bytes, |one| found.push(one));
    }
    found
}

fn messages(found: &[Decoded]) -> Vec<&LogMessage> {
    found
        .iter()
        .map(|one| match one {
            Decoded::Message(message) => message,
            other => panic!("{other:?}"),
        })
        .collect()
}

/// Asserts that the log has the messages of the start in order, each with its place in the firmware's source.
fn assert_tells_the_start(found: &[Decoded]) {
    let messages = messages(found);
    let place = |text: &str| {
        messages
            .iter()
            .position(|message| message.text.contains(text))
    };
    let order = [
        "reset reason 0, fault before it 0; 170 MHz",
        "no lookup in flash",
        "comparators on",
        "timers and ADCs run",
        "watchdog runs: ",
    ];
    let places = order.map(|text| place(text).unwrap_or_else(|| panic!("{text}: {messages:#?}")));
    assert!(places.is_sorted(), "{messages:#?}");
    for message in &messages {
        let is_value = |c: char| c == ':' || c.is_ascii_digit();
        let text = message.text.split(is_value).next().expect("a first part");
        assert!(line_of(message).contains(text.trim()), "{message:?}");
    }
    let watchdog = &messages[places[4]];
    assert_eq!(watchdog.level, Some(LogLevel::Info));
    let us = watchdog
        .text
        .strip_prefix("watchdog runs: ")
        .and_then(|us| us.strip_suffix(" µs"));
    let us: Option<u32> = us.and_then(|us| us.parse().ok());
    assert_eq!(us, Some(WATCHDOG_US));
}

#[test]
fn over_the_link_it_tells_the_start() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let serial = bench.clone();
    let mut way = LinkLogOpener::new(move || Ok(Box::new(serial.serial())));
    let found = listen(&mut way);
    assert_tells_the_start(&found);
    assert_no_violations(&bench);
}

#[test]
fn over_rtt_it_tells_the_start_and_the_program_goes_on() {
    let bench = with_pot(PotKind::Ferromagnetic);
    bench.run_s(0.1);
    let before = bench.with(|machine| machine.resets.len());
    let desk = Desk::new(DebuggedBoard::new(bench.clone()));
    let found = listen(&mut ProbeLogOpener::new(Probes::with(desk.lister()), None));
    assert_tells_the_start(&found);
    assert_eq!(bench.with(|machine| machine.resets.len()), before);
    assert_no_violations(&bench);
}

/// The build id in the image's own file equals the one in the flash.
#[test]
fn what_runs_is_known_by_its_build_id_both_ways() {
    let image = Image::read(&IMAGE).expect("the image under test");
    let bench = with_pot(PotKind::Ferromagnetic);
    let serial = bench.clone();
    let over_link = LinkLogOpener::new(move || Ok(Box::new(serial.serial())))
        .open()
        .expect("the log opens")
        .running();
    let desk = Desk::new(DebuggedBoard::new(bench));
    let over_probe = ProbeLogOpener::new(Probes::with(desk.lister()), None)
        .open()
        .expect("the log opens")
        .running();
    assert_eq!(over_link.build_id, Some(image.build_id));
    assert_eq!(over_link.crc, Some(image.crc));
    assert_eq!(over_probe, over_link);
}
