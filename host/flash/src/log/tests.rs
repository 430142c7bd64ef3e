//! The decoder on frames as a board encodes them.

use ihd_signal::printable::is_shown;
use proptest::prelude::*;

use super::decoder::{Decoded, Decoder};
use super::message::{LogLevel, LogMessage};
use super::table::{LogTable, LogTableError};
use ihd_fakes::SampleLog;

fn decoder() -> Decoder {
    let table = LogTable::parse(&SampleLog::of_everything().elf(), "sample.elf").unwrap();
    Decoder::new(Some(table))
}

fn decoded(decoder: &mut Decoder, bytes: &[u8]) -> Vec<Decoded> {
    let mut all = Vec::new();
    decoder.push(bytes, |one| all.push(one));
    all
}

fn message(number: u16, values: &[u8]) -> LogMessage {
    match decoded(&mut decoder(), &SampleLog::frame(number, values)).as_slice() {
        [Decoded::Message(message)] => message.clone(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn values_are_put_into_the_texts() {
    let watchdog = message(1, &[0xE8, 3, 0, 0]);
    assert_eq!(watchdog.text, "watchdog runs: 1000 µs");
    assert_eq!(watchdog.level, Some(LogLevel::Info));
    assert_eq!(watchdog.place, None);
    let fault = message(2, &[0x2A, 0]);
    assert_eq!(
        (fault.text.as_str(), fault.level),
        ("self-test: fault 0x002a", Some(LogLevel::Error))
    );
    let values = [
        &[2, 0, 0, 0][..],
        b"ab",
        &[13, 0],
        &[1, 0, 0, 0, b'x', 1, 2, 0xff],
    ]
    .concat();
    assert_eq!(
        message(3, &values).text,
        "ab and interned, b\"x\", [1, 2, ff]"
    );
    assert_eq!(message(6, b"a\xffb\xff").level, None);
}

#[test]
fn parts_are_followed() {
    // Bits 0 to 12 of one value, an enumeration, one element of a pair, two bytes.
    let values = [
        &[0x35, 0x02][..],
        &[8, 0, 1, 0xDC, 5],
        &[1, 0, 0, 0, 9, 0, 1, 0, 2, 0],
        &[12, 0, b'o', b'k'],
    ];
    assert_eq!(
        message(5, &values.concat()).text,
        "5 100011 Heating { power_w: 1500 } [Pair { v: 1, i: 2 }] b\"ok\""
    );
}

#[test]
fn what_a_terminal_would_obey_is_shown_instead() {
    let evil = "\x1b]0;owned\x07\nfake\u{202e}";
    let values = [
        &[evil.len() as u8, 0, 0, 0][..],
        evil.as_bytes(),
        &[13, 0],
        &[0; 4],
        &[0; 3],
    ];
    let text = message(3, &values.concat()).text;
    assert!(
        text.starts_with(r"\u{1b}]0;owned\u{7}\u{a}fake\u{202e} and"),
        "{text}"
    );
}

#[test]
fn what_is_no_message_is_counted_and_the_next_one_found() {
    let mut decoder = decoder();
    let good = SampleLog::frame(1, &[1, 0, 0, 0]);
    for bad in [
        // No such number, a part, cut, too long, no encoding.
        SampleLog::frame(99, &[]),
        SampleLog::frame(9, &[0; 4]),
        SampleLog::frame(7, &[1, 2]),
        SampleLog::frame(1, &[1, 2, 3, 4, 5]),
        vec![1, 0xff, 0],
        [vec![1; 5_000], vec![0]].concat(),
        // A billion elements without a byte.
        SampleLog::frame(5, &[1, 2, 14, 0, 0, 0xCA, 0x9A, 0x3B, 14, 0, 12, 0, 1, 1]),
    ] {
        let stream = [&bad[..], &good].concat();
        let all = decoded(&mut decoder, &stream);
        assert!(
            matches!(all.as_slice(), [Decoded::Malformed, Decoded::Message(_)]),
            "{bad:?}: {all:?}"
        );
    }
}

#[test]
fn behind_a_loss_what_was_begun_is_no_frame() {
    let mut decoder = decoder();
    let frame = SampleLog::frame(1, &[1, 2, 3, 4]);
    assert_eq!(decoded(&mut decoder, &frame[..3]), []);
    decoder.lost();
    assert!(matches!(
        decoded(&mut decoder, &frame).as_slice(),
        [Decoded::Message(_)]
    ));
}

#[test]
fn without_a_table_frames_are_counted() {
    let mut decoder = Decoder::new(None);
    let stream = SampleLog::frame(1, &[1, 0, 0, 0]).repeat(3);
    assert_eq!(decoded(&mut decoder, &stream), vec![Decoded::Unread; 3]);
}

#[test]
fn what_cannot_be_decoded_is_refused_with_its_reason() {
    let refused = |elf: &[u8]| LogTable::parse(elf, "x.elf").err().unwrap();
    let dates = SampleLog::new(&[("defmt_info", "at {=u64:iso8601ms}")]);
    let why = refused(&dates.elf());
    assert!(
        matches!(why, LogTableError::Unsupported { .. }) && why.to_string().contains("x.elf"),
        "{why}"
    );
    let raw = SampleLog::new(&[("defmt_info", "x")]).encoded_as("raw");
    assert!(matches!(
        refused(&raw.elf()),
        LogTableError::Unsupported { .. }
    ));
    let elf = SampleLog::of_everything().elf();
    assert!(matches!(
        refused(&elf[..200]),
        LogTableError::Damaged { .. }
    ));
    assert!(matches!(refused(b"no file"), LogTableError::Damaged { .. }));
}

proptest! {
    /// Short form of the fuzz target `log_frames`.
    #[test]
    fn any_values_of_any_message_end_in_a_text_fit_for_a_terminal(
        number in 0u16..18,
        values in prop::collection::vec(prop_oneof![Just(0u8), 0u8..16, any::<u8>()], 0..80)
    ) {
        let all = decoded(&mut decoder(), &SampleLog::frame(number, &values));
        prop_assert_eq!(all.len(), 1);
        if let Decoded::Message(message) = &all[0] {
            prop_assert!(message.text.chars().all(is_shown));
        }
    }
}
