//! A store that does not answer, while the learner pushes lookups to a hob that heats.

use std::time::Duration;

use ihd_model::Command;
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_store::ResultFilter;
use tokio::time::sleep;

use super::calm::{POWER_W, asked_w, heat, with_daemon};
use super::disk::DiskState;
use super::hob::HOBS;
use super::world::World;
use crate::daemon::Daemon;
use crate::device::DeviceRequest;
use crate::learning::LookupToPush;
use crate::lease::LEASE_S;

/// Silences the store, and fills the queue of a device's task with lookups of the learner, each of which waits a second for it.
fn silence_store(world: &World, daemon: &Daemon, name: &str) {
    world.disk.set(DiskState {
        delay: Duration::from_secs(3_600),
        ..DiskState::default()
    });
    let requests = daemon.handle_of(name).unwrap().requests;
    tokio::spawn(async move {
        for version in 1.. {
            let lookup = RlLookup { version, ..prior() };
            let push = DeviceRequest::PushLookup {
                lookup: Box::new(LookupToPush::without_certainty(lookup)),
                forgotten_count: 0,
            };
            if requests.send(push).await.is_err() {
                return;
            }
        }
    });
}

/// The device's task waits for the store again and again. Meanwhile it keeps the hob heating for a lease that is renewed, and switches
/// off when it is not: the end of a lease may be late by one wait for the store, of a second.
#[test]
fn a_store_that_does_not_answer_neither_ends_heating_nor_keeps_it_on() {
    with_daemon(async |world, daemon| {
        let name = HOBS[0];
        let lease = || async { daemon.take_lease(name, "ada", false).await.unwrap() };
        heat(daemon).await;
        silence_store(world, daemon, name);
        for _ in 0..12 {
            lease().await;
            sleep(Duration::from_secs(5)).await;
            let connections = world.lock().sockets[0].connection;
            assert_eq!((asked_w(world), connections), (POWER_W, 1));
        }
        // Queries have connections of their own.
        let asked = world.now();
        daemon.view().lookups(name).await.unwrap();
        let all = ResultFilter::default();
        daemon.view().results(all).await.unwrap();
        assert_eq!(world.now(), asked, "a query waits for the store's thread");
        lease().await;
        let began = world.now();
        while asked_w(world) > 0 {
            sleep(Duration::from_millis(10)).await;
        }
        let after = world.now() - began;
        let end = Duration::from_secs(LEASE_S);
        let late = Duration::from_millis(1_200);
        assert!(after >= end && after <= end + late, "off after {after:?}");
    });
}

/// Its client was told after 15 s that it is not carried out.
#[test]
fn power_that_waited_for_too_long_is_not_carried_out_later() {
    with_daemon(async |world, daemon| {
        let name = HOBS[0];
        let lease = || async { daemon.take_lease(name, "ada", false).await.unwrap() };
        heat(daemon).await;
        silence_store(world, daemon, name);
        sleep(Duration::from_secs(5)).await;
        let asking = daemon.clone();
        let raised = tokio::spawn(async move {
            let power_w = POWER_W + 300;
            asking
                .command(name, "ada", Command::Power { power_w })
                .await
        });
        for _ in 0..10 {
            lease().await;
            sleep(Duration::from_secs(4)).await;
            assert_eq!(asked_w(world), POWER_W);
        }
        let refused = raised.await.unwrap().unwrap_err().to_string();
        assert!(refused.contains("not carried out within 15 s"), "{refused}");
    });
}
