//! Windows over a damaged link: every one is delivered as it was recorded, or rejected with its
//! reason, or shows as a gap.

use std::collections::BTreeSet;
use std::f64::consts::TAU;
use std::time::Duration;

use ihd_firmware::control::request::PanelEvent;
use ihd_link::{Client, DeviceEvent, Window};
use ihd_shared::sampling::{
    ADC_LOCK_P, ADC_LOCK_Q, AMPERE_PER_CODE, CODE_MAX, Pair, VOLT_PER_CODE, f_adc_hz,
};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::window::MAX_PAIRS;
use ihd_shared::wire::frame::{Frame, MAX_ENCODED, decode, encode_numbered};
use ihd_shared::wire::hello::{ROLE_HOST, ours};
use ihd_shared::wire::messages::{
    AnyMessage, Configure, Message, Raw, SetPower, Stream, TrajectoryChunk, WindowChunk, WindowEnd,
    WindowStart,
};
use ihd_shared::wire::number::Number;
use ihd_shared::wire::timing::HOST_UNHEARD_MS;
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::transport::SharedHob;
use ihd_tests::desk_hob::{DeskHob, DeskLink, desk_hello, heating, heating_where};

/// Events of the client during the next half-cycles, all of them.
fn watch(client: &mut Client, half_cycles: u64) -> Vec<DeviceEvent> {
    let end = client.clock() + Duration::from_millis(10 * half_cycles);
    let mut events = Vec::new();
    loop {
        let left = end.saturating_sub(client.clock());
        match client.next_event(left).unwrap() {
            Some(event) => events.push(event),
            None if left.is_zero() => return events,
            None => {}
        }
    }
}

/// A frame's id, sequence number and payload.
fn unframed(frame: &[u8]) -> (u8, u16, Vec<u8>) {
    let mut stuffed = frame[1..frame.len() - 1].to_vec();
    let Frame { id, seq, payload } = decode(&mut stuffed).unwrap();
    (id, seq, payload.to_vec())
}

/// The frame of a message; a request's number is that of its frame.
fn framed(message: &impl Message, seq: u16) -> Vec<u8> {
    let mut out = [0; MAX_ENCODED];
    let number = Number::from_le_bytes(seq.to_le_bytes());
    let length = encode_numbered(message, number, seq, &mut out).unwrap();
    out[..length].to_vec()
}

#[test]
fn a_window_arrives_whole() {
    let (mut client, _link) = heating();
    let events = watch(&mut client, 6);
    let windows: Vec<&Window> = events
        .iter()
        .map(|e| match e {
            DeviceEvent::Window(w) => &**w,
            other => panic!("unexpected {other:?}"),
        })
        .collect();
    assert!(windows.len() >= 2, "{} windows", windows.len());
    for w in windows {
        assert!((w.f_mains_hz() - 50.0).abs() < 0.01, "{}", w.f_mains_hz());
        let expected = f_adc_hz(w.f_sw_hz) * 10e-3;
        assert!((w.pairs.len() as f64 - expected).abs() <= 61.0);
        assert!(w.pair_time_s(0).abs() <= 61.0 * w.dt_s());
        assert!((w.pair_time_s(w.pairs.len() - 1) - 10e-3).abs() < 61.0 * w.dt_s());
        let blocks = w.pairs.len() as f64 / 61.0;
        assert!(
            (w.trajectory.len() as f64 - blocks).abs() <= 2.0,
            "{}",
            w.trajectory.len()
        );
        assert!(
            w.trajectory_time_s(0) >= 0.0 && w.trajectory_time_s(w.trajectory.len() - 1) < 10e-3
        );
        // The load: 4.5 ohm · √(f/45 kHz) and 26 µH, in the middle of the half-cycle.
        let middle = w.trajectory[w.trajectory.len() / 2];
        let r = 4.5 * (f64::from(w.f_sw_hz) / 45e3).sqrt();
        assert!((middle.r.ohm() / r - 1.0).abs() < 0.02, "{:?}", middle.r);
        assert!((middle.l.henry() / 26e-6 - 1.0).abs() < 0.02);
        let crest = w.i_ampere().into_iter().fold(0.0, f64::max);
        let v_crest = w.v_volt().into_iter().fold(0.0, f64::max);
        assert!(crest > 10.0 && v_crest > 100.0 && v_crest < 400.0);
    }
    assert_eq!(client.counters().windows.missing, 0);
}

/// Treatment of one kind of frame.
type Damage = fn(frame: &[u8]) -> Vec<Vec<u8>>;

/// Applies `damage` to the `nth` frame with message `id` of one window; returns what became of it,
/// and checks that the next window is untouched. What is asked for again never comes.
fn reason_after(id: u8, nth: usize, damage: Damage) -> &'static str {
    let (mut client, link) = heating_where(false);
    watch(&mut client, 4);
    let before = client.counters();
    let mut count = 0;
    link.hob().mangle = Box::new(move |frame| {
        if unframed(frame).0 != id {
            return frame.to_vec();
        }
        count += 1;
        if count == nth + 1 {
            damage(frame).concat()
        } else {
            frame.to_vec()
        }
    });
    // The device keeps the window for 20 of them.
    let events = watch(&mut client, 30);
    let rejected: Vec<_> = events
        .iter()
        .filter_map(|e| match e {
            DeviceEvent::WindowRejected { seq, reason } => Some((*seq, reason.label())),
            _ => None,
        })
        .collect();
    let [(seq, label)] = rejected[..] else {
        panic!("one window must be rejected, once: {rejected:?}");
    };
    let accepted: Vec<u32> = events
        .iter()
        .filter_map(|e| match e {
            DeviceEvent::Window(w) => Some(w.seq),
            _ => None,
        })
        .collect();
    assert!(!accepted.contains(&seq), "{label}: rejected and accepted");
    assert!(accepted.len() >= 2, "{label}: {accepted:?}");
    let counters = client.counters();
    assert_eq!(counters.windows_rejected.get(label), Some(&1));
    assert_eq!(
        counters.windows.received - before.windows.received,
        accepted.len() as u32
    );
    label
}

fn dropped(_: &[u8]) -> Vec<Vec<u8>> {
    Vec::new()
}

fn bit_flipped(frame: &[u8]) -> Vec<Vec<u8>> {
    let mut frame = frame.to_vec();
    let middle = frame.len() / 2;
    frame[middle] ^= 0x10;
    vec![frame]
}

fn truncated(frame: &[u8]) -> Vec<Vec<u8>> {
    vec![frame[..frame.len() / 2].to_vec()]
}

#[test]
fn frames_lost_cut_or_flipped_for_good_reject_the_window_with_the_reason() {
    for damage in [dropped, bit_flipped, truncated] {
        assert_eq!(reason_after(WindowStart::ID, 0, damage), "no start");
        assert_eq!(reason_after(WindowChunk::ID, 0, damage), "missing chunk");
        assert_eq!(reason_after(WindowChunk::ID, 7, damage), "missing chunk");
        assert_eq!(
            reason_after(TrajectoryChunk::ID, 0, damage),
            "missing chunk"
        );
        assert_eq!(reason_after(WindowEnd::ID, 0, damage), "no end");
    }
}

/// A frame is lost the first time it comes.
fn lost_once(of: u8, damage: Damage) -> impl FnMut(&[u8]) -> Vec<u8> {
    let (mut seen, mut damaged) = (0, BTreeSet::new());
    move |frame: &[u8]| {
        let (id, _, payload) = unframed(frame);
        // Window and offset, or window alone.
        let key = (id, payload[..payload.len().min(4)].to_vec());
        seen += 1;
        if id == of && seen % 3 == 0 && damaged.insert(key) {
            return damage(frame).concat();
        }
        frame.to_vec()
    }
}

#[test]
fn what_is_lost_is_asked_for_again_and_costs_no_window() {
    let window_ids = [
        WindowStart::ID,
        WindowChunk::ID,
        TrajectoryChunk::ID,
        WindowEnd::ID,
    ];
    for damage in [dropped, bit_flipped, truncated] {
        for id in window_ids {
            let (mut client, link) = heating();
            link.hob().mangle = Box::new(lost_once(id, damage));
            let events = watch(&mut client, 80);
            assert!(
                events.iter().all(|e| matches!(e, DeviceEvent::Window(_))),
                "{id:#04x}: {:?}",
                client.counters()
            );
            let counters = client.counters();
            assert!(counters.windows.received >= 5, "{id:#04x}: {counters:?}");
            assert!(counters.pieces_asked > 0, "{id:#04x}: {counters:?}");
            // What is asked for is what was lost, and at the most as much again.
            let lost = counters.frames_bad + counters.frames_lost;
            assert!(counters.pieces_asked <= 2 * lost.max(4), "{counters:?}");
        }
    }
}

#[test]
fn a_window_of_which_nothing_but_its_end_came_is_asked_for() {
    let (mut client, link) = heating();
    let (mut ended, mut seen) = (false, 0);
    link.hob().mangle = Box::new(move |frame| {
        let id = unframed(frame).0;
        if !ended && (WindowStart::ID..WindowEnd::ID).contains(&id) {
            seen += 1;
            return Vec::new();
        }
        ended |= id == WindowEnd::ID && seen > 0;
        frame.to_vec()
    });
    let events = watch(&mut client, 30);
    assert!(events.len() >= 5, "{}", events.len());
    assert!(events.iter().all(|e| matches!(e, DeviceEvent::Window(_))));
    let counters = client.counters();
    assert_eq!(counters.windows_rejected_total(), 0);
    assert!(counters.pieces_asked > 10, "{counters:?}");
}

/// Chunks that come twice, or in another order, give the same window as those that come once and in order.
#[test]
fn repetition_and_order_cost_nothing() {
    for sends_again in [true, false] {
        for disorder in [repeated_all(), swapped(), repeated_late()] {
            let (mut client, link) = heating_where(sends_again);
            link.hob().mangle = disorder;
            let events = watch(&mut client, 20);
            assert!(events.iter().all(|e| matches!(e, DeviceEvent::Window(_))));
            assert!(events.len() >= 6, "{}", events.len());
            let counters = client.counters();
            assert_eq!(counters.windows_rejected_total(), 0);
        }
    }
}

type Disorder = Box<dyn FnMut(&[u8]) -> Vec<u8> + Send>;

fn repeated_all() -> Disorder {
    Box::new(|frame| frame.repeat(2))
}

/// Each window frame comes again behind the two that follow it.
fn repeated_late() -> Disorder {
    let mut last = std::collections::VecDeque::new();
    Box::new(move |frame| {
        let mut bytes = frame.to_vec();
        if unframed(frame).0 >= WindowStart::ID {
            last.push_back(frame.to_vec());
            if last.len() > 2 {
                bytes.extend(last.pop_front().unwrap());
            }
        }
        bytes
    })
}

/// Each second window frame comes behind the one that follows it; nothing follows the last.
fn swapped() -> Disorder {
    let mut held: Option<Vec<u8>> = None;
    Box::new(move |frame| {
        if !(WindowStart::ID..=WindowEnd::ID).contains(&unframed(frame).0) {
            return frame.to_vec();
        }
        match held.take() {
            Some(held) => [frame.to_vec(), held].concat(),
            None if unframed(frame).0 == WindowEnd::ID => frame.to_vec(),
            None => {
                held = Some(frame.to_vec());
                Vec::new()
            }
        }
    })
}

/// Each keeps the recorder for 20 half-cycles, in place of the one that is due every second.
#[test]
fn windows_that_nobody_lets_go_of_are_kept_for_a_while() {
    let link = DeskLink::new(DeskHob::new(desk_hello()));
    link.hob()
        .offer(&framed(&ours(ROLE_HOST, 0, 1, "test", "host"), 0));
    link.hob().offer(&framed(&SetPower { power_w: 1_000 }, 1));
    link.hob().run(60);
    let stream = Stream {
        telemetry_every: 0,
        windows_every: 2,
    };
    link.hob().offer(&framed(&stream, 2));
    link.hob().run(40);
    let recorded = link.hob().sampling_path().recorder().counters().recorded;
    assert!((1..=3).contains(&recorded), "{recorded}");
}

#[test]
fn windows_that_are_asked_for_keep_no_power_on() {
    let (mut client, _link) = heating();
    // Windows are let go of all the while, and nothing is commanded.
    let events = watch(&mut client, u64::from(HOST_UNHEARD_MS / 10) + 10);
    assert!(events.len() > 100);
    assert_eq!(client.status().unwrap().asked_w, 0);
}

/// Changes a decoded message and frames it again with a matching CRC.
fn forged(frame: &[u8], change: impl FnOnce(AnyMessage<'_>, u16) -> Vec<u8>) -> Vec<Vec<u8>> {
    let (id, seq, payload) = unframed(frame);
    vec![change(AnyMessage::decode(id, &payload).unwrap(), seq)]
}

fn forged_start(frame: &[u8], change: fn(&mut WindowStart)) -> Vec<Vec<u8>> {
    forged(frame, |message, seq| {
        let AnyMessage::WindowStart(mut start) = message else {
            panic!("not a start");
        };
        change(&mut start);
        framed(&start, seq)
    })
}

fn forged_chunk(frame: &[u8], change: fn(&mut Vec<u8>, &mut u16)) -> Vec<Vec<u8>> {
    forged(frame, |message, seq| {
        let AnyMessage::WindowChunk(chunk) = message else {
            panic!("not a chunk");
        };
        let (mut data, mut offset) = (chunk.data.0.to_vec(), chunk.offset);
        change(&mut data, &mut offset);
        let chunk = WindowChunk {
            offset,
            data: Raw(&data),
            ..chunk
        };
        framed(&chunk, seq)
    })
}

#[test]
fn what_a_frame_crc_cannot_see_the_window_does() {
    let at_start = |change: Damage| reason_after(WindowStart::ID, 0, change);
    let at_chunk = |nth, change: Damage| reason_after(WindowChunk::ID, nth, change);
    assert_eq!(
        at_start(|f| forged_start(f, |s| s.pairs = MAX_PAIRS as u16 + 1)),
        "too large"
    );
    assert_eq!(
        at_start(|f| forged_start(f, |s| s.trajectory = 273)),
        "too large"
    );
    assert_eq!(at_start(|f| forged_start(f, |s| s.pairs = 0)), "empty");
    assert_eq!(at_start(|f| forged_start(f, |s| s.f_sw_hz = 0)), "empty");
    assert_eq!(
        at_start(|f| forged_start(f, |s| s.half_cycle_ns = 0)),
        "empty"
    );
    assert_eq!(
        at_start(|f| forged_start(f, |s| s.pairs = 100)),
        "chunk beyond end"
    );
    assert_eq!(
        at_start(|f| forged_start(f, |s| s.saturated = s.pairs / 500)),
        "saturated"
    );
    assert_eq!(at_chunk(2, |f| forged_chunk(f, |d, _| d[5] ^= 1)), "crc");
    assert_eq!(
        at_chunk(2, |f| forged_chunk(f, |d, _| d.truncate(5))),
        "ragged chunk"
    );
    assert_eq!(
        at_chunk(2, |f| forged_chunk(f, |d, _| d.clear())),
        "ragged chunk"
    );
    assert_eq!(
        at_chunk(2, |f| forged_chunk(f, |_, offset| *offset -= 1)),
        "repeated chunk"
    );
}

/// A replay, because a bridge that switches answers a sample at the end of the range with another
/// frequency, which no window outlives.
#[test]
fn saturated_pairs_reject_the_window() {
    let link = DeskLink::new(DeskHob::new(desk_hello()));
    let mut client = Client::connect(Box::new(link)).unwrap();
    client.stream(0, 1).unwrap();
    let (r, l) = (MicroOhm(4_000_000), PicoHenry(25_000_000));
    let mut replay = client.start_replay(45_000, r, l).unwrap();
    // 20 A through that load, in phase with the block; |Z| = 8.12 ohm at a phase of 60.5°.
    let wave = |amplitude: f64, n: usize, lead: f64| {
        let turns = n as f64 * f64::from(ADC_LOCK_Q) / ADC_LOCK_P as f64;
        (amplitude * (TAU * turns + lead).cos()).round() as i16
    };
    // 150 blocks are a half-cycle, of which 0.4 % of the pairs are clipped; the second run ends the first.
    for block in 0..310 {
        let mut pairs: [Pair; ADC_LOCK_P] = std::array::from_fn(|n| Pair {
            v: wave(8.12 * 20.0 / VOLT_PER_CODE, n, 1.056) + (block & 1) as i16,
            i: wave(20.0 / AMPERE_PER_CODE, n, 0.0),
        });
        if block % 4 == 0 {
            pairs[0].v = CODE_MAX;
        }
        let crossing = (block % 150 == 0).then_some(0);
        replay.blocks(&pairs, crossing, 3_000).unwrap();
    }
    let mut rejected = 0;
    while let Some(event) = replay.client().next_event(Duration::ZERO).unwrap() {
        let DeviceEvent::WindowRejected { reason, .. } = event else {
            panic!("unexpected {event:?}");
        };
        assert_eq!(reason.label(), "saturated");
        assert!(reason.to_string().contains("end of the ADC's range"));
        rejected += 1;
    }
    assert!(rejected > 0);
    assert!(replay.client().status().unwrap().saturated_pairs > 0);
}

#[test]
fn what_a_slow_link_makes_the_device_drop_is_counted_on_both_ends() {
    let (mut client, link) = heating();
    link.hob().bytes_per_block = 100;
    client.stream(0, 1).unwrap();
    let events = watch(&mut client, 40);
    assert!(events.iter().all(|e| matches!(e, DeviceEvent::Window(_))));
    link.hob().bytes_per_block = usize::MAX;
    client.stream(0, 0).unwrap();
    watch(&mut client, 2);
    let (counters, status) = (client.counters(), client.status().unwrap());
    assert!(counters.windows.missing > 5, "{counters:?}");
    let seen = counters.windows.received + counters.windows.missing;
    let known = status.windows_recorded + status.windows_dropped;
    // Those dropped after the last one sent show with the next.
    assert!(seen <= known && known - seen <= 3, "{seen} of {known}");
    assert_eq!(counters.windows_rejected_total(), 0);
}

/// Bursts come in whole seconds, and windows in whole fifths of one: each burst shows a window, whatever half-cycle it began in.
#[test]
fn each_burst_of_a_low_level_shows_a_window() {
    assert_each_burst_shows_a_window(10);
}

#[test]
fn each_burst_of_a_low_level_shows_a_window_all_variants() {
    assert_each_burst_shows_a_window(1);
}

/// Tests every so many half-cycles of the time between two windows.
fn assert_each_burst_shows_a_window(every: usize) {
    const BURSTS: usize = 2;
    for delay in (0..20).step_by(every) {
        let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
        let mut client = Client::connect(Box::new(hob.clone())).unwrap();
        client.stream(0, 20).unwrap();
        watch(&mut client, 20 + delay);
        hob.lock().panel(PanelEvent::Level(1));
        // The pot is found, and the first burst's frequency.
        watch(&mut client, 300);
        let events = watch(&mut client, 100 * BURSTS as u64);
        let windows = events
            .iter()
            .filter(|e| matches!(e, DeviceEvent::Window(_)));
        assert_eq!(
            windows.count(),
            BURSTS,
            "switched on {delay} half-cycles later"
        );
    }
}

/// The frequency alternates about the power's, but not within a window and just before it.
#[test]
fn dithering_cuts_no_window() {
    let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
    let mut client = Client::connect(Box::new(hob)).unwrap();
    let dither_permille = *Configure::DITHER_PERMILLE.end();
    client
        .configure(&Configure {
            dither_permille,
            ..Configure::DEFAULT
        })
        .unwrap();
    client.stream(1, 20).unwrap();
    client.set_power(1_500).unwrap();
    watch(&mut client, 100);
    let events = watch(&mut client, 200);
    let windows = events
        .iter()
        .filter(|e| matches!(e, DeviceEvent::Window(_)));
    let frequencies: BTreeSet<_> = events
        .iter()
        .filter_map(|e| match e {
            DeviceEvent::Telemetry(t) => Some(t.f_sw_hz),
            _ => None,
        })
        .collect();
    assert!(frequencies.len() >= 3, "{frequencies:?}");
    assert_eq!(windows.count(), 10);
    assert_eq!(client.status().unwrap().windows_dropped, 0);
}
