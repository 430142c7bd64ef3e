//! The lives of a daemon in one world: begun, used, killed or stopped, and begun again on the same store.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use ihd_store::{Reader, ResultFilter, WindowFilter};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tempfile::TempDir;
use tokio::runtime::Runtime;
use tokio::sync::broadcast::error::RecvError;
use tokio::time::sleep;

use super::faults::{end_all_faults, fail_at_random};
use super::users::{User, ask_at_random};
use super::world::{HOBS, World};
use crate::config::Config;
use crate::daemon::Daemon;
use crate::machine::Machine;
use crate::model::{Command, DeviceState};
use crate::{OpenDevice, Opened, config::Address};

use super::link::Link;

/// Between two looks at the promises.
const CHECK_EVERY: Duration = Duration::from_millis(100);

/// Between two windows that the simulated learner looks at.
const LEARN_EVERY: Duration = Duration::from_millis(100);

/// From when nothing fails any more until all has to work again: the longest wait between two tries to connect, what a
/// hello and a silent device take, and what the store is asked again after.
const MENDED_WITHIN: Duration = Duration::from_secs(40);

/// Course of events in a world.
pub struct Course {
    lines: Vec<String>,
    broken: Option<String>,
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
pub fn idle(time: Duration) -> [u64; HOBS.len()] {
    // Calm.
    let world = World::new(0);
    let folder = memory();
    paused_runtime().block_on(async {
        world.begin_life();
        let machine = machine_in(&world);
        let daemon = Daemon::start_on(machine, configuration(folder.path()), open_in(&world));
        let daemon = daemon.await.expect("it starts");
        sleep(time).await;
        daemon.stop().await;
        world.end_life();
    });
    let state = world.lock();
    std::array::from_fn(|hob| state.sockets[hob].connection)
}

/// Runs one seed.
pub fn run(seed: u64) -> Course {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let folder = memory();
    let store = folder.path().join("store");
    let world = World::new(seed);
    let lives = if world.is_calm {
        1
    } else {
        rng.random_range(1..4)
    };
    for life in 1..=lives {
        let runtime = paused_runtime();
        let is_last = life == lives;
        runtime.block_on(async {
            live(&world, &store, rng.random(), is_last).await;
            world.end_life();
        });
        // Its tasks end wherever each of them is: killed, where it was not stopped.
        drop(runtime);
        world.pass_without_daemon(Duration::from_millis(rng.random_range(0..15_000)));
        check_store(&world, &store);
        if world.lock().promises.broken.is_some() {
            break;
        }
    }
    let mut state = world.lock();
    Course {
        lines: std::mem::take(&mut state.course),
        broken: state.promises.broken.clone(),
    }
}

fn configuration(store: &Path) -> Config {
    let mut text = String::from("discover_usb = false\n");
    for name in HOBS {
        text += &format!("[[device]]\nname = \"{name}\"\naddress = \"serial:{name}\"\n");
    }
    let mut config = Config::parse(&text, "simulation").expect("a configuration");
    config.store = store.to_owned();
    config
}

async fn live(world: &Arc<World>, store: &Path, seed: u64, is_last: bool) {
    world.begin_life();
    world.note("a daemon begins");
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let machine = machine_in(world);
    let open = open_in(world);
    let daemon = match Daemon::start_on(machine, configuration(store), open).await {
        Ok(daemon) => daemon,
        Err(error) => return world.note_broken(format!("the daemon does not start: {error}")),
    };
    world.set_daemon(daemon.clone());
    beside(world, &daemon);
    let users = tokio::spawn(ask_at_random(
        Arc::clone(world),
        daemon.clone(),
        rng.random(),
    ));
    let faults = tokio::spawn(fail_at_random(Arc::clone(world), rng.random()));
    sleep(Duration::from_millis(rng.random_range(1_000..30_000))).await;
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
    sleep(MENDED_WITHIN).await;
    check_mended(world, &daemon).await;
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

/// Checks that all works, now that nothing fails.
async fn check_mended(world: &Arc<World>, daemon: &Daemon) {
    for (hob, name) in HOBS.into_iter().enumerate() {
        let state = daemon.device(name).map(|report| report.state);
        let works = !matches!(
            state,
            None | Some(
                DeviceState::Searching | DeviceState::Suspended | DeviceState::Incompatible
            )
        );
        if !works {
            world.note_broken(format!("{name} is {state:?} though nothing fails any more"));
        }
        let eve = User {
            world: Arc::clone(world),
            daemon: daemon.clone(),
            hob,
            name: "eve",
        };
        if let Err(error) = daemon.take_lease(name, "eve", true).await {
            world.note_broken(format!("{name} cannot be taken over: {error}"));
        }
        // What tripped is cleared first.
        let _ = daemon.command(name, "eve", Command::ClearFault).await;
        world.number_heating_request(hob);
        let power_w = 700;
        let heats = daemon
            .command(name, "eve", Command::Power { power_w })
            .await;
        let asked_w = world.lock().sockets[hob].hob.asked_w;
        if heats.is_err() || asked_w != power_w {
            world.note_broken(format!("{name} has {asked_w} of {power_w} W: {heats:?}"));
        }
        if !eve.off().await {
            world.note_broken(format!("{name} cannot be switched off"));
        }
        check_windows(world, daemon, name);
        check_lookup(world, daemon, hob).await;
    }
}

/// Checks that each window that was announced is counted in one place.
fn check_windows(world: &World, daemon: &Daemon, name: &str) {
    let Some(report) = daemon.device(name) else {
        return;
    };
    let w = &report.windows;
    let counted = w.stored + w.refused + w.dropped_by_device + w.lost + w.not_stored;
    // The one that is at the store.
    if w.announced.abs_diff(counted) > 1 {
        world.note_broken(format!("{name}'s windows do not add up: {w:?}"));
    }
}

/// Checks that the lookup that a hob uses is one that the store knows.
async fn check_lookup(world: &World, daemon: &Daemon, hob: usize) {
    let used = world.lock().sockets[hob].hob.lookup.clone();
    let rows = daemon.lookups(HOBS[hob]).await.unwrap_or_default();
    let blob = used.to_bytes();
    let is_known = rows
        .iter()
        .any(|row| row.version == used.version && row.blob == blob);
    if used.version > 0 && !is_known {
        let name = HOBS[hob];
        world.note_broken(format!(
            "{name} uses lookup {} that the store does not know",
            used.version
        ));
    }
}

/// Checks that what was acknowledged is in the store.
fn check_store(world: &World, folder: &Path) {
    let reader = match Reader::open(folder) {
        Ok(reader) => reader,
        Err(error) => return world.note_broken(format!("the store cannot be read: {error}")),
    };
    let windows = reader.windows(&WindowFilter::default());
    let limit = Some(u32::MAX);
    let results = reader.results(&ResultFilter {
        limit,
        ..ResultFilter::default()
    });
    let (windows, results) = match (windows, results) {
        (Ok(windows), Ok(results)) => (windows, results),
        (windows, results) => {
            let why = format!("the store cannot be read: {windows:?} {results:?}");
            return world.note_broken(why.chars().take(300).collect());
        }
    };
    let key = |device: &str, boot, seq| {
        let hob = HOBS.iter().position(|hob| *hob == device)?;
        Some((hob, boot, seq))
    };
    let stored = windows.iter().filter_map(|w| key(&w.device, w.boot, w.seq));
    let kept = results.iter().filter_map(|r| key(&r.device, r.boot, r.seq));
    let (stored, kept): (BTreeSet<_>, BTreeSet<_>) = (stored.collect(), kept.collect());
    let promises = &mut world.lock().promises;
    let lost = promises.stored.difference(&stored).next();
    let lost_result = promises.results.difference(&kept).next();
    if let Some(lost) = lost.or(lost_result) {
        promises.broken.get_or_insert(format!(
            "hob, boot, number {lost:?} was acknowledged, and is not in the store"
        ));
    }
}
