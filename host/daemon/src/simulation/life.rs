//! The lives of a daemon in one world: begun, used, killed or stopped, and begun again on the same store.

use std::ops::Range;
use std::path::Path;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tempfile::TempDir;
use tokio::runtime::Runtime;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::oneshot;
use tokio::time::sleep;

#[cfg(test)]
use super::faults::greet;
use super::faults::{end_all_faults, fail_at_random};
use super::users::ask_at_random;
use super::world::{HOBS, Left, World};
use crate::config::Config;
use crate::daemon::Daemon;
use crate::fleet::FleetConfig;
use crate::machine::Machine;
#[cfg(test)]
use crate::model::{Command, What};
use crate::{OpenDevice, Opened, config::Address};

use super::link::Link;
use super::mended::{MENDED_WITHIN, check_mended, check_settled, check_store, until_all_works};

/// Between two looks at the promises.
const CHECK_EVERY: Duration = Duration::from_millis(100);

/// Between two windows that the simulated learner looks at.
const LEARN_EVERY: Duration = Duration::from_millis(100);

/// Lengths of a course, each within a range.
struct Lengths {
    lives: Range<u32>,
    life_ms: Range<u64>,
    /// From the end of one life to the next.
    dead_ms: Range<u64>,
}

impl Lengths {
    fn of(left: Left, is_edge: bool) -> Self {
        match left {
            // Trust in a fleet lasts 20 s.
            Left::Script if is_edge => Self {
                lives: 1..4,
                life_ms: 5_000..90_000,
                dead_ms: 0..40_000,
            },
            Left::Script => Self {
                lives: 1..4,
                life_ms: 1_000..30_000,
                dead_ms: 0..15_000,
            },
            Left::Board => Self {
                lives: 1..3,
                life_ms: 1_000..4_000,
                dead_ms: 0..1_000,
            },
        }
    }
}

/// One life of a daemon that is an edge, for its part in a fleet.
pub struct Life {
    /// The world.
    pub world: Arc<World>,
    /// The daemon.
    pub daemon: Daemon,
    /// Chance of this life.
    pub seed: u64,
    /// Ready once the part has to end. A killed daemon's part just goes.
    pub ended: oneshot::Receiver<()>,
}

/// A daemon's part in a fleet, begun with each of its lives.
pub type Part = dyn Fn(Life) -> Pin<Box<dyn Future<Output = ()> + Send>>;

/// Course of events in a world.
pub struct Course {
    lines: Vec<String>,
    broken: Option<String>,
    /// Simulated time that it lasted.
    pub lasted: Duration,
}

impl Course {
    /// A line for each thing that happened.
    pub fn text(&self) -> String {
        self.lines.join("\n")
    }

    /// The first promise that was broken.
    pub fn broken(&self) -> Option<&str> {
        self.broken.as_deref()
    }
}

/// A folder for a store, in memory where the system has one there.
fn memory() -> TempDir {
    let memory = Path::new("/dev/shm");
    let folder = match memory.is_dir() {
        true => tempfile::tempdir_in(memory),
        false => tempfile::tempdir(),
    };
    folder.expect("a folder for the store")
}

fn paused_runtime() -> Runtime {
    tokio::runtime::Builder::new_current_thread()
        .enable_time()
        .start_paused(true)
        .build()
        .expect("a runtime")
}

/// Runs a daemon for so long with hobs that nobody asks for anything. Returns the connections made to each.
#[cfg(test)]
pub fn idle(time: Duration) -> [u64; HOBS.len()] {
    // Calm.
    let world = World::new(0, Left::Script, false);
    let folder = memory();
    paused_runtime().block_on(async {
        world.begin_life();
        let machine = machine_in(&world);
        let daemon = Daemon::start_on(
            machine,
            configuration(&world, folder.path()),
            open_in(&world),
        );
        let daemon = daemon.await.expect("it starts");
        sleep(time).await;
        daemon.stop().await;
        world.end_life();
    });
    let state = world.lock();
    std::array::from_fn(|hob| state.sockets[hob].connection)
}

/// Says hello as a stranger to a hob of this kind that heats for somebody; nothing else happens. Returns how long the daemon went on to tell
/// of power, and what it said of its end.
#[cfg(test)]
pub fn greeted(left: Left) -> (Duration, String) {
    // Calm.
    let world = World::new(0, left, false);
    let folder = memory();
    let told = paused_runtime().block_on(async {
        world.begin_life();
        let (machine, open) = (machine_in(&world), open_in(&world));
        let daemon = Daemon::start_on(machine, configuration(&world, folder.path()), open);
        let daemon = daemon.await.expect("it starts");
        world.set_daemon(daemon.clone());
        until_all_works(&daemon).await;
        let (name, power_w) = (HOBS[0], 900);
        daemon
            .take_lease(name, "ada", false)
            .await
            .expect("it is free");
        let heat = Command::Power { power_w };
        daemon.command(name, "ada", heat).await.expect("it heats");
        let mut notices = daemon.watch();
        greet(&world, 0);
        let began = world.now();
        let why = loop {
            let notice = notices.recv().await.expect("the daemon lives");
            if let What::Lease { holder, why, .. } = &notice.what
                && holder.is_empty()
            {
                break why.clone();
            }
        };
        let report = daemon.device(name).expect("a hob of this world");
        assert_eq!((report.asked_by_daemon_w, report.lease), (0, None));
        let told = (world.now() - began, why);
        daemon.stop().await;
        world.end_life();
        told
    });
    let broken = world.lock().promises.broken.clone();
    assert_eq!(broken, None);
    told
}

/// Runs one seed; the daemon is an edge where it is given a part in a fleet.
///
/// # Panics
/// There is no folder for a store, or no runtime.
pub fn run(seed: u64, left: Left, part: Option<&Part>) -> Course {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let folder = memory();
    let store = folder.path().join("store");
    let world = World::new(seed, left, part.is_some());
    let lengths = Lengths::of(left, world.is_edge);
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
        // Its tasks end wherever each of them is: killed, where it was not stopped.
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

fn configuration(world: &World, store: &Path) -> Config {
    let mut text = String::from("discover_usb = false\n");
    for name in HOBS {
        text += &format!("[[device]]\nname = \"{name}\"\naddress = \"serial:{name}\"\n");
    }
    let mut config = Config::parse(&text, "simulation").expect("a configuration");
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
    part: Option<&Part>,
) {
    world.begin_life();
    world.note("a daemon begins");
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let machine = machine_in(world);
    let open = open_in(world);
    let daemon = match Daemon::start_on(machine, configuration(world, store), open).await {
        Ok(daemon) => daemon,
        Err(error) => return world.note_broken(format!("the daemon does not start: {error}")),
    };
    world.set_daemon(daemon.clone());
    beside(world, &daemon);
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
    let faults = tokio::spawn(fail_at_random(Arc::clone(world), rng.random()));
    sleep(life).await;
    users.abort();
    faults.abort();
    if !is_last {
        // Between any two turns of its tasks.
        for _ in 0..rng.random_range(0..40) {
            tokio::task::yield_now().await;
        }
        return world.note("the daemon is killed");
    }
    end_all_faults(world);
    world.note("all is mended");
    match world.left {
        Left::Script => sleep(MENDED_WITHIN).await,
        Left::Board => until_all_works(&daemon).await,
    }
    if world.is_edge {
        check_settled(world, &daemon, store).await;
    }
    check_mended(world, &daemon).await;
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
        let link = Link::connect(&world, name)?;
        Ok(Opened::real(Box::new(link)))
    })
}

/// Starts what runs beside the daemon: its learner, a listener to its notices, and the check of the promises.
fn beside(world: &Arc<World>, daemon: &Daemon) {
    let learner = daemon.learner().map(|learner| Arc::downgrade(&learner));
    tokio::spawn(async move {
        while let Some(learner) = learner.as_ref().and_then(std::sync::Weak::upgrade) {
            learner.learn_one();
            drop(learner);
            sleep(LEARN_EVERY).await;
        }
    });
    let (mut notices, hears) = (daemon.watch(), Arc::clone(world));
    tokio::spawn(async move {
        loop {
            match notices.recv().await {
                Ok(notice) => hears.record_notice(&notice),
                Err(RecvError::Lagged(_)) => {}
                Err(RecvError::Closed) => return,
            }
        }
    });
    let looks = Arc::clone(world);
    tokio::spawn(async move {
        loop {
            sleep(CHECK_EVERY).await;
            looks.check_now();
        }
    });
}
