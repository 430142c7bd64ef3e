//! The deframer on any stream: bytes as they are, whole frames, and frames with a byte changed or cut off.
//!
//! What must hold:
//! - a run of bytes between zeros is one good frame or one bad, and is counted as such;
//! - a good frame, sent again, deframes to itself;
//! - every whole frame of the stream is found, in order;
//! - frames counted as lost are the gaps of the sequence numbers;
//! - after any stream a whole frame is found.

#![cfg_attr(fuzzing, no_main)]

mod reader;

use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::frame::MAX_PAYLOAD;
use ihd_shared::wire::messages::{Hello, Message};
use reader::{Reader, framed_raw};

/// Id, sequence number and payload.
type Owned = (u8, u16, Vec<u8>);

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    check(bytes, &[]);
    let (stream, whole) = stream(bytes);
    check(&stream, &whole);
});

/// A stream by the bytes' instructions, and its whole frames.
fn stream(bytes: &[u8]) -> (Vec<u8>, Vec<Owned>) {
    let mut reader = Reader(bytes);
    let (mut stream, mut whole) = (Vec::new(), Vec::new());
    while !reader.is_empty() {
        let (what, length) = (reader.u8(), usize::from(reader.u8()));
        if what % 4 == 0 {
            stream.extend_from_slice(reader.bytes(length));
            continue;
        }
        // A byte more or less a step, and up to the longest payload.
        let scale = if what & 0x80 == 0 { 1 } else { 4 };
        let (id, seq) = (reader.u8(), reader.u16());
        let payload = reader.bytes((length * scale).min(MAX_PAYLOAD));
        let mut frame = framed_raw(id, seq, payload);
        let at = usize::from(reader.u8()) % frame.len();
        match what % 4 {
            1 => whole.push((id, seq, payload.to_vec())),
            2 => frame[at] ^= reader.u8(),
            _ => frame.truncate(at),
        }
        stream.extend(frame);
    }
    (stream, whole)
}

fn check(stream: &[u8], whole: &[Owned]) {
    let mut deframer = Deframer::new();
    let found = deframe(&mut deframer, stream);
    let mut rest = whole.iter().peekable();
    for frame in found.iter().flatten() {
        rest.next_if_eq(&frame);
    }
    assert_eq!(rest.next(), None, "a whole frame was not found");

    let runs = stream.split(|&b| b == 0).rev().skip(1);
    let runs = runs.filter(|run| !run.is_empty()).count();
    assert_eq!(found.len(), runs, "a run is one good frame or one bad");
    let counters = deframer.counters();
    let good = found.iter().flatten().count();
    assert_eq!(counters.good as usize, good);
    assert_eq!(counters.bad as usize, runs - good);
    assert_eq!(counters.lost, lost(found.iter().flatten()));

    let last = (0x7f, 9, vec![0, 1, 0]);
    let frame = framed_raw(last.0, last.1, &last.2);
    let after = deframe(&mut deframer, &frame);
    assert_eq!(after.last(), Some(&Some(last)), "not in step again");
}

/// Results of the deframer on a stream; `None` for bytes that are no frame.
fn deframe(deframer: &mut Deframer, stream: &[u8]) -> Vec<Option<Owned>> {
    let mut found = Vec::new();
    for &byte in stream {
        if let Some(result) = deframer.push(byte) {
            let owned = result.map(|f| (f.id, f.seq, f.payload.to_vec()));
            if let Ok((id, seq, payload)) = &owned {
                again(*id, *seq, payload);
            }
            found.push(owned.ok());
        }
    }
    found
}

/// A good frame, encoded once more, is the same frame.
fn again(id: u8, seq: u16, payload: &[u8]) {
    let mut deframer = Deframer::new();
    let mut frames = 0;
    for byte in framed_raw(id, seq, payload) {
        if let Some(result) = deframer.push(byte) {
            let frame = result.expect("what was encoded decodes");
            assert_eq!((frame.id, frame.seq, frame.payload), (id, seq, payload));
            frames += 1;
        }
    }
    assert_eq!(frames, 1);
}

/// The gaps of the sequence, counted another way: forwards, unless that is more than half the range.
fn lost<'a>(frames: impl Iterator<Item = &'a Owned>) -> u32 {
    let (mut lost, mut last) = (0, None::<u16>);
    for (id, seq, _) in frames {
        if let Some(last) = last.filter(|_| *id != Hello::ID) {
            let ahead = (i64::from(*seq) - i64::from(last) - 1).rem_euclid(65_536);
            if ahead < 32_768 {
                lost += ahead as u32;
            }
        }
        last = Some(*seq);
    }
    lost
}
