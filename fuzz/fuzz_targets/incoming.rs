//! The host's receiving end on frames with valid CRCs, whole and damaged windows, and raw bytes between.
//!
//! What must hold:
//! - every window of which anything came ends in a whole window or in a counted rejection, once the stream is over;
//! - every good frame is one of: an answer, telemetry, a fault, a log, a window message, bytes of a test of the link,
//!   malformed, unknown;
//! - events and counters agree, and no frame makes more than three events, two windows that are given up and its own: a client
//!   that takes them out holds no more than what it has not taken, and the windows under way;
//! - a window given out is within its bounds, and its segment has finite numbers.

#![cfg_attr(fuzzing, no_main)]

mod reader;

use ihd_link::receiver::{DeviceEvent, Receiver};
use ihd_link::window::{MAX_SATURATED_FRACTION, Window};
use ihd_shared::window::{MAX_PAIRS, MAX_TRAJECTORY, PAIR_BYTES, TRAJECTORY_ENTRY_BYTES};
use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::frame::CRC32;
use ihd_shared::wire::messages::{
    AnyMessage, MESSAGES, Message, Raw, TrajectoryChunk, WindowChunk, WindowEnd, WindowStart,
};
use reader::{Reader, framed, framed_raw};

/// Bytes that one input may send.
const MAX_BYTES: u64 = 150_000;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let mut reader = Reader(bytes);
    let mut host = Host::default();
    while !reader.is_empty() && host.sent < MAX_BYTES {
        match reader.u8() % 8 {
            0 => {
                let length = usize::from(reader.u8());
                host.send(reader.bytes(length));
            }
            1 | 2 => {
                let (id, length) = (reader.u8(), usize::from(reader.u16()) % 1_018);
                // One of the table, or any.
                let row = MESSAGES.get(usize::from(id)).and_then(|m| m.id);
                host.frame(row.unwrap_or(id), reader.bytes(length));
            }
            3 | 4 => host.window(&mut reader),
            5 => host.piece(&mut reader),
            6 => host.take(),
            _ => host.receiver.restart_sequence(),
        }
    }
    host.receiver.finish();
    host.take();
    host.check();
});

/// The receiving end, and what was sent to it and taken from it.
#[derive(Default)]
struct Host {
    receiver: Receiver,
    seq: u16,
    sent: u64,
    /// Finds the same frames, to count window messages.
    frames: Deframer,
    starts: u32,
    window_messages: u32,
    answers: u32,
    telemetry: u32,
    faults: u32,
    windows: u32,
    rejected: u32,
    logs: u32,
    link_data: u32,
}

impl Host {
    fn send(&mut self, bytes: &[u8]) {
        self.sent += bytes.len() as u64;
        for &byte in bytes {
            if let Some(Ok(frame)) = self.frames.push(byte) {
                match AnyMessage::decode(frame.id, frame.split().1) {
                    Ok(AnyMessage::WindowStart(_)) => {
                        self.starts += 1;
                        self.window_messages += 1;
                    }
                    Ok(
                        AnyMessage::WindowChunk(_)
                        | AnyMessage::TrajectoryChunk(_)
                        | AnyMessage::WindowEnd(_)
                        | AnyMessage::WindowGone(_),
                    ) => self.window_messages += 1,
                    Ok(AnyMessage::LinkData(_)) => self.link_data += 1,
                    _ => {}
                }
            }
            let before = (self.receiver.events.len(), self.receiver.answers.len());
            let _ = self.receiver.push(byte);
            assert!(self.receiver.events.len() <= before.0 + 3);
            assert!(self.receiver.answers.len() <= before.1 + 1);
        }
    }

    fn frame(&mut self, id: u8, payload: &[u8]) {
        let bytes = framed_raw(id, self.seq, payload);
        self.seq = self.seq.wrapping_add(1);
        self.send(&bytes);
    }

    fn message<M: Message>(&mut self, message: &M) {
        let bytes = framed(message, self.seq);
        self.seq = self.seq.wrapping_add(1);
        self.send(&bytes);
    }

    /// A window as a device sends it, or with one thing wrong.
    fn window(&mut self, reader: &mut Reader<'_>) {
        let (seq, wrong) = (u32::from(reader.u8()) % 64, reader.u8());
        let start = start(seq, reader);
        let pattern = reader.array::<8>();
        let fill = |n: usize| -> Vec<u8> { pattern.iter().copied().cycle().take(n).collect() };
        let pairs = fill(usize::from(start.pairs) * PAIR_BYTES);
        let trajectory = fill(usize::from(start.trajectory) * TRAJECTORY_ENTRY_BYTES);
        let mut digest = CRC32.digest();
        digest.update(&pairs);
        digest.update(&trajectory);
        let crc32 = digest.finalize() ^ u32::from(wrong == 1);
        self.message(&start);
        if wrong == 2 {
            self.message(&start);
        }
        for (k, data) in pairs.chunks(960).enumerate() {
            let offset = (k * 240) as u16;
            let data = Raw(data);
            if !(wrong == 3 && k == 1) {
                self.message(&WindowChunk { seq, offset, data });
            }
            if wrong == 4 && k == 0 {
                self.message(&WindowChunk { seq, offset, data });
            }
        }
        for (k, data) in trajectory.chunks(960).enumerate() {
            let (offset, data) = ((k * 120) as u16, Raw(data));
            self.message(&TrajectoryChunk { seq, offset, data });
        }
        if wrong != 5 {
            self.message(&WindowEnd { seq, crc32 });
        }
    }

    /// One message of a window, in any order.
    fn piece(&mut self, reader: &mut Reader<'_>) {
        let (what, seq) = (reader.u8(), u32::from(reader.u8()) % 64);
        let offset = reader.u16();
        let length = usize::from(reader.u8());
        let crc32 = reader.u32();
        match what % 4 {
            0 => {
                let start = start(seq, reader);
                self.message(&start);
            }
            1 => {
                let data = Raw(reader.bytes(length));
                self.message(&WindowChunk { seq, offset, data });
            }
            2 => {
                let data = Raw(reader.bytes(length));
                self.message(&TrajectoryChunk { seq, offset, data });
            }
            _ => self.message(&WindowEnd { seq, crc32 }),
        }
    }

    /// Takes out what a client takes.
    fn take(&mut self) {
        self.answers += self.receiver.answers.drain(..).count() as u32;
        for event in self.receiver.events.drain(..) {
            match event {
                DeviceEvent::Telemetry(_) => self.telemetry += 1,
                DeviceEvent::Fault(fault) => {
                    assert!(!format!("{:?}", fault.fault).is_empty());
                    self.faults += 1;
                }
                DeviceEvent::Window(window) => {
                    check_window(&window);
                    self.windows += 1;
                }
                DeviceEvent::WindowRejected { reason, .. } => {
                    assert!(!reason.to_string().is_empty());
                    self.rejected += 1;
                }
                DeviceEvent::Log { .. } => self.logs += 1,
            }
        }
    }

    fn check(&self) {
        let counters = self.receiver.counters();
        let rejected = counters.windows_rejected_total();
        assert_eq!(counters.bytes, self.sent);
        assert_eq!(counters.telemetry.received, self.telemetry);
        assert_eq!(counters.windows.received, self.windows);
        assert_eq!(rejected, self.rejected);
        // Of whatever anything came ends once, by now.
        assert_eq!(
            self.windows + rejected,
            counters.windows_begun,
            "{counters:?}"
        );
        assert!(self.windows <= self.starts, "{counters:?}");
        let told = self.answers + self.telemetry + self.faults + self.logs;
        let others = told + self.window_messages + self.link_data;
        let unread = counters.messages_malformed + counters.messages_unknown;
        assert_eq!(counters.frames_good, others + unread);
    }
}

fn start(seq: u32, reader: &mut Reader<'_>) -> WindowStart {
    // Few pairs mostly, so that an input holds many windows; sometimes too many.
    let (size, full) = (u16::from(reader.u8()), reader.u8() == 1);
    WindowStart {
        seq,
        dropped: u32::from(reader.u8()),
        half_cycle: seq,
        f_sw_hz: u32::from(reader.u8()) * 1_000,
        half_cycle_ns: 1 << (reader.u8() % 32),
        first_pair_ns: reader.u32() as i32,
        first_trajectory_ns: reader.u32() as i32,
        pairs: if full { 16_384 - 250 + size } else { 3 * size },
        trajectory: u16::from(reader.u8()) * 5 / 4,
        saturated: u16::from(reader.u8()) / 16,
        lookup_version: 0,
        v_full_scale_mv: 640_000,
        i_full_scale_ma: 80_000,
    }
}

fn check_window(window: &Window) {
    let pairs = window.pairs.len();
    assert!((1..=MAX_PAIRS).contains(&pairs) && window.trajectory.len() <= MAX_TRAJECTORY);
    let saturated = window.pairs.iter().filter(|p| p.is_saturated()).count();
    assert!(saturated <= usize::from(window.saturated));
    assert!(f64::from(window.saturated) <= MAX_SATURATED_FRACTION * pairs as f64);
    let segment = window.segment();
    assert_eq!((segment.v_v.len(), segment.i_a.len()), (pairs, pairs));
    let numbers = [
        segment.f_sw_hz,
        segment.mains_hz,
        segment.t0_s,
        segment.dt_s,
    ];
    assert!(numbers.iter().all(|x| x.is_finite()) && segment.dt_s > 0.0);
    assert!(
        window
            .trajectory_time_s(window.trajectory.len())
            .is_finite()
    );
}
