//! Devices that flood, stall and lie: no command and no wait outlasts its time, nothing grows without bound.

use ihd_shared::wire::messages::{
    AnyMessage, Raw, Telemetry, WindowChunk, WindowEnd, WindowGone, WindowStart,
};

use super::super::fake::{FakeDevice, FakeOutput, front_end};
use super::*;

/// Greets, and answers nothing else.
fn deaf(message: &AnyMessage<'_>, sent: &mut FakeOutput) {
    if let AnyMessage::Hello(_) = message {
        sent.greet();
    }
}

fn start(seq: u32, pairs: u16) -> WindowStart {
    WindowStart {
        seq,
        dropped: 0,
        half_cycle: seq,
        f_sw_hz: 45_000,
        half_cycle_ns: 10_000_000,
        first_pair_ns: 0,
        first_trajectory_ns: 0,
        pairs,
        trajectory: 0,
        saturated: 0,
        lookup_version: 0,
        v_full_scale_mv: 640_000,
        i_full_scale_ma: 80_000,
    }
}

fn telemetry(seq: u32) -> Telemetry {
    let (mut telemetry, _): (Telemetry, _) = postcard::take_from_bytes(&[0; 64]).unwrap();
    telemetry.seq = seq;
    telemetry
}

/// A whole window of zeros.
fn window(seq: u32, sent: &mut FakeOutput) {
    sent.message(&start(seq, 960));
    for offset in [0, 240, 480, 720] {
        let data = Raw(&[0; 960]);
        sent.message(&WindowChunk { seq, offset, data });
    }
    let crc32 = ihd_shared::wire::frame::CRC32.checksum(&[0; 3_840]);
    sent.message(&WindowEnd { seq, crc32 });
}

type Flood = Box<dyn FnMut(&mut FakeOutput) + Send>;

/// A [`Flood`] that counts its calls.
fn counted(mut flood: impl FnMut(u32, &mut FakeOutput) + Send + 'static) -> Flood {
    let mut calls = 0;
    Box::new(move |sent| {
        flood(calls, sent);
        calls += 1;
    })
}

/// Bytes that a hostile device sends whenever the host waits.
fn floods() -> Vec<(&'static str, Flood)> {
    vec![
        ("garbage", counted(|_, sent| sent.raw(&[0xA5; 16_384]))),
        ("zeros", counted(|_, sent| sent.raw(&[0; 16_384]))),
        ("a byte at a time", counted(|_, sent| sent.raw(&[1]))),
        (
            "answers to nothing",
            counted(|_, sent| {
                // Every number but that of a request that the host makes.
                for number in (0x1000..0x1100u16).map(u16::to_le_bytes) {
                    sent.number = Number::from_le_bytes(number);
                    sent.done();
                }
            }),
        ),
        (
            "what no request is answered with",
            counted(|_, sent| (0..100).for_each(|_| sent.message(&front_end()))),
        ),
        (
            "greetings",
            counted(|_, sent| (0..100).for_each(|_| sent.greet())),
        ),
        (
            "telemetry",
            counted(|call, sent| (0..300).for_each(|k| sent.message(&telemetry(300 * call + k)))),
        ),
        (
            "refusals of pieces",
            counted(|_, sent| {
                (0..200).for_each(|seq| sent.message(&WindowGone { seq }));
            }),
        ),
        (
            "windows that begin and never end",
            counted(|call, sent| {
                (0..100).for_each(|k| sent.message(&start(100 * call + k, 16_384)));
            }),
        ),
        (
            "one window, the same piece for ever",
            counted(|_, sent| {
                let (offset, data) = (9, Raw(&[7; 4]));
                sent.message(&start(7, 16_384));
                sent.message(&WindowChunk {
                    seq: 7,
                    offset,
                    data,
                });
            }),
        ),
        (
            "ends of windows that never began",
            counted(|seq, sent| sent.message(&WindowEnd { seq, crc32: 1 })),
        ),
        ("whole windows", counted(window)),
    ]
}

fn check_bounds(client: &Client, what: &str) {
    let receiver = &client.receiver;
    assert!(receiver.events.len() <= MAX_EVENTS, "{what}");
    // Those of one read.
    assert!(receiver.answers.len() <= 2_000, "{what}");
}

#[test]
fn no_wait_outlasts_its_time_whatever_comes() {
    let wait = Duration::from_millis(500);
    for (what, flood) in floods() {
        let mut client = Client::connect(Box::new(FakeDevice::new(deaf, flood))).unwrap();
        let began = client.clock();
        while client.clock() - began < Duration::from_secs(3) {
            let at = client.clock();
            client.next_event(wait).unwrap();
            // A last read may come at the end.
            assert!(client.clock() - at < 2 * wait, "{what}");
            check_bounds(&client, what);
        }
        // Takes what is there, and comes back.
        for _ in 0..3 {
            client.next_event(Duration::ZERO).unwrap();
            check_bounds(&client, what);
        }
    }
}

#[test]
fn no_command_outlasts_its_time_whatever_comes() {
    for (what, flood) in floods() {
        let mut client = Client::connect(Box::new(FakeDevice::new(deaf, flood))).unwrap();
        client.set_timeout(Duration::from_millis(500));
        for _ in 0..3 {
            let at = client.clock();
            let status = client.status();
            assert!(matches!(status, Err(LinkError::NoAnswer { .. })), "{what}");
            assert!(client.clock() - at < Duration::from_millis(1_000), "{what}");
            check_bounds(&client, what);
        }
    }
}

/// Events that nobody takes are counted, telemetry before windows.
#[test]
fn of_too_many_events_telemetry_goes_first_and_nothing_uncounted() {
    let flood = counted(|call, sent| {
        if call < 300 {
            sent.message(&telemetry(2 * call));
            sent.message(&telemetry(2 * call + 1));
            window(call, sent);
        }
    });
    let mut client = Client::connect(Box::new(FakeDevice::new(deaf, flood))).unwrap();
    client.set_timeout(Duration::from_secs(30));
    assert!(client.status().is_err());
    let counters = client.counters();
    assert_eq!(
        (counters.telemetry.received, counters.windows.received),
        (600, 300)
    );
    let mut windows = Vec::new();
    while let Some(event) = client.next_event(Duration::ZERO).unwrap() {
        match event {
            DeviceEvent::Window(window) => windows.push(window.seq),
            other => panic!("{other:?}"),
        }
    }
    let newest: Vec<u32> = (300 - MAX_EVENTS as u32..300).collect();
    assert_eq!(windows, newest);
    assert_eq!(counters.events_dropped as usize, 900 - MAX_EVENTS);
}

/// An answer that is lost costs a part of the time-out.
#[test]
fn what_may_come_twice_is_asked_again() {
    for lost in 0..4 {
        let mut asked = 0;
        let hard_of_hearing = move |message: &AnyMessage<'_>, sent: &mut FakeOutput| match message {
            AnyMessage::Hello(_) => sent.greet(),
            AnyMessage::SetPower(_) => {
                asked += 1;
                if asked > lost {
                    sent.done();
                }
            }
            _ => {}
        };
        let mut client =
            Client::connect(Box::new(FakeDevice::new(hard_of_hearing, |_| {}))).unwrap();
        let at = client.clock();
        let outcome = client.set_power(700);
        let took = client.clock() - at;
        assert!(took <= DEFAULT_TIMEOUT, "{took:?}");
        match lost {
            0..3 => assert!(outcome.is_ok(), "{lost}: {outcome:?}"),
            _ => assert!(matches!(outcome, Err(LinkError::NoAnswer { .. }))),
        }
        assert!(took >= DEFAULT_TIMEOUT / 3 * lost.min(3));
    }
}

/// Frames beyond a hob's rates are counted and nothing else, and answers among them arrive.
#[test]
fn of_a_flood_a_hobs_share_is_decoded() {
    let mut power_w = 0;
    let flood = counted(move |call, sent| {
        (0..100).for_each(|k| sent.message(&telemetry(100 * call + k)));
    });
    let answers = |message: &AnyMessage<'_>, sent: &mut FakeOutput| match message {
        AnyMessage::Hello(_) => sent.greet(),
        AnyMessage::SetPower(_) => sent.done(),
        _ => {}
    };
    let mut client = Client::connect(Box::new(FakeDevice::new(answers, flood))).unwrap();
    let before = client.counters().telemetry.received;
    client.limit_floods();
    let began = client.clock();
    while client.clock() - began < Duration::from_secs(3) {
        client.next_event(Duration::from_millis(100)).unwrap();
        client.set_power(power_w).unwrap();
        power_w = 1 - power_w;
    }
    let passed_s = (client.clock() - began).as_secs_f64();
    let counters = client.counters();
    let decoded = counters.telemetry.received - before;
    assert!(f64::from(decoded) <= 240.0 * (passed_s + 2.0), "{decoded}");
    assert!(f64::from(decoded) >= 239.0 * passed_s, "{decoded}");
    assert!(counters.frames_beyond > 1_000, "{counters:?}");
    assert_eq!((counters.frames_bad, counters.frames_lost), (0, 0));
}
