//! Large files as scopes write them, for the benchmark and the test of memory.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use ihd_capture::write;
use ihd_signal::{Capture, TimeBase};

/// Sampling interval of all files.
pub const DT_S: f64 = 20e-9;

/// Bytes before the samples of tests/fixtures/formats/tek_wfm3le_*.wfm.
const WFM_HEADER: usize = 838;

/// Code of sample `k`, a triangle of 45 kHz with some wobble, so that compression has work.
fn code(k: usize) -> i16 {
    let phase = (k as i64 * 60) % 65536;
    let wobble = (k as i64).wrapping_mul(2_654_435_761) >> 8 & 0x3F;
    ((phase - 32768).abs() - 16384 + wobble) as i16
}

fn volts(k: usize) -> f64 {
    f64::from(code(k)) * 1e-2
}

fn amperes(k: usize) -> f64 {
    f64::from(code(k + 100)) * 2e-3
}

/// Voltage and current as WFM of version 3, 16 bit: the fixture's header, with more samples.
pub fn wfm(folder: &Path, samples: usize) -> [PathBuf; 2] {
    ["v", "i"].map(|channel| {
        let fixture = format!("../../tests/fixtures/formats/tek_wfm3le_{channel}.wfm");
        let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join(fixture);
        let mut bytes = std::fs::read(fixture).expect("fixture");
        bytes.truncate(WFM_HEADER);
        let length = (2 * samples) as u32;
        // Record length; begin and end of the samples, end of the buffer.
        let fields = [
            (504, samples as u32),
            (822, 0),
            (826, length),
            (830, length),
            (834, length),
        ];
        for (at, value) in fields {
            bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        }
        bytes.extend((0..samples).flat_map(|k| code(k).to_le_bytes()));
        let path = folder.join(format!("large_{channel}.wfm"));
        std::fs::write(&path, bytes).expect("written");
        path
    })
}

/// Time, voltage and current as a table, 33 bytes a row.
pub fn csv(folder: &Path, samples: usize) -> PathBuf {
    let mut text = String::from("time_s,v_V,i_A\n");
    for k in 0..samples {
        let t_s = k as f64 * DT_S;
        writeln!(text, "{t_s:.6e},{:.5e},{:.3e}", volts(k), amperes(k)).expect("to memory");
    }
    let path = folder.join("large.csv");
    std::fs::write(&path, text).expect("written");
    path
}

/// Time, voltage and current as MAT v5 of doubles, not compressed.
pub fn mat(folder: &Path, samples: usize) -> PathBuf {
    let mut bytes = vec![b' '; 124];
    bytes.extend([0, 1, b'I', b'M']);
    let word = |bytes: &mut Vec<u8>, x: usize| bytes.extend((x as u32).to_le_bytes());
    let time = |k: usize| k as f64 * DT_S;
    for (name, value) in [
        ("t", time as fn(usize) -> f64),
        ("v_V", volts),
        ("i_A", amperes),
    ] {
        let data = 8 * samples;
        // Matrix of flags (class double), sizes, name, and the numbers.
        for x in [
            14,
            16 + 16 + 16 + 8 + data,
            6,
            8,
            6,
            0,
            5,
            8,
            samples,
            1,
            1,
            name.len(),
        ] {
            word(&mut bytes, x);
        }
        bytes.extend(name.bytes().chain(std::iter::repeat(0)).take(8));
        word(&mut bytes, 9);
        word(&mut bytes, data);
        bytes.extend((0..samples).flat_map(|k| value(k).to_le_bytes()));
    }
    let path = folder.join("large.mat");
    std::fs::write(&path, bytes).expect("written");
    path
}

/// Voltage and current as NPZ, deflated, by our own export.
pub fn npz(folder: &Path, samples: usize) -> PathBuf {
    let single = |value: fn(usize) -> f64| (0..samples).map(|k| value(k) as f32).collect();
    let capture = Capture {
        name: String::new(),
        time: TimeBase::Even {
            t0_s: 0.0,
            dt_s: DT_S,
        },
        v_v: single(volts),
        i_a: single(amperes),
        ..Capture::default()
    };
    let path = folder.join("large.npz");
    write(&capture, &path, &mut |_| ()).expect("written");
    path
}
