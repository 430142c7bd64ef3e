//! A device that plays windows of the simulated hob over and over, as often as a board does or faster: what a
//! hob says, without the second of processor time that a second of a simulated one takes.

use std::collections::BTreeMap;
use std::io;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use ihd_link::{Client, DeviceEvent, Window};
use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::{
    FaultEvent, Message, Pot, SetPower, State, Telemetry, WindowStart,
};
use ihd_shared::wire::timing::HOST_UNHEARD_MS;
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::transport::SharedHob;

use crate::device::{Polite, Port, Samples, Wire, telemetry};

/// Half-cycles a second of 50 Hz mains.
const HALF_CYCLES_PER_S: f64 = 100.0;

/// Half-cycles that a device catches up with after its host read nothing; windows of those before are dropped and
/// counted.
const CATCH_UP: u32 = 40;

/// A pot, in windows of some powers.
#[derive(Clone)]
pub struct Tape(Vec<(Telemetry, WindowStart, Samples)>);

impl Tape {
    /// `each` windows of each power, of the simulated hob with this seed.
    pub fn record(seed: u64, powers_w: &[u16], each: usize) -> Self {
        let config = HobConfig {
            seed,
            ..HobConfig::default()
        };
        let hob = SharedHob::new(SimHob::new(&config));
        let mut client = Client::connect(Box::new(hob)).expect("a hob in this process");
        let mut tape = Vec::new();
        for &power_w in powers_w {
            client.set_power(power_w).expect("it heats");
            client.stream(1, 20).expect("it streams");
            let mut known = BTreeMap::new();
            let mut taken = 0;
            while taken < each {
                let event = client
                    .next_event(Duration::from_secs(5))
                    .expect("it streams");
                match event.expect("it streams") {
                    DeviceEvent::Telemetry(t) => drop(known.insert(t.half_cycle, t)),
                    DeviceEvent::Window(w) => {
                        // From a half-cycle that has reached its power.
                        if let Some(t) = known.get(&w.half_cycle)
                            && t.power_mw > 900 * u32::from(power_w)
                        {
                            tape.push(played(t.clone(), *w));
                            taken += 1;
                        }
                    }
                    _ => {}
                }
            }
        }
        Self(tape)
    }
}

fn played(telemetry: Telemetry, w: Window) -> (Telemetry, WindowStart, Samples) {
    let samples = Samples::new(w.pairs, &w.trajectory);
    let start = WindowStart {
        f_sw_hz: w.f_sw_hz,
        half_cycle_ns: w.half_cycle_ns,
        first_pair_ns: w.first_pair_ns,
        first_trajectory_ns: w.first_trajectory_ns,
        saturated: w.saturated,
        v_full_scale_mv: w.scales.v_full_scale_mv,
        i_full_scale_ma: w.scales.i_full_scale_ma,
        ..samples.start(0)
    };
    (telemetry, start, samples)
}

/// Action of a person.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Act {
    /// Heats, as its panel says.
    Heat,
    /// Panel off.
    Off,
    /// The pot is away.
    Lift,
    /// A fault trips, and passes.
    Fault,
    /// The mains is too low.
    Dip,
    /// Power off and on again: another boot.
    Boot,
}

/// State of the device itself.
pub struct Truth {
    device: Polite,
    tape: usize,
    act: Act,
    speed: f64,
    began: Instant,
    half_cycles: u32,
    telemetry_seq: u32,
    window_seq: u32,
    windows_dropped: u32,
    /// Counts of all boots.
    pub windows_due: u64,
    pub windows_dropped_ever: u64,
    pub lookups_taken: u32,
    heard: u32,
    /// Power that a host asked for, other than 0.
    pub asked_by_host: u32,
    /// When a host switched it off last.
    pub off_at: Option<Instant>,
    connected: bool,
}

impl Truth {
    /// Does something to it.
    pub fn act(&mut self, act: Act) {
        self.act = act;
        if act == Act::Boot {
            self.device.hello.boot_id = self.device.hello.boot_id.wrapping_add(0x10_0001);
            (self.half_cycles, self.telemetry_seq, self.window_seq) = (0, 0, 0);
            (self.windows_dropped, self.heard) = (0, 0);
            self.device.status.asked_w = 0;
            self.began = Instant::now();
            self.act = Act::Heat;
            // Its link goes down with it.
            self.connected = false;
        }
    }

    /// Puts on another pot of its tapes.
    pub fn put(&mut self, tape: usize) {
        self.tape = tape;
    }

    /// Power that a host asks for, in watt.
    pub fn asked_w(&self) -> u16 {
        self.device.status.asked_w
    }

    /// Half-cycles that its clock says have passed.
    fn due(&self) -> u32 {
        (self.began.elapsed().as_secs_f64() * self.speed * HALF_CYCLES_PER_S) as u32
    }
}

/// The device and its port.
#[derive(Clone)]
pub struct Player {
    truth: Arc<Mutex<Truth>>,
    tapes: Arc<Vec<Tape>>,
    port: Option<Arc<Port>>,
}

impl Player {
    /// A device that heats from the start, `speed` times as fast as real time.
    pub fn start(boot_id: u32, tapes: Arc<Vec<Tape>>, speed: f64) -> io::Result<Self> {
        let truth = Truth {
            device: Polite::new(boot_id),
            tape: 0,
            act: Act::Heat,
            speed,
            began: Instant::now(),
            half_cycles: 0,
            telemetry_seq: 0,
            window_seq: 0,
            windows_dropped: 0,
            windows_due: 0,
            windows_dropped_ever: 0,
            lookups_taken: 0,
            heard: 0,
            asked_by_host: 0,
            off_at: None,
            connected: false,
        };
        let mut player = Self {
            truth: Arc::new(Mutex::new(truth)),
            tapes,
            port: None,
        };
        let own = player.clone();
        let port = Port::open(move |wire| own.serve(wire))?;
        player.port = Some(Arc::new(port));
        Ok(player)
    }

    pub fn address(&self) -> SocketAddr {
        self.port.as_ref().expect("it has been started").address()
    }

    pub fn truth(&self) -> MutexGuard<'_, Truth> {
        self.truth.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn serve(&self, wire: &mut Wire) -> io::Result<()> {
        {
            let mut truth = self.truth();
            truth.connected = true;
            // Nobody listened: what was due meanwhile was for nobody.
            truth.half_cycles = truth.due();
            truth.device.stream.telemetry_every = 0;
            truth.device.stream.windows_every = 0;
        }
        loop {
            let ms = (10.0 / self.truth().speed).clamp(1.0, 10.0);
            let came = wire.next(Duration::from_millis(ms as u64))?;
            let mut truth = self.truth();
            if !truth.connected {
                return Ok(());
            }
            if let Some((id, payload)) = came {
                truth.heard = truth.half_cycles;
                let before = (
                    truth.device.status.lookup_version,
                    truth.device.status.asked_w,
                );
                truth.refresh();
                truth.device.answer(wire, id, &payload)?;
                let status = &truth.device.status;
                let is_off = id == SetPower::ID && status.asked_w == 0;
                let (taken, asked) = (status.lookup_version != before.0, status.asked_w > before.1);
                truth.lookups_taken += u32::from(taken);
                truth.asked_by_host += u32::from(asked);
                if is_off {
                    truth.off_at = Some(Instant::now());
                }
                continue;
            }
            drop(truth);
            self.pass_time(wire)?;
        }
    }

    /// Streams what has become due.
    fn pass_time(&self, wire: &mut Wire) -> io::Result<()> {
        loop {
            let (telemetry, window) = {
                let mut truth = self.truth();
                let due = truth.due();
                if truth.half_cycles >= due {
                    return Ok(());
                }
                let late = due - truth.half_cycles > CATCH_UP;
                truth.half_cycle(&self.tapes, late)
            };
            if let Some(Heard::Fault(event)) = &telemetry {
                wire.send(event)?;
            }
            if let Some(Heard::Telemetry(t)) = &telemetry {
                wire.send(&**t)?;
            }
            if let Some((start, tape, k)) = window {
                wire.window(&start, &self.tapes[tape].0[k].2)?;
            }
        }
    }
}

enum Heard {
    Telemetry(Box<Telemetry>),
    Fault(FaultEvent),
}

impl Truth {
    /// The status that goes with this moment.
    fn refresh(&mut self) {
        let state = self.state();
        let s = &mut self.device.status;
        s.state = state;
        s.half_cycles = self.half_cycles;
        s.windows_recorded = self.window_seq.wrapping_sub(self.windows_dropped);
        s.windows_dropped = self.windows_dropped;
        s.panel_level = if self.act == Act::Heat { 5 } else { 0 };
    }

    fn state(&self) -> State {
        match self.act {
            Act::Heat | Act::Boot => State::Heating,
            Act::Off if self.device.status.asked_w > 0 => State::Heating,
            Act::Off => State::Idle,
            Act::Lift => State::WaitingForPot,
            Act::Fault | Act::Dip => State::Pausing,
        }
    }

    /// One half-cycle: what the host gets of it. A device that is `late` has no room for a window.
    fn half_cycle(
        &mut self,
        tapes: &[Tape],
        late: bool,
    ) -> (Option<Heard>, Option<(WindowStart, usize, usize)>) {
        let h = self.half_cycles;
        self.half_cycles += 1;
        if h.saturating_sub(self.heard) * 10 > HOST_UNHEARD_MS {
            self.device.status.asked_w = 0;
        }
        let state = self.state();
        let tape = self.tape.min(tapes.len() - 1);
        // Some seconds at each power.
        let k = h as usize / 300 % tapes[tape].0.len();
        let (of_tape, start, _) = &tapes[tape].0[k];
        let stream = &self.device.stream;
        let every = |n: u8| n > 0 && h.is_multiple_of(u32::from(n));
        let (telemetry_due, window_due) = (
            every(stream.telemetry_every),
            every(stream.windows_every) && state == State::Heating,
        );
        let mut heard = None;
        if telemetry_due {
            let seq = self.telemetry_seq;
            self.telemetry_seq += 1;
            let mut t = match state {
                State::Heating => of_tape.clone(),
                _ => Telemetry {
                    f_sw_hz: 0,
                    power_mw: 0,
                    i_crest_ma: 0,
                    ..telemetry(seq)
                },
            };
            (t.seq, t.dropped, t.half_cycle, t.state) = (seq, 0, h, state);
            t.lookup_version = self.device.status.lookup_version;
            t.asked_w =
                self.device
                    .status
                    .asked_w
                    .max(if self.act == Act::Heat { 1_000 } else { 0 });
            if self.act == Act::Lift {
                t.pot = Pot::Absent;
            }
            if self.act == Act::Fault {
                t.fault = Fault::HARDWARE_OVER_CURRENT;
            }
            heard = Some(Heard::Telemetry(Box::new(t)));
            if self.act == Act::Fault && h.is_multiple_of(100) {
                heard = Some(Heard::Fault(FaultEvent {
                    half_cycle: h,
                    fault: Fault::HARDWARE_OVER_CURRENT,
                }));
                self.telemetry_seq -= 1;
            }
        }
        let mut window = None;
        if window_due {
            let mut start = start.clone();
            start.seq = self.window_seq;
            self.window_seq += 1;
            self.windows_due += 1;
            if late {
                self.windows_dropped += 1;
                self.windows_dropped_ever += 1;
            } else {
                (start.dropped, start.half_cycle) = (self.windows_dropped, h);
                start.lookup_version = self.device.status.lookup_version;
                window = Some((start, tape, k));
            }
        }
        (heard, window)
    }
}
