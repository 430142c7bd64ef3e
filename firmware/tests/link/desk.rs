//! Board with a pot that heats, and its line to a host.

use std::f64::consts::{FRAC_2_PI, TAU};

use ihd_firmware::link::housekeeping::Housekeeping;
use ihd_firmware::sampling::path::{AdcBlock, SamplingPath};
use ihd_firmware::sense::bus::BusReading;
use ihd_shared::hob::RESONANCE_CAPACITANCE_NF;
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_shared::sampling::{ADC_LOCK_P, AMPERE_PER_CODE, Pair, VOLT_PER_CODE, block_ns};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::frame::{MAX_ENCODED, encode, encode_numbered};
use ihd_shared::wire::hello::{ROLE_DEVICE, ROLE_HOST, ours};
use ihd_shared::wire::messages::{
    AnyMessage, Message, Outcome, PushLookup, Raw, ReplayStart, Request, SetPower, State,
};
use ihd_shared::wire::number::Number;

/// Half-cycle of 50 Hz, in nanoseconds.
pub const HALF_CYCLE_NS: u32 = 10_000_000;

/// R and X in ohm and crest current in ampere of the pot's samples, whatever the frequency.
const POT: (f64, f64, f64) = (4.2, 8.6, 26.0);

/// Board with a pot, and a line to its host.
pub struct Desk {
    pub path: Box<SamplingPath>,
    pub housekeeping: Box<Housekeeping>,
    /// Blocks so far, and the time since the mains crossed zero, in nanoseconds.
    pub block: u64,
    pub since_crossing_ns: u32,
    pub mains: bool,
    /// Line that gives the device what it sends.
    pub echoes: bool,
    pub number: Number,
    pub sent: u16,
}

impl Desk {
    /// A board that has mains and was greeted by a host.
    pub fn new() -> Self {
        let hello = ours(ROLE_DEVICE, 0, 1, "desk", "desk");
        let mut desk = Self {
            path: Box::new(SamplingPath::new(
                MicroOhm(4_000_000),
                PicoHenry(26_000_000),
            )),
            housekeeping: Box::new(Housekeeping::new(hello)),
            block: 0,
            since_crossing_ns: 0,
            mains: true,
            echoes: false,
            number: Number::NONE,
            sent: 0,
        };
        desk.notice(&ours(ROLE_HOST, 0, 2, "host", "host"));
        desk
    }

    /// Pairs of this block; no two are alike.
    fn pairs(&self, envelope: f64) -> [Pair; ADC_LOCK_P] {
        let (r_ohm, x_ohm, crest_a) = POT;
        let i_a = if self.path.drive().is_switching() {
            crest_a * envelope
        } else {
            0.0
        };
        let mut pairs = core::array::from_fn(|n| {
            // The current lags the bridge's voltage by a fifth of a period.
            let angle = TAU * ((3 * n) as f64 / 61.0 - 0.2);
            let v = i_a * (r_ohm * angle.sin() + x_ohm * angle.cos());
            Pair {
                v: (v / VOLT_PER_CODE).round() as i16,
                i: (i_a * angle.sin() / AMPERE_PER_CODE).round() as i16,
            }
        });
        pairs[0].v ^= (self.block & 3) as i16;
        pairs
    }

    pub fn step(&mut self) {
        let crosses = self.since_crossing_ns >= HALF_CYCLE_NS;
        if crosses {
            self.since_crossing_ns -= HALF_CYCLE_NS;
        }
        let phase = f64::from(self.since_crossing_ns) / f64::from(HALF_CYCLE_NS);
        let envelope = (TAU * 0.5 * phase).sin();
        let f_hz = f64::from(self.path.drive().f_sw_hz);
        let x_c_ohm = 1e9 / (TAU * f_hz * f64::from(RESONANCE_CAPACITANCE_NF));
        let (r_ohm, x_ohm, crest_a) = POT;
        let bus_dv = 10.0 * crest_a * r_ohm.hypot(x_ohm - x_c_ohm) / FRAC_2_PI * envelope;
        let pairs = self.pairs(envelope);
        self.path.on_block(&AdcBlock {
            pairs: &pairs,
            zero_crossing: (crosses && self.mains).then_some(0),
            bus: BusReading::steady(bus_dv as u16),
            dc_link_ma: None,
            lost: 0,
        });
        self.block += 1;
        self.since_crossing_ns += block_ns(self.path.drive().f_sw_hz);
        self.housekeeping.poll(&mut *self.path);
        let frame = self.transmit();
        if self.echoes {
            self.housekeeping.receive(&mut *self.path, &frame);
        }
    }

    pub fn run_ms(&mut self, ms: u32) {
        let until = self.path.now_ms() + ms;
        while self.path.now_ms() < until {
            self.step();
        }
    }

    pub fn run_to_crest(&mut self) {
        while self.since_crossing_ns < HALF_CYCLE_NS / 2 {
            self.step();
        }
    }

    /// The next frame of the device; empty without one.
    pub fn transmit(&mut self) -> Vec<u8> {
        let mut out = [0; MAX_ENCODED];
        let length = self.housekeeping.transmit(&mut *self.path, &mut out);
        out[..length].to_vec()
    }

    pub fn notice(&mut self, message: &impl Message) {
        let mut frame = [0; MAX_ENCODED];
        let length = encode(message, self.sent, &mut frame).expect("it fits");
        self.sent += 1;
        self.housekeeping.receive(&mut *self.path, &frame[..length]);
        while !self.transmit().is_empty() {}
    }

    /// Sends a request; returns id and payload of its answer, without the number.
    pub fn request(&mut self, request: &impl Request) -> (u8, Vec<u8>) {
        let mut frame = [0; MAX_ENCODED];
        self.number = self.number.next();
        let length = encode_numbered(request, self.number, self.sent, &mut frame);
        self.sent += 1;
        let frame = &frame[..length.expect("it fits")];
        self.housekeeping.receive(&mut *self.path, frame);
        let mut answer = None;
        let mut deframer = Deframer::new();
        loop {
            let bytes = self.transmit();
            if bytes.is_empty() {
                return answer.expect("the device answers at once");
            }
            for byte in bytes {
                if let Some(Ok(frame)) = deframer.push(byte)
                    && frame.split().0 == self.number
                {
                    answer = Some((frame.id, frame.split().1.to_vec()));
                }
            }
        }
    }

    /// Asks for a replay at a frequency; returns the outcome, `Ok` where it begins.
    pub fn start_replay(&mut self, f_sw_hz: u32) -> Outcome {
        let (r, l) = (MicroOhm(4_000_000), PicoHenry(26_000_000));
        let (id, bytes) = self.request(&ReplayStart { f_sw_hz, r, l });
        match AnyMessage::decode(id, &bytes) {
            Ok(AnyMessage::Reply(reply)) => reply.outcome,
            Ok(AnyMessage::ReplayMode(mode)) if mode.active => Outcome::Ok,
            other => panic!("{other:?}"),
        }
    }

    /// Sends a request that a `Reply` answers; returns the outcome.
    pub fn outcome(&mut self, request: &impl Request) -> Outcome {
        let (id, bytes) = self.request(request);
        match AnyMessage::decode(id, &bytes) {
            Ok(AnyMessage::Reply(reply)) => reply.outcome,
            other => panic!("{other:?}"),
        }
    }

    pub fn push(&mut self, version: u32) -> Outcome {
        let lookup = RlLookup { version, ..prior() };
        self.outcome(&PushLookup {
            blob: Raw(&lookup.to_bytes()),
        })
    }

    /// Heats with 1,000 W.
    pub fn heat(&mut self) {
        self.request(&SetPower { power_w: 1_000 });
        self.run_ms(2_000);
        assert_eq!(self.housekeeping.control().state(), State::Heating);
        assert!(self.path.drive().is_switching());
    }

    pub fn asked_w(&self) -> u16 {
        self.housekeeping.control().asked_w()
    }
}
