//! Script of a hob: the firmware's handling of frames and time, without the physics.

use std::collections::VecDeque;
use std::time::Duration;

use ihd_firmware::link::conversation::{Conversation, RequestOrder};
use ihd_firmware::link::identity::DeviceIdentity;
use ihd_shared::fault::Fault;
use ihd_shared::hob::{RATED_POWER_W, REQUESTED_POWER_MAX_W};
use ihd_shared::lookup::{LOOKUP_VERSION_STEP, RlLookup, prior::prior};
use ihd_shared::sampling::{I_FULL_SCALE_MA, V_FULL_SCALE_MV};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::window::{CHUNK_BYTES, PAIR_BYTES, TrajectoryEntry};
use ihd_shared::wire::frame::{CRC32, MAX_ENCODED, encode_numbered};
use ihd_shared::wire::hello::{CAP_SIMULATED, ROLE_DEVICE, check, ours};
use ihd_shared::wire::messages::{
    AnyMessage, FaultEvent, FrontEnd, Hello, Limit, LookupBlob, Message, OffReason, Outcome, Pot,
    Raw, Reply, State, Status, Telemetry, TrajectoryChunk, WindowChunk, WindowEnd, WindowStart,
};
use ihd_shared::wire::number::Number;
use ihd_shared::wire::timing::HOST_UNHEARD_MS;

use super::hob::{WorldHob, read_frame};
use super::samples;

/// One half-cycle at 50 Hz.
const HALF_CYCLE: Duration = Duration::from_millis(10);

/// Half-cycles between two telemetry messages, whatever rate is requested: fewer frames, the same order of events.
const TELEMETRY_EVERY: u32 = 10;

/// Half-cycles between two windows.
const WINDOW_EVERY: u32 = 70;

/// Half-cycles between two windows that show a load, whose identification takes a hundred times as long.
const LOADED_WINDOW_EVERY: u32 = 200;

/// Hob as a script.
pub struct ScriptedHob {
    /// Number of the boot.
    boot_id: u32,
    /// Requested power, in watt.
    asked_w: u16,
    lookup: RlLookup,
    /// Number of windows since the boot.
    windows: u32,
    /// `true` if its windows show [`samples::LOAD`] while it heats.
    is_loaded: bool,
    hello: Hello,
    half_cycle: u32,
    /// World's time of half-cycle 0.
    began: Duration,
    unheard: u32,
    is_paired: bool,
    streams: bool,
    telemetries: u32,
    fault: Fault,
    pending: Option<RlLookup>,
    frame_seq: u16,
    conversation: Conversation,
    /// Number of the last request; its response is in `answer`.
    number: Number,
    answer: Option<Vec<u8>>,
    /// Frames for the host, each with its time of sending.
    sent: VecDeque<(Duration, Vec<u8>)>,
}

impl ScriptedHob {
    /// Creates a hob that is switched on at the world's time `now`.
    pub fn new(boot_id: u32, now: Duration) -> Self {
        Self {
            boot_id,
            asked_w: 0,
            lookup: prior(),
            windows: 0,
            is_loaded: false,
            hello: ours(ROLE_DEVICE, CAP_SIMULATED, boot_id, "script 1.0", "script"),
            half_cycle: 0,
            began: now,
            unheard: 0,
            is_paired: false,
            streams: false,
            telemetries: 0,
            fault: Fault::NONE,
            pending: None,
            frame_seq: 0,
            conversation: Conversation::default(),
            number: Number::NONE,
            answer: None,
            sent: VecDeque::new(),
        }
    }

    /// Makes windows show a load while it heats, or not.
    pub fn loaded(self, is_loaded: bool) -> Self {
        Self { is_loaded, ..self }
    }

    fn now(&self) -> Duration {
        self.began + HALF_CYCLE * self.half_cycle
    }

    fn send<M: Message>(&mut self, message: &M) {
        let mut frame = [0; MAX_ENCODED];
        let length = encode_numbered(message, self.number, self.frame_seq, &mut frame)
            .expect("it fits a frame");
        self.frame_seq = self.frame_seq.wrapping_add(1);
        let frame = frame[..length].to_vec();
        if M::PART.is_numbered() {
            self.answer = Some(frame.clone());
        }
        let at = self.now();
        self.sent.push_back((at, frame));
    }

    fn reply(&mut self, outcome: Outcome, detail: u32) {
        self.send(&Reply { outcome, detail });
    }

    fn state(&self) -> State {
        match (self.fault == Fault::NONE, self.asked_w) {
            (false, _) => State::Pausing,
            (true, 0) => State::Idle,
            (true, _) => State::Heating,
        }
    }

    fn send_telemetry(&mut self) {
        self.telemetries += 1;
        let telemetry = Telemetry {
            seq: self.telemetries,
            dropped: 0,
            half_cycle: self.half_cycle,
            state: self.state(),
            fault: self.fault,
            pot: Pot::Ferromagnetic,
            f_sw_hz: if self.asked_w > 0 { 45_000 } else { 0 },
            r: MicroOhm(4_000_000),
            l: PicoHenry(50_000_000),
            i_crest_ma: 30_000,
            power_mw: 1_000 * u32::from(self.asked_w),
            phase_mrad: 700,
            lookup_version: self.lookup.version,
            asked_w: self.asked_w,
            limit: Limit::None,
            bus_peak_dv: 3_250,
            v_coil_peak_dv: 4_000,
            i_turn_off_min_ma: 20_000,
            off_reason: OffReason::None,
            glass_hot: false,
        };
        self.send(&telemetry);
    }

    fn send_window(&mut self) {
        let seq = self.windows;
        self.windows += 1;
        let pairs = match self.is_loaded && self.asked_w > 0 {
            true => samples::with_load(),
            false => samples::without_load(),
        };
        let entry = TrajectoryEntry {
            r: MicroOhm(4_000_000),
            l: PicoHenry(50_000_000),
        };
        let trajectory = entry.to_le_bytes();
        self.send(&WindowStart {
            seq,
            dropped: 0,
            half_cycle: self.half_cycle,
            f_sw_hz: samples::F_SW_HZ,
            half_cycle_ns: 10_000_000,
            first_pair_ns: 1_000,
            first_trajectory_ns: 40_000,
            pairs: u16::try_from(pairs.len() / PAIR_BYTES).expect("a half-cycle"),
            trajectory: 1,
            saturated: 0,
            lookup_version: self.lookup.version,
            v_full_scale_mv: V_FULL_SCALE_MV,
            i_full_scale_ma: I_FULL_SCALE_MA,
        });
        for (k, chunk) in pairs.chunks(CHUNK_BYTES).enumerate() {
            let offset = k * CHUNK_BYTES / PAIR_BYTES;
            self.send(&WindowChunk {
                seq,
                offset: u16::try_from(offset).expect("a half-cycle"),
                data: Raw(chunk),
            });
        }
        self.send(&TrajectoryChunk {
            seq,
            offset: 0,
            data: Raw(&trajectory),
        });
        let mut digest = CRC32.digest();
        digest.update(&pairs);
        digest.update(&trajectory);
        let crc32 = digest.finalize();
        self.send(&WindowEnd { seq, crc32 });
    }

    fn handle(&mut self, number: Number, message: &AnyMessage<'_>) {
        if !matches!(message, AnyMessage::ResendWindow(_)) {
            self.unheard = 0;
        }
        if let AnyMessage::Hello(theirs) = message {
            return self.pair(theirs);
        }
        if !self.is_paired {
            return;
        }
        match self.conversation.turn(number) {
            RequestOrder::New => self.carry_out(number, message),
            RequestOrder::Again => {
                let at = self.now();
                self.sent
                    .extend(self.answer.clone().map(|frame| (at, frame)));
            }
            RequestOrder::Past | RequestOrder::Unnumbered => {}
        }
    }

    fn carry_out(&mut self, number: Number, message: &AnyMessage<'_>) {
        (self.number, self.answer) = (number, None);
        match message {
            AnyMessage::SetPower(m) => self.set_power(m.power_w),
            AnyMessage::Stream(m) => {
                self.streams = m.telemetry_every > 0;
                self.reply(Outcome::Ok, 0);
            }
            AnyMessage::GetStatus(_) => self.send_status(),
            AnyMessage::GetFrontEnd(_) => self.send_front_end(),
            AnyMessage::GetBoard(_) => self.send(&DeviceIdentity::default().message()),
            AnyMessage::ReadLookup(_) => {
                let blob = self.lookup.to_bytes();
                self.send(&LookupBlob { blob: Raw(&blob) });
            }
            AnyMessage::PushLookup(m) => {
                let (outcome, detail) = self.accept(m.blob.0);
                self.reply(outcome, detail);
            }
            AnyMessage::ResetLookup(_) => {
                self.pending = Some(prior());
                self.reply(Outcome::Ok, 0);
            }
            AnyMessage::ClearFault(_) => {
                self.fault = Fault::NONE;
                self.reply(Outcome::Ok, 0);
            }
            _ => {}
        }
    }

    fn pair(&mut self, theirs: &Hello) {
        self.asked_w = 0;
        self.is_paired = check(&self.hello, theirs).is_ok();
        self.streams = false;
        self.discard_sent();
        self.conversation = Conversation::default();
        (self.number, self.answer) = (Number::NONE, None);
        let hello = self.hello.clone();
        self.send(&hello);
    }

    fn set_power(&mut self, power_w: u16) {
        if power_w > REQUESTED_POWER_MAX_W {
            return self.reply(Outcome::PowerOutOfRange, u32::from(REQUESTED_POWER_MAX_W));
        }
        if power_w > 0 && self.fault != Fault::NONE {
            let number = u32::from(self.fault.number());
            return self.reply(Outcome::FaultActive, number);
        }
        self.asked_w = power_w.min(RATED_POWER_W);
        self.reply(Outcome::Ok, u32::from(self.asked_w));
    }

    fn accept(&mut self, blob: &[u8]) -> (Outcome, u32) {
        let version = self.lookup.version;
        let highest = version.saturating_add(LOOKUP_VERSION_STEP);
        match RlLookup::from_bytes(blob) {
            Err(why) => why.outcome(),
            Ok(_) if self.pending.is_some() => (Outcome::Busy, 0),
            Ok(lookup) if lookup.version <= version => (Outcome::LookupStale, version),
            Ok(lookup) if lookup.version > highest => (Outcome::LookupStep, highest),
            Ok(lookup) => {
                self.pending = Some(lookup);
                (Outcome::Ok, 0)
            }
        }
    }

    fn send_front_end(&mut self) {
        self.send(&FrontEnd {
            v_full_scale_mv: V_FULL_SCALE_MV,
            i_full_scale_ma: I_FULL_SCALE_MA,
            bus_full_scale_mv: 500_000,
            mains_full_scale_mv: 500_000,
            bits: 12,
        });
    }

    fn send_status(&mut self) {
        self.send(&Status {
            state: self.state(),
            fault: self.fault,
            pot: Pot::Ferromagnetic,
            asked_w: self.asked_w,
            delivered_mw: 1_000 * u32::from(self.asked_w),
            f_sw_hz: if self.asked_w > 0 { 45_000 } else { 0 },
            lookup_version: self.lookup.version,
            half_cycles: self.half_cycle,
            windows_recorded: self.windows,
            windows_dropped: 0,
            telemetry_dropped: 0,
            frames_bad: 0,
            frames_lost: 0,
            saturated_pairs: 0,
            limit: Limit::None,
            tries_left: 3,
            heat_sink_c: 30,
            glass_c: 60,
            coil_c: 40,
            fan: false,
            panel_level: 255,
            key_locked: false,
            off_reason: OffReason::None,
            glass_hot: false,
            timer_min: 0,
        });
    }
}

impl WorldHob for ScriptedHob {
    fn asked_w(&self) -> u16 {
        self.asked_w
    }

    fn lookup(&self) -> &RlLookup {
        &self.lookup
    }

    fn receive(&mut self, frame: &[u8]) {
        read_frame(frame, |number, message| self.handle(number, message));
    }

    fn is_locked_out(&self) -> bool {
        false
    }

    /// Restarts; only the lookup, which is in flash, is retained.
    fn reboot(&mut self, now: Duration) {
        let lookup = self.lookup.clone();
        *self = Self::new(self.boot_id + 1, now).loaded(self.is_loaded);
        self.lookup = lookup;
    }

    /// Switches the bridge off; power is refused until the fault is cleared.
    fn trip(&mut self) {
        self.asked_w = 0;
        self.fault = Fault::from_number(1);
        let (half_cycle, fault) = (self.half_cycle, self.fault);
        self.send(&FaultEvent { half_cycle, fault });
    }

    fn take_sent(&mut self, now: Duration) -> Option<Vec<u8>> {
        match self.sent.front() {
            Some((at, _)) if *at <= now => self.sent.pop_front().map(|(_, frame)| frame),
            _ => None,
        }
    }

    fn discard_sent(&mut self) {
        self.sent.clear();
    }

    fn advance_to(&mut self, now: Duration) {
        while self.now() + HALF_CYCLE <= now {
            self.half_cycle += 1;
            self.unheard = self.unheard.saturating_add(1);
            if self.unheard * 10 >= HOST_UNHEARD_MS {
                self.asked_w = 0;
            }
            if let Some(lookup) = self.pending.take() {
                self.lookup = lookup;
            }
            if self.is_paired && self.streams {
                if self.half_cycle.is_multiple_of(TELEMETRY_EVERY) {
                    self.send_telemetry();
                }
                let window_every = match self.is_loaded {
                    true => LOADED_WINDOW_EVERY,
                    false => WINDOW_EVERY,
                };
                if self.half_cycle.is_multiple_of(window_every) {
                    self.send_window();
                }
            }
        }
    }
}
