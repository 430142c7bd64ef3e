//! Faults of links, hobs, disk and clock, at random times.

use std::sync::Arc;
use std::time::Duration;

use ihd_shared::wire::frame::{MAX_ENCODED, encode};
use ihd_shared::wire::hello::{ROLE_HOST, ours};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::time::sleep;

use super::disk::DiskState;
use super::hob::HOBS;
use super::world::{Socket, World};

/// Injects random faults at random times, until the task is aborted.
pub async fn inject_random_faults(world: Arc<World>, seed: u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    if world.is_calm {
        return;
    }
    {
        let mut state = world.lock();
        for socket in &mut state.sockets {
            let mut chance = |most: f64| match rng.random_bool(0.4) {
                true => rng.random_range(0.0..most),
                false => 0.0,
            };
            socket.loss_chance = chance(0.1);
            socket.duplicate_chance = chance(0.1);
            socket.delay_chance = chance(0.01);
        }
    }
    loop {
        sleep(Duration::from_millis(rng.random_range(500..8_000))).await;
        let hob = world.any_hob(&mut rng);
        let duration = Duration::from_millis(rng.random_range(10..6_000));
        match rng.random_range(0..10) {
            0 => cut(&world, hob),
            1 => fail_for(&world, hob, duration, "is unplugged", |s, on| {
                s.is_plugged = !on
            }),
            2 | 3 => fail_for(&world, hob, duration, "is mute", |s, on| s.is_mute = on),
            4 => reboot(&world, hob),
            5 => trip(&world, hob),
            6 | 7 => {
                let delay_ms = rng.random_range(0..3_000);
                let state = DiskState {
                    delay: Duration::from_millis(if rng.random_bool(0.5) { delay_ms } else { 0 }),
                    refuses_records: rng.random_bool(0.3),
                    refuses_windows: rng.random_bool(0.3),
                };
                fail_disk_for(&world, duration, state);
            }
            8 => send_foreign_hello(&world, hob),
            _ => shift_clock(&world, &mut rng),
        }
    }
}

fn cut(world: &World, hob: usize) {
    world.note(&format!("{} is cut off", HOBS[hob]));
    world.lock().sockets[hob].connection += 1;
}

fn reboot(world: &World, hob: usize) {
    world.note(&format!("{} reboots", HOBS[hob]));
    let now = world.now();
    world.lock().sockets[hob].hob.reboot(now);
}

fn trip(world: &World, hob: usize) {
    world.note(&format!("{} trips", HOBS[hob]));
    world.lock().sockets[hob].hob.trip();
}

/// Delivers a hello of another host to a hob.
pub fn send_foreign_hello(world: &World, hob: usize) {
    world.note(&format!("a stranger says hello to {}", HOBS[hob]));
    let mut frame = [0; MAX_ENCODED];
    let hello = ours(ROLE_HOST, 0, 0, "a stranger", "host");
    let length = encode(&hello, 0, &mut frame).expect("it fits a frame");
    world.deliver(hob, &frame[..length]);
}

fn shift_clock(world: &World, rng: &mut ChaCha8Rng) {
    let by_ms = match rng.random_bool(0.5) {
        true => rng.random_range(-3_000..3_000),
        false => rng.random_range(-90_000_000..90_000_000),
    };
    world.note(&format!("the clock is shifted by {by_ms} ms"));
    world.shift_clock_by(by_ms);
}

fn fail_for(
    world: &Arc<World>,
    hob: usize,
    duration: Duration,
    text: &'static str,
    set: fn(&mut Socket, bool),
) {
    world.note(&format!("{} {text} for {duration:?}", HOBS[hob]));
    set(&mut world.lock().sockets[hob], true);
    let world = Arc::clone(world);
    tokio::spawn(async move {
        sleep(duration).await;
        set(&mut world.lock().sockets[hob], false);
    });
}

fn fail_disk_for(world: &Arc<World>, duration: Duration, state: DiskState) {
    world.note(&format!("the disk: {state:?} for {duration:?}"));
    world.disk.set(state);
    let world = Arc::clone(world);
    tokio::spawn(async move {
        sleep(duration).await;
        world.disk.set(DiskState::default());
    });
}

/// Ends all lasting faults; a locked-out hob is switched off and on.
pub fn end_all_faults(world: &World) {
    world.end_faults();
    world.disk.set(DiskState::default());
    let now = world.now();
    for socket in &mut world.lock().sockets {
        if socket.hob.is_locked_out() {
            socket.hob.reboot(now);
        }
        (socket.is_plugged, socket.is_mute) = (true, false);
        (
            socket.loss_chance,
            socket.duplicate_chance,
            socket.delay_chance,
        ) = (0.0, 0.0, 0.0);
    }
}
