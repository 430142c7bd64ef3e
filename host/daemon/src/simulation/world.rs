//! The world around the daemon: time, hobs, and what was seen.

use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::time::Instant;

use super::board::Board;
use super::disk::Disk;
use super::hob::Hob;
use super::promises::Promises;
use super::script::Script;
use crate::daemon::Daemon;

/// Names of the hobs.
pub const HOBS: [&str; 2] = ["left", "right"];

/// 2026-11-22 23:59:00 UTC, in milliseconds since 1970: a midnight is near.
const ORIGIN_MS: i64 = 1_795_391_940_000;

/// Kind of a hob.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Left {
    /// A script.
    Script,
    /// The firmware on the simulated board, for which a second of the world costs up to a second of a core.
    Board,
}

/// The world. It outlives the daemons in it.
pub struct World {
    /// The disk of the store.
    pub disk: Arc<Disk>,
    /// Nothing fails by itself: promises are kept within short bounds.
    pub is_calm: bool,
    /// Kind of the left hob; the right one is a script.
    pub left: Left,
    /// The daemon is an edge of a fleet.
    pub is_edge: bool,
    /// Windows of hobs that heat show [`super::LOAD`]; else they show none.
    pub is_loaded: bool,
    /// Nothing fails any more.
    is_mended: AtomicBool,
    /// Microseconds that passed before this daemon's life.
    before_us: AtomicU64,
    life_began: Mutex<Option<Instant>>,
    /// By how much the wall's clock was put on, in milliseconds.
    clock_offset_ms: AtomicI64,
    state: Mutex<State>,
    daemon: Mutex<Option<Daemon>>,
}

/// All that changes but time.
pub struct State {
    /// Chance for the links.
    pub rng: ChaCha8Rng,
    /// The hobs, each on its socket.
    pub sockets: [Socket; HOBS.len()],
    /// What was promised.
    pub promises: Promises,
    /// What happened, a line each.
    pub course: Vec<String>,
}

/// A hob and its link.
pub struct Socket {
    /// The hob.
    pub hob: Box<dyn Hob>,
    /// Nobody can connect to one that is not.
    pub is_plugged: bool,
    /// Nothing passes either way.
    pub is_mute: bool,
    /// Counts connections: one that is not the last is closed.
    pub connection: u64,
    /// Chance that a frame is lost, doubled, or held up with all behind it.
    pub lost: f64,
    /// As `lost`.
    pub doubled: f64,
    /// As `lost`.
    pub late: f64,
}

impl World {
    /// Of this seed.
    pub fn new(seed: u64, left: Left, is_edge: bool) -> Arc<Self> {
        let is_calm = seed.is_multiple_of(4);
        let is_loaded = is_edge && seed.is_multiple_of(3);
        let script = |boot_id| Script::new(boot_id, Duration::ZERO).loaded(is_loaded);
        let left_hob: Box<dyn Hob> = match left {
            Left::Script => Box::new(script(100)),
            Left::Board => Box::new(Board::new(100, Duration::ZERO)),
        };
        let socket = |hob| Socket {
            hob,
            is_plugged: true,
            is_mute: false,
            connection: 0,
            lost: 0.0,
            doubled: 0.0,
            late: 0.0,
        };
        Arc::new(Self {
            disk: Arc::default(),
            is_calm,
            left,
            is_edge,
            is_loaded,
            is_mended: AtomicBool::new(false),
            before_us: AtomicU64::new(0),
            life_began: Mutex::new(None),
            clock_offset_ms: AtomicI64::new(0),
            state: Mutex::new(State {
                rng: ChaCha8Rng::seed_from_u64(seed),
                sockets: [socket(left_hob), socket(Box::new(script(200)))],
                promises: Promises::default(),
                course: Vec::new(),
            }),
            daemon: Mutex::new(None),
        })
    }

    /// Time since the world began.
    pub fn now(&self) -> Duration {
        let before = Duration::from_micros(self.before_us.load(Ordering::Relaxed));
        let began = *lock(&self.life_began);
        before + began.map_or(Duration::ZERO, |began| began.elapsed())
    }

    /// The wall's clock, in milliseconds since 1970.
    pub fn wall_ms(&self) -> i64 {
        ORIGIN_MS + self.now().as_millis() as i64 + self.clock_offset_ms.load(Ordering::Relaxed)
    }

    /// Puts the wall's clock on, or back.
    pub fn set_clock_forward(&self, by_ms: i64) {
        self.clock_offset_ms.fetch_add(by_ms, Ordering::Relaxed);
    }

    /// A daemon begins its life on the runtime that calls.
    pub fn begin_life(&self) {
        *lock(&self.life_began) = Some(Instant::now());
    }

    /// The daemon that lives.
    pub fn set_daemon(&self, daemon: Daemon) {
        *lock(&self.daemon) = Some(daemon);
    }

    /// Its life ends now, on the runtime that calls: outside of it there is no simulated clock.
    pub fn end_life(&self) {
        let now = self.now();
        *lock(&self.life_began) = None;
        self.before_us
            .store(now.as_micros() as u64, Ordering::Relaxed);
    }

    /// It is gone, and for so long there is no other.
    pub fn pass_without_daemon(&self, dead_for: Duration) {
        *lock(&self.daemon) = None;
        self.before_us
            .fetch_add(dead_for.as_micros() as u64, Ordering::Relaxed);
        let now = self.now();
        let mut state = self.lock();
        for socket in &mut state.sockets {
            socket.connection += 1;
            socket.hob.live_until(now);
        }
    }

    /// A hob at random; where a board is there, it as a rule.
    pub fn any_hob(&self, rng: &mut ChaCha8Rng) -> usize {
        match self.left {
            Left::Script => rng.random_range(0..HOBS.len()),
            Left::Board => usize::from(rng.random_bool(0.2)),
        }
    }

    /// The daemon, while one lives.
    pub fn daemon(&self) -> Option<Daemon> {
        lock(&self.daemon).clone()
    }

    /// Something may fail now.
    pub fn may_fail(&self) -> bool {
        !self.is_calm && !self.is_mended.load(Ordering::Relaxed)
    }

    /// From now on nothing fails.
    pub fn mend(&self) {
        self.is_mended.store(true, Ordering::Relaxed);
    }

    /// All that changes but time.
    pub fn lock(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }

    /// Writes a line of the course.
    pub fn note(&self, text: &str) {
        let now_s = self.now().as_secs_f64();
        self.lock().course.push(format!("{now_s:10.3} {text}"));
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
