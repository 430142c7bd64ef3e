//! World around the daemon: time, hobs, disk, and the record of events.

use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::time::Instant;

use super::board::SimulatedBoard;
use super::disk::SimulatedDisk;
use super::hob::{HOBS, WorldHob};
use super::promises::Promises;
use super::script::ScriptedHob;
use crate::daemon::Daemon;
use crate::locking::lock;

/// Start of the wall clock: 2026-11-22 23:59:00 UTC, shortly before midnight, in milliseconds since 1970.
const ORIGIN_MS: i64 = 1_795_391_940_000;

/// Kind of a hob.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HobKind {
    /// Script without physics.
    Script,
    /// Firmware on the simulated board; a simulated second takes up to a second of a core.
    Board,
}

/// World of one seed. It outlives the daemons in it.
pub struct World {
    /// Disk of the store.
    pub disk: Arc<SimulatedDisk>,
    /// `true` if no random faults occur: the promises then have shorter limits.
    pub is_calm: bool,
    /// Kind of the left hob; the right one is a script.
    pub left: HobKind,
    /// `true` if the daemon is an edge of a fleet.
    pub is_edge: bool,
    /// `true` if windows of heating hobs show [`super::LOAD`]; otherwise they show no load.
    pub is_loaded: bool,
    /// `true` after all faults have ended.
    faults_ended: AtomicBool,
    /// Simulated microseconds before the current daemon was started.
    before_us: AtomicU64,
    life_began: Mutex<Option<Instant>>,
    /// Offset of the wall clock in milliseconds.
    clock_offset_ms: AtomicI64,
    state: Mutex<WorldState>,
    daemon: Mutex<Option<Daemon>>,
}

/// State of the world, except time.
pub struct WorldState {
    /// Random numbers of the links.
    pub rng: ChaCha8Rng,
    /// Hobs with their links.
    pub sockets: [Socket; HOBS.len()],
    /// State of the promises.
    pub promises: Promises,
    /// Lines of the course.
    pub course: Vec<String>,
}

/// Hob and its link.
pub struct Socket {
    /// Hob.
    pub hob: Box<dyn WorldHob>,
    /// `true` while connections are possible.
    pub is_plugged: bool,
    /// `true` while no frame passes in either direction.
    pub is_mute: bool,
    /// Number of the last connection; earlier ones are closed.
    pub connection: u64,
    /// Probability that a frame is lost.
    pub loss_chance: f64,
    /// Probability that a frame is duplicated.
    pub duplicate_chance: f64,
    /// Probability that a frame is delayed, with all frames behind it.
    pub delay_chance: f64,
}

impl World {
    /// Creates the world of a seed.
    pub fn new(seed: u64, left: HobKind, is_edge: bool) -> Arc<Self> {
        let is_calm = seed.is_multiple_of(4);
        let is_loaded = is_edge && seed.is_multiple_of(3);
        let script = |boot_id| ScriptedHob::new(boot_id, Duration::ZERO).loaded(is_loaded);
        let left_hob: Box<dyn WorldHob> = match left {
            HobKind::Script => Box::new(script(100)),
            HobKind::Board => Box::new(SimulatedBoard::new(100, Duration::ZERO)),
        };
        let socket = |hob| Socket {
            hob,
            is_plugged: true,
            is_mute: false,
            connection: 0,
            loss_chance: 0.0,
            duplicate_chance: 0.0,
            delay_chance: 0.0,
        };
        Arc::new(Self {
            disk: Arc::default(),
            is_calm,
            left,
            is_edge,
            is_loaded,
            faults_ended: AtomicBool::new(false),
            before_us: AtomicU64::new(0),
            life_began: Mutex::new(None),
            clock_offset_ms: AtomicI64::new(0),
            state: Mutex::new(WorldState {
                rng: ChaCha8Rng::seed_from_u64(seed),
                sockets: [socket(left_hob), socket(Box::new(script(200)))],
                promises: Promises::default(),
                course: Vec::new(),
            }),
            daemon: Mutex::new(None),
        })
    }

    /// Returns the time since the start of the world.
    pub fn now(&self) -> Duration {
        let before = Duration::from_micros(self.before_us.load(Ordering::Relaxed));
        let began = *lock(&self.life_began);
        before + began.map_or(Duration::ZERO, |began| began.elapsed())
    }

    /// Returns the wall clock's time, in milliseconds since 1970.
    pub fn wall_ms(&self) -> i64 {
        ORIGIN_MS + self.now().as_millis() as i64 + self.clock_offset_ms.load(Ordering::Relaxed)
    }

    /// Shifts the wall clock by milliseconds, positive for forward.
    pub fn shift_clock_by(&self, by_ms: i64) {
        self.clock_offset_ms.fetch_add(by_ms, Ordering::Relaxed);
    }

    /// Starts the clock of a daemon on the calling runtime.
    pub fn begin_life(&self) {
        *lock(&self.life_began) = Some(Instant::now());
    }

    /// Sets the running daemon.
    pub fn set_daemon(&self, daemon: Daemon) {
        *lock(&self.daemon) = Some(daemon);
    }

    /// Stops the clock of the daemon on the calling runtime: outside of it there is no simulated clock.
    pub fn end_life(&self) {
        let now = self.now();
        *lock(&self.life_began) = None;
        self.before_us
            .store(now.as_micros() as u64, Ordering::Relaxed);
    }

    /// Drops the daemon and lets time pass without one.
    pub fn pass_without_daemon(&self, dead_for: Duration) {
        *lock(&self.daemon) = None;
        self.before_us
            .fetch_add(dead_for.as_micros() as u64, Ordering::Relaxed);
        let now = self.now();
        let mut state = self.lock();
        for socket in &mut state.sockets {
            socket.connection += 1;
            socket.hob.advance_to(now);
        }
    }

    /// Returns the index of a random hob; a board is preferred.
    pub fn any_hob(&self, rng: &mut ChaCha8Rng) -> usize {
        match self.left {
            HobKind::Script => rng.random_range(0..HOBS.len()),
            HobKind::Board => usize::from(rng.random_bool(0.2)),
        }
    }

    /// Returns the running daemon; `None` between two of them.
    pub fn daemon(&self) -> Option<Daemon> {
        lock(&self.daemon).clone()
    }

    /// Returns `true` if faults may occur now.
    pub fn may_fail(&self) -> bool {
        !self.is_calm && !self.faults_ended.load(Ordering::Relaxed)
    }

    /// Ends all faults for good.
    pub fn end_faults(&self) {
        self.faults_ended.store(true, Ordering::Relaxed);
    }

    /// Locks the state of the world, except time.
    pub fn lock(&self) -> MutexGuard<'_, WorldState> {
        lock(&self.state)
    }

    /// Adds a line to the course.
    pub fn note(&self, text: &str) {
        let now_s = self.now().as_secs_f64();
        self.lock().course.push(format!("{now_s:10.3} {text}"));
    }
}
