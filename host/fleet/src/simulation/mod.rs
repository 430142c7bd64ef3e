//! Deterministic simulation of an edge's part in the fleet: its own tasks (edge/) beside the product's daemon in the daemon's simulation
//! (`ihd_daemon::simulation`), with a server in memory and workers.
//!
//! ```text
//!  hobs, users, disk, clock, kills ──► Daemon ◄──► edge's tasks ──► line.rs ──► server.rs ◄── workers.rs
//!                                                  outbox, inbox,   stalls, cuts, lost      honest, lying, silent,
//!                                                  trust, name …    and late messages       slow, publishing twice
//! ```
//!
//! `IHD_SEED=4711 cargo nextest run -p ihd-fleet simulation --no-capture` runs one seed again and prints its course; `IHD_SEEDS=10000` runs
//! so many.

pub mod line;
pub mod server;
mod watch;
mod weather;
mod workers;

use std::sync::Arc;

use ihd_daemon::simulation::{Course, DaemonPart, HobKind, Life, env_number, run, run_all};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use line::SimulatedConnection;
use server::ServerMemory;

use crate::edge::{Edge, State};
use crate::server::FleetServer;

/// Seeds of the short form.
const SEEDS: u64 = 4;

/// Name of the edge, as its daemon is configured.
const EDGE: &str = "kitchen";

/// Runs one seed: server and workers outlive the daemons.
fn course(seed: u64) -> Course {
    let memory = ServerMemory::new();
    let part: Box<DaemonPart> =
        Box::new(move |life| Box::pin(take_part(Arc::clone(&memory), life)));
    run(seed, HobKind::Script, Some(&*part))
}

async fn take_part(memory: Arc<ServerMemory>, life: Life) {
    let Life {
        world,
        daemon,
        seed,
        ended,
    } = life;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let state = State::begin();
    let line = SimulatedConnection::new(
        Arc::clone(&world),
        Arc::clone(&memory),
        Arc::clone(&state),
        rng.random(),
    );
    let address = "nats://simulated".to_owned();
    let server = FleetServer::Simulated(line.clone());
    let (_, edge) = Edge::begin(daemon.clone(), EDGE.to_owned(), address, server, state);
    let beside = [
        tokio::spawn(weather::change(line.clone(), rng.random())),
        tokio::spawn(workers::work(line.clone(), rng.random())),
        tokio::spawn(watch::watch(line.clone(), daemon.clone())),
    ];
    // A dropped sender ends the life, too.
    let _ = ended.await;
    edge.stop().await;
    watch::check_results(&line, &daemon);
    for task in beside {
        task.abort();
    }
}

#[test]
fn every_window_comes_back_once_whatever_fails() {
    let seeds = env_number("IHD_SEEDS").unwrap_or(SEEDS);
    run_all(0..seeds, course);
}

#[test]
fn one_seed_gives_one_course() {
    let [first, second] = [(), ()].map(|()| course(1).text());
    assert!(first.lines().count() > 20, "something happens");
    let mut lines = first.lines().zip(second.lines());
    assert_eq!(lines.find(|(first, second)| first != second), None);
    assert_eq!(first, second);
}
