//! Lookups on the device and in the store agree after any sequence of events.

use std::sync::atomic::Ordering;

use ihd_daemon::Daemon;
use ihd_model::{Command, DeviceState, EventKind};
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_sim::hob::HobConfig;
use ihd_store::{JournalFilter, LookupState, Store};

use super::rig::{Rig, command_stored, until, until_state, wait_for_event};

/// Returns a valid lookup of a version, with one observed cell.
fn lookup(version: u32, mark: usize) -> RlLookup {
    let mut lookup = RlLookup { version, ..prior() };
    lookup.mark_observed(mark, mark);
    lookup
}

async fn push(daemon: &Daemon, lookup: &RlLookup) -> String {
    let blob = lookup.to_bytes().to_vec();
    let pushed = command_stored(daemon, Command::LookupPush { blob });
    pushed.await.unwrap().text
}

async fn states(daemon: &Daemon) -> Vec<(u32, LookupState)> {
    let rows = daemon.view().lookups("bench").await.unwrap();
    rows.iter().map(|row| (row.version, row.state)).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn pushed_rolled_back_and_reset() {
    use LookupState::{Active, Superseded};
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    let report = until_state(&daemon, DeviceState::Idle).await;
    assert_eq!(report.lookup.on_device, Some(0));
    let mut events = daemon.watch();
    assert!(push(&daemon, &lookup(1, 1)).await.contains("version 1"));
    let version = wait_for_event(&mut events, |kind| match kind {
        EventKind::LookupActive { version, .. } => Some(*version),
        _ => None,
    });
    assert_eq!(version.await, 1);
    push(&daemon, &lookup(2, 2)).await;
    let report = until(&daemon, |r| r.lookup.on_device == Some(2)).await;
    assert_eq!(report.lookup.active, Some(2));
    let rows = states(&daemon).await;
    assert_eq!(rows, [(0, Superseded), (1, Superseded), (2, Active)]);
    let back = command_stored(&daemon, Command::LookupRollback { version: None }).await;
    assert!(back.unwrap().text.contains("version 3"));
    let active = daemon.view().lookups("bench").await.unwrap().pop().unwrap();
    assert_eq!(
        active.blob,
        lookup(3, 1).to_bytes(),
        "the cells of version 1"
    );
    command_stored(&daemon, Command::LookupReset).await.unwrap();
    let report = until(&daemon, |r| r.lookup.on_device == Some(0)).await;
    assert_eq!(report.lookup.active, Some(0));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_refused_lookup_is_a_state() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    // Invalid bytes are an error, and nothing is stored.
    let blob = vec![1, 2, 3];
    let refused = daemon
        .command("bench", "a", Command::LookupPush { blob })
        .await;
    assert!(refused.unwrap_err().to_string().contains("bytes"));
    assert_eq!(states(&daemon).await, [(0, LookupState::Active)]);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_device_that_lost_its_lookup_gets_it_again() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    push(&daemon, &lookup(7, 3)).await;
    // Another boot, with an empty flash.
    rig.bench().replace(&HobConfig {
        seed: 99,
        ..HobConfig::default()
    });
    let report = until(&daemon, |r| {
        r.identity.as_ref().is_some_and(|i| i.boot_id == 99) && r.lookup.on_device == Some(7)
    })
    .await;
    assert_eq!(report.lookup.active, Some(7));
    daemon.stop().await;
}

/// Puts a hob without a lookup, of this seed and chip, in place of the one that is there.
async fn swap(rig: &Rig, daemon: &Daemon, seed: u64, chip: u8) {
    rig.bench().unplugged.store(true, Ordering::Relaxed);
    until_state(daemon, DeviceState::Searching).await;
    rig.bench().replace(&HobConfig {
        seed,
        ..HobConfig::default()
    });
    rig.bench().hob().set_chip([chip; 12]);
    rig.bench().unplugged.store(false, Ordering::Relaxed);
    until(daemon, |r| {
        let boot = r.identity.as_ref().map(|i| i.boot_id);
        boot == Some(seed as u32) && r.state == DeviceState::Idle
    })
    .await;
}

/// The chip's number tells a board that has lost its lookup from another one under its name.
#[tokio::test(flavor = "multi_thread")]
async fn another_board_does_not_get_the_lookup_of_the_one_before() {
    use LookupState::{Active, Superseded};
    let rig = Rig::new(&["bench"]);
    rig.bench().hob().set_chip([1; 12]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    push(&daemon, &lookup(7, 3)).await;
    until(&daemon, |r| r.lookup.active == Some(7)).await;
    swap(&rig, &daemon, 98, 1).await;
    until(&daemon, |r| r.lookup.on_device == Some(7)).await;
    swap(&rig, &daemon, 99, 2).await;
    let report = until(&daemon, |r| r.lookup.active == Some(0)).await;
    assert_eq!(report.lookup.on_device, Some(0));
    let rows = states(&daemon).await;
    assert!(
        rows.iter()
            .all(|row| matches!(row, (0, Active) | (7, Superseded))),
        "{rows:?}"
    );
    let filter = JournalFilter {
        kind: Some("learned".to_owned()),
        ..JournalFilter::default()
    };
    let told = daemon.view().journal(filter).await.unwrap();
    assert!(
        told.len() == 1 && told[0].text.contains("another board"),
        "{told:?}"
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_pending_when_the_daemon_died_is_pushed_by_the_next() {
    let rig = Rig::new(&["bench"]);
    let config = rig.config();
    {
        let mut store = Store::open(&config.store, &config.store_settings())
            .unwrap()
            .store;
        let device = store.device("bench", "serial:bench").unwrap();
        store
            .pend_lookup(device, &lookup(4, 4), "a test", None)
            .unwrap();
    }
    let daemon = rig.daemon().await;
    let report = until(&daemon, |r| {
        r.lookup.on_device == Some(4) && r.lookup.active == Some(4)
    })
    .await;
    assert_eq!(report.lookup.pending, None);
    assert_eq!(report.lookup.observed_cells, 1);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_somebody_else_pushed_is_adopted() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    push(&daemon, &lookup(1, 1)).await;
    daemon.stop().await;
    let other = Rig {
        benches: rig.benches.clone(),
        folder: tempfile::tempdir().unwrap(),
    };
    let daemon = other.daemon().await;
    until(&daemon, |r| r.lookup.active == Some(1)).await;
    push(&daemon, &lookup(2, 5)).await;
    daemon.stop().await;
    let daemon = rig.daemon().await;
    until(&daemon, |r| r.lookup.active == Some(2)).await;
    let last = daemon.view().lookups("bench").await.unwrap().pop().unwrap();
    assert_eq!((last.version, last.origin.as_str()), (2, "device"));
    daemon.stop().await;
}
