//! A calm world with a working daemon, for tests of one thing that happens in it.

use std::sync::Arc;

use super::life::{configuration, paused_runtime, start, store_folder};
use super::recovery::wait_until_working;
use super::world::{HobKind, World};
use crate::Daemon;

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

/// Returns the requested power of the left hob now, in watt.
pub fn asked_w(world: &World) -> u16 {
    let now = world.now();
    let hob = &mut world.lock().sockets[0].hob;
    hob.advance_to(now);
    hob.asked_w()
}
