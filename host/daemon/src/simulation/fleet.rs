//! A fleet of which the daemon is an edge: a server in memory that stalls, forgets and says things twice, and workers that answer, lie or
//! stay silent. What the daemon does with it is the product's own ([`crate::fleet`]); the task that talks to a server is scripted here.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use ihd_link::Window;
use ihd_store::{Due, DueWindow, Sent};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::time::{Instant, sleep, timeout};

use super::world::World;
use crate::daemon::Daemon;
use crate::fleet::{FleetConfig, TRUSTED_FOR};
use crate::learning::{Answer, Stated};

/// Between two turns of the edge's task.
const TURN: Duration = Duration::from_millis(500);

/// Windows that are sent in one turn.
const BATCH: usize = 32;

/// Longest wait for one answer to be taken in.
const TAKEN_WITHIN: Duration = Duration::from_secs(30);

/// Hob, boot and number of a window.
type Key = (String, u32, u32);

/// The server's memory. It outlives the daemons.
#[derive(Default)]
pub struct Fleet {
    /// Windows that wait for a worker.
    windows: BTreeMap<Key, Window>,
    /// Answers that the edge has not acknowledged.
    answers: BTreeMap<u64, (Key, Answer)>,
    /// Answers so far.
    count: u64,
    /// Windows with an answer: the first counts.
    answered: BTreeSet<Key>,
    /// It has lost its disk, and the edge has not noted that yet.
    is_new: bool,
}

impl Fleet {
    fn publish(&mut self, key: Key, answer: Answer) {
        self.count += 1;
        self.answers.insert(self.count, (key, answer));
    }
}

/// Configuration of the edge.
pub fn config() -> FleetConfig {
    FleetConfig {
        url: "nats://simulated".to_owned(),
        edge: Some("kitchen".to_owned()),
        nkey_file: None,
        token_file: None,
        ca: None,
        captures: false,
    }
}

/// Edge's task, server and workers, until the daemon's life ends.
pub async fn take_part(world: Arc<World>, daemon: Daemon, seed: u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut away_until = Instant::now();
    loop {
        sleep(TURN).await;
        let fails = world.may_fail();
        if fails && rng.random_bool(0.02) {
            let lasts = Duration::from_millis(rng.random_range(1_000..60_000));
            world.note(&format!("the fleet's server stalls for {lasts:?}"));
            away_until = Instant::now() + lasts;
        }
        if fails && Instant::now() < away_until {
            continue;
        }
        if fails && rng.random_bool(0.01) {
            world.note("the fleet's server loses its disk");
            *world.fleet() = Fleet {
                is_new: true,
                ..Fleet::default()
            };
        }
        let is_new = world.fleet().is_new;
        if is_new {
            match daemon.due_again(i64::MAX).await {
                Ok(_) => world.fleet().is_new = false,
                // A store that is full: tried again.
                Err(_) => continue,
            }
        }
        send(&world, &daemon, &mut rng, fails).await;
        work(&world, &mut rng, fails);
        take_in(&world, &daemon, &mut rng, fails).await;
        daemon.trust_fleet(Some(Instant::now() + TRUSTED_FOR));
    }
}

/// Sends what is due; of some the acknowledgement is lost.
async fn send(world: &World, daemon: &Daemon, rng: &mut ChaCha8Rng, fails: bool) {
    let Ok(due) = daemon.due(BATCH).await else {
        return;
    };
    let mut sent = Vec::new();
    for due in due {
        let Ok(found) = daemon.read_due(due.clone()).await else {
            continue;
        };
        let key = key(&due);
        let what = match found {
            Due::Window(window) => {
                let fleet = &mut *world.fleet();
                if !fleet.answered.contains(&key) {
                    fleet.windows.insert(key, *window);
                }
                Sent::Window
            }
            Due::Result(_) => {
                world.fleet().answered.insert(key);
                Sent::Result
            }
            Due::Gone => Sent::Nothing,
        };
        if !fails || rng.random_bool(0.9) {
            sent.push((due, what));
        }
    }
    // What is not noted is due again.
    let _ = daemon.sent(sent).await;
}

fn key(due: &DueWindow) -> Key {
    (due.device.clone(), due.boot, due.seq)
}

/// Answers what waits: some windows later, some twice, and some that nobody has asked about.
fn work(world: &World, rng: &mut ChaCha8Rng, fails: bool) {
    let fleet = &mut *world.fleet();
    for (key, window) in std::mem::take(&mut fleet.windows) {
        if fails && rng.random_bool(0.2) {
            fleet.windows.insert(key, window);
            continue;
        }
        let answer = answer(rng, &window);
        if fails && rng.random_bool(0.1) {
            let (hob, boot, seq) = key.clone();
            fleet.publish((hob, boot, seq + 100_000), answer.clone());
        }
        if rng.random_bool(0.1) {
            fleet.publish(key.clone(), answer.clone());
        }
        fleet.publish(key.clone(), answer);
        fleet.answered.insert(key);
    }
}

/// A lie, or nothing: a scripted hob's windows show no load.
fn answer(rng: &mut ChaCha8Rng, window: &Window) -> Answer {
    let points: Vec<f64> = (0..64).map(|k| 156e-6 * f64::from(k)).collect();
    let found = match rng.random_bool(0.7) {
        true => Ok(Stated {
            r_ohm: points
                .iter()
                .map(|_| rng.random_range(-1.0..20.0))
                .collect(),
            l_h: vec![20e-6; points.len()],
            t_s: points,
            ..Stated::default()
        }),
        false => Err(format!("window {} shows nothing", window.seq)),
    };
    Answer {
        by: format!("worker-{}", rng.random_range(0..9)),
        skew_s: None,
        found,
        busy: Duration::from_millis(60),
    }
}

/// Hands answers to the daemon, in any order; what is not acknowledged comes again.
async fn take_in(world: &World, daemon: &Daemon, rng: &mut ChaCha8Rng, fails: bool) {
    let waiting = world.fleet().answers.clone();
    for (number, ((hob, boot, seq), answer)) in waiting {
        let received = daemon.receive(&hob, boot, seq, answer);
        let received = timeout(TAKEN_WITHIN, received).await;
        let is_acknowledged = matches!(received, Ok(Ok(_)));
        if is_acknowledged && (!fails || rng.random_bool(0.9)) {
            world.fleet().answers.remove(&number);
        }
    }
}

/// Checks that the fleet owes nothing, now that nothing fails: each window has come to its end.
pub async fn check_settled(world: &World, daemon: &Daemon) {
    match daemon.fleet_tally().await {
        Ok(tally) if tally.due + tally.sent > 0 => {
            world.note_broken(format!("windows are still at the fleet: {tally:?}"));
        }
        Ok(_) => {}
        Err(why) => world.note_broken(format!("windows cannot be counted: {why}")),
    }
    if daemon.workers().values().any(|worker| worker.confirmed > 0) {
        world.note_broken("a lie was confirmed".to_owned());
    }
}
