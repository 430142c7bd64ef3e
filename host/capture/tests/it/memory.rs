//! Memory: a size that a file declares is not reserved.

use std::fs;
use std::path::Path;

use ihd_capture::mcap::{self, McapFileError};
use ihd_capture::{OpenOptions, open};
use peak_alloc::PeakAlloc;

#[global_allocator]
static PEAK: PeakAlloc = PeakAlloc;

/// Memory in bytes that other tests of this binary may take at the same time, and the largest chunk unpacked.
const ROOM: usize = 256 << 20;

fn peak_of(read: impl FnOnce()) -> usize {
    let before = PEAK.current_usage();
    PEAK.reset_peak_usage();
    read();
    PEAK.peak_usage().saturating_sub(before)
}

/// 246 bytes that declare 536,870,911 doubles.
#[test]
fn an_array_of_4_gib_in_246_bytes_is_refused() {
    let damaged = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/damaged");
    let peak = peak_of(|| {
        let refused = open(&damaged.join("lies.mat"), &OpenOptions::default()).unwrap_err();
        let text = refused.to_string();
        assert!(
            text.contains("lies.mat, byte 136") && text.contains("declared"),
            "{text}"
        );
    });
    assert!(peak < ROOM, "{peak} bytes");
}

/// Every text of every record outside a chunk with a length of 4 GiB: header, metadata.
#[test]
fn a_text_of_4_gib_costs_its_record_and_no_memory() {
    let capture = super::damage::capture();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    mcap::write(&capture, &path).unwrap();
    let bytes = fs::read(&path).unwrap();
    for text in [
        "ihd-capture 1",
        "ihd-capture",
        "v_full_scale_v",
        "coil",
        "23 turns",
    ] {
        let word = [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat();
        let at = bytes.windows(word.len()).position(|w| w == word);
        let at = at.unwrap_or_else(|| panic!("{text} is not in the file"));
        let mut bytes = bytes.clone();
        bytes[at..at + 4].copy_from_slice(&0xffff_0000u32.to_le_bytes());
        fs::write(&path, &bytes).unwrap();
        let peak = peak_of(|| match mcap::salvage(&path) {
            // All but the table itself is there.
            Ok(salvaged) => {
                assert_eq!(salvaged.capture.len(), capture.len(), "{text}");
                assert_eq!(salvaged.losses.damaged, 1, "{text}");
            }
            Err(error) => {
                assert_eq!(text, "ihd-capture 1", "{error}");
                assert!(matches!(error, McapFileError::Damaged { .. }), "{error}");
            }
        });
        assert!(peak < ROOM, "{text}: {peak} bytes");
    }
}
