//! A controller on a desk: the real firmware, fed with computed blocks, behind an in-memory link
//! that can damage what passes.
//!
//! The load is one constant R and L, so a current follows from the drive in closed form; what is
//! tested here is the link, not the physics. Time passes only while somebody waits for bytes.

use std::collections::VecDeque;
use std::f64::consts::{PI, TAU};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use ihd_firmware::drive::bridge::Drive;
use ihd_firmware::link::housekeeping::Housekeeping;
use ihd_firmware::link::service::BoardServices;
use ihd_firmware::sampling::path::{AdcBlock, SamplingPath};
use ihd_firmware::sense::bus::BusReading;
use ihd_link::{Client, LinkError, Transport};
use ihd_shared::board::BARE_COIL_NH;
use ihd_shared::lookup::RlLookup;
use ihd_shared::sampling::{
    ADC_LOCK_P, ADC_LOCK_Q, AMPERE_PER_CODE, Pair, VOLT_PER_CODE, block_ns,
};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::frame::MAX_ENCODED;
use ihd_shared::wire::hello::{CAP_SIMULATED, ROLE_DEVICE, ours};
use ihd_shared::wire::messages::{AnyMessage, Hello, Piece, Program};

/// Half-cycle of the desk's mains, in nanoseconds.
pub const HALF_CYCLE_NS: u64 = 10_000_000;

const BUS_PEAK_V: f64 = 325.0;
const LOAD_L_H: f64 = 26e-6;
/// R at 45 kHz and L of the coil alone.
const EMPTY: (f64, f64) = (0.1, BARE_COIL_NH as f64 * 1e-9);
const C_F: f64 = 1080e-9;

/// Effect of the link on a frame to the host: the bytes that arrive.
pub type Mangle = Box<dyn FnMut(&[u8]) -> Vec<u8> + Send>;

/// Firmware, load and the device's end of the link.
pub struct DeskHob {
    housekeeping: Housekeeping,
    sampling_path: Box<SamplingPath>,
    time_ns: u64,
    /// R of the load at 45 kHz, in ohm; 0 for no pot: the empty coil.
    pub load_ohm: f64,
    blocks: u32,
    /// Bytes the link carries per block; what is more waits in the device.
    pub bytes_per_block: usize,
    /// Housekeeping has its turn every so many blocks.
    pub turn_every: u32,
    /// Effect of the link on each frame to the host.
    pub mangle: Mangle,
    /// Requests for pieces of windows reach the device: it sends them again.
    pub sends_again: bool,
    ears: Deframer,
    to_device: VecDeque<u8>,
    to_host: VecDeque<u8>,
    /// Its board.
    pub board: DeskBoard,
}

/// Board of a desk hob: nothing, or a program that can restart.
#[derive(Default)]
pub struct DeskBoard {
    /// The program can restart.
    pub can_restart: bool,
    /// It has ended for a restart.
    pub has_restarted: bool,
}

impl BoardServices for DeskBoard {
    fn has_program(&self, into: Program) -> bool {
        self.can_restart && into == Program::Firmware
    }
    fn restart(&mut self, _: Program) {
        self.has_restarted = true;
    }
}

/// The hello of a desk device.
pub fn desk_hello() -> Hello {
    ours(ROLE_DEVICE, CAP_SIMULATED, 7, "desk 0.0.0", "desk")
}

impl DeskHob {
    /// A pot stands on the coil, the link is fast and whole.
    pub fn new(hello: Hello) -> Self {
        let (r, l) = (MicroOhm(4_000_000), PicoHenry(26_000_000));
        Self {
            housekeeping: Housekeeping::new(hello),
            sampling_path: Box::new(SamplingPath::new(r, l)),
            time_ns: 0,
            load_ohm: 4.5,
            blocks: 0,
            bytes_per_block: usize::MAX,
            turn_every: 1,
            mangle: Box::new(<[u8]>::to_vec),
            sends_again: true,
            ears: Deframer::new(),
            to_device: VecDeque::new(),
            to_host: VecDeque::new(),
            board: DeskBoard::default(),
        }
    }

    /// The firmware below the sampling path.
    pub fn housekeeping(&self) -> &Housekeeping {
        &self.housekeeping
    }

    /// Starts from a kept lookup, as a board does.
    pub fn restore(&mut self, lookup: RlLookup) {
        self.housekeeping.restore(&mut *self.sampling_path, lookup);
    }

    /// The firmware's sampling path.
    pub fn sampling_path(&mut self) -> &mut SamplingPath {
        &mut self.sampling_path
    }

    /// Time since boot, in nanoseconds.
    pub fn time_ns(&self) -> u64 {
        self.time_ns
    }

    /// Bytes for the device, as they come.
    pub fn offer(&mut self, bytes: &[u8]) {
        if self.sends_again {
            self.to_device.extend(bytes);
        } else {
            self.offer_without_piece_requests(bytes);
        }
        self.exchange();
    }

    /// All but the frames that ask for pieces of windows; those that let go of one pass.
    fn offer_without_piece_requests(&mut self, bytes: &[u8]) {
        let mut frame = Vec::new();
        for &byte in bytes {
            frame.push(byte);
            let Some(Ok(whole)) = self.ears.push(byte) else {
                continue;
            };
            let message = AnyMessage::decode(whole.id, whole.split().1);
            if matches!(message, Ok(AnyMessage::ResendWindow(m)) if m.piece != Piece::Nothing) {
                frame.clear();
            }
            self.to_device.extend(frame.drain(..));
        }
        self.to_device.extend(frame);
    }

    /// Bytes that have arrived at the host.
    pub fn collect(&mut self) -> Vec<u8> {
        self.to_host.drain(..).collect()
    }

    /// Lets time pass.
    pub fn run(&mut self, half_cycles: u64) {
        let end = self.time_ns + half_cycles * HALF_CYCLE_NS;
        while self.time_ns < end {
            self.step();
        }
    }

    /// One block of samples, then the link.
    pub fn step(&mut self) {
        let drive = self.sampling_path.drive();
        let duration = u64::from(block_ns(drive.f_sw_hz));
        let pairs = self.pairs(drive);
        let next_crossing = (self.time_ns / HALF_CYCLE_NS + 1) * HALF_CYCLE_NS;
        let zero_crossing = (next_crossing <= self.time_ns + duration)
            .then(|| ((next_crossing - self.time_ns) * ADC_LOCK_P as u64).div_ceil(duration) as u8);
        let block = AdcBlock {
            pairs: &pairs,
            zero_crossing,
            bus: BusReading::steady((BUS_PEAK_V * self.envelope() * 10.0) as u16),
            dc_link_ma: None,
            lost: 0,
        };
        self.sampling_path.on_block(&block);
        let block_cycles = (duration * 170 / 1_000) as u32;
        self.sampling_path
            .utilisation()
            .add(block_cycles / 4, block_cycles);
        self.time_ns += duration;
        self.blocks += 1;
        if self.blocks.is_multiple_of(self.turn_every) {
            self.housekeeping.poll(&mut *self.sampling_path);
            self.housekeeping
                .serve(&mut *self.sampling_path, &mut self.board);
        }
        self.exchange();
    }

    fn envelope(&self) -> f64 {
        (PI * self.time_ns as f64 / HALF_CYCLE_NS as f64)
            .sin()
            .abs()
    }

    /// Steady alternating current at the switching frequency: I = V1 / Z, V = (R + jωL) I, the upper switch
    /// closing as the block begins; and a code of noise, without which a converter counts as frozen.
    fn pairs(&self, drive: Drive) -> [Pair; ADC_LOCK_P] {
        let noise = |n: usize| (self.blocks.wrapping_mul(2_654_435_761) >> (n % 29)) as i16 & 1;
        if !drive.is_switching() {
            return std::array::from_fn(|n| Pair {
                v: noise(n),
                i: noise(n + 7),
            });
        }
        let f = f64::from(drive.f_sw_hz);
        let (load_ohm, load_h) = if self.load_ohm > 0.0 {
            (self.load_ohm, LOAD_L_H)
        } else {
            EMPTY
        };
        let (r, x) = (load_ohm * (f / 45e3).sqrt(), TAU * f * load_h);
        let v1 = 2.0 / PI * BUS_PEAK_V * self.envelope();
        let x_tank = x - (TAU * f * C_F).recip();
        let (i, at_i) = (v1 / r.hypot(x_tank), -0.5 * PI - x_tank.atan2(r));
        let (v, at_v) = (i * r.hypot(x), at_i + x.atan2(r));
        std::array::from_fn(|n| {
            let turns = n as f64 * f64::from(ADC_LOCK_Q) / ADC_LOCK_P as f64;
            let code = |x: f64, per_code: f64| (x / per_code).round() as i16;
            Pair {
                v: code(v * (TAU * turns + at_v).cos(), VOLT_PER_CODE) + noise(n),
                i: code(i * (TAU * turns + at_i).cos(), AMPERE_PER_CODE) + noise(n + 7),
            }
        })
    }

    fn exchange(&mut self) {
        let offered = self.to_device.make_contiguous();
        self.housekeeping.receive(&mut *self.sampling_path, offered);
        self.to_device.clear();
        let mut frame = [0; MAX_ENCODED];
        let mut carried = 0;
        while carried < self.bytes_per_block {
            let length = self
                .housekeeping
                .transmit(&mut *self.sampling_path, &mut frame);
            if length == 0 {
                break;
            }
            carried += length;
            self.to_host.extend((self.mangle)(&frame[..length]));
        }
    }
}

/// The host's end of the desk's link, and a handle on what is behind it.
#[derive(Clone)]
pub struct DeskLink {
    hob: Arc<Mutex<DeskHob>>,
    /// Garbage that arrives at the device before each of the host's frames, in turn.
    noise: VecDeque<Vec<u8>>,
}

impl DeskLink {
    /// A link to a device.
    pub fn new(hob: DeskHob) -> Self {
        Self {
            hob: Arc::new(Mutex::new(hob)),
            noise: VecDeque::new(),
        }
    }

    /// Creates a [`DeskLink`] with garbage before each of the host's frames.
    pub fn noisy(hob: DeskHob, noise: Vec<Vec<u8>>) -> Self {
        Self {
            noise: noise.into(),
            ..Self::new(hob)
        }
    }

    /// Returns the hob behind the link.
    pub fn hob(&self) -> MutexGuard<'_, DeskHob> {
        self.hob.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Transport for DeskLink {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let noise = self.noise.pop_front().unwrap_or_default();
        let mut hob = self.hob();
        hob.offer(&noise);
        hob.offer(bytes);
        Ok(())
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        let mut hob = self.hob();
        let deadline = u128::from(hob.time_ns) + timeout.as_nanos();
        while hob.to_host.is_empty() && u128::from(hob.time_ns) < deadline {
            hob.step();
        }
        let length = buf.len().min(hob.to_host.len());
        for (slot, byte) in buf.iter_mut().zip(hob.to_host.drain(..length)) {
            *slot = byte;
        }
        Ok(length)
    }

    fn describe(&self) -> String {
        "desk".to_owned()
    }

    fn clock(&self) -> Duration {
        Duration::from_nanos(self.hob().time_ns)
    }
}

/// A client whose device heats, settled on one frequency, and streams every second half-cycle.
///
/// # Panics
/// When the device refuses: the test then fails where it should.
pub fn heating() -> (Client, DeskLink) {
    heating_where(true)
}

/// The same where the device sends pieces of windows again or, as over a link that loses every request for them, does not.
///
/// # Panics
/// As [`heating`].
pub fn heating_where(sends_again: bool) -> (Client, DeskLink) {
    let mut hob = DeskHob::new(desk_hello());
    hob.sends_again = sends_again;
    let link = DeskLink::new(hob);
    let mut client = Client::connect(Box::new(link.clone())).unwrap();
    client.set_power(1_000).unwrap();
    link.hob().run(60);
    client.stream(0, 2).unwrap();
    (client, link)
}
