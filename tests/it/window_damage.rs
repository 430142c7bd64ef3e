//! Any damage to a stream of windows: nothing is silently accepted, nothing panics.

use std::collections::BTreeMap;
use std::sync::{Arc, LazyLock, Mutex};

use ihd_link::receiver::Receiver;
use ihd_link::{DeviceEvent, Window};
use ihd_shared::wire::frame::{MAX_ENCODED, encode_raw};
use ihd_tests::desk_hob::heating;
use proptest::prelude::*;

/// The frames a heating device sends in some half-cycles, undamaged.
static RECORDED: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| {
    let (_client, link) = heating();
    let frames = Arc::new(Mutex::new(Vec::new()));
    let kept = Arc::clone(&frames);
    link.hob().mangle = Box::new(move |frame| {
        kept.lock().unwrap().push(frame.to_vec());
        frame.to_vec()
    });
    // Nobody lets go of a window, which is kept for 20 half-cycles.
    link.hob().run(80);
    let mut frames = frames.lock().unwrap();
    std::mem::take(&mut *frames)
});

fn windows_of(stream: impl IntoIterator<Item = u8>) -> (BTreeMap<u32, Window>, Receiver) {
    let mut receiver = Receiver::default();
    for byte in stream {
        let _ = receiver.push(byte);
    }
    receiver.finish();
    let windows = receiver.events.iter().filter_map(|e| match e {
        DeviceEvent::Window(w) => Some((w.seq, (**w).clone())),
        _ => None,
    });
    (windows.collect(), receiver)
}

#[derive(Clone, Debug)]
enum Fate {
    Pass,
    Drop,
    Repeat,
    Flip(prop::sample::Index, u8),
    Cut(prop::sample::Index),
    Before(Vec<u8>),
}

fn fate() -> impl Strategy<Value = Fate> {
    let at = any::<prop::sample::Index>;
    prop_oneof![
        200 => Just(Fate::Pass),
        1 => Just(Fate::Drop),
        1 => Just(Fate::Repeat),
        1 => (at(), 0..8u8).prop_map(|(i, b)| Fate::Flip(i, b)),
        1 => at().prop_map(Fate::Cut),
        1 => prop::collection::vec(any::<u8>(), 0..50).prop_map(Fate::Before),
    ]
}

fn suffer(frame: &[u8], fate: &Fate) -> Vec<u8> {
    let mut bytes = frame.to_vec();
    match fate {
        Fate::Pass => {}
        Fate::Drop => bytes.clear(),
        Fate::Repeat => bytes.extend_from_slice(frame),
        Fate::Flip(at, bit) => bytes[at.index(frame.len())] ^= 1 << bit,
        Fate::Cut(at) => bytes.truncate(at.index(frame.len())),
        Fate::Before(garbage) => bytes.splice(0..0, garbage.iter().copied()).for_each(drop),
    }
    bytes
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// After any damage to frames, a window that is given out is the one that was recorded, and
    /// one that was seen at all is given out or rejected, once.
    #[test]
    fn no_damage_is_silently_accepted(
        fates in prop::collection::vec(fate(), 400),
    ) {
        let frames = &*RECORDED;
        let (truth, _) = windows_of(frames.concat());
        prop_assert!(truth.len() >= 3);
        let damaged: Vec<u8> = frames
            .iter()
            .zip(fates.iter().cycle())
            .flat_map(|(frame, fate)| suffer(frame, fate))
            .collect();
        let (windows, receiver) = windows_of(damaged);
        for (seq, window) in &windows {
            prop_assert_eq!(Some(window), truth.get(seq));
        }
        let counters = receiver.counters();
        prop_assert_eq!(counters.windows.received as usize, windows.len());
        let mut seqs: Vec<u32> = receiver.events.iter().map(|e| match e {
            DeviceEvent::Window(w) => w.seq,
            DeviceEvent::WindowRejected { seq, .. } => *seq,
            other => panic!("unexpected {other:?}"),
        }).collect();
        let ends = seqs.len();
        seqs.dedup();
        prop_assert_eq!(seqs.len(), ends, "a window ended twice");
        if fates.iter().all(|f| matches!(f, Fate::Pass | Fate::Before(_))) {
            prop_assert_eq!(windows, truth);
        }
    }

    /// Any window messages in any order: no panic, and nothing is a window without its CRC.
    #[test]
    fn messages_in_any_order_make_no_window(
        messages in prop::collection::vec((0x83..=0x86u8, prop::collection::vec(any::<u8>(), 0..40)), 0..40),
    ) {
        let mut stream = Vec::new();
        let mut out = [0; MAX_ENCODED];
        for (seq, (id, payload)) in messages.iter().enumerate() {
            let length = encode_raw(*id, seq as u16, payload, &mut out).unwrap();
            stream.extend_from_slice(&out[..length]);
        }
        prop_assert!(windows_of(stream).0.is_empty());
    }
}
