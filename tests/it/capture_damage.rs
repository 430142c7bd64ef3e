//! Capture files that were cut, damaged or made to harm: what is whole is read, everything else is a
//! typed error with file and offset, in bounded memory.

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use ihd_capture::mcap;
use ihd_capture::mcap::McapFileError;
use ihd_capture::mcap::topics::{PROFILE, Topic};
use ihd_signal::Capture;
use ihd_sim::recording::run::record;
use ihd_sim::recording::sensing::Rate;
use ihd_sim::recording::settings::{CaptureSpec, LoadKind};
use proptest::prelude::*;
use tempfile::TempDir;

/// A capture of 8 MB in some ten chunks, and its file.
static WHOLE: LazyLock<(Capture, Vec<u8>)> = LazyLock::new(|| {
    let mut settings = CaptureSpec {
        load: LoadKind::Behavioural,
        duration_s: 10e-3,
        ..CaptureSpec::default()
    };
    settings.sensing.rate = Rate::Hz(100e6);
    let recording = record(&settings, |_| ()).unwrap();
    let mut capture = recording.capture("whole");
    capture.truth.retain(|t| t.r_ohm[0].is_finite());
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("whole.mcap");
    mcap::write(&capture, &path).unwrap();
    (capture, fs::read(path).unwrap())
});

fn file(dir: &TempDir, bytes: &[u8]) -> PathBuf {
    let path = dir.path().join("changed.mcap");
    fs::write(&path, bytes).unwrap();
    path
}

/// End of each chunk and number of pairs before it, by another reader of the format.
fn chunk_ends(bytes: &[u8]) -> Vec<(usize, usize)> {
    let mut ends = Vec::new();
    let (mut at, mut pairs) = (::mcap::MAGIC.len(), 0);
    let mut samples = None;
    while let Some(prefix) = bytes.get(at..at + 9) {
        let length = u64::from_le_bytes(prefix[1..].try_into().unwrap()) as usize;
        let body = &bytes[at + 9..at + 9 + length];
        at += 9 + length;
        let record = ::mcap::parse_record(prefix[0], body).unwrap();
        if let ::mcap::records::Record::Chunk { header, data } = record {
            for record in ::mcap::read::ChunkReader::new(header, &data).unwrap() {
                match record.unwrap() {
                    ::mcap::records::Record::Channel(c) if c.topic == Topic::Samples.name() => {
                        samples = Some(c.id);
                    }
                    // Two f64, a count, and two f32 a pair behind four bytes of CDR header.
                    ::mcap::records::Record::Message { header, data }
                        if Some(header.channel_id) == samples =>
                    {
                        let count = u32::from_le_bytes(data[20..24].try_into().unwrap());
                        pairs += count as usize / 2;
                    }
                    _ => {}
                }
            }
            ends.push((at, pairs));
        } else if prefix[0] == ::mcap::records::op::FOOTER {
            break;
        }
    }
    ends
}

#[test]
fn a_file_cut_anywhere_gives_everything_up_to_its_last_whole_chunk() {
    let (whole, bytes) = &*WHOLE;
    let ends = chunk_ends(bytes);
    assert!(ends.len() > 5 && ends.last().unwrap().1 == whole.len());
    let dir = TempDir::new().unwrap();
    // Every chunk's end and the bytes around it, and a raster over the file.
    let around = ends.iter().flat_map(|(end, _)| [end - 1, *end, end + 1]);
    let raster = (600..bytes.len()).step_by(bytes.len() / 40);
    for cut in around.chain(raster) {
        let due = ends.iter().rev().find(|(end, _)| *end <= cut);
        let due = due.map_or(0, |(_, pairs)| *pairs);
        let read = mcap::read(&file(&dir, &bytes[..cut])).unwrap();
        assert_eq!(read.len(), due, "cut at {cut}");
        assert!(read.v_v[..] == whole.v_v[..due] && read.i_a[..] == whole.i_a[..due]);
    }
}

#[test]
fn a_file_cut_within_its_header_is_none() {
    let (_, bytes) = &*WHOLE;
    let dir = TempDir::new().unwrap();
    for cut in 0..40 {
        let error = mcap::read(&file(&dir, &bytes[..cut])).unwrap_err();
        assert!(error.to_string().contains("changed.mcap"), "{cut}: {error}");
    }
}

/// A file with the given profile, library and whatever else `fill` writes, uncompressed.
fn made(profile: &str, fill: impl FnOnce(&mut ::mcap::Writer<Cursor<&mut Vec<u8>>>)) -> Vec<u8> {
    let mut bytes = Vec::new();
    let options = ::mcap::WriteOptions::new()
        .profile(profile)
        .compression(None);
    let mut writer = options.create(Cursor::new(&mut bytes)).unwrap();
    fill(&mut writer);
    writer.finish().unwrap();
    drop(writer);
    bytes
}

fn error_of(bytes: &[u8]) -> McapFileError {
    let dir = TempDir::new().unwrap();
    mcap::read(&file(&dir, bytes)).unwrap_err()
}

#[test]
fn another_profile_is_refused_with_what_to_do() {
    for (profile, hint) in [
        ("ihd-capture 2", "later ihd"),
        ("ros2", "not recorded by ihd"),
        ("", "not recorded by ihd"),
    ] {
        let text = error_of(&made(profile, |_| ())).to_string();
        for part in ["changed.mcap", hint, PROFILE] {
            assert!(text.contains(part), "{part:?} is missing in {text:?}");
        }
    }
}

#[test]
fn what_a_later_minor_version_or_another_tool_adds_is_ignored() {
    let bytes = made(PROFILE, |w| {
        let none = BTreeMap::new();
        let channel = w.add_channel(0, "/camera", "jpeg", &none).unwrap();
        let header = ::mcap::records::MessageHeader {
            channel_id: channel,
            sequence: 0,
            log_time: 0,
            publish_time: 0,
        };
        w.write_to_known_channel(&header, b"picture").unwrap();
        let table = ::mcap::records::Metadata {
            name: "of another tool".into(),
            metadata: none,
        };
        w.write_metadata(&table).unwrap();
        w.write_private_record(0x80, b"private", Default::default())
            .unwrap();
        w.attach(&::mcap::Attachment {
            log_time: 0,
            create_time: 0,
            name: "schematic.pdf".into(),
            media_type: "application/pdf".into(),
            data: vec![0; 1000].into(),
        })
        .unwrap();
    });
    let dir = TempDir::new().unwrap();
    assert!(mcap::read(&file(&dir, &bytes)).unwrap().is_empty());
}

#[test]
fn a_known_topic_of_another_layout_is_reported_not_skipped() {
    let bytes = made(PROFILE, |w| {
        let schema = w.add_schema("somebody/msg/Samples", "ros2msg", b"");
        w.add_channel(schema.unwrap(), "/samples", "cdr", &BTreeMap::new())
            .unwrap();
    });
    let text = error_of(&bytes).to_string();
    assert!(
        text.contains("/samples") && text.contains("somebody"),
        "{text}"
    );
}

/// The first record of a kind: where its length stands.
fn length_of(bytes: &[u8], opcode: u8) -> usize {
    let mut at = ::mcap::MAGIC.len();
    while bytes[at] != opcode {
        at += 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
    }
    at + 1
}

#[test]
fn a_hostile_length_is_refused_where_it_stands() {
    use ::mcap::records::op;
    let (_, whole) = &*WHOLE;
    let huge = (1u64 << 60).to_le_bytes();
    // Of a record, of a chunk unpacked, and of a record of which nothing is known.
    let header = length_of(whole, op::HEADER);
    let metadata = length_of(whole, op::METADATA);
    let chunk = length_of(whole, op::CHUNK);
    for at in [header, metadata, chunk, chunk + 8 + 16] {
        let mut bytes = whole.clone();
        bytes[at..at + 8].copy_from_slice(&huge);
        let error = error_of(&bytes);
        assert!(
            matches!(error, McapFileError::TooLong { .. }),
            "{at}: {error}"
        );
        let text = error.to_string();
        assert!(text.contains("changed.mcap at byte ") && text.contains("1152921504606846976"));
    }
    let mut bytes = whole.clone();
    bytes[metadata - 1] = 0x7f;
    bytes[metadata..metadata + 8].copy_from_slice(&huge);
    assert!(matches!(error_of(&bytes), McapFileError::TooLong { .. }));
}

#[test]
fn a_hostile_length_within_a_chunk_is_refused() {
    // Uncompressed and without CRC, so that only the length is wrong.
    let mut bytes = made(PROFILE, |w| {
        w.add_channel(0, "/x", "", &BTreeMap::new()).unwrap();
    });
    let chunk = length_of(&bytes, ::mcap::records::op::CHUNK) - 1;
    let crc = chunk + 9 + 24;
    bytes[crc..crc + 4].fill(0);
    // Behind the times, the size, the CRC, an empty name and the packed size.
    let first = chunk + 9 + 24 + 4 + 4 + 8;
    for length in [1u64 << 60, u64::MAX, 1_000] {
        bytes[first + 1..first + 9].copy_from_slice(&length.to_le_bytes());
        let error = error_of(&bytes);
        assert!(matches!(error, McapFileError::Damaged { .. }), "{error}");
        assert!(
            error.to_string().contains("longer than the chunk"),
            "{error}"
        );
    }
}

#[test]
fn a_chunk_that_unpacks_to_more_than_it_declares_is_refused() {
    let (_, whole) = &*WHOLE;
    let size = length_of(whole, ::mcap::records::op::CHUNK) + 8 + 16;
    let mut bytes = whole.clone();
    bytes[size..size + 8].copy_from_slice(&1000u64.to_le_bytes());
    assert!(matches!(error_of(&bytes), McapFileError::Damaged { .. }));
}

#[test]
fn what_is_no_file_is_reported() {
    let dir = TempDir::new().unwrap();
    let text = mcap::read(dir.path()).unwrap_err().to_string();
    assert!(text.contains("is a directory"), "{text}");
    let text = mcap::read(Path::new("/dev/null")).unwrap_err().to_string();
    assert!(text.contains("/dev/null is a pipe or a device"), "{text}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// With any change of a few bytes reading ends, with an error or with no more than there was.
    #[test]
    fn damage_anywhere_is_an_error_or_nothing(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in any::<prop::sample::Index>(),
    ) {
        let (whole, bytes) = &*WHOLE;
        // The first 200 kB: header, metadata, and the first chunks.
        let mut bytes = bytes[..200_000].to_vec();
        bytes.truncate(cut.index(bytes.len()) + 1);
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        let dir = TempDir::new().unwrap();
        match mcap::read(&file(&dir, &bytes)) {
            Ok(read) => prop_assert!(read.len() <= whole.len()),
            Err(error) => prop_assert!(error.to_string().contains("changed.mcap")),
        }
    }
}
