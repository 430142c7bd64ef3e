use super::*;
use ihd_shared::units::{MicroOhm, PicoHenry};
use std::boxed::Box;
use std::vec::Vec;

fn recorder() -> Box<Recorder> {
    Box::new(Recorder::new())
}

fn entry(k: i32) -> TrajectoryEntry {
    TrajectoryEntry {
        r: MicroOhm(k),
        l: PicoHenry(-k),
    }
}

#[test]
fn raw_pairs_are_taken_through_crossings_and_are_no_window() {
    let mut recorder = Box::new(Recorder::new());
    assert!(recorder.begin_raw() && !recorder.begin_raw());
    let pair = |v| Pair { v, i: 7 };
    recorder.push(&core::array::from_fn(|k| pair(k as i16)), 0..9, 0);
    recorder.end(10_000_000);
    recorder.push(&[pair(100); ADC_LOCK_P], 0..ADC_LOCK_P, 0);
    let mut raw = [0; 16];
    assert_eq!(recorder.read_pairs(ADC_LOCK_P as u16 - 1, &mut raw), 4);
    assert_eq!(raw[..4], pair(60).to_le_bytes());
    assert_eq!(raw[4..8], pair(100).to_le_bytes());
    assert_eq!(recorder.read_pairs(2 * ADC_LOCK_P as u16, &mut raw), 0);
    assert!(recorder.is_raw() && recorder.ready().is_none());
    // The bridge begins to switch, and a window is due.
    recorder.interrupt();
    assert!(!recorder.is_raw());
    recorder.begin(1, 45_000, 0, 0);
    assert!(!recorder.begin_raw());
    recorder.end_raw();
    recorder.push(&[pair(4); ADC_LOCK_P], 60..ADC_LOCK_P, 0);
    assert_eq!(recorder.read_pairs(0, &mut raw), 1);
    assert_eq!(recorder.counters().dropped, 0);
}

#[test]
fn a_half_cycle_goes_in_and_comes_out() {
    let mut r = recorder();
    r.begin(5, 45_000, -10_000, -164);
    let pairs: [Pair; ADC_LOCK_P] = core::array::from_fn(|k| Pair {
        v: k as i16,
        i: 2047,
    });
    r.push(&pairs, 9..ADC_LOCK_P, 61);
    for k in 0..4 {
        r.estimate(entry(k), 66_667, 2);
        r.advance(66_667);
        r.push(&pairs, 0..ADC_LOCK_P, 61);
    }
    // Centres: -10000 + 33333 - 133334 < 0 for two blocks, then 23.3 µs and 90 µs.
    r.end(200_000);
    assert!(r.ready().is_none(), "the trajectory's tail is missing");
    r.estimate(entry(4), 66_667, 2);
    r.advance(66_667);
    r.estimate(entry(5), 66_667, 2); // 223 µs: beyond the end
    let header = *r.ready().unwrap();
    assert_eq!((header.pairs, header.first_pair_ns), (52 + 4 * 61, -164));
    assert_eq!(header.saturated, header.pairs);
    assert_eq!((header.trajectory, header.first_trajectory_ns), (3, 23_333));
    let mut bytes = [0; 8];
    assert_eq!(r.read_pairs(0, &mut bytes), 2);
    assert_eq!(bytes, [9, 0, 255, 7, 10, 0, 255, 7]);
    assert_eq!(r.read_trajectory(2, &mut bytes), 1);
    assert_eq!(bytes[..4], 4i32.to_le_bytes());
    assert_eq!(r.read_trajectory(3, &mut bytes), 0);
}

/// A chunk that begins at a word is copied another way than one that does not.
#[test]
fn a_chunk_is_the_same_wherever_its_bytes_lie() {
    let mut r = recorder();
    r.begin(0, 45_000, 0, 0);
    let pairs: [Pair; ADC_LOCK_P] = core::array::from_fn(|k| Pair {
        v: k as i16 - 30,
        i: 2_047 - 3 * k as i16,
    });
    r.push(&pairs, 0..ADC_LOCK_P, 0);
    for k in 0..31 {
        r.estimate(entry(k), 60_000, 0);
    }
    r.end(1);
    let mut bytes = [0xAA; 4 * ADC_LOCK_P + 8];
    let at = bytes.as_ptr().align_offset(4);
    for (shift, offset) in [(0, 0), (1, 0), (0, 7), (3, 7), (2, 60), (0, 61)] {
        let out = &mut bytes[at + shift..][..4 * ADC_LOCK_P];
        out.fill(0xAA);
        let expected = pairs[usize::from(offset)..].iter();
        let expected: Vec<u8> = expected.flat_map(|pair| pair.to_le_bytes()).collect();
        assert_eq!(usize::from(r.read_pairs(offset, out)) * 4, expected.len());
        assert_eq!(out[..expected.len()], expected);
        assert!(out[expected.len()..].iter().all(|&byte| byte == 0xAA));
        let n = usize::from(r.read_trajectory(2, out));
        let expected: Vec<u8> = (2..2 + n as i32)
            .flat_map(|k| entry(k).to_le_bytes())
            .collect();
        assert_eq!((n, &out[..8 * n]), (29, &expected[..]));
    }
}

#[test]
fn a_busy_slot_counts_and_drops() {
    let mut r = recorder();
    r.begin(0, 45_000, 0, 0);
    r.end(1);
    r.interrupt();
    r.begin(1, 45_000, 0, 0);
    r.begin(2, 45_000, 0, 0);
    assert_eq!(
        r.counters(),
        WindowCounters {
            due: 3,
            recorded: 1,
            dropped: 2
        }
    );
    assert_eq!(r.ready().map(|h| h.seq), Some(0));
    r.release();
    r.begin(3, 45_000, 0, 0);
    r.end(1);
    r.interrupt();
    assert_eq!(
        r.ready().map(|h| h.seq),
        Some(3),
        "drops must show as a gap"
    );
}

#[test]
fn a_frequency_step_in_the_middle_drops_the_window() {
    let mut r = recorder();
    r.begin(0, 45_000, 0, 0);
    r.interrupt();
    assert_eq!(r.counters().dropped, 1);
    assert!(r.ready().is_none());
}

#[test]
fn an_endless_half_cycle_fills_up_and_stops() {
    let mut r = recorder();
    r.begin(0, 80_000, 0, 0);
    for _ in 0..400 {
        r.push(&[Pair::default(); ADC_LOCK_P], 0..ADC_LOCK_P, 0);
        r.estimate(entry(1), 37_500, 0);
        r.advance(37_500);
    }
    r.end(1);
    r.estimate(entry(1), 37_500, 0);
    let header = r.ready().unwrap();
    assert_eq!(usize::from(header.pairs), MAX_PAIRS);
    assert_eq!(usize::from(header.trajectory), MAX_TRAJECTORY);
}
