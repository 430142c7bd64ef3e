//! A damaged chunk costs only itself, wherever the damage lies, and is told.

use std::fs;
use std::ops::Range;
use std::sync::LazyLock;

use ihd_capture::mcap;
use ihd_signal::Capture;
use ihd_sim::recording::run::record;
use ihd_sim::recording::sensing::Rate;
use ihd_sim::recording::settings::{CaptureSpec, LoadKind};

/// 4 MB in memory, five chunks in the file.
pub fn capture() -> Capture {
    static CAPTURE: LazyLock<Capture> = LazyLock::new(|| {
        let mut settings = CaptureSpec {
            load: LoadKind::Behavioural,
            duration_s: 10e-3,
            ..CaptureSpec::default()
        };
        settings.sensing.rate = Rate::Hz(50e6);
        let mut capture = record(&settings, |_| ()).unwrap().capture("whole");
        capture.truth.retain(|t| t.r_ohm[0].is_finite());
        capture.metadata.insert("coil".into(), "23 turns".into());
        capture
    });
    CAPTURE.clone()
}

/// Positions of the records of a kind, prefix included.
fn records(bytes: &[u8], opcode: u8) -> Vec<Range<usize>> {
    let (mut at, mut found) = (::mcap::MAGIC.len(), Vec::new());
    while let Some(prefix) = bytes.get(at..at + 9) {
        let length = u64::from_le_bytes(prefix[1..].try_into().unwrap()) as usize;
        let end = at + 9 + length;
        if prefix[0] == opcode {
            found.push(at..end);
        }
        if prefix[0] == ::mcap::records::op::FOOTER {
            break;
        }
        at = end;
    }
    found
}

#[test]
fn three_bytes_overwritten_cost_one_chunk() {
    let whole = capture();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    mcap::write(&whole, &path).unwrap();
    let bytes = fs::read(&path).unwrap();
    let chunks = records(&bytes, ::mcap::records::op::CHUNK);
    assert!(chunks.len() >= 4, "{}", chunks.len());
    // Pairs of a chunk: 1 MiB of 8 bytes each, and a message's worth at either end.
    let of_chunk = (1 << 17) + 2 * mcap::writer::PAIRS_PER_MESSAGE;
    for chunk in &chunks {
        // Kind, length, times, sizes, CRC, the packing's name, packed bytes, the last ones.
        for offset in [
            0,
            1,
            4,
            9,
            17,
            25,
            33,
            37,
            41,
            45,
            60,
            chunk.len() / 2,
            chunk.len() - 3,
        ] {
            let mut bytes = bytes.clone();
            let at = chunk.start + offset;
            for byte in &mut bytes[at..at + 3] {
                *byte = !*byte;
            }
            fs::write(&path, &bytes).unwrap();
            let salvaged =
                mcap::salvage(&path).unwrap_or_else(|e| panic!("{chunk:?} + {offset}: {e}"));
            let got = salvaged.capture.len();
            assert!(
                got + of_chunk >= whole.len() && got <= whole.len(),
                "{chunk:?} + {offset}: {got} of {} pairs",
                whole.len()
            );
            // Times lie outside the CRC: they cost nothing. All else is told.
            if got < whole.len() {
                assert!(salvaged.losses.damaged > 0, "{chunk:?} + {offset}");
                let first = salvaged.losses.first_damage.as_ref().unwrap();
                // Where kind and length are hit together it shows in what the length leads to.
                let there = first.contains(&format!("at byte {}:", chunk.start));
                assert!(there || offset < 4, "{chunk:?} + {offset}: {first}");
            }
            assert_eq!(salvaged.losses.cut_at, None, "{chunk:?} + {offset}");
            // What is read is what was written, at its time.
            let t_s = |k: usize| salvaged.capture.time.at(k).unwrap();
            for k in (0..got).step_by(9973) {
                let from = (t_s(k) / 20e-9).round() as usize;
                assert_eq!(
                    salvaged.capture.v_v[k], whole.v_v[from],
                    "{chunk:?} + {offset}, {k}"
                );
            }
        }
    }
}

#[test]
fn a_cut_is_told_with_its_place() {
    let whole = capture();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    mcap::write(&whole, &path).unwrap();
    let bytes = fs::read(&path).unwrap();
    assert!(mcap::salvage(&path).unwrap().losses.is_none());
    let chunks = records(&bytes, ::mcap::records::op::CHUNK);
    for chunk in &chunks {
        fs::write(&path, &bytes[..chunk.end - 1]).unwrap();
        let salvaged = mcap::salvage(&path).unwrap();
        assert_eq!(salvaged.losses.cut_at, Some(chunk.start as u64));
        assert_eq!(salvaged.losses.damaged, 0);
        let text = salvaged.losses.to_string();
        assert!(
            text.contains(&format!("ends at byte {}", chunk.start)),
            "{text}"
        );
    }
}
