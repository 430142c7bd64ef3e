//! The firmware with any frames from a host, and any samples from its board.
//!
//! What must hold after every block:
//! - the bridge is off while a fault is active, in replay mode, and unless the controller probes or heats
//!   for power that was asked for, at most the rating;
//! - the switching frequency is within the hob's ratings, and changes only at a zero crossing while the
//!   bridge runs;
//! - what the device sends are good frames in sequence, of messages that a host knows; frequencies in
//!   telemetry are zero or within the ratings, and a window whose samples were in range arrives whole
//!   unless a hello cut it off;
//! - bytes are taken as long as the answers are;
//! - the active lookup is plausible, and its version never falls.

#![cfg_attr(fuzzing, no_main)]

mod host_frames_board;
mod reader;

use host_frames_board::Board;
use ihd_firmware::drive::bridge::{Bridge, Drive};
use ihd_firmware::link::housekeeping::Housekeeping;
use ihd_firmware::sampling::path::SamplingPath;
use ihd_link::receiver::{DeviceEvent, Receiver};
use ihd_shared::fault::Fault;
use ihd_shared::hob::{F_SW_MAX_HZ, F_SW_MIN_HZ, RATED_POWER_W};
use ihd_shared::lookup::plausible;
use ihd_shared::lookup::prior::prior;
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::wire::frame::MAX_ENCODED;
use ihd_shared::wire::hello::{CAP_SIMULATED, ROLE_DEVICE, ROLE_HOST, ours};
use ihd_shared::wire::messages::{
    ClearFault, GetStatus, Hello, MESSAGES, Message, PushLookup, Raw, ReadLookup, ReplayBlocks,
    ReplayEnd, ReplayStart, SetPower, State, Status, Stream,
};
use reader::{Reader, framed, framed_raw};

/// Blocks that one input may run: some forty half-cycles.
const MAX_BLOCKS: u32 = 10_000;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let mut reader = Reader(bytes);
    let mut device = Device::new(reader.u8());
    while !reader.is_empty() && device.blocks < MAX_BLOCKS {
        match reader.u8() % 8 {
            0..4 => device.command(&mut reader),
            4 | 5 => {
                let blocks = u32::from(reader.u8());
                device.board.change(&mut reader);
                for _ in 0..blocks {
                    device.block();
                }
            }
            6 => device.rest_of_half_cycle(),
            _ => device.link_is_read = reader.u8() % 4 != 0,
        }
    }
    device.link_is_read = true;
    device.exchange();
    device.check_link();
});

/// The firmware, the board around it, and a host that listens.
struct Device {
    housekeeping: Housekeeping,
    sampling_path: Box<SamplingPath>,
    board: Board,
    host: Receiver,
    to_device: Vec<u8>,
    link_is_read: bool,
    seq: u16,
    hellos: u32,
    blocks: u32,
    drive: Drive,
    lookup_version: u32,
}

impl Device {
    fn new(paired: u8) -> Self {
        let (r, l) = prior().interpolate(F_SW_MAX_HZ, 0);
        let hello = ours(ROLE_DEVICE, CAP_SIMULATED, 7, "fuzz 0.0.0", "fuzz");
        let mut new = Self {
            housekeeping: Housekeeping::new(hello),
            sampling_path: Box::new(SamplingPath::new(r, l)),
            board: Board::default(),
            host: Receiver::default(),
            to_device: Vec::new(),
            link_is_read: true,
            seq: 0,
            hellos: 0,
            blocks: 0,
            drive: Drive::OFF,
            lookup_version: 0,
        };
        if !paired.is_multiple_of(4) {
            new.hello();
        }
        new
    }

    fn hello(&mut self) {
        self.send(&ours(ROLE_HOST, 0, 1, "fuzz 0.0.0", "host"));
    }

    fn send<M: Message>(&mut self, message: &M) {
        let bytes = framed(message, self.seq);
        self.seq = self.seq.wrapping_add(1);
        self.offer(&bytes);
    }

    fn offer(&mut self, bytes: &[u8]) {
        self.to_device.extend_from_slice(bytes);
        self.exchange();
    }

    /// One command of the table, or something like one.
    fn command(&mut self, reader: &mut Reader<'_>) {
        match reader.u8() % 16 {
            0 => self.hello(),
            1 | 2 => {
                let power_w = reader.u16() % 3_000;
                self.send(&SetPower { power_w });
            }
            3 => {
                let [telemetry_every, windows_every] = reader.array().map(|x| x % 4);
                self.send(&Stream {
                    telemetry_every,
                    windows_every,
                });
            }
            4 => self.send(&GetStatus {}),
            5 | 6 => self.push_lookup(reader),
            7 => self.send(&ReadLookup {}),
            8 => self.send(&ClearFault {}),
            9 => {
                let f_sw_hz = 33_000 + u32::from(reader.u16()) % 50_000;
                let (r, l) = (reader.u32() as i32, reader.u32() as i32);
                let (r, l) = (MicroOhm(r), PicoHenry(l));
                self.send(&ReplayStart { f_sw_hz, r, l });
            }
            10 | 11 => self.replay_blocks(reader),
            12 => self.send(&ReplayEnd {}),
            13 => {
                let (id, length) = (reader.u8(), usize::from(reader.u8()));
                // One of the table, or any.
                let row = MESSAGES.get(usize::from(id)).and_then(|m| m.id);
                let frame = framed_raw(row.unwrap_or(id), self.seq, reader.bytes(length));
                self.seq = self.seq.wrapping_add(reader.u8().into());
                self.offer(&frame);
            }
            14 => {
                let length = usize::from(reader.u8());
                self.offer(reader.bytes(length));
            }
            _ => self.sampling_path.raise(Fault::HARDWARE_OVER_CURRENT),
        }
    }

    /// The active lookup with rows scaled, or any bytes.
    fn push_lookup(&mut self, reader: &mut Reader<'_>) {
        let mut lookup = self.housekeeping.lookup().clone();
        lookup.version = lookup.version.wrapping_add(reader.u8().into());
        let (r, l) = (u32::from(reader.u8()), u32::from(reader.u8()));
        let scaled = |x: u16, by: u32| (u32::from(x) * by / 128).min(65_535) as u16;
        lookup.r = lookup.r.map(|row| row.map(|x| scaled(x, r)));
        lookup.l = lookup.l.map(|row| row.map(|x| scaled(x, l)));
        let mut blob = lookup.to_bytes();
        if reader.u8().is_multiple_of(8) {
            let at = usize::from(reader.u16()) % blob.len();
            blob[at] ^= reader.u8();
        }
        self.send(&PushLookup { blob: Raw(&blob) });
    }

    /// Up to five blocks of the board's samples, or a piece of one.
    fn replay_blocks(&mut self, reader: &mut Reader<'_>) {
        self.board.change(reader);
        let count = usize::from(reader.u8() % 6);
        let drive = Drive::switching(self.drive.f_sw_hz);
        // Five blocks do not fit a frame.
        let mut data: Vec<u8> = (0..count.min(4))
            .flat_map(|_| self.board.pairs(drive))
            .flat_map(|pair| pair.to_le_bytes())
            .collect();
        if count == 5 {
            data.truncate(usize::from(reader.u16()) % data.len());
        }
        let message = ReplayBlocks {
            zero_crossing: reader.u16() % 256,
            bus_dv: reader.u16(),
            data: Raw(&data),
        };
        if reader.u8() == 1 {
            self.seq = self.seq.wrapping_sub(1);
        }
        self.send(&message);
    }

    fn rest_of_half_cycle(&mut self) {
        let half_cycle = self.sampling_path.half_cycles();
        for _ in 0..300 {
            self.block();
            if self.sampling_path.half_cycles() != half_cycle {
                break;
            }
        }
    }

    /// One block of samples, then the link, as a board does it.
    fn block(&mut self) {
        let pairs = self.board.pairs(self.drive);
        let block = self.board.block(&pairs, self.drive);
        let was = self.drive;
        self.drive = self.sampling_path.on_block(&block);
        self.blocks += 1;
        assert_eq!(self.drive, self.sampling_path.drive());
        self.check_drive();
        if self.drive.is_switching() && was != self.drive {
            assert_ne!(was.bridge, Bridge::Open);
            // Between two crossings only a soft limit acts, and only upwards.
            let softened = was.bridge == self.drive.bridge && self.drive.f_sw_hz > was.f_sw_hz;
            assert!(
                block.zero_crossing.is_some() || softened,
                "{was:?} {:?}",
                self.drive
            );
        }
        self.housekeeping.poll(&mut *self.sampling_path);
        let lookup = self.housekeeping.lookup();
        if lookup.version != self.lookup_version {
            assert!(lookup.version > self.lookup_version || lookup.version == 0);
            assert_eq!(plausible::check(lookup), Ok(()));
            self.lookup_version = lookup.version;
        }
        self.exchange();
    }

    fn check_drive(&self) {
        let drive = self.drive;
        assert!(
            (F_SW_MIN_HZ..=F_SW_MAX_HZ).contains(&drive.f_sw_hz),
            "{drive:?}"
        );
        if drive.bridge != Bridge::Open {
            let control = self.housekeeping.control();
            assert_eq!(self.sampling_path.fault(), Fault::NONE);
            assert!(!self.sampling_path.is_replaying());
            // Off waits for the zero crossing.
            let ends = !self.sampling_path.requested_drive().is_switching();
            let may = matches!(
                control.state(),
                State::Probing | State::Heating | State::WaitingForPot
            );
            assert!(ends || (may && (1..=RATED_POWER_W).contains(&control.asked_w())));
        }
    }

    /// Bytes to the device, and its frames to the host.
    fn exchange(&mut self) {
        self.housekeeping
            .receive(&mut *self.sampling_path, &self.to_device);
        self.to_device.clear();
        if self.link_is_read {
            self.transmit();
        }
    }

    fn transmit(&mut self) {
        let mut frame = [0; MAX_ENCODED];
        loop {
            let length = self
                .housekeeping
                .transmit(&mut *self.sampling_path, &mut frame);
            if length == 0 {
                return self.listen();
            }
            for &byte in &frame[..length] {
                assert!(self.host.push(byte).is_ok(), "not a frame");
            }
        }
    }

    fn listen(&mut self) {
        let rated = |f_sw_hz: u32| f_sw_hz == 0 || (F_SW_MIN_HZ..=F_SW_MAX_HZ).contains(&f_sw_hz);
        for event in self.host.events.drain(..) {
            match event {
                DeviceEvent::Telemetry(m) => assert!(rated(m.f_sw_hz), "{m:?}"),
                DeviceEvent::Window(w) => assert!(rated(w.f_sw_hz), "{}", w.f_sw_hz),
                DeviceEvent::Fault(_)
                | DeviceEvent::WindowRejected { .. }
                | DeviceEvent::Log { .. } => {}
            }
        }
        for answer in self.host.answers.drain(..) {
            self.hellos += u32::from(answer.id() == Hello::ID);
            if let Some(m) = answer.decode::<Status>() {
                assert!(rated(m.f_sw_hz) && m.asked_w <= RATED_POWER_W);
            }
        }
    }

    fn check_link(&self) {
        let counters = self.host.counters();
        assert_eq!((counters.frames_bad, counters.frames_lost), (0, 0));
        assert_eq!(
            (counters.messages_malformed, counters.messages_unknown),
            (0, 0)
        );
        for (why, windows) in &counters.windows_rejected {
            match *why {
                // The host began anew within it; pieces that were asked for may have come before others.
                "no end" | "missing chunk" | "no start" => assert!(*windows <= self.hellos),
                "saturated" => {}
                _ => panic!("{windows} windows arrive damaged: {why}"),
            }
        }
    }
}
