//! Lookups and hellos on any bytes, and lookups of any cells with their CRC put right.
//!
//! What must hold:
//! - a lookup that is accepted serialises to the bytes it came from, is plausible, and interpolates to
//!   numbers between its own smallest and largest;
//! - a lookup that is refused for its cells is not plausible, and the refusal has an answer and a text;
//! - a hello that decodes, encoded once more, decodes to itself, in no more bytes;
//! - a hello that fits carries the magic word, another role and our major version, and we fit it.

#![cfg_attr(fuzzing, no_main)]

mod reader;

use ihd_shared::lookup::blob::{BlobError, LEN};
use ihd_shared::lookup::grid::{CURRENTS, FREQUENCIES};
use ihd_shared::lookup::prior::prior;
use ihd_shared::lookup::{HENRY_PER_CODE, OHM_PER_CODE, RlLookup, plausible};
use ihd_shared::wire::PROTOCOL_MAJOR;
use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::frame::CRC32;
use ihd_shared::wire::hello::{MAGIC, ROLE_DEVICE, ROLE_HOST, check, ours};
use ihd_shared::wire::messages::{AnyMessage, Hello, Message};
use reader::{Reader, framed};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let mut reader = Reader(bytes);
    match reader.u8() % 4 {
        0 => lookup(reader.0, &mut Reader(bytes)),
        1 => {
            let mut blob = reader.array::<LEN>();
            correct(&mut blob);
            lookup(&blob, &mut reader);
        }
        2 => {
            let blob = edited(&mut reader).to_bytes();
            lookup(&blob, &mut reader);
        }
        _ => hello(reader.0),
    }
});

fn correct(blob: &mut [u8; LEN]) {
    let crc = CRC32.checksum(&blob[..LEN - 4]).to_le_bytes();
    blob[LEN - 4..].copy_from_slice(&crc);
}

/// The prior with cells scaled and marks set: near what is plausible, on either side.
fn edited(reader: &mut Reader<'_>) -> RlLookup {
    let mut lookup = prior();
    lookup.version = reader.u32();
    for _ in 0..reader.u8() {
        let (what, row, column) = (reader.u8(), reader.u8(), reader.u8());
        let (f, i) = (
            usize::from(row) % FREQUENCIES,
            usize::from(column) % CURRENTS,
        );
        let factor = u32::from(reader.u8());
        let scaled = |x: u16| (u32::from(x) * factor / 128).min(u32::from(u16::MAX)) as u16;
        match what % 8 {
            0 => lookup.mark_observed(f, i),
            1 => lookup.r[f][i] = scaled(lookup.r[f][i]),
            2 => lookup.l[f][i] = scaled(lookup.l[f][i]),
            3 => lookup.r[f] = lookup.r[f].map(scaled),
            4 => lookup.l[f] = lookup.l[f].map(scaled),
            5 => lookup.r[f][i] = reader.u16(),
            6 => lookup.l[f][i] = reader.u16(),
            _ => lookup.observed[row as usize % lookup.observed.len()] = column,
        }
    }
    lookup
}

fn lookup(bytes: &[u8], reader: &mut Reader<'_>) {
    let lookup = match RlLookup::from_bytes(bytes) {
        Ok(lookup) => lookup,
        Err(why) => {
            assert!(!why.to_string().is_empty());
            let _ = why.outcome();
            if let BlobError::Length { got } = why {
                assert!(got == bytes.len() && got != LEN);
            }
            return;
        }
    };
    assert_eq!(lookup.to_bytes()[..], *bytes);
    assert_eq!(plausible::check(&lookup), Ok(()));
    let (f_sw_hz, i_ma) = (reader.u32(), reader.u32());
    let (r, l) = lookup.interpolate(f_sw_hz, i_ma);
    within(r.ohm(), &lookup.r, OHM_PER_CODE, 1e-6);
    within(l.henry(), &lookup.l, HENRY_PER_CODE, 1e-12);
}

/// An interpolated value lies between the cells, rounding aside.
fn within(value: f64, cells: &[[u16; CURRENTS]; FREQUENCIES], unit: f64, rounding: f64) {
    let cells = || cells.iter().flatten().map(|c| f64::from(*c) * unit);
    let low = cells().fold(f64::INFINITY, f64::min) - rounding;
    let high = cells().fold(0.0, f64::max) + rounding;
    assert!((low..=high).contains(&value), "{value}: {low} to {high}");
}

fn hello(bytes: &[u8]) {
    let Ok(AnyMessage::Hello(theirs)) = AnyMessage::decode(Hello::ID, bytes) else {
        return;
    };
    let mut deframer = Deframer::new();
    for byte in framed(&theirs, 0) {
        if let Some(result) = deframer.push(byte) {
            let frame = result.expect("what was encoded decodes");
            assert!(frame.payload.len() <= bytes.len());
            let again = AnyMessage::decode(frame.id, frame.split().1);
            assert_eq!(again, Ok(AnyMessage::Hello(theirs.clone())));
        }
    }
    for role in [ROLE_HOST, ROLE_DEVICE] {
        let ours = ours(role, 0, 1, "fuzz 0.0.0", "fuzz");
        match check(&ours, &theirs) {
            Ok(()) => {
                assert_eq!(
                    (theirs.magic, theirs.protocol_major),
                    (MAGIC, PROTOCOL_MAJOR)
                );
                assert_ne!(theirs.role, role);
                assert_eq!(check(&theirs, &ours), Ok(()));
            }
            Err(why) => assert!(!why.to_string().is_empty()),
        }
    }
}
