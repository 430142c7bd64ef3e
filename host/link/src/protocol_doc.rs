//! Generator of docs/protocol.md from the message table.

use std::fmt::Write;

use ihd_shared::fault::Fault;
use ihd_shared::lookup::LOOKUP_VERSION_STEP;
use ihd_shared::lookup::blob::LEN;
use ihd_shared::lookup::grid::{CURRENTS, FREQUENCIES};
use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q};
use ihd_shared::window::{CHUNK_BYTES, MAX_PAIRS, MAX_TRAJECTORY};
use ihd_shared::wire::frame::{MAX_BODY, MAX_ENCODED, MAX_PAYLOAD};
use ihd_shared::wire::messages::{ENUMS, MESSAGES, SCHEMA_HASH};
use ihd_shared::wire::schema::{Entry, Part};
use ihd_shared::wire::{PROTOCOL_MAJOR, PROTOCOL_MINOR};

/// Returns the whole document as Markdown.
pub fn markdown() -> String {
    let mut doc = introduction();
    doc.push_str("\n## Messages\n\n| id | name | sent as | answered by |\n|---|---|---|---|\n");
    for m in MESSAGES {
        let (id, name, anchor) = (m.id.unwrap_or_default(), m.name, m.name.to_lowercase());
        let answer = m.answer.map_or_else(String::new, |answer| {
            format!("[{answer}](#{})", answer.to_lowercase())
        });
        line(
            &mut doc,
            &format!(
                "| {id:#04x} | [{name}](#{anchor}) | {} | {answer} |",
                sent_as(m)
            ),
        );
    }
    for m in MESSAGES {
        message(&mut doc, m);
    }
    doc.push_str("\n## Enumerations\n\nOne byte each, the number.\n");
    for e in ENUMS {
        section(&mut doc, e.name, e.doc);
        table(&mut doc, "number", e);
    }
    faults(&mut doc);
    doc
}

fn introduction() -> String {
    format!(
        "\
# Protocol {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}

Generated from the message table in `shared/src/wire/messages.rs`; do not edit. After a change of
the table: `UPDATE_DOCS=1 cargo test -p ihd-tests protocol_doc`.

Schema hash `{SCHEMA_HASH:016x}`.

## Frames

    00  COBS( id u8 · seq u16 LE · payload · crc32 LE )  00

The same bytes in process, over TCP, over USB and in files. The payload is the message in
[postcard](https://postcard.jamesmunns.com/wire-format) (integers as varints, signed ones zigzag), at
most {MAX_PAYLOAD} bytes; a frame is at most {MAX_BODY} bytes before stuffing and {MAX_ENCODED} on
the wire. The CRC is CRC-32/ISO-HDLC (zlib's) over id, seq and payload. `seq` counts the frames that
one end sends, so that the other sees what got lost. A receiver splits at zeros, drops runs that are
no frame, counts them, and is in step again at the next zero.

The payload of a request or an answer is the request's number, `u16` LE, and then the message; that of any other message is the
message alone.

| type | on the wire |
|---|---|
| `u8`, enumeration | one byte |
| `bool` | one byte, 0 or 1 |
| `u16`, `u32`, `u64`, `Fault` | varint |
| `i16`, `i32` | zigzag varint |
| `MicroOhm`, `PicoHenry` | `i32` in that unit, zigzag varint |
| `Raw`, `String<N>` | length as varint, then the bytes; a string is UTF-8 of at most N bytes |

## Handshake

The host sends `Hello`, the device answers with its own, and both check: the magic word, opposite
roles, the same major version, and the same schema hash where the minor version agrees. A device that
does not fit answers every later request with `NotPaired`; the host ends with the reason. A hello, one that does
not fit included, ends the conversation before it: the device forgets what was queued and asked for, heats no more for a host (the panel's
power stays), and streams nothing until `Stream` asks for it. Power lapses with its conversation, so nobody keeps a former host's alive.

## Requests and answers

The host numbers its requests from 1 on, 65535 is followed by 1, and the answer repeats the number. One request is under way at a
time. Each row of the table below binds a request to its answer; a request that is not carried out, and one that has nothing to
tell, is answered by `Reply`. An answer under any other number is nobody's: late ones, and those that come twice, are counted and dropped.

Answers get lost as other frames do. While one stays away the host sends the request again under its number, twice within its
time-out. A device carries each request out once:

| number | the device |
|---|---|
| after that of the last request, by less than half of all numbers | carries it out, and keeps the answer |
| of the last request | sends the answer that it kept, once there is one |
| before that of the last request | does nothing: it was overtaken, and its host has given it up |
| 0 | answers `Malformed` under 0 |

So a request that comes again does no harm, whatever it asks for. Two are sent once all the same: `Restart`, which would meet the next
program, and `ReplayBlocks`, after which a host that is in doubt asks for the last estimates.

## Evolution

A new message or a new fault raises the minor version. So does a new value of `Outcome`, provided that a device
answers with it to new messages alone: a host that does not know the message never asks, and so never meets the value. A device
answers a request that it does not know with `UnknownMessage` under its number. Any
other change of a message or an enumeration, an appended field included, raises the major version. `Hello` is frozen for ever. `tests/it/wire_golden.rs` pins every
message's bytes.

The faults are no part of the schema hash. A new one takes the next free number, and no number is ever
given another meaning: an older host keeps the whole message and shows the number.

Recordings of 1.x to 3.x are still read: what a device sends of its own accord has changed by appended fields alone, and
requests and answers mean nothing to a reader.

## Windows

A window is every sample pair of one mains half-cycle: `WindowStart`, `WindowChunk`s, `TrajectoryChunk`s,
`WindowEnd`, in this order, other messages in between. At most {MAX_PAIRS} pairs and {MAX_TRAJECTORY} trajectory
entries, {CHUNK_BYTES} bytes a chunk.

    pair              v i16 LE · i i16 LE   ADC codes, 4 bytes; {ADC_LOCK_P} pairs per {ADC_LOCK_Q} switching periods
    trajectory entry  R i32 LE · L i32 LE   µΩ and pH, 8 bytes; one per {ADC_LOCK_P} pairs

`WindowEnd` carries the CRC-32 of all pair bytes, then all trajectory bytes. A window's number counts before a
buffer is claimed: a gap is a window that was dropped.

Chunks leave the device without gap or overlap. What is lost of them the host asks for again with `ResendWindow`,
a few pieces at a time, when the window's end has come or nothing more of the window comes (100 ms, or
longer on a slow link), and six times at the most without success; `WindowGone` ends it. A receiver takes pieces in any order and more than once;
those that overlap must agree.

## Log

What the firmware logs is defmt: each frame is an index into a table that the image's ELF file holds, and the arguments, in
rzCOBS. `Log` carries whole frames. The build id in `Board` says which file it is. Log leaves behind telemetry and before
windows: a frame of it is rare and short, and on a slow link a stream of windows would otherwise never let it pass.

## Lookup

    \"IHDL\" · format u8 · version u32 · R cells u16 · L cells u16 · observed bits · crc32

Little-endian, {LEN} bytes. {FREQUENCIES} frequencies × {CURRENTS} currents, cell index =
frequency · {CURRENTS} + current; R in 16 ohm / 65536, L in 64 µH / 65536. Bit `cell % 8` of observed
byte `cell / 8` is set where the cell rests on observations. The CRC-32 covers all before it. At a
half-cycle boundary a device takes a lookup at most {LOOKUP_VERSION_STEP} versions above its own with plausible cells,
and saves it while idle, once a minute at most. `ResetLookup` leads back to the built-in one, version 0.
"
    )
}

fn message(doc: &mut String, m: &Entry) {
    section(doc, m.name, m.doc);
    line(
        doc,
        &format!("Id {:#04x}, {}.", m.id.unwrap_or_default(), sent_as(m)),
    );
    if let Some(answer) = m.answer {
        let repetition = match m.is_sent_once {
            true => " Sent once.",
            false => "",
        };
        line(doc, &format!("\nAnswered by `{answer}`.{repetition}"));
    }
    if !m.items.is_empty() {
        doc.push('\n');
        table(doc, "type", m);
    }
}

fn sent_as(m: &Entry) -> &'static str {
    m.part.map_or("", Part::text)
}

fn section(doc: &mut String, name: &str, text: &str) {
    line(doc, &format!("\n### {name}\n\n{}\n", prose(text)));
}

fn table(doc: &mut String, kind: &str, entry: &Entry) {
    line(doc, &format!("| name | {kind} | meaning |\n|---|---|---|"));
    for item in entry.items {
        let kind: String = item.kind.split_whitespace().collect();
        let kind = kind.replace("<'a>", "");
        line(
            doc,
            &format!("| `{}` | `{kind}` | {} |", item.name, prose(item.doc)),
        );
    }
}

fn faults(doc: &mut String) {
    line(
        doc,
        "
## Faults

The number, as `u16`. The list is open: a number that a host does not know decodes like any other, and
is shown as \"fault 120 (unknown to this version: update ihd)\". The table is `shared/src/fault.rs`.

| number | name | meaning | what a person reads |
|---|---|---|---|",
    );
    for row in Fault::TABLE {
        let (number, name) = (row.fault.number(), row.name);
        let meaning = prose(row.doc);
        line(
            doc,
            &format!("| {number} | `{name}` | {meaning} | {} |", row.text),
        );
    }
}

/// Converts a doc comment to prose: links of rustdoc become plain code.
fn prose(text: &str) -> String {
    text.trim()
        .replace("[`", "`")
        .replace("`]", "`")
        .replace("crate::", "")
        .replace("super::", "")
        .replace('|', "\\|")
}

fn line(doc: &mut String, text: &str) {
    // Writing to a string cannot fail.
    let _ = writeln!(doc, "{text}");
}
