//! The host's client against the real firmware: handshake, commands, lookups, refusals.

use std::time::Duration;

use ihd_link::{Client, DeviceEvent, GrantedPower, LinkError, Transport};
use ihd_shared::board::{BUS_FULL_SCALE_DV, MAINS_FULL_SCALE_MV};
use ihd_shared::fault::Fault;
use ihd_shared::hob::{RATED_POWER_W, REQUESTED_POWER_MAX_W};
use ihd_shared::lookup::blob::LEN;
use ihd_shared::lookup::prior::prior;
use ihd_shared::lookup::{LOOKUP_VERSION_STEP, RlLookup};
use ihd_shared::sampling::{I_FULL_SCALE_MA, V_FULL_SCALE_MV};
use ihd_shared::wire::PROTOCOL_MAJOR;
use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::frame::{CRC32, MAX_ENCODED, encode, encode_numbered, encode_raw};
use ihd_shared::wire::hello::{ROLE_HOST, ours};
use ihd_shared::wire::messages::{
    AnyMessage, Configure, FrontEnd, GetStatus, Hello, MESSAGES, Message, Outcome, Piece, Pot,
    Program, Reply, ResendWindow, Restart, SetPower, State, Status, is_numbered,
};
use ihd_shared::wire::number::Number;
use ihd_shared::wire::timing::HOST_UNHEARD_MS;
use ihd_sim::hob::{HobConfig, PanelEvent, SimHob};
use ihd_sim::transport::SharedHob;
use ihd_tests::desk_hob::{DeskHob, DeskLink, desk_hello};
use proptest::prelude::*;

fn connected() -> (Client, DeskLink) {
    let link = DeskLink::new(DeskHob::new(desk_hello()));
    let client = Client::connect(Box::new(link.clone())).unwrap();
    (client, link)
}

fn newer(version: u32) -> RlLookup {
    RlLookup { version, ..prior() }
}

/// The outcome and detail of a refusal.
fn refusal<T: std::fmt::Debug>(result: Result<T, LinkError>) -> (Outcome, u32) {
    match result {
        Err(LinkError::Refused {
            outcome, detail, ..
        }) => (outcome, detail),
        other => panic!("not refused: {other:?}"),
    }
}

#[test]
fn a_device_says_what_it_is_and_takes_commands() {
    let (mut client, link) = connected();
    assert_eq!(client.hello(), &desk_hello());
    // A start takes three good half-cycles.
    link.hob().run(4);
    client.set_power(1_000).unwrap();
    link.hob().step();
    let status = client.status().unwrap();
    assert_eq!((status.state, status.asked_w), (State::Probing, 1_000));
    assert_eq!(client.counters().frames_bad, 0);
}

/// The desk's board spends a quarter of its time on samples; 37.5 µs are a block at 80 kHz.
#[test]
fn a_device_says_how_busy_it_is_since_it_was_asked_last() {
    let (mut client, link) = connected();
    link.hob().run(2);
    let seen = client.utilisation().unwrap();
    assert!((520..540).contains(&seen.blocks), "{seen:?}");
    assert_eq!((seen.mean_permille, seen.worst_permille), (249, 249));
    assert_eq!(seen.longest_gap_us, 37);
    link.hob().turn_every = 20;
    link.hob().run(1);
    link.hob().turn_every = 1;
    link.hob().run(1);
    assert_eq!(client.utilisation().unwrap().longest_gap_us, 750);
    link.hob().run(1);
    assert_eq!(client.utilisation().unwrap().longest_gap_us, 37);
}

#[test]
fn the_scales_are_known_once_it_is_connected() {
    let (client, _) = connected();
    let front_end = FrontEnd {
        v_full_scale_mv: V_FULL_SCALE_MV,
        i_full_scale_ma: I_FULL_SCALE_MA,
        bus_full_scale_mv: 100 * BUS_FULL_SCALE_DV,
        mains_full_scale_mv: MAINS_FULL_SCALE_MV,
        bits: 12,
    };
    assert_eq!(client.front_end(), &front_end);
}

/// Wrong option bytes: the device runs and says so, and clearing does not let it heat.
#[test]
fn a_standing_fault_is_reported_and_cannot_be_cleared() {
    let link = DeskLink::new(DeskHob::new(desk_hello()));
    link.hob().sampling_path().latch_fault(Fault::OPTION_BYTES);
    link.hob().run(1);
    let mut client = Client::connect(Box::new(link.clone())).unwrap();
    let number = u32::from(Fault::OPTION_BYTES.number());
    let Some(DeviceEvent::Fault(event)) = client.next_event(Duration::from_secs(1)).unwrap() else {
        panic!("it must be reported");
    };
    assert_eq!(event.fault, Fault::OPTION_BYTES);
    for _ in 0..2 {
        let status = client.status().unwrap();
        assert_eq!(
            (status.state, status.fault),
            (State::LockedOut, Fault::OPTION_BYTES)
        );
        assert_eq!(
            refusal(client.set_power(1_000)),
            (Outcome::LockedOut, number)
        );
        assert_eq!(refusal(client.clear_fault()), (Outcome::LockedOut, number));
        link.hob().run(1);
    }
}

#[test]
fn another_major_is_reported_at_the_host() {
    let mut hello = desk_hello();
    hello.protocol_major = PROTOCOL_MAJOR + 1;
    let link = DeskLink::new(DeskHob::new(hello));
    let Err(error) = Client::connect(Box::new(link)) else {
        panic!("it must not connect");
    };
    let text = error.to_string();
    assert!(matches!(error, LinkError::Mismatch { .. }), "{text}");
    let versions = [
        format!("protocol major version {}", PROTOCOL_MAJOR + 1),
        format!("{PROTOCOL_MAJOR} here"),
    ];
    for part in versions
        .iter()
        .map(String::as_str)
        .chain(["desk 0.0.0", "flash"])
    {
        assert!(text.contains(part), "{part:?} is missing in {text:?}");
    }
}

/// Every frame in a stream: id, number, and the reply if it is one.
fn answers(stream: &[u8]) -> Vec<(u8, Number, Option<Reply>)> {
    let mut deframer = Deframer::new();
    let mut found = Vec::new();
    for &byte in stream {
        if let Some(Ok(frame)) = deframer.push(byte) {
            let (number, message) = frame.split();
            let reply = match AnyMessage::decode(frame.id, message) {
                Ok(AnyMessage::Reply(reply)) => Some(reply),
                _ => None,
            };
            found.push((frame.id, number, reply));
        }
    }
    found
}

/// A device of this build that a host of this version has said hello to.
fn greeted(major: u16) -> DeskHob {
    let mut hob = DeskHob::new(desk_hello());
    let mut theirs = ours(ROLE_HOST, 0, 1, "other", "host");
    theirs.protocol_major = major;
    let mut frame = [0; MAX_ENCODED];
    let length = encode(&theirs, 0, &mut frame).unwrap();
    hob.offer(&frame[..length]);
    let hello = answers(&hob.collect());
    assert_eq!(hello, [(Hello::ID, Number::NONE, None)]);
    hob
}

/// Offers a message of zeros under a number; what is answered within a second.
fn offered(hob: &mut DeskHob, id: u8, number: Number) -> Vec<(u8, Number, Option<Reply>)> {
    let mut frame = [0; MAX_ENCODED];
    let mut payload = number.to_le_bytes().to_vec();
    payload.extend([0; 12]);
    // Fields of zeros, as many as decode.
    let length = (0..=12)
        .find(|n| AnyMessage::decode(id, &payload[2..2 + n]).is_ok())
        .unwrap_or(0);
    let numbered = if is_numbered(id) { 0 } else { 2 };
    let payload = &payload[numbered..2 + length];
    let length = encode_raw(id, 1, payload, &mut frame).unwrap();
    hob.offer(&frame[..length]);
    hob.run(100);
    answers(&hob.collect())
}

#[test]
fn a_device_refuses_a_host_of_another_major_everything() {
    let mut hob = greeted(PROTOCOL_MAJOR + 1);
    let mut number = Number::NONE;
    for id in MESSAGES.iter().filter_map(|m| m.id) {
        number = number.next();
        let expected = is_numbered(id).then_some((
            Reply::ID,
            number,
            Some(Reply {
                outcome: Outcome::NotPaired,
                detail: 0,
            }),
        ));
        if id != Hello::ID {
            let answers = offered(&mut hob, id, number);
            assert_eq!(answers, Vec::from_iter(expected), "id {id:#04x}");
        }
    }
}

/// Each row of the table against the firmware: the answer that it binds or a reply, under the request's number, once; and the
/// same when the request comes again.
#[test]
fn every_request_is_answered_as_the_table_says() {
    let id_of = |name| MESSAGES.iter().find(|m| m.name == name).and_then(|m| m.id);
    let mut hob = greeted(PROTOCOL_MAJOR);
    let mut number = Number::NONE;
    for request in MESSAGES.iter().filter(|m| m.answer.is_some()) {
        number = number.next();
        let id = request.id.unwrap();
        let answers = offered(&mut hob, id, number);
        let [(answer, repeated, reply)] = &answers[..] else {
            panic!("{}: {answers:?}", request.name);
        };
        assert_eq!(*repeated, number, "{}", request.name);
        match reply {
            Some(reply) => assert_ne!(reply.outcome, Outcome::UnknownMessage, "{}", request.name),
            None => assert_eq!(Some(*answer), id_of(request.answer.unwrap())),
        }
        if !request.is_sent_once {
            assert_eq!(offered(&mut hob, id, number), answers, "{}", request.name);
        }
        // One that was overtaken is nobody's any more, and one without a number is none.
        assert_eq!(
            offered(&mut hob, id, Number::FIRST).len(),
            usize::from(number == Number::FIRST)
        );
        let [(Reply::ID, Number::NONE, Some(reply))] = &offered(&mut hob, id, Number::NONE)[..]
        else {
            panic!("{} without a number", request.name);
        };
        assert_eq!(reply.outcome, Outcome::Malformed);
    }
}

#[test]
fn a_reset_device_asks_for_a_new_connection() {
    let (mut client, link) = connected();
    *link.hob() = DeskHob::new(desk_hello());
    assert_eq!(refusal(client.set_power(500)).0, Outcome::NotPaired);
    assert!(Client::connect(Box::new(link)).is_ok());
}

/// A peer that answers everything with the same bytes.
struct Parrot(&'static [u8]);

impl Transport for Parrot {
    fn send(&mut self, _: &[u8]) -> Result<(), LinkError> {
        Ok(())
    }
    fn receive(&mut self, buf: &mut [u8], _: Duration) -> Result<usize, LinkError> {
        let length = self.0.len();
        buf[..length].copy_from_slice(std::mem::take(&mut self.0));
        Ok(length)
    }
    fn describe(&self) -> String {
        "parrot".into()
    }
}

#[test]
fn a_peer_that_is_no_device_is_distinguished_from_silence() {
    for (bytes, text) in [
        (&b"HTTP/1.1 400 Bad Request\r\n"[..], "no frame"),
        (b"", "nothing came"),
    ] {
        let Err(error) = Client::connect(Box::new(Parrot(bytes))) else {
            panic!("a parrot must not connect");
        };
        assert!(error.to_string().contains(text), "{error}");
    }
}

#[test]
fn a_good_lookup_becomes_active_at_the_half_cycle_boundary() {
    let (mut client, link) = connected();
    link.hob().run(1);
    client.push_lookup(&newer(3)).unwrap();
    assert_eq!(link.hob().housekeeping().lookup().version, 0);
    let busy = refusal(client.push_lookup(&newer(4)));
    assert_eq!(busy.0, Outcome::Busy);
    link.hob().run(1);
    assert_eq!(client.status().unwrap().lookup_version, 3);
    assert_eq!(client.read_lookup().unwrap(), newer(3));
    client.push_lookup(&newer(4)).unwrap();
}

/// A lookup far ahead would leave no room for the next one; after a reset any low version is new.
#[test]
fn a_version_steps_within_bounds_and_a_reset_leads_back_to_the_prior() {
    let (mut client, link) = connected();
    link.hob().run(1);
    let too_far = refusal(client.push_lookup(&newer(LOOKUP_VERSION_STEP + 1)));
    assert_eq!(too_far, (Outcome::LookupStep, LOOKUP_VERSION_STEP));
    let too_far = refusal(client.push_lookup(&newer(u32::MAX)));
    assert_eq!(too_far, (Outcome::LookupStep, LOOKUP_VERSION_STEP));
    client.push_lookup(&newer(LOOKUP_VERSION_STEP)).unwrap();
    link.hob().run(1);
    let changes = link.hob().housekeeping().lookup_changes();
    client.reset_lookup().unwrap();
    assert_eq!(refusal(client.reset_lookup()).0, Outcome::Busy);
    link.hob().run(1);
    assert_eq!(client.read_lookup().unwrap(), prior());
    // The board keeps it in flash when it sees this.
    assert_eq!(link.hob().housekeeping().lookup_changes(), changes + 1);
    client.push_lookup(&newer(1)).unwrap();
    link.hob().run(1);
    assert_eq!(client.read_lookup().unwrap(), newer(1));
}

/// A reset that was kept is no lookup of an older build.
#[test]
fn what_was_kept_of_version_zero_is_this_builds_prior() {
    let link = DeskLink::new(DeskHob::new(desk_hello()));
    let mut older = newer(0);
    older.r[0][0] += 1;
    link.hob().restore(older);
    assert_eq!(link.hob().housekeeping().lookup(), &prior());
    link.hob().restore(newer(4));
    assert_eq!(link.hob().housekeeping().lookup(), &newer(4));
    // Windows name it, too.
    let mut client = Client::connect(Box::new(link.clone())).unwrap();
    client.set_power(1_000).unwrap();
    link.hob().run(60);
    client.stream(0, 2).unwrap();
    let window = loop {
        match client.next_event(Duration::from_secs(2)).unwrap() {
            Some(DeviceEvent::Window(window)) => break window,
            Some(_) => {}
            None => panic!("no window within 2 s of the device's time"),
        }
    };
    assert_eq!(window.lookup_version, 4);
}

#[test]
fn settings_outside_their_range_change_nothing() {
    let (mut client, link) = connected();
    let set = |give_up_s, dither_permille| Configure {
        give_up_s,
        dither_permille,
    };
    assert_eq!(link.hob().housekeeping().settings(), &Configure::DEFAULT);
    for good in [set(60, 0), set(600, 10)] {
        client.configure(&good).unwrap();
        assert_eq!(link.hob().housekeeping().settings(), &good);
    }
    for (bad, field) in [(set(59, 0), 0), (set(601, 11), 0), (set(60, 11), 1)] {
        assert_eq!(
            refusal(client.configure(&bad)),
            (Outcome::OutOfRange, field)
        );
        assert_eq!(link.hob().housekeeping().settings(), &set(600, 10));
    }
}

#[test]
fn a_bad_lookup_is_refused_with_its_reason_and_the_old_one_stays() {
    let (mut client, link) = connected();
    let kept = newer(5);
    client.push_lookup(&kept).unwrap();
    link.hob().run(1);
    let changed = |change: fn(&mut RlLookup)| {
        let mut lookup = newer(6);
        change(&mut lookup);
        lookup.to_bytes().to_vec()
    };
    let mut bad_crc = changed(|_| ());
    bad_crc[40] ^= 1;
    let mut other_format = changed(|_| ());
    other_format[4] += 1;
    let crc = CRC32.checksum(&other_format[..LEN - 4]);
    other_format[LEN - 4..].copy_from_slice(&crc.to_le_bytes());
    let cases = [
        (bad_crc, Outcome::LookupCrc, 0),
        (other_format, Outcome::LookupFormat, 1),
        (vec![0; 3], Outcome::LookupLength, LEN as u32),
        (vec![0; 1_000], Outcome::LookupLength, LEN as u32),
        (newer(5).to_bytes().to_vec(), Outcome::LookupStale, 5),
        (newer(0).to_bytes().to_vec(), Outcome::LookupStale, 5),
        (changed(|l| l.r[1][2] = 0), Outcome::LookupRange, 19),
        (changed(|l| l.l[0][3] = u16::MAX), Outcome::LookupRange, 3),
        (
            changed(|l| l.l[0][0] = l.l[0][1] / 2),
            Outcome::LookupSlope,
            0,
        ),
        (
            changed(|l| l.r[0][1] = l.r[0][0] + l.r[0][0] / 10),
            Outcome::LookupNotMonotone,
            0,
        ),
    ];
    for (blob, outcome, detail) in cases {
        assert_eq!(refusal(client.push_lookup_bytes(&blob)), (outcome, detail));
        link.hob().run(2);
        assert_eq!(client.read_lookup().unwrap(), kept, "after {outcome:?}");
    }
    let too_long = client.push_lookup_bytes(&[0; 2_000]);
    assert!(matches!(too_long, Err(LinkError::Unsendable { .. })));
}

/// More than the rating is granted as the rating, and the reply and every report tell so; a power that no hob gives is refused,
/// and what was requested before goes on.
#[test]
fn power_above_the_rating_is_granted_as_the_rating() {
    let (mut client, link) = connected();
    client.stream(1, 0).unwrap();
    for (asked_w, granted_w, text) in [
        (RATED_POWER_W, RATED_POWER_W, "2500 W asked for"),
        (
            RATED_POWER_W + 1,
            RATED_POWER_W,
            "2501 W asked, 2500 W is the most this hob gives",
        ),
        (1_000, 1_000, "1000 W asked for"),
        (
            REQUESTED_POWER_MAX_W,
            RATED_POWER_W,
            "10000 W asked, 2500 W is the most this hob gives",
        ),
    ] {
        let granted = client.set_power(asked_w).unwrap();
        assert_eq!(granted, GrantedPower { asked_w, granted_w });
        assert_eq!(granted.to_string(), text);
        assert_eq!(client.status().unwrap().asked_w, granted_w);
        link.hob().run(20);
        let mut told_w = None;
        while let Some(event) = client.next_event(Duration::ZERO).unwrap() {
            if let DeviceEvent::Telemetry(telemetry) = event {
                told_w = Some(telemetry.asked_w);
            }
        }
        assert_eq!(told_w, Some(granted_w));
    }
    for asked_w in [REQUESTED_POWER_MAX_W + 1, u16::MAX] {
        let refused = refusal(client.set_power(asked_w));
        assert_eq!(refused, (Outcome::PowerOutOfRange, 10_000), "{asked_w}");
        assert_eq!(client.status().unwrap().asked_w, RATED_POWER_W);
    }
}

/// Nothing has to be cleared or asked for again: the pot comes, and is heated.
#[test]
fn a_missing_pot_is_waited_for() {
    let (mut client, link) = connected();
    link.hob().load_ohm = 0.0;
    client.set_power(1_000).unwrap();
    link.hob().run(300);
    let status = client.status().unwrap();
    let seen = (status.state, status.pot, status.fault, status.asked_w);
    let waiting = State::WaitingForPot;
    assert_eq!(seen, (waiting, Pot::Absent, Fault::NONE, 1_000));
    assert!(client.next_event(Duration::ZERO).unwrap().is_none());
    link.hob().load_ohm = 4.5;
    link.hob().run(150);
    let status = client.status().unwrap();
    assert_eq!(
        (status.state, status.pot),
        (State::Heating, Pot::Ferromagnetic)
    );
}

#[test]
fn events_that_arrive_while_a_command_waits_are_kept() {
    let (mut client, link) = connected();
    client.stream(1, 0).unwrap();
    for _ in 0..3 {
        link.hob().run(3);
        client.status().unwrap();
    }
    let mut seen = Vec::new();
    while let Some(event) = client.next_event(Duration::ZERO).unwrap() {
        let DeviceEvent::Telemetry(telemetry) = event else {
            panic!("unexpected {event:?}");
        };
        seen.push(telemetry.seq);
    }
    assert_eq!(seen, (0..9).collect::<Vec<_>>());
    assert_eq!(client.counters().telemetry.missing, 0);
}

#[test]
fn an_answer_that_stays_away_is_reported_and_a_late_one_is_not_taken_for_another() {
    let (mut client, link) = connected();
    let (mut swallowed, mut answers) = (Vec::new(), 0);
    // What is answered to three times the same question arrives only together with the next answer.
    link.hob().mangle = Box::new(move |frame| {
        answers += 1;
        swallowed.extend_from_slice(frame);
        if answers <= 3 {
            return Vec::new();
        }
        std::mem::take(&mut swallowed)
    });
    client.set_timeout(Duration::from_millis(100));
    let error = client.status().unwrap_err();
    assert!(matches!(
        error,
        LinkError::NoAnswer {
            command: "GetStatus",
            ..
        }
    ));
    assert!(error.to_string().contains("100ms"), "{error}");
    client.set_power(700).unwrap();
    assert_eq!(client.counters().answers_stray, 3);
}

#[test]
fn an_answer_that_is_lost_costs_a_third_of_the_time_out() {
    let (mut client, link) = connected();
    let mut answers = 0;
    link.hob().mangle = Box::new(move |frame| {
        answers += 1;
        if answers % 2 == 1 {
            Vec::new()
        } else {
            frame.to_vec()
        }
    });
    let at = client.clock();
    client.set_power(700).unwrap();
    let took = client.clock() - at;
    assert!(
        took > Duration::from_millis(600) && took < Duration::from_millis(800),
        "{took:?}"
    );
    // Taken, unheard, and not taken twice: the second time it is neither stale nor busy.
    client.push_lookup(&newer(3)).unwrap();
    assert_eq!(client.read_lookup().unwrap(), newer(3));
    client.reset_lookup().unwrap();
    link.hob().run(2);
    assert_eq!(client.status().unwrap().lookup_version, 0);
}

#[test]
fn telemetry_that_the_link_loses_shows_as_a_gap() {
    let (mut client, link) = connected();
    client.stream(1, 0).unwrap();
    let mut count = 0;
    link.hob().mangle = Box::new(move |frame| {
        count += 1;
        if (2..5).contains(&count) {
            Vec::new()
        } else {
            frame.to_vec()
        }
    });
    link.hob().run(8);
    client.status().unwrap();
    let counters = client.counters();
    assert_eq!(
        (counters.telemetry.received, counters.telemetry.missing),
        (5, 3)
    );
    assert_eq!(counters.frames_lost, 3);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Garbage between the frames, in both directions, costs no command its answer.
    #[test]
    fn garbage_between_frames_costs_no_answer(
        to_device in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..1_500), 6),
        to_host in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..1_500), 1..6),
    ) {
        let mut hob = DeskHob::new(desk_hello());
        let mut noise = to_host.into_iter().cycle();
        hob.mangle = Box::new(move |frame| [noise.next().unwrap_or_default(), frame.to_vec()].concat());
        let link = DeskLink::noisy(hob, to_device);
        let mut client = Client::connect(Box::new(link.clone())).unwrap();
        client.set_power(1_200).unwrap();
        client.stream(0, 1).unwrap();
        client.push_lookup(&newer(1)).unwrap();
        link.hob().run(1);
        let status = client.status().unwrap();
        prop_assert_eq!((status.asked_w, status.lookup_version), (1_200, 1));
        prop_assert_eq!(client.read_lookup().unwrap(), newer(1));
        prop_assert_eq!(status.frames_lost, 0);
    }

    /// After any bytes as a frame's payload the device answers the next request.
    #[test]
    fn any_payload_under_any_id_leaves_the_device_answering(
        frames in prop::collection::vec(
            (any::<u8>(), prop::collection::vec(any::<u8>(), 0..600)), 1..12),
    ) {
        let (client, link) = connected();
        drop(client);
        let mut out = [0; MAX_ENCODED];
        for (k, (id, payload)) in frames.iter().enumerate() {
            let length = encode_raw(*id, k as u16, payload, &mut out).unwrap();
            link.hob().offer(&out[..length]);
        }
        link.hob().run(1);
        link.hob().collect();
        let hello = ours(ROLE_HOST, 0, 1, "test", "host");
        let length = encode(&hello, 98, &mut out).unwrap();
        link.hob().offer(&out[..length]);
        link.hob().collect();
        let length = encode_numbered(&GetStatus {}, Number::FIRST, 99, &mut out).unwrap();
        link.hob().offer(&out[..length]);
        prop_assert!(!link.hob().collect().is_empty());
        prop_assert!(Client::connect(Box::new(link)).is_ok());
    }
}

#[test]
fn a_host_that_falls_silent_no_longer_heats() {
    let (mut client, link) = connected();
    client.set_power(1_000).unwrap();
    link.hob().run(u64::from(HOST_UNHEARD_MS / 10) - 10);
    assert_eq!(
        client.status().unwrap().asked_w,
        1_000,
        "it was heard in time"
    );
    link.hob().run(u64::from(HOST_UNHEARD_MS / 10) + 2);
    let status = client.status().unwrap();
    assert_eq!(
        (status.state, status.asked_w, status.f_sw_hz),
        (State::Idle, 0, 0)
    );
}

/// More requests than there is room for responses come from a host that reads none of them.
#[test]
fn a_host_that_reads_nothing_can_still_switch_off() {
    let mut hob = greeted(PROTOCOL_MAJOR);
    let mut number = Number::NONE;
    let mut offer = |hob: &mut DeskHob, message: AnyMessage<'_>| {
        let mut frame = [0; MAX_ENCODED];
        number = number.next();
        let length = match message {
            AnyMessage::ResendWindow(m) => encode(&m, 0, &mut frame),
            AnyMessage::SetPower(m) => encode_numbered(&m, number, 0, &mut frame),
            _ => encode_numbered(&GetStatus {}, number, 0, &mut frame),
        };
        hob.offer(&frame[..length.unwrap()]);
        number
    };
    let power = |power_w| AnyMessage::SetPower(SetPower { power_w });
    offer(&mut hob, power(1_000));
    hob.run(60);
    assert_eq!(hob.housekeeping().control().state(), State::Heating);
    hob.collect();
    hob.bytes_per_block = 0;
    for offset in 0..40 {
        let (seq, piece) = (0, Piece::Pairs);
        offer(
            &mut hob,
            AnyMessage::ResendWindow(ResendWindow { seq, piece, offset }),
        );
    }
    let asked = offer(&mut hob, AnyMessage::GetStatus(GetStatus {}));
    for _ in 0..40 {
        offer(&mut hob, AnyMessage::GetStatus(GetStatus {}));
    }
    offer(&mut hob, power(0));
    hob.run(2);
    let control = hob.housekeeping().control();
    assert_eq!((control.state(), control.asked_w()), (State::Idle, 0));
    assert!(!hob.sampling_path().drive().is_switching());
    // Pieces leave room for responses.
    hob.bytes_per_block = usize::MAX;
    hob.run(1);
    let read = answers(&hob.collect());
    assert!(read.contains(&(Status::ID, asked, None)), "{read:?}");
}

/// Responses that nobody reads fill the queue while the device is about to restart.
#[test]
fn a_host_that_reads_nothing_does_not_hold_a_restart_up() {
    let mut hob = greeted(PROTOCOL_MAJOR);
    hob.board.can_restart = true;
    hob.bytes_per_block = 0;
    let mut number = Number::NONE;
    for k in 0..40 {
        let mut frame = [0; MAX_ENCODED];
        number = number.next();
        let into = Program::Firmware;
        let length = match k {
            0 => encode_numbered(&Restart { into }, number, 0, &mut frame),
            _ => encode_numbered(&GetStatus {}, number, 0, &mut frame),
        };
        hob.offer(&frame[..length.unwrap()]);
        // The restart begins before the others come.
        hob.run(u64::from(k == 0));
    }
    hob.run(100);
    assert!(hob.board.has_restarted);
}

/// A hello that fits, and one of another major version: both end the conversation before.
#[test]
fn a_hello_ends_the_power_that_the_host_before_it_asked_for() {
    for major in [PROTOCOL_MAJOR, PROTOCOL_MAJOR + 1] {
        let (mut client, link) = connected();
        client.set_power(1_000).unwrap();
        link.hob().run(60);
        assert_eq!(client.status().unwrap().state, State::Heating);
        let hello = Hello {
            protocol_major: major,
            ..ours(ROLE_HOST, 0, 1, "test", "host")
        };
        let mut out = [0; MAX_ENCODED];
        let length = encode(&hello, 0, &mut out).unwrap();
        link.hob().offer(&out[..length]);
        link.hob().run(2);
        let mut hob = link.hob();
        let control = hob.housekeeping().control();
        assert_eq!((control.state(), control.asked_w()), (State::Idle, 0));
        assert!(!hob.sampling_path().drive().is_switching());
    }
}

#[test]
fn a_hello_leaves_the_panel_no_more_than_both_asked_for() {
    let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
    let mut first = Client::connect(Box::new(hob.clone())).unwrap();
    hob.lock().panel(PanelEvent::Level(5));
    first.set_power(300).unwrap();
    assert_eq!(first.status().unwrap().asked_w, 300);
    let mut second = Client::connect(Box::new(hob.clone())).unwrap();
    assert_eq!(second.status().unwrap().asked_w, 300);
    hob.lock().panel(PanelEvent::Level(5));
    assert_eq!(second.status().unwrap().asked_w, 700);
}

#[test]
fn a_new_host_begins_a_new_sequence_and_hears_of_the_fault() {
    let (mut client, link) = connected();
    client.set_power(1_000).unwrap();
    link.hob().run(10);
    link.hob().sampling_path().latch_fault(Fault::FLASH_ECC);
    for _ in 0..100 {
        client.status().unwrap();
    }
    drop(client);
    let mut second = Client::connect(Box::new(link.clone())).unwrap();
    link.hob().run(2);
    let event = second.next_event(Duration::from_millis(50)).unwrap();
    assert!(
        matches!(event, Some(DeviceEvent::Fault(ref f)) if f.fault == Fault::FLASH_ECC),
        "{event:?}"
    );
    assert_eq!(second.status().unwrap().frames_lost, 0);
}

#[test]
fn a_window_under_way_is_not_sent_to_the_next_host() {
    let (mut client, link) = connected();
    client.set_power(1_000).unwrap();
    client.stream(0, 1).unwrap();
    // Into the middle of a half-cycle that is recorded.
    link.hob().run(60);
    for _ in 0..60 {
        link.hob().step();
    }
    drop(client);
    let mut second = Client::connect(Box::new(link.clone())).unwrap();
    link.hob().run(20);
    assert_eq!(second.next_event(Duration::from_millis(50)).unwrap(), None);
    assert_eq!(second.counters().window_messages_stray, 0);
}

#[test]
fn a_window_names_the_lookup_it_was_recorded_under() {
    let (mut client, link) = connected();
    client.set_power(1_000).unwrap();
    client.stream(0, 1).unwrap();
    link.hob().run(60);
    client.push_lookup(&newer(5)).unwrap();
    let mut versions = Vec::new();
    while versions.len() < 100 {
        let event = client.next_event(Duration::from_secs(1)).unwrap();
        if let DeviceEvent::Window(w) = event.expect("windows come") {
            versions.push((w.half_cycle, w.lookup_version));
        }
    }
    // Pushed within half-cycle 60, in use when 61 had begun: what began before names 0.
    assert!(
        versions
            .iter()
            .all(|&(h, v)| v == if h <= 61 { 0 } else { 5 }),
        "{versions:?}"
    );
    assert!(versions.iter().any(|&(_, v)| v == 0) && versions.iter().any(|&(_, v)| v == 5));
}
