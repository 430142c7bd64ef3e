use std::path::{Path, PathBuf};
use std::time::Duration;

use ciborium::Value;
use ihd_daemon::learning::{StatedLoad, WorkerAnswer};
use ihd_link::Window;
use ihd_model::{FitRemark, FitStep};
use ihd_shared::sampling::{Pair, Scales};

use super::packing::{pack, unpack};
use super::*;

/// Fields of a message, with their names.
type Fields = Vec<(Value, Value)>;

/// A window that one worker may not identify.
pub(crate) fn window_message() -> WindowMessage {
    let pair = |k: u8| Pair::from_le_bytes([k, 0, 255 - k, 0]);
    WindowMessage {
        hob: "bench-1".into(),
        boot: 0xDEAD_BEEF,
        at_ms: 1_795_000_000_000,
        skew_s: Some(-60e-9),
        not_for: vec!["lab-7".into()],
        window: Window {
            seq: 4_711,
            half_cycle: 23_555,
            f_sw_hz: 45_000,
            half_cycle_ns: 10_000_000,
            first_pair_ns: -500,
            pairs: (0..=255).cycle().take(600).map(pair).collect(),
            first_trajectory_ns: 12,
            trajectory: Vec::new(),
            saturated: 3,
            lookup_version: 9,
            scales: Scales {
                v_full_scale_mv: 700_000,
                i_full_scale_ma: 90_000,
            },
        },
    }
}

/// An answer whose numbers are exact in single precision.
fn answer() -> AnswerMessage {
    AnswerMessage {
        hob: "bench-1".into(),
        boot: 0xDEAD_BEEF,
        seq: 4_711,
        window_at_ms: 1_795_000_000_000,
        at_ms: 1_795_000_000_120,
        answer: WorkerAnswer {
            by: "lab-3".into(),
            skew_s: Some(-60e-9),
            load: Ok(StatedLoad {
                t_s: vec![0.0, 0.25, 0.5],
                r_ohm: vec![3.5, 3.25, 3.0],
                l_h: vec![0.5, 0.25, 0.125],
                r_sigma_ohm: vec![0.5; 3],
                l_sigma_h: vec![0.25; 3],
                iterations: 17,
                steps: vec![FitStep {
                    step: 1,
                    loss: 0.5,
                    change: None,
                }],
                remarks: vec![FitRemark {
                    code: "noisy".into(),
                    severity: "info".into(),
                    text: "31 dB".into(),
                }],
            }),
            busy: Duration::from_millis(118),
        },
    }
}

fn golden(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/wire/golden");
    folder.join(format!("{name}-{VERSION}.cbor.zst"))
}

/// The bytes of this version, as first written: a change of them is another version.
#[test]
fn the_bytes_of_this_version_stay() {
    for (name, bytes) in [
        ("window", window_message().to_bytes().unwrap()),
        ("answer", answer().to_bytes().unwrap()),
    ] {
        let path = golden(name);
        if std::env::var_os("UPDATE_WIRE").is_some() {
            std::fs::write(&path, &bytes).unwrap();
        }
        let stored: Value = unpack(&std::fs::read(&path).unwrap()).unwrap();
        assert_eq!(
            stored,
            unpack::<Value>(&bytes).unwrap(),
            "{}",
            path.display()
        );
    }
    let read = |name| std::fs::read(golden(name)).unwrap();
    assert_eq!(
        WindowMessage::from_bytes(&read("window")).unwrap(),
        window_message()
    );
    assert_eq!(
        AnswerMessage::from_bytes(&read("answer")).unwrap(),
        answer()
    );
}

/// The fields of a message, changed.
fn changed(bytes: &[u8], change: impl FnOnce(&mut Fields)) -> Vec<u8> {
    let mut value: Value = unpack(bytes).unwrap();
    change(value.as_map_mut().unwrap());
    pack(&value).unwrap()
}

#[test]
fn a_field_that_is_not_known_is_ignored_and_a_missing_one_refuses_the_message() {
    let bytes = answer().to_bytes().unwrap();
    let more = changed(&bytes, |fields| {
        fields.push(("mood".into(), "cheerful".into()));
    });
    assert_eq!(AnswerMessage::from_bytes(&more).unwrap(), answer());
    let optional = ["skew_s"];
    let names: Vec<String> = {
        let value: Value = unpack(&bytes).unwrap();
        let fields = value.as_map().unwrap().iter();
        fields
            .map(|(name, _)| name.as_text().unwrap().to_owned())
            .collect()
    };
    for name in names {
        let less = changed(&bytes, |fields| {
            fields.retain(|(k, _)| k.as_text() != Some(&name))
        });
        let read = AnswerMessage::from_bytes(&less);
        assert_eq!(read.is_ok(), optional.contains(&&*name), "{name}: {read:?}");
    }
    // Fields are identified by name, not by order.
    let exchanged = changed(&bytes, |fields| fields.reverse());
    assert_eq!(AnswerMessage::from_bytes(&exchanged).unwrap(), answer());
}

#[test]
fn whatever_is_cut_or_flipped_is_an_error_and_no_panic() {
    let bytes = window_message().to_bytes().unwrap();
    for end in (0..bytes.len()).step_by(37) {
        assert!(WindowMessage::from_bytes(&bytes[..end]).is_err(), "{end}");
    }
    for at in (0..bytes.len()).step_by(11) {
        let mut wrong = bytes.clone();
        wrong[at] ^= 0x10;
        // Some bits of a zstd frame mean nothing.
        if let Ok(read) = WindowMessage::from_bytes(&wrong) {
            assert_eq!(read, window_message(), "byte {at}");
        }
    }
}

#[test]
fn another_version_a_bomb_and_what_no_honest_sender_says_are_refused_in_words() {
    let refused = |change: &dyn Fn(&mut Fields)| {
        let bytes = changed(&answer().to_bytes().unwrap(), |fields| change(fields));
        AnswerMessage::from_bytes(&bytes).unwrap_err().to_string()
    };
    let set = |name: &'static str, value: Value| {
        move |fields: &mut Fields| {
            let field = fields.iter_mut().find(|(k, _)| k.as_text() == Some(name));
            field.unwrap().1 = value.clone();
        }
    };
    for (name, value, word) in [
        ("version", Value::from(3), "version 3"),
        ("hob", Value::from("a.>"), "cannot be"),
        ("by", Value::from("x".repeat(3_000)), "no worker's name"),
        ("busy_ms", Value::from(u32::MAX), "busy_ms"),
        ("busy_ms", Value::from(1e19), "cannot be read"),
        ("seq", Value::from(-1), "cannot be read"),
        ("found", Value::from("nothing"), "cannot be read"),
    ] {
        let why = refused(&set(name, value));
        assert!(why.contains(word), "{name}: {why}");
    }
    let lists = [
        (vec![0.0; 129], "at most 128"),
        (vec![0.0; 2], "t_s has 2"),
        (vec![0.0, f64::NAN, 1.0], "no number"),
    ];
    for (t_s, word) in lists {
        let mut message = answer();
        message.answer.load.as_mut().unwrap().t_s = t_s;
        let why = AnswerMessage::from_bytes(&message.to_bytes().unwrap()).unwrap_err();
        assert!(why.to_string().contains(word), "{why}");
    }
    let bomb = zstd::bulk::compress(&vec![0; 64 << 20], 19).unwrap();
    assert!(AnswerMessage::from_bytes(&bomb).is_err());
    let deep = zstd::bulk::compress(&[0x81; 100_000], 1).unwrap();
    assert!(AnswerMessage::from_bytes(&deep).is_err());
}
