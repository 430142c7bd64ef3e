//! Lives of a daemon in one world: started, used, killed or stopped, and started again on the same store.

use std::ops::Range;
use std::path::Path;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

#[cfg(test)]
use ihd_model::{Command, EventKind};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tempfile::TempDir;
use tokio::runtime::Runtime;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::oneshot;
use tokio::time::sleep;

#[cfg(test)]
use super::faults::send_foreign_hello;
use super::faults::{end_all_faults, inject_random_faults};
use super::hob::HOBS;
use super::users::ask_at_random;
use super::world::{HobKind, World};
use crate::config::DaemonConfig;
use crate::daemon::Daemon;
use crate::error::DaemonError;
use crate::fleet::FleetConfig;
use crate::machine::Machine;
use crate::{OpenDevice, OpenedDevice, config::Address};

use super::link::SimulatedLink;
use super::recovery::{
    RECOVERY_TIME, check_recovery, check_settled, check_store, wait_until_working,
};

/// Period of checking the promises.
const CHECK_PERIOD: Duration = Duration::from_millis(100);

/// Period between two windows of the simulated learner.
const LEARN_PERIOD: Duration = Duration::from_millis(100);

/// Durations of a course, each within a range.
struct Lengths {
    lives: Range<u32>,
    life_ms: Range<u64>,
    /// Time from the end of one life to the next, in milliseconds.
    dead_ms: Range<u64>,
}

impl Lengths {
    fn new(left: HobKind, is_edge: bool) -> Self {
        match left {
            // A delegation to the fleet lasts 20 s.
            HobKind::Script if is_edge => Self {
                lives: 1..4,
                life_ms: 5_000..90_000,
                dead_ms: 0..40_000,
            },
            HobKind::Script => Self {
                lives: 1..4,
                life_ms: 1_000..30_000,
                dead_ms: 0..15_000,
            },
            HobKind::Board => Self {
                lives: 1..3,
                life_ms: 1_000..4_000,
                dead_ms: 0..1_000,
            },
        }
    }
}

/// Life of a daemon that is an edge, for its part in a fleet.
pub struct Life {
    /// The world.
    pub world: Arc<World>,
    /// The daemon.
    pub daemon: Daemon,
    /// Seed of this life.
    pub seed: u64,
    /// Signals that the part has to end. The part of a killed daemon is dropped instead.
    pub ended: oneshot::Receiver<()>,
}

/// Part of a daemon in a fleet, started with each of its lives.
pub type DaemonPart = dyn Fn(Life) -> Pin<Box<dyn Future<Output = ()> + Send>>;

/// Course of events in a world.
pub struct Course {
    lines: Vec<String>,
    broken: Option<String>,
    /// Simulated duration.
    pub lasted: Duration,
}

impl Course {
    /// Returns one line for each event.
    pub fn text(&self) -> String {
        self.lines.join("\n")
    }

    /// Returns the first broken promise; `None` if all were kept.
    pub fn broken(&self) -> Option<&str> {
        self.broken.as_deref()
    }
}

/// Creates a folder for a store, in memory if the system supports it.
pub(super) fn store_folder() -> TempDir {
    let memory = Path::new("/dev/shm");
    let folder = match memory.is_dir() {
        true => tempfile::tempdir_in(memory),
        false => tempfile::tempdir(),
    };
    folder.expect("a folder for the store")
}

pub(super) fn paused_runtime() -> Runtime {
    tokio::runtime::Builder::new_current_thread()
        .enable_time()
        .start_paused(true)
        .build()
        .expect("a runtime")
}

/// Starts a daemon in a world, on the calling runtime. Its devices have the addresses `serial:left` and `serial:right`.
///
/// # Errors
/// As [`Daemon::start`].
pub async fn start(world: &Arc<World>, config: DaemonConfig) -> Result<Daemon, DaemonError> {
    world.begin_life();
    Daemon::start_on(machine_in(world), config, open_in(world)).await
}

/// Runs a daemon for a time without any request. Returns the number of connections to each hob.
#[cfg(test)]
pub fn idle(time: Duration) -> [u64; HOBS.len()] {
    // Seed 0 is calm.
    let world = World::new(0, HobKind::Script, false);
    let folder = store_folder();
    paused_runtime().block_on(async {
        let daemon = start(&world, configuration(&world, folder.path())).await;
        let daemon = daemon.expect("it starts");
        sleep(time).await;
        daemon.stop().await;
        world.end_life();
    });
    let state = world.lock();
    std::array::from_fn(|hob| state.sockets[hob].connection)
}

/// Sends a hello of another host to a hob that heats under a lease; no other fault occurs. Returns the time until the daemon
/// reported the end of the lease, and the reason that it gave.
#[cfg(test)]
pub fn foreign_hello(left: HobKind) -> (Duration, String) {
    // Seed 0 is calm.
    let world = World::new(0, left, false);
    let folder = store_folder();
    let outcome = paused_runtime().block_on(async {
        let daemon = start(&world, configuration(&world, folder.path())).await;
        let daemon = daemon.expect("it starts");
        world.set_daemon(daemon.clone());
        wait_until_working(&daemon).await;
        let (name, power_w) = (HOBS[0], 900);
        daemon
            .take_lease(name, "ada", false)
            .await
            .expect("it is free");
        let heat = Command::Power { power_w };
        daemon.command(name, "ada", heat).await.expect("it heats");
        let mut events = daemon.watch();
        send_foreign_hello(&world, 0);
        let began = world.now();
        let why = loop {
            let event = events.recv().await.expect("the daemon lives");
            if let EventKind::Lease { holder, why, .. } = &event.kind
                && holder.is_empty()
            {
                break why.clone();
            }
        };
        let report = daemon.view().device(name).expect("a hob of this world");
        assert_eq!((report.asked_by_daemon_w, report.lease), (0, None));
        let outcome = (world.now() - began, why);
        daemon.stop().await;
        world.end_life();
        outcome
    });
    let broken = world.lock().promises.broken.clone();
    assert_eq!(broken, None);
    outcome
}

/// Runs one seed; the daemon is an edge if it is given a part in a fleet.
///
/// # Panics
/// Panics without a folder for the store, or without a runtime.
pub fn run(seed: u64, left: HobKind, part: Option<&DaemonPart>) -> Course {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let folder = store_folder();
    let store = folder.path().join("store");
    let world = World::new(seed, left, part.is_some());
    let lengths = Lengths::new(left, world.is_edge);
    let lives = if world.is_calm {
        1
    } else {
        rng.random_range(lengths.lives)
    };
    for life in 1..=lives {
        let runtime = paused_runtime();
        let is_last = life == lives;
        runtime.block_on(async {
            let life = Duration::from_millis(rng.random_range(lengths.life_ms.clone()));
            live(&world, &store, rng.random(), life, is_last, part).await;
            world.end_life();
        });
        // Its tasks end wherever each of them is: a daemon that was not stopped is killed.
        drop(runtime);
        let dead_ms = rng.random_range(lengths.dead_ms.clone());
        world.pass_without_daemon(Duration::from_millis(dead_ms));
        check_store(&world, &store);
        if world.lock().promises.broken.is_some() {
            break;
        }
    }
    let lasted = world.now();
    let mut state = world.lock();
    Course {
        lines: std::mem::take(&mut state.course),
        broken: state.promises.broken.clone(),
        lasted,
    }
}

pub(super) fn configuration(world: &World, store: &Path) -> DaemonConfig {
    let mut text = String::from("discover_usb = false\n");
    for name in HOBS {
        text += &format!("[[device]]\nname = \"{name}\"\naddress = \"serial:{name}\"\n");
    }
    let mut config = DaemonConfig::parse(&text, "simulation").expect("a configuration");
    config.store = store.to_owned();
    config.fleet = world.is_edge.then(|| FleetConfig {
        url: "nats://simulated".to_owned(),
        edge: Some("kitchen".to_owned()),
        nkey_file: None,
        token_file: None,
        ca: None,
        captures: false,
    });
    config
}

async fn live(
    world: &Arc<World>,
    store: &Path,
    seed: u64,
    life: Duration,
    is_last: bool,
    part: Option<&DaemonPart>,
) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let starting = start(world, configuration(world, store));
    world.note("a daemon begins");
    let daemon = match starting.await {
        Ok(daemon) => daemon,
        Err(error) => return world.note_broken(format!("the daemon does not start: {error}")),
    };
    world.set_daemon(daemon.clone());
    spawn_observers(world, &daemon);
    let (end, ended) = oneshot::channel();
    let part = part.map(|part| {
        tokio::spawn(part(Life {
            world: Arc::clone(world),
            daemon: daemon.clone(),
            seed: rng.random(),
            ended,
        }))
    });
    let users = tokio::spawn(ask_at_random(
        Arc::clone(world),
        daemon.clone(),
        rng.random(),
    ));
    let faults = tokio::spawn(inject_random_faults(Arc::clone(world), rng.random()));
    sleep(life).await;
    users.abort();
    faults.abort();
    if !is_last {
        // Killed between any two polls of its tasks.
        for _ in 0..rng.random_range(0..40) {
            tokio::task::yield_now().await;
        }
        return world.note("the daemon is killed");
    }
    end_all_faults(world);
    world.note("all faults end");
    match world.left {
        HobKind::Script => sleep(RECOVERY_TIME).await,
        HobKind::Board => wait_until_working(&daemon).await,
    }
    if world.is_edge {
        check_settled(world, &daemon, store).await;
    }
    check_recovery(world, &daemon).await;
    drop(end);
    if let Some(part) = part
        && part.await.is_err()
    {
        world.note_broken("the part in a fleet panicked".to_owned());
    }
    daemon.stop().await;
    world.note("the daemon has stopped");
    world.check_now();
}

fn machine_in(world: &Arc<World>) -> Machine {
    let clock = Arc::clone(world);
    Machine::simulated(Arc::new(move || clock.wall_ms()), Arc::clone(&world.disk))
}

fn open_in(world: &Arc<World>) -> Arc<OpenDevice> {
    let world = Arc::clone(world);
    Arc::new(move |address: &Address| {
        let spec = address.spec.to_string();
        let name = spec.trim_start_matches("serial:");
        let link = SimulatedLink::connect(&world, name)?;
        Ok(OpenedDevice::real(Box::new(link)))
    })
}

/// Starts the learner of a simulated daemon, which refuses every window.
pub fn spawn_learner(daemon: &Daemon) {
    let learner = daemon.learner().map(|learner| Arc::downgrade(&learner));
    tokio::spawn(async move {
        while let Some(learner) = learner.as_ref().and_then(std::sync::Weak::upgrade) {
            learner.learn_one();
            drop(learner);
            sleep(LEARN_PERIOD).await;
        }
    });
}

/// Starts the tasks beside the daemon: its learner, a subscriber to its events, and the check of the promises.
fn spawn_observers(world: &Arc<World>, daemon: &Daemon) {
    spawn_learner(daemon);
    let (mut events, event_world) = (daemon.watch(), Arc::clone(world));
    tokio::spawn(async move {
        loop {
            match events.recv().await {
                Ok(event) => event_world.record_event(&event),
                Err(RecvError::Lagged(_)) => {}
                Err(RecvError::Closed) => return,
            }
        }
    });
    let checked_world = Arc::clone(world);
    tokio::spawn(async move {
        loop {
            sleep(CHECK_PERIOD).await;
            checked_world.check_now();
        }
    });
}
