//! Golden bytes of every message: what is on the wire today stays so, or the version changes.

use std::collections::BTreeMap;

use ihd_link::DeviceEvent;
use ihd_link::receiver::Receiver;
use ihd_shared::fault::Fault;
use ihd_shared::lookup::blob::LEN;
use ihd_shared::replay::{BLOCK_BYTES, BLOCKS_PER_MESSAGE};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::window::CHUNK_BYTES;
use ihd_shared::wire::frame::{
    MAX_ENCODED, MAX_PAYLOAD, decode, encode, encode_numbered, encode_raw,
};
use ihd_shared::wire::hello::MAGIC;
use ihd_shared::wire::messages::{
    AnyMessage, Board, Channels, ClearFault, Clocks, Comparators, Configure, FaultEvent, FrontEnd,
    GetBoard, GetFrontEnd, GetStatus, GetUtilisation, Hello, Limit, LinkData, LinkTested, Log,
    LookupBlob, MESSAGES, Message, OffReason, Outcome, Piece, Pot, Program, PushLookup, Raw,
    ReadLookup, ReplayBlocks, ReplayEnd, ReplayEstimates, ReplayMode, ReplayStart, Reply,
    ResendWindow, ResetLookup, Restart, SCHEMA_HASH, SetPower, State, Status, Stream, StreamLog,
    Telemetry, TestChannels, TestClocks, TestComparators, TestLink, TrajectoryChunk, Utilisation,
    WindowChunk, WindowEnd, WindowGone, WindowStart, is_numbered,
};
use ihd_shared::wire::number::Number;
use ihd_shared::wire::{PROTOCOL_MAJOR, PROTOCOL_MINOR};

const HELLO: &str = include_str!("../fixtures/wire/hello.txt");
const GOLDEN: &str = include_str!("../fixtures/wire/messages.txt");

/// Number, name, message and frame of each message in a golden file.
fn golden(text: &str) -> BTreeMap<u8, (String, Vec<u8>, Vec<u8>)> {
    let lines: Vec<&str> = text.lines().filter(|l| !l.starts_with('#')).collect();
    let at = lines.iter().position(|l| l.starts_with("0x")).unwrap();
    lines[at..]
        .chunks(3)
        .map(|entry| {
            let (id, name) = entry[0].split_once(' ').unwrap();
            let id = u8::from_str_radix(&id[2..], 16).unwrap();
            let [payload, frame] = [(1, "payload"), (2, "frame")]
                .map(|(k, key)| unhex(entry[k].trim().strip_prefix(key).unwrap().trim()));
            (id, (name.to_owned(), payload, frame))
        })
        .collect()
}

fn unhex(text: &str) -> Vec<u8> {
    let nibble = |c: char| c.to_digit(16).unwrap() as u8;
    let nibbles: Vec<u8> = text.chars().map(nibble).collect();
    nibbles
        .chunks_exact(2)
        .map(|n| (n[0] << 4) | n[1])
        .collect()
}

/// The frame of any message, under a number if it carries one.
fn framed(message: &AnyMessage<'_>, number: Number, seq: u16) -> Vec<u8> {
    let (mut payload, mut out) = ([0; MAX_PAYLOAD], [0; MAX_ENCODED]);
    let (id, message) = message.bytes(&mut payload).unwrap();
    let number = number.to_le_bytes();
    let number = if is_numbered(id) { &number[..] } else { &[] };
    let length = encode_raw(id, seq, &[number, message].concat(), &mut out).unwrap();
    out[..length].to_vec()
}

/// The same by the encoder of both ends.
fn encoded(id: u8, message: &[u8], number: Number, seq: u16) -> Vec<u8> {
    let mut out = [0; MAX_ENCODED];
    let length = match AnyMessage::decode(id, message).unwrap() {
        AnyMessage::SetPower(m) => encode_numbered(&m, number, seq, &mut out),
        AnyMessage::Status(m) => encode_numbered(&m, number, seq, &mut out),
        AnyMessage::Telemetry(m) => encode(&m, seq, &mut out),
        _ => return Vec::new(),
    };
    let length = length.unwrap();
    out[..length].to_vec()
}

/// One message of each kind, with fields that differ from each other and from zero; make.py repeats them.
fn samples<'a>(chunk: &'a [u8], lookup: &'a [u8]) -> Vec<AnyMessage<'a>> {
    vec![
        AnyMessage::Hello(Hello {
            magic: MAGIC,
            role: 1,
            protocol_major: 0x102,
            protocol_minor: 0x304,
            schema_hash: 0x0102_0304_0506_0708,
            capabilities: 5,
            boot_id: 0xDEAD_BEEF,
            reset_reason: 3,
            fault_before_reset: 300,
            build: "ihd-firmware 0.1.0".try_into().unwrap(),
            board: "board".try_into().unwrap(),
        }),
        AnyMessage::SetPower(SetPower { power_w: 1_500 }),
        AnyMessage::Stream(Stream {
            telemetry_every: 1,
            windows_every: 200,
        }),
        AnyMessage::GetStatus(GetStatus {}),
        AnyMessage::PushLookup(PushLookup {
            blob: Raw(&[0, 1, 0xFF]),
        }),
        AnyMessage::ReadLookup(ReadLookup {}),
        AnyMessage::ClearFault(ClearFault {}),
        AnyMessage::ReplayStart(ReplayStart {
            f_sw_hz: 52_345,
            r: MicroOhm(4_000_000),
            l: PicoHenry(-25_000_000),
        }),
        AnyMessage::ReplayBlocks(ReplayBlocks {
            zero_crossing: 61,
            bus_dv: 3_250,
            data: Raw(chunk),
        }),
        AnyMessage::ReplayEnd(ReplayEnd {}),
        AnyMessage::GetUtilisation(GetUtilisation {}),
        AnyMessage::ResetLookup(ResetLookup {}),
        AnyMessage::Configure(Configure {
            give_up_s: 420,
            dither_permille: 9,
        }),
        AnyMessage::GetFrontEnd(GetFrontEnd {}),
        AnyMessage::ResendWindow(ResendWindow {
            seq: 77,
            piece: Piece::Trajectory,
            offset: 240,
        }),
        AnyMessage::Restart(Restart {
            into: Program::Bootloader,
        }),
        AnyMessage::GetBoard(GetBoard {}),
        AnyMessage::LinkData(LinkData {
            seq: 70_000,
            data: Raw(chunk),
        }),
        AnyMessage::TestLink(TestLink {
            frames: 500,
            bytes: 960,
        }),
        AnyMessage::StreamLog(StreamLog { on: true }),
        AnyMessage::TestChannels(TestChannels {}),
        AnyMessage::TestComparators(TestComparators {}),
        AnyMessage::TestClocks(TestClocks {}),
        AnyMessage::Reply(Reply {
            outcome: Outcome::LookupStale,
            detail: 70_000,
        }),
        AnyMessage::Status(status()),
        AnyMessage::Telemetry(telemetry()),
        AnyMessage::WindowStart(WindowStart {
            seq: 77,
            dropped: 1,
            half_cycle: 3_001,
            f_sw_hz: 52_345,
            half_cycle_ns: 9_999_500,
            first_pair_ns: -1_234,
            first_trajectory_ns: 28_656,
            pairs: 10_643,
            trajectory: 174,
            saturated: 3,
            lookup_version: 7,
            v_full_scale_mv: 640_001,
            i_full_scale_ma: 80_002,
        }),
        AnyMessage::WindowChunk(WindowChunk {
            seq: 77,
            offset: 240,
            data: Raw(chunk),
        }),
        AnyMessage::TrajectoryChunk(TrajectoryChunk {
            seq: 77,
            offset: 120,
            data: Raw(chunk),
        }),
        AnyMessage::WindowEnd(WindowEnd {
            seq: 77,
            crc32: 0x1234_5678,
        }),
        AnyMessage::LookupBlob(LookupBlob { blob: Raw(lookup) }),
        AnyMessage::FaultEvent(FaultEvent {
            half_cycle: 3_002,
            fault: Fault::MAINS_LOST,
        }),
        AnyMessage::ReplayMode(ReplayMode {
            active: true,
            blocks: 200,
        }),
        AnyMessage::ReplayEstimates(ReplayEstimates {
            first: 200,
            data: Raw(chunk),
        }),
        AnyMessage::Utilisation(Utilisation {
            blocks: 120_001,
            mean_permille: 459,
            worst_permille: 601,
            longest_gap_us: 19_876,
        }),
        AnyMessage::FrontEnd(FrontEnd {
            v_full_scale_mv: 640_001,
            i_full_scale_ma: 80_002,
            bus_full_scale_mv: 500_003,
            mains_full_scale_mv: 400_004,
            bits: 12,
        }),
        AnyMessage::Board(Board {
            id_code: 0x2003_6469,
            flash_kib: 512,
            option_bytes: 0xFBEF_F8AA,
            reset_flags: 0x1400_0000,
            starts: 3,
            image_bytes: 128_316,
            image_crc: 0x1234_5678,
            sealed_crc: 0x1234_5679,
            build_id: Raw(&BUILD_ID),
            chip: Raw(&BUILD_ID[..12]),
        }),
        AnyMessage::Channels(Channels {
            samples: 40_000,
            v_mean: -300,
            v_rms: 410,
            i_mean: -512,
            i_rms: 530,
            slow_samples: 1_200,
            bus_mean: 260,
            bus_rms: 380,
            mains_mean: -700,
            mains_rms: 90_000,
            reference: 1_505,
            vdda_mv: 3_301,
        }),
        AnyMessage::Comparators(Comparators {
            positive_tripped: true,
            positive_quiet: false,
            negative_tripped: false,
            negative_quiet: true,
        }),
        AnyMessage::Clocks(Clocks {
            main_hz: 170_000_000,
            lsi_periods: 3_200,
            lsi_main_cycles: 17_000_100,
            usb_frames: 500,
            usb_main_cycles: 85_000_200,
            hsi48_off: -21,
            hsi48_trim: 64,
        }),
        AnyMessage::LinkTested(LinkTested {
            frames: 500,
            bytes: 480_000,
            bad: 1,
            lost: 2,
        }),
        AnyMessage::Log(Log {
            seq: 70_000,
            dropped: 3,
            data: Raw(chunk),
        }),
        AnyMessage::WindowGone(WindowGone { seq: 77 }),
    ]
}

/// Twenty bytes that differ.
const BUILD_ID: [u8; 20] = [
    0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19,
];

fn status() -> Status {
    Status {
        state: State::Heating,
        fault: Fault::from_number(3),
        pot: Pot::Ferromagnetic,
        asked_w: 1_800,
        delivered_mw: 1_795_123,
        f_sw_hz: 45_678,
        lookup_version: 12,
        half_cycles: 100_001,
        windows_recorded: 201,
        windows_dropped: 302,
        telemetry_dropped: 403,
        frames_bad: 504,
        frames_lost: 605,
        saturated_pairs: 706,
        limit: Limit::Temperature,
        tries_left: 3,
        heat_sink_c: 86,
        glass_c: 251,
        coil_c: -300,
        fan: true,
        panel_level: 8,
        key_locked: true,
        off_reason: OffReason::Unattended,
        glass_hot: true,
        timer_min: 90,
    }
}

fn telemetry() -> Telemetry {
    Telemetry {
        seq: 1_000,
        dropped: 2,
        half_cycle: 3_000,
        state: State::Heating,
        fault: Fault::NONE,
        pot: Pot::Ferromagnetic,
        f_sw_hz: 52_345,
        r: MicroOhm(4_123_456),
        l: PicoHenry(25_654_321),
        i_crest_ma: 34_567,
        power_mw: 1_499_999,
        phase_mrad: -345,
        lookup_version: 7,
        asked_w: 1_800,
        limit: Limit::CoilVoltage,
        bus_peak_dv: 3_251,
        v_coil_peak_dv: 5_432,
        i_turn_off_min_ma: -1_250,
        off_reason: OffReason::NoPot,
        glass_hot: true,
    }
}

#[test]
fn every_message_has_its_golden_bytes() {
    let chunk = [1, 2, 3, 4, 5, 6, 7, 8];
    let lookup = [b"IHDL".as_slice(), &[0; 300]].concat();
    let mut golden_of = golden(GOLDEN);
    golden_of.extend(golden(HELLO));
    let mut covered = Vec::new();
    for sample in samples(&chunk, &lookup) {
        let mut bytes = [0; MAX_PAYLOAD];
        let (id, bytes) = sample.bytes(&mut bytes).unwrap();
        covered.push(id);
        let (name, message, on_wire) = golden_of
            .remove(&id)
            .unwrap_or_else(|| panic!("{sample:?} is missing in tests/fixtures/wire/make.py"));
        assert_eq!(bytes, message, "bytes of {name}; read messages.txt");
        let seq = 0x100 + u16::from(id);
        let number = Number::from_le_bytes((0x200 + u16::from(id)).to_le_bytes());
        assert_eq!(framed(&sample, number, seq), on_wire, "frame of {name}");
        let by_the_encoder = encoded(id, &message, number, seq);
        assert!(
            by_the_encoder.is_empty() || by_the_encoder == on_wire,
            "{name}"
        );
        assert_eq!(AnyMessage::decode(id, &message).as_ref(), Ok(&sample));
        let mut stuffed = on_wire[1..on_wire.len() - 1].to_vec();
        let (read, rest) = decode(&mut stuffed).unwrap().split();
        let carried = if is_numbered(id) {
            number
        } else {
            Number::NONE
        };
        assert_eq!((read, rest), (carried, &message[..]), "{name}");
    }
    let table: Vec<u8> = MESSAGES.iter().filter_map(|m| m.id).collect();
    assert_eq!(covered, table, "messages of the table without a sample");
    assert!(
        golden_of.is_empty(),
        "no longer in the table: {golden_of:?}"
    );
}

#[test]
fn the_names_are_those_of_the_table() {
    let mut golden_of = golden(GOLDEN);
    golden_of.extend(golden(HELLO));
    for m in MESSAGES {
        assert_eq!(golden_of[&m.id.unwrap()].0, m.name);
    }
}

#[test]
fn the_schema_and_its_version_change_together() {
    let pinned: Vec<&str> = GOLDEN
        .lines()
        .filter(|l| {
            ["protocol ", "schema ", "faults "]
                .iter()
                .any(|p| l.starts_with(p))
        })
        .collect();
    let faults: Vec<String> = Fault::TABLE
        .iter()
        .map(|row| format!("{} {}", row.fault.number(), row.name))
        .collect();
    let now = [
        format!("protocol {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}"),
        format!("schema {SCHEMA_HASH:016x}"),
        format!("faults {}", faults.join(", ")),
    ];
    if std::env::var_os("UPDATE_WIRE").is_some() && pinned[0] != now[0] {
        let (note, rest) = GOLDEN.split_once("protocol ").unwrap();
        let (_, messages) = rest.split_once("0x").unwrap();
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/wire/messages.txt");
        std::fs::write(path, format!("{note}{}\n0x{messages}", now.join("\n"))).unwrap();
        return;
    }
    assert_eq!(
        pinned, now,
        "the tables have changed: raise PROTOCOL_MINOR for a new message (with its outcomes) or a new fault, \
         PROTOCOL_MAJOR for anything else; then UPDATE_WIRE=1 pins all three in tests/fixtures/wire/messages.txt"
    );
}

/// Messages of a newer device reach an older host whole, but for the name of the fault.
#[test]
fn a_fault_of_a_newer_device_costs_nothing_else() {
    let newer = Fault::from_number(120);
    assert_eq!(newer.name(), None, "take another number");
    let golden_of = golden(GOLDEN);
    let with_fault = |id: u8, at: usize| {
        let mut payload = golden_of[&id].1.clone();
        payload[at] = 120;
        payload
    };
    let mut receiver = Receiver::default();
    for (seq, (id, payload)) in [
        (Status::ID, with_fault(Status::ID, 1)),
        // Before it: seq 2 bytes, dropped 1, half-cycle 2, state 1; there the half-cycle's 2 alone.
        (Telemetry::ID, with_fault(Telemetry::ID, 6)),
        (FaultEvent::ID, with_fault(FaultEvent::ID, 2)),
    ]
    .into_iter()
    .enumerate()
    {
        let mut out = [0; MAX_ENCODED];
        let number = if is_numbered(id) { &[9, 0][..] } else { &[] };
        let payload = [number, &payload].concat();
        let length = encode_raw(id, seq as u16, &payload, &mut out).unwrap();
        for &byte in &out[..length] {
            receiver.push(byte).unwrap();
        }
    }
    assert_eq!(receiver.counters().messages_malformed, 0);
    let status = Status {
        fault: newer,
        ..status()
    };
    let answer = receiver.answers.pop_front().unwrap();
    assert_eq!(answer.number().to_le_bytes(), [9, 0]);
    assert_eq!(answer.decode(), Some(status));
    let telemetry = Telemetry {
        fault: newer,
        ..telemetry()
    };
    assert_eq!(
        receiver.events.pop_front(),
        Some(DeviceEvent::Telemetry(telemetry))
    );
    let Some(DeviceEvent::Fault(event)) = receiver.events.pop_front() else {
        panic!("the fault event is missing");
    };
    assert_eq!((event.half_cycle, event.fault), (3_002, newer));
    assert!(event.fault.to_string().starts_with("fault 120 ("));
}

/// Frozen for ever, so pinned here once more: who changes this array breaks every older peer.
#[test]
fn hello_is_frozen() {
    const PAYLOAD: &str = "c990918a030182028406888e98a8c0e080810105effdb6f50d03ac021269\
                           68642d6669726d7761726520302e312e3005626f617264";
    let (_, payload, _) = &golden(HELLO)[&1];
    assert_eq!(payload, &unhex(PAYLOAD));
    assert_eq!(MAGIC.to_le_bytes(), *b"IHD1");
    assert_eq!(Hello::ID, 1);
}

/// The transmit queue drops what does not fit a frame, so the longest of each message has to fit.
#[test]
fn the_longest_of_every_message_fits_a_frame() {
    let name = "x".repeat(32);
    let mut longest = samples(&[0xFF; CHUNK_BYTES], &[0xFF; LEN]);
    for message in &mut longest {
        match message {
            AnyMessage::Hello(m) => {
                *m = Hello {
                    magic: u32::MAX,
                    role: u8::MAX,
                    protocol_major: u16::MAX,
                    protocol_minor: u16::MAX,
                    schema_hash: u64::MAX,
                    capabilities: u32::MAX,
                    boot_id: u32::MAX,
                    reset_reason: u8::MAX,
                    fault_before_reset: u16::MAX,
                    build: name.as_str().try_into().unwrap(),
                    board: name.as_str().try_into().unwrap(),
                }
            }
            AnyMessage::PushLookup(m) => m.blob = Raw(&[0xFF; LEN]),
            AnyMessage::ReplayBlocks(m) => {
                (m.zero_crossing, m.bus_dv) = (u16::MAX, u16::MAX);
                m.data = Raw(&[0xFF; BLOCKS_PER_MESSAGE * BLOCK_BYTES]);
            }
            AnyMessage::WindowChunk(m) => (m.seq, m.offset) = (u32::MAX, u16::MAX),
            AnyMessage::TrajectoryChunk(m) => (m.seq, m.offset) = (u32::MAX, u16::MAX),
            AnyMessage::LinkData(m) => m.seq = u32::MAX,
            AnyMessage::Log(m) => (m.seq, m.dropped) = (u32::MAX, u32::MAX),
            // Two short runs of bytes and nine integers.
            AnyMessage::Board(_) => {}
            // Integers only, at most 22 of at most 5 bytes: far below a frame.
            _ => {}
        }
        assert!(framed(message, Number::FIRST, u16::MAX).len() <= MAX_ENCODED);
    }
}
