//! A board's log: any bytes, and frames of messages that there are with any values, in chunks of any size.
//!
//! What must hold:
//! - it ends, in bounded memory: no count or length of a device is believed;
//! - every stretch between zeros is a message, or counted once as none;
//! - no text holds what a terminal would obey;
//! - after any bytes a whole frame is found;
//! - chunks make no difference.

#![cfg_attr(fuzzing, no_main)]

mod reader;

use std::sync::LazyLock;

use ihd_fakes::SampleLog;
use ihd_flash::log::decoder::{Decoded, Decoder};
use ihd_flash::log::table::LogTable;
use ihd_signal::printable::is_shown;
use reader::Reader;

/// The longest text that a frame of 4 KiB makes: seven bytes of values a byte, some of which name a format string of 70
/// characters, each of which may be escaped.
const MAX_TEXT_BYTES: usize = 7 * 4096 * 80;

static ELF: LazyLock<Vec<u8>> = LazyLock::new(|| SampleLog::of_everything().elf());

fn decoder() -> Decoder {
    let table = LogTable::parse(&ELF, "sample").expect("the sample is whole");
    Decoder::new(Some(table))
}

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let (chunks, lost) = stream(bytes);
    let mut decoder = decoder();
    let mut found = Vec::new();
    for (chunk, lost) in chunks.iter().zip(&lost) {
        if *lost {
            decoder.lost();
        }
        decoder.push(chunk, |one| found.push(one));
    }
    for one in &found {
        if let Decoded::Message(message) = one {
            assert!(message.text.chars().all(is_shown), "{:?}", message.text);
            assert!(message.text.len() < MAX_TEXT_BYTES);
        }
        assert!(*one != Decoded::Unread);
    }
    let whole = chunks.concat();
    if !lost.contains(&true) {
        let stretches = whole
            .split(|&byte| byte == 0)
            .filter(|part| !part.is_empty());
        let ended = stretches.count() - usize::from(whole.last().is_some_and(|&byte| byte != 0));
        assert_eq!(found.len(), ended);
        let mut at_once = Vec::new();
        self::decoder().push(&whole, |one| at_once.push(one));
        assert_eq!(at_once, found);
    }
    let mut last = Vec::new();
    decoder.push(&[0], |_| ());
    decoder.push(&SampleLog::frame(1, &[1, 0, 0, 0]), |one| last.push(one));
    assert!(matches!(last.as_slice(), [Decoded::Message(m)] if m.text == "watchdog runs: 1 µs"));
});

/// A stream by the bytes' instructions, in chunks, and whether something is lost before each.
fn stream(bytes: &[u8]) -> (Vec<Vec<u8>>, Vec<bool>) {
    let mut reader = Reader(bytes);
    let (mut chunks, mut lost) = (Vec::new(), Vec::new());
    while !reader.is_empty() {
        let what = reader.u8();
        let length = usize::from(reader.u8());
        chunks.push(match what % 4 {
            0 => reader.bytes(length).to_vec(),
            1 => reader.bytes(16 * length).to_vec(),
            _ => {
                let number = u16::from(reader.u8() % 18);
                SampleLog::frame(number, reader.bytes(length))
            }
        });
        lost.push(what >= 0xf0);
    }
    (chunks, lost)
}
