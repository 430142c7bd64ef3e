//! Replay in the loop: the same answer over every link, at every speed, and no difference unseen.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use ihd_firmware::link::response::front_end;
use ihd_link::{Client, DeviceEvent as LinkEvent, LinkError, Transport};
use ihd_shared::fault::Fault;
use ihd_shared::sampling::{ADC_LOCK_P, Pair};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::frame::{MAX_ENCODED, decode, encode, encode_numbered};
use ihd_shared::wire::hello::CAP_REPLAYING;
use ihd_shared::wire::messages::{
    AnyMessage, FrontEnd, Message, Outcome as Answer, Raw, ReplayEstimates, State, Telemetry,
    WindowEnd,
};
use ihd_shared::wire::timing::HOST_UNHEARD_MS;
use ihd_signal::Segment;
use ihd_sim::hob::{HobConfig, PanelEvent, SimHob};
use ihd_sim::injection::{Injection, InjectionKind};
use ihd_sim::recording::run::record;
use ihd_sim::recording::sensing::Rate;
use ihd_sim::recording::settings;
use ihd_sim::recording::settings::{LoadKind, RecordingChange, RecordingEvent};
use ihd_sim::transport::SharedHob;
use ihd_survey::{Hints, Survey};
use ihd_tests::desk_hob::{DeskHob, DeskLink, desk_hello};
use ihd_train::replay::{ReplayOptions, ReplayReport, run};

/// 25 ms with a frequency step, sampled by an oscilloscope.
fn segments() -> Vec<Segment> {
    let mut settings = settings::CaptureSpec {
        load: LoadKind::Behavioural,
        duration_s: 25e-3,
        events: vec![RecordingEvent {
            t_s: 12e-3,
            change: RecordingChange::Frequency(52e3),
        }],
        ..settings::CaptureSpec::default()
    };
    settings.sensing.rate = Rate::Hz(10e6);
    let recording = record(&settings, |_| ()).unwrap();
    let capture = recording.capture("a test");
    let survey = Survey::from_capture(&capture, &Hints::default()).unwrap();
    survey.segments(&capture)
}

/// Replays on whatever `connect` reaches.
fn replayed(
    settings: ReplayOptions,
    connect: &mut dyn FnMut() -> Result<Client, LinkError>,
) -> ReplayReport {
    let outcome = run(&segments(), settings, connect, &mut |_, _| ()).unwrap();
    ReplayReport {
        seconds: 0.0,
        ..outcome
    }
}

/// A client that does not wait long for what a bad link has lost.
fn client(transport: impl Transport + 'static) -> Result<Client, LinkError> {
    let mut client = Client::connect(Box::new(transport))?;
    client.set_timeout(Duration::from_millis(30));
    Ok(client)
}

const QUICK: ReplayOptions = ReplayOptions {
    speed: None,
    patience: Some(Duration::from_millis(30)),
};

#[test]
fn a_device_of_this_build_gives_the_same_bits_windows_and_states() {
    let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
    let outcome = replayed(ReplayOptions::default(), &mut || client(hob.clone()));
    assert!(outcome.is_identical(), "{:?}", outcome.first);
    assert_eq!(outcome.stretches, 2);
    // 25 ms at three periods a block.
    assert!((370..410).contains(&outcome.blocks), "{}", outcome.blocks);
    assert_eq!(outcome.estimates, outcome.blocks);
    // Crossings at 10 and 20 ms (and at 0): a window each that the one slot was free for.
    assert!(
        outcome.windows.compared >= 1 && outcome.windows.lost == 0,
        "{outcome:?}"
    );
    assert!(
        outcome.telemetry.compared >= 2 && outcome.telemetry.lost == 0,
        "{outcome:?}"
    );
    assert_eq!((outcome.repeats, outcome.reconnects), (0, 0));
}

/// A frequency below the hob's, a stretch of half a block, and a coil voltage of twice the front end's range.
#[test]
fn what_is_not_replayed_as_it_is_is_counted() {
    let whole = segments();
    let slow = Segment {
        f_sw_hz: 30e3,
        ..whole[0].clone()
    };
    let part = |of: &Segment, samples: usize| Segment {
        v_v: of.v_v.iter().take(samples).copied().collect(),
        i_a: of.i_a.iter().take(samples).copied().collect(),
        ..of.clone()
    };
    let beyond = Segment {
        v_v: whole[0].v_v.iter().map(|v| 100.0 * v).collect(),
        ..whole[0].clone()
    };
    let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
    let mut connect = || client(hob.clone());
    let short = part(&whole[0], 300);
    // 4 ms from 2 ms on: no crossing of the mains in it.
    let quiet = Segment {
        t0_s: whole[0].t0_s + 2e-3,
        ..part(&whole[0], 40_000)
    };
    let given = [slow.clone(), short, quiet];
    let outcome = run(
        &given,
        ReplayOptions::default(),
        &mut connect,
        &mut |_, _| (),
    )
    .unwrap();
    let omitted = outcome.omitted;
    assert_eq!((omitted.out_of_range, omitted.short), (1, 1));
    assert_eq!(omitted.samples, slow.v_v.len() + 300);
    assert_eq!((outcome.stretches, outcome.saturated), (1, 0));
    assert!(outcome.is_identical() && outcome.is_without_half_cycles());
    let outcome = run(&[beyond], QUICK, &mut connect, &mut |_, _| ()).unwrap();
    assert!(outcome.saturated > 1000, "{}", outcome.saturated);
}

#[test]
fn speed_does_not_change_the_answer() {
    let hob = || SharedHob::new(SimHob::new(&HobConfig::default()));
    let fastest = hob();
    let fastest = replayed(ReplayOptions::default(), &mut || client(fastest.clone()));
    for speed in [0.2, 5.0] {
        let paced = hob();
        let settings = ReplayOptions {
            speed: Some(speed),
            ..ReplayOptions::default()
        };
        assert_eq!(replayed(settings, &mut || client(paced.clone())), fastest);
    }
}

/// The same codes are other volts there: what it makes of them cannot be compared.
#[test]
fn a_device_of_other_scales_is_not_compared() {
    let mut connect = || {
        let link = DeskLink::new(DeskHob::new(desk_hello()));
        link.hob().mangle = Box::new(|sent: &[u8]| {
            let mut stuffed = sent.to_vec();
            let end = stuffed.len() - 1;
            let frame = decode(&mut stuffed[1..end]).unwrap();
            if frame.id != FrontEnd::ID {
                return sent.to_vec();
            }
            let other = FrontEnd {
                v_full_scale_mv: 500_000,
                ..front_end()
            };
            let mut out = [0; MAX_ENCODED];
            let (number, _) = frame.split();
            let length = encode_numbered(&other, number, frame.seq, &mut out).unwrap();
            out[..length].to_vec()
        });
        client(link)
    };
    let error = run(&segments(), QUICK, &mut connect, &mut |_, _| ()).unwrap_err();
    let text = error.to_string();
    assert!(text.contains("±500.0 V, ±80.1 A, this build's"), "{text}");
}

/// A small generator, so that each seed damages in its own way.
struct Dice(u32);

impl Dice {
    fn roll(&mut self, sides: u32) -> u32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 16) % sides
    }

    /// Fate of a frame: lost, doubled, cut, or with one bit inverted.
    fn damage(&mut self, frame: &[u8]) -> Vec<u8> {
        let at = self.roll(frame.len() as u32) as usize;
        match self.roll(40) {
            0 => Vec::new(),
            1 => [frame, frame].concat(),
            2 => frame[..at].to_vec(),
            3 => {
                let mut flipped = frame.to_vec();
                flipped[at] ^= 1 << self.roll(8);
                flipped
            }
            _ => frame.to_vec(),
        }
    }
}

/// A link whose host's frames suffer, too.
struct Damaging {
    inner: DeskLink,
    dice: Arc<Mutex<Option<Dice>>>,
}

impl Transport for Damaging {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        match &mut *self.dice.lock().unwrap() {
            Some(dice) => self.inner.send(&dice.damage(bytes)),
            None => self.inner.send(bytes),
        }
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        self.inner.receive(buf, timeout)
    }

    fn describe(&self) -> String {
        "damaging".to_owned()
    }

    fn clock(&self) -> Duration {
        self.inner.clock()
    }
}

#[test]
fn a_link_that_drops_repeats_and_cuts_never_changes_the_result() {
    let mut repeats = 0;
    for seed in 1..=12 {
        let mut connect = || {
            let inner = DeskLink::new(DeskHob::new(desk_hello()));
            let dice = Arc::new(Mutex::new(None));
            let link = Damaging {
                inner: inner.clone(),
                dice: Arc::clone(&dice),
            };
            let client = client(link)?;
            // The handshake has no second try; everything after it has.
            let mut back = Dice(seed);
            let mangle = move |frame: &[u8]| back.damage(frame);
            inner.hob().mangle = Box::new(mangle);
            *dice.lock().unwrap() = Some(Dice(seed + 1_000));
            Ok(client)
        };
        let outcome = run(&segments(), QUICK, &mut connect, &mut |_, _| ());
        let outcome = outcome.unwrap_or_else(|why| panic!("seed {seed}: {why}"));
        assert!(outcome.is_identical(), "seed {seed}: {:?}", outcome.first);
        assert_eq!(outcome.estimates, outcome.blocks, "seed {seed}");
        repeats += outcome.repeats;
    }
    assert!(repeats > 50, "{repeats}: the link was not bad enough");
}

/// A link that ends after so many of the host's frames.
struct Ending {
    inner: DeskLink,
    left: u32,
}

impl Transport for Ending {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        if self.left == 0 {
            return Err(self.closed());
        }
        self.left -= 1;
        self.inner.send(bytes)
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        if self.left == 0 {
            // The device took the last frame, and its answer is lost.
            let _ = self.inner.receive(buf, Duration::ZERO);
            return Err(self.closed());
        }
        self.inner.receive(buf, timeout)
    }

    fn describe(&self) -> String {
        "ending".to_owned()
    }

    fn clock(&self) -> Duration {
        self.inner.clock()
    }
}

impl Ending {
    fn closed(&self) -> LinkError {
        LinkError::Closed {
            device: self.describe(),
        }
    }
}

#[test]
fn a_link_that_ends_is_made_anew_and_the_replay_goes_on_where_it_was() {
    let desk = DeskLink::new(DeskHob::new(desk_hello()));
    let mut lives = vec![1_000_000, 30, 41, 20];
    let outcome = replayed(QUICK, &mut || {
        client(Ending {
            inner: desk.clone(),
            left: lives.pop().unwrap(),
        })
    });
    assert_eq!(outcome.reconnects, 3);
    assert!(outcome.is_identical(), "{:?}", outcome.first);
    assert_eq!(outcome.estimates, outcome.blocks);
}

#[test]
fn one_bit_of_one_estimate_is_seen_and_reported() {
    let desk = DeskLink::new(DeskHob::new(desk_hello()));
    // The estimates' frames, made anew with one micro-ohm more in one of them.
    let mut deframer = Deframer::new();
    let mut seen = 0;
    desk.hob().mangle = Box::new(move |frame| {
        for &byte in frame {
            let Some(Ok(whole)) = deframer.push(byte) else {
                continue;
            };
            let (number, message) = whole.split();
            let (seq, payload) = (whole.seq, message.to_vec());
            if let Ok(AnyMessage::ReplayEstimates(m)) = AnyMessage::decode(whole.id, &payload) {
                seen += 1;
                if seen == 30 {
                    let mut data = m.data.0.to_vec();
                    data[8] ^= 1;
                    let changed = ReplayEstimates {
                        first: m.first,
                        data: Raw(&data),
                    };
                    let mut out = [0; MAX_ENCODED];
                    let length = encode_numbered(&changed, number, seq, &mut out).unwrap();
                    return out[..length].to_vec();
                }
            }
        }
        frame.to_vec()
    });
    let outcome = replayed(QUICK, &mut || client(desk.clone()));
    assert_eq!(outcome.differences, 1);
    let difference = &outcome.first[0];
    assert_eq!(difference.what, "R, µΩ");
    let numbers: Vec<i64> = [&difference.device, &difference.host]
        .map(|text| text.parse().unwrap())
        .to_vec();
    assert_eq!((numbers[0] - numbers[1]).abs(), 1);
    // The second block of the thirtieth message: block 117 of 66.7 µs.
    assert!(
        (difference.t_s - 117.0 * 3.0 / 45e3).abs() < 1e-4,
        "{difference:?}"
    );
}

/// Telemetry withheld by a device whose link loses nothing: frames count, and none is missing.
#[test]
fn what_a_device_does_not_send_over_a_sound_link_is_a_difference() {
    let desk = DeskLink::new(DeskHob::new(desk_hello()));
    let mut deframer = Deframer::new();
    desk.hob().mangle = Box::new(move |frame| {
        for &byte in frame {
            if let Some(Ok(whole)) = deframer.push(byte)
                && whole.id == Telemetry::ID
            {
                // Another message of the same number, which means nothing to a replay.
                let mut out = [0; MAX_ENCODED];
                let nothing = WindowEnd { seq: 7, crc32: 0 };
                let length = encode(&nothing, whole.seq, &mut out).unwrap();
                return out[..length].to_vec();
            }
        }
        frame.to_vec()
    });
    let outcome = replayed(QUICK, &mut || client(desk.clone()));
    assert!(
        outcome.telemetry.lost > 0 && !outcome.is_identical(),
        "{outcome:?}"
    );
    assert_eq!(outcome.first[0].what, "windows and telemetry");
}

#[test]
fn replay_mode_locks_the_power_outputs_and_says_so() {
    let desk = DeskLink::new(DeskHob::new(desk_hello()));
    let mut first = client(desk.clone()).unwrap();
    first.set_power(1_000).unwrap();
    desk.hob().run(60);
    assert_eq!(first.status().unwrap().state, State::Heating);
    let (r, l) = (MicroOhm(4_000_000), PicoHenry(25_000_000));
    let refused = first.start_replay(45_000, r, l).err().expect("it heats");
    assert!(refused.to_string().contains("switch it off"), "{refused}");
    assert_eq!(first.status().unwrap().state, State::Heating);
    // The bridge opens at the next zero crossing, for which the host waits.
    first.set_power(0).unwrap();
    let mut replay = first.start_replay(45_000, r, l).unwrap();
    let status = replay.client().status().unwrap();
    assert_eq!((status.state, status.f_sw_hz), (State::Idle, 0));
    let refused = replay.client().set_power(1_000).unwrap_err();
    assert!(
        matches!(
            refused,
            LinkError::Refused {
                outcome: Answer::FaultActive,
                detail: 0,
                ..
            }
        ),
        "{refused}"
    );
    assert!(refused.to_string().contains("replay mode"), "{refused}");
    // Whoever comes next sees it in the hello.
    let mut second = client(desk.clone()).unwrap();
    assert!(second.hello().capabilities & CAP_REPLAYING != 0);
    assert!(second.set_power(1_000).is_err());
    second.continue_replay(0).end().unwrap();
    second.set_power(1_000).unwrap();
}

/// Lets a hob's simulated time pass.
fn pass(hob: &SharedHob, duration_s: f64) {
    let mut hob = hob.lock();
    let until_s = hob.t_s() + duration_s;
    while hob.t_s() < until_s {
        hob.step();
    }
}

/// Each entry and each end cuts a half-cycle, at any place of it.
#[test]
fn replays_one_after_the_other_do_not_look_like_a_broken_mains() {
    let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
    let mut client = client(hob.clone()).unwrap();
    pass(&hob, 0.1);
    for k in 0..20 {
        let (r, l) = (MicroOhm(4_000_000), PicoHenry(25_000_000));
        let replay = client.start_replay(45_000, r, l).unwrap();
        pass(&hob, 0.009);
        replay.end().unwrap();
        pass(&hob, 0.004 + 0.001 * f64::from(k % 9));
        assert_eq!(client.status().unwrap().fault, Fault::NONE, "replay {k}");
    }
}

/// A host that ends a replay all the time, where none is, keeps no check from acting: that of the mains takes several half-cycles.
#[test]
fn the_end_of_no_replay_forgets_nothing() {
    let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
    let mut client = client(hob.clone()).unwrap();
    client.set_power(1_000).unwrap();
    pass(&hob, 1.0);
    assert_eq!(client.status().unwrap().state, State::Heating);
    let kind = InjectionKind::LostCrossings;
    hob.lock().inject(|injections| {
        injections.start(Injection {
            kind,
            value: 2.0,
            channel: kind.default_channel(),
        });
    });
    let trips = (0..100).any(|_| {
        pass(&hob, 0.01);
        client.continue_replay(0).end().unwrap();
        hob.lock().panel(PanelEvent::KeyLock(false));
        client.status().unwrap().fault != Fault::NONE
    });
    assert!(trips);
}

/// Nobody ends the replay of a host that is gone: a touch of the panel does, and so do ten seconds of silence.
#[test]
fn the_replay_of_a_host_that_is_gone_ends() {
    let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
    let start = |hob: &SharedHob| {
        let mut client = client(hob.clone()).unwrap();
        pass(hob, 0.1);
        let (r, l) = (MicroOhm(4_000_000), PicoHenry(25_000_000));
        client.start_replay(45_000, r, l).unwrap();
    };
    start(&hob);
    hob.lock().panel(PanelEvent::Level(6));
    pass(&hob, 1.0);
    let state = |hob: &SharedHob| hob.lock().housekeeping().control().state();
    assert_eq!(state(&hob), State::Heating, "a person does not wait");
    hob.lock().panel(PanelEvent::Level(0));
    start(&hob);
    pass(&hob, f64::from(HOST_UNHEARD_MS) / 1e3 + 0.1);
    assert_eq!(client(hob).unwrap().hello().capabilities & CAP_REPLAYING, 0);
}

/// Without mains no half-cycle ends, and the host's time runs on: with the mains back nothing heats for a host that is gone.
#[test]
fn a_host_that_falls_silent_while_the_mains_is_away_is_gone() {
    let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
    let mut host = client(hob.clone()).unwrap();
    host.set_power(1_500).unwrap();
    pass(&hob, 1.0);
    assert_eq!(host.status().unwrap().state, State::Heating);
    hob.lock().set_mains(0.0, 50.0);
    pass(&hob, 0.5);
    assert_eq!(host.status().unwrap().delivered_mw, 0);
    pass(&hob, f64::from(HOST_UNHEARD_MS) / 1e3);
    hob.lock().set_mains(230.0, 50.0);
    pass(&hob, 1.0);
    let status = host.status().unwrap();
    assert_eq!((status.state, status.asked_w), (State::Idle, 0));
}

#[test]
fn a_fault_tells_the_half_cycle_in_which_it_tripped() {
    let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
    let mut client = client(hob).unwrap();
    let mut replay = client
        .start_replay(45_000, MicroOhm(4_000_000), PicoHenry(25_000_000))
        .unwrap();
    // 150 blocks of three periods are 10 ms; each crossing begins a half-cycle.
    // A code of noise: a converter that repeats itself counts as frozen.
    let quiet = |block: i16| [Pair { v: block & 1, i: 0 }; ADC_LOCK_P];
    let loud = [Pair { v: 0, i: 1_960 }; ADC_LOCK_P];
    for half_cycle in 0..3 {
        replay.blocks(&quiet(0), Some(0), 0).unwrap();
        let blocks = if half_cycle < 2 { 149 } else { 20 };
        for block in 1..=blocks {
            replay.blocks(&quiet(block), None, 3_000).unwrap();
        }
    }
    replay.blocks(&loud, None, 3_000).unwrap();
    let now = replay.client().status().unwrap();
    let fault = loop {
        let event = replay.client().next_event(Duration::from_millis(100));
        if let LinkEvent::Fault(event) = event.unwrap().expect("a fault is reported") {
            break event;
        }
    };
    assert_eq!(fault.fault, Fault::OVER_CURRENT);
    assert_eq!(fault.half_cycle, now.half_cycles);
}
