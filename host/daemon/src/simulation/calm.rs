//! A calm world with a working daemon, for tests of one thing that happens in it.

use std::sync::Arc;

use ihd_model::Command;

use super::hob::HOBS;
use super::life::{configuration, paused_runtime, start, store_folder};
use super::recovery::wait_until_working;
use super::world::{HobKind, World};
use crate::Daemon;

/// Power of [`heat`].
pub const POWER_W: u16 = 900;

/// Runs `test` beside scripted hobs that have a working daemon.
pub fn with_daemon(test: impl AsyncFnOnce(&Arc<World>, &Daemon)) {
    // Seed 0 is calm.
    let world = World::new(0, HobKind::Script, false);
    let folder = store_folder();
    paused_runtime().block_on(async {
        let daemon = start(&world, configuration(&world, folder.path())).await;
        let daemon = daemon.expect("it starts");
        wait_until_working(&daemon).await;
        test(&world, &daemon).await;
        world.end_life();
    });
}

/// Has the left hob heat with [`POWER_W`] under a lease of `ada`.
pub async fn heat(daemon: &Daemon) {
    let name = HOBS[0];
    daemon.take_lease(name, "ada", false).await.unwrap();
    let heat = Command::Power { power_w: POWER_W };
    daemon.command(name, "ada", heat).await.expect("it heats");
}

/// Returns the requested power of the left hob now, in watt.
pub fn asked_w(world: &World) -> u16 {
    let now = world.now();
    let hob = &mut world.lock().sockets[0].hob;
    hob.advance_to(now);
    hob.asked_w()
}
