//! A device that only speaks the protocol: what a test makes it say, without the work of simulating a hob.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread;
use std::time::Duration;

use ihd_shared::fault::Fault;
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_shared::sampling::{I_FULL_SCALE_MA, Pair, V_FULL_SCALE_MV};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::window::{CHUNK_BYTES, TrajectoryEntry};
use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::frame::{CRC32, Frame, MAX_ENCODED, encode_numbered, encode_raw};
use ihd_shared::wire::hello::{CAP_SIMULATED, ROLE_DEVICE, ours};
use ihd_shared::wire::messages::{
    AnyMessage, FrontEnd, Hello, Limit, LookupBlob, Message, OffReason, Outcome, Pot, Raw, Reply,
    State, Status, Stream, Telemetry, TrajectoryChunk, Utilisation, WindowChunk, WindowEnd,
    WindowStart,
};
use ihd_shared::wire::number::Number;

/// One host's connection, in frames.
pub struct Wire {
    stream: TcpStream,
    seq: u16,
    /// Number of the request that was taken last: what is sent answers it.
    pub number: Number,
    deframer: Deframer,
    /// Frames that came and were not taken yet: id, number and message.
    came: Vec<(u8, Number, Vec<u8>)>,
    stop: Arc<AtomicBool>,
}

impl Wire {
    fn new(stream: TcpStream, stop: Arc<AtomicBool>) -> io::Result<Self> {
        stream.set_nonblocking(false)?;
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(Duration::from_millis(200)))?;
        Ok(Self {
            stream,
            seq: 0,
            number: Number::NONE,
            deframer: Deframer::new(),
            came: Vec::new(),
            stop,
        })
    }

    /// Sends bytes as they are; waits while the host reads nothing, and ends with the test.
    pub fn bytes(&mut self, mut bytes: &[u8]) -> io::Result<()> {
        while !bytes.is_empty() {
            self.check()?;
            match self.stream.write(bytes) {
                Ok(n) => bytes = &bytes[n..],
                Err(e) if is_timeout(&e) => {}
                Err(e) => return Err(e),
            }
        }
        Ok(())
    }

    fn check(&self) -> io::Result<()> {
        match self.stop.load(Relaxed) {
            true => Err(ErrorKind::Interrupted.into()),
            false => Ok(()),
        }
    }

    pub fn send<M: Message>(&mut self, message: &M) -> io::Result<()> {
        let bytes = self.framed(message);
        self.bytes(&bytes)
    }

    /// A message's frame; an answer is one to the last request.
    pub fn framed<M: Message>(&mut self, message: &M) -> Vec<u8> {
        let mut out = [0; MAX_ENCODED];
        let n = encode_numbered(message, self.number, self.seq, &mut out).expect("it fits");
        self.seq = self.seq.wrapping_add(1);
        out[..n].to_vec()
    }

    /// A frame with a payload that need be no message.
    pub fn send_raw(&mut self, id: u8, payload: &[u8]) -> io::Result<()> {
        let mut out = [0; MAX_ENCODED];
        let n = encode_raw(id, self.seq, payload, &mut out).expect("it fits");
        self.seq = self.seq.wrapping_add(1);
        self.bytes(&out[..n])
    }

    /// The next frame of the host, within `timeout`.
    pub fn next(&mut self, timeout: Duration) -> io::Result<Option<(u8, Vec<u8>)>> {
        self.check()?;
        if self.came.is_empty() {
            let timeout = timeout.max(Duration::from_millis(1));
            self.stream.set_read_timeout(Some(timeout))?;
            let mut buf = [0; 4096];
            match self.stream.read(&mut buf) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(n) => {
                    for &byte in &buf[..n] {
                        if let Some(Ok(frame)) = self.deframer.push(byte) {
                            self.came.push(taken(&frame));
                        }
                    }
                }
                Err(e) if is_timeout(&e) => {}
                Err(e) => return Err(e),
            }
        }
        if self.came.is_empty() {
            return Ok(None);
        }
        let (id, number, message) = self.came.remove(0);
        self.number = number;
        Ok(Some((id, message)))
    }

    /// Sends a window whole.
    pub fn window(&mut self, start: &WindowStart, samples: &Samples) -> io::Result<()> {
        let mut out = self.framed(start);
        let mut digest = CRC32.digest();
        let chunk =
            |k: usize, bytes: usize| u16::try_from(k * CHUNK_BYTES / bytes).unwrap_or(u16::MAX);
        for (k, data) in samples.pairs.chunks(CHUNK_BYTES).enumerate() {
            digest.update(data);
            out.extend(self.framed(&WindowChunk {
                seq: start.seq,
                offset: chunk(k, 4),
                data: Raw(data),
            }));
        }
        for (k, data) in samples.trajectory.chunks(CHUNK_BYTES).enumerate() {
            digest.update(data);
            out.extend(self.framed(&TrajectoryChunk {
                seq: start.seq,
                offset: chunk(k, 8),
                data: Raw(data),
            }));
        }
        out.extend(self.framed(&WindowEnd {
            seq: start.seq,
            crc32: digest.finalize(),
        }));
        self.bytes(&out)
    }
}

fn taken(frame: &Frame<'_>) -> (u8, Number, Vec<u8>) {
    let (number, message) = frame.split();
    (frame.id, number, message.to_vec())
}

fn is_timeout(e: &io::Error) -> bool {
    matches!(
        e.kind(),
        ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
    )
}

/// Pairs and trajectory of a window as they travel.
#[derive(Clone, Debug, Default)]
pub struct Samples {
    pub pairs: Vec<u8>,
    pub trajectory: Vec<u8>,
}

impl Samples {
    pub fn new(pairs: impl IntoIterator<Item = Pair>, trajectory: &[TrajectoryEntry]) -> Self {
        Self {
            pairs: pairs.into_iter().flat_map(Pair::to_le_bytes).collect(),
            trajectory: trajectory.iter().flat_map(|t| t.to_le_bytes()).collect(),
        }
    }

    /// Sines of some amplitude, of a load that is not there.
    pub fn sines(count: usize) -> Self {
        let pair = |k: usize| {
            let phase = k as f64 * std::f64::consts::TAU * 3.0 / 61.0;
            let bytes = [1_000.0 * phase.sin(), 600.0 * (phase - 0.7).sin()]
                .map(|x| (x as i16).to_le_bytes());
            Pair::from_le_bytes([bytes[0][0], bytes[0][1], bytes[1][0], bytes[1][1]])
        };
        let entry = TrajectoryEntry {
            r: MicroOhm(4_000_000),
            l: PicoHenry(50_000_000),
        };
        Self::new((0..count).map(pair), &[entry; 150])
    }

    /// A start that fits them.
    pub fn start(&self, seq: u32) -> WindowStart {
        WindowStart {
            seq,
            dropped: 0,
            half_cycle: 20 * seq.wrapping_add(1),
            f_sw_hz: 45_000,
            half_cycle_ns: 10_000_000,
            first_pair_ns: 1_000,
            first_trajectory_ns: 40_000,
            pairs: (self.pairs.len() / 4) as u16,
            trajectory: (self.trajectory.len() / 8) as u16,
            saturated: 0,
            lookup_version: 0,
            v_full_scale_mv: V_FULL_SCALE_MV,
            i_full_scale_ma: I_FULL_SCALE_MA,
        }
    }
}

/// A device that answers every command as a board does that does not heat.
#[derive(Clone, Debug)]
pub struct Polite {
    pub hello: Hello,
    pub front_end: FrontEnd,
    pub status: Status,
    /// Its lookup's bytes.
    pub lookup: Vec<u8>,
    /// Streams that the host has requested.
    pub stream: Stream,
    /// Answer to every command without one of its own.
    pub outcome: (Outcome, u32),
    /// A lookup that is accepted becomes active.
    pub activates: bool,
}

impl Polite {
    pub fn new(boot_id: u32) -> Self {
        Self {
            hello: ours(ROLE_DEVICE, CAP_SIMULATED, boot_id, "polite 0.0.0", "test"),
            front_end: FrontEnd {
                v_full_scale_mv: V_FULL_SCALE_MV,
                i_full_scale_ma: I_FULL_SCALE_MA,
                bus_full_scale_mv: 450_000,
                mains_full_scale_mv: 450_000,
                bits: 12,
            },
            status: idle_status(),
            lookup: prior().to_bytes().to_vec(),
            stream: Stream {
                telemetry_every: 0,
                windows_every: 0,
            },
            outcome: (Outcome::Ok, 0),
            activates: true,
        }
    }

    /// Answers what comes for a while.
    pub fn attend(&mut self, wire: &mut Wire, timeout: Duration) -> io::Result<()> {
        match wire.next(timeout)? {
            Some((id, payload)) => self.answer(wire, id, &payload),
            None => Ok(()),
        }
    }

    /// Answers everything, for ever.
    pub fn serve(&mut self, wire: &mut Wire) -> io::Result<()> {
        loop {
            self.attend(wire, Duration::from_millis(50))?;
        }
    }

    /// Answers one frame.
    pub fn answer(&mut self, wire: &mut Wire, id: u8, payload: &[u8]) -> io::Result<()> {
        let Ok(message) = AnyMessage::decode(id, payload) else {
            return self.reply(wire, (Outcome::UnknownMessage, 0));
        };
        match message {
            AnyMessage::Hello(_) => {
                self.status.asked_w = 0;
                wire.send(&self.hello)
            }
            // It keeps no window.
            AnyMessage::ResendWindow(_) => Ok(()),
            AnyMessage::GetFrontEnd(_) => wire.send(&self.front_end),
            AnyMessage::GetStatus(_) => wire.send(&self.status),
            AnyMessage::ReadLookup(_) => wire.send(&LookupBlob {
                blob: Raw(&self.lookup),
            }),
            AnyMessage::GetUtilisation(_) => wire.send(&Utilisation {
                blocks: 0,
                mean_permille: 0,
                worst_permille: 0,
                longest_gap_us: 0,
            }),
            AnyMessage::Stream(stream) => {
                self.stream = stream;
                self.reply(wire, self.outcome)
            }
            AnyMessage::SetPower(power) => {
                if self.outcome.0 == Outcome::Ok {
                    self.status.asked_w = power.power_w;
                }
                self.reply(wire, self.outcome)
            }
            AnyMessage::PushLookup(push) => {
                let outcome = self.take_lookup(push.blob.0);
                self.reply(wire, outcome)
            }
            AnyMessage::ResetLookup(_) => {
                if self.outcome.0 == Outcome::Ok && self.activates {
                    self.lookup = prior().to_bytes().to_vec();
                    self.status.lookup_version = 0;
                }
                self.reply(wire, self.outcome)
            }
            AnyMessage::ClearFault(_) | AnyMessage::Configure(_) => self.reply(wire, self.outcome),
            _ => self.reply(wire, (Outcome::UnknownMessage, 0)),
        }
    }

    fn take_lookup(&mut self, blob: &[u8]) -> (Outcome, u32) {
        if self.outcome.0 != Outcome::Ok {
            return self.outcome;
        }
        match RlLookup::from_bytes(blob) {
            Err(why) => why.outcome(),
            Ok(lookup) if lookup.version <= self.status.lookup_version => {
                (Outcome::LookupStale, self.status.lookup_version)
            }
            Ok(lookup) => {
                if self.activates {
                    self.lookup = blob.to_vec();
                    self.status.lookup_version = lookup.version;
                }
                (Outcome::Ok, 0)
            }
        }
    }

    fn reply(&self, wire: &mut Wire, (outcome, detail): (Outcome, u32)) -> io::Result<()> {
        wire.send(&Reply { outcome, detail })
    }
}

/// Nothing has happened yet.
pub fn idle_status() -> Status {
    Status {
        state: State::Idle,
        fault: Fault::NONE,
        pot: Pot::Unknown,
        asked_w: 0,
        delivered_mw: 0,
        f_sw_hz: 0,
        lookup_version: 0,
        half_cycles: 1,
        windows_recorded: 0,
        windows_dropped: 0,
        telemetry_dropped: 0,
        frames_bad: 0,
        frames_lost: 0,
        saturated_pairs: 0,
        limit: Limit::None,
        tries_left: 3,
        heat_sink_c: 25,
        glass_c: 25,
        coil_c: 25,
        fan: false,
        panel_level: 0,
        key_locked: false,
        off_reason: OffReason::None,
        glass_hot: false,
        timer_min: 0,
    }
}

/// Heats at 45 kHz.
pub fn telemetry(seq: u32) -> Telemetry {
    Telemetry {
        seq,
        dropped: 0,
        half_cycle: seq,
        state: State::Heating,
        fault: Fault::NONE,
        pot: Pot::Ferromagnetic,
        f_sw_hz: 45_000,
        r: MicroOhm(4_000_000),
        l: PicoHenry(50_000_000),
        i_crest_ma: 30_000,
        power_mw: 1_000_000,
        phase_mrad: 700,
        lookup_version: 0,
        asked_w: 1_000,
        limit: Limit::None,
        bus_peak_dv: 3_250,
        v_coil_peak_dv: 4_000,
        i_turn_off_min_ma: 5_000,
        off_reason: OffReason::None,
        glass_hot: false,
    }
}

/// A port at which somebody serves one host after the other.
pub struct Port {
    address: SocketAddr,
    stop: Arc<AtomicBool>,
}

impl Port {
    /// `serve` has each connection until it returns; its error ends only that.
    pub fn open(
        mut serve: impl FnMut(&mut Wire) -> io::Result<()> + Send + 'static,
    ) -> io::Result<Self> {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        let stop = Arc::new(AtomicBool::new(false));
        let own = Arc::clone(&stop);
        thread::spawn(move || {
            while !own.load(Relaxed) {
                match listener.accept() {
                    Ok((stream, _)) => {
                        let _ = Wire::new(stream, Arc::clone(&own)).and_then(|mut w| serve(&mut w));
                    }
                    Err(_) => thread::sleep(Duration::from_millis(5)),
                }
            }
        });
        Ok(Self { address, stop })
    }

    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Port {
    fn drop(&mut self) {
        self.stop.store(true, Relaxed);
    }
}
