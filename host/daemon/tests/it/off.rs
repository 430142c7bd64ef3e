//! Command `off`: it precedes all other work, and no earlier request heats after it.

use std::sync::atomic::Ordering;
use std::time::Duration;

use ihd_model::{Command, DeviceState};
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_store::{LookupRow, LookupState, StoreReader};

use super::rig::{Clock, Rig, command_stored, let_hob_run, nap, power, until, until_state};

/// Number of commands that wait for the device's task; more than its queue holds.
const WAITING: usize = 20;

impl Rig {
    fn database(&self) -> std::path::PathBuf {
        self.folder.path().join("store/ihd.db")
    }

    /// Locks the database until the returned connection is dropped, as a stuck disk would.
    fn lock_database(&self) -> rusqlite::Connection {
        let connection = rusqlite::Connection::open(self.database()).unwrap();
        connection.busy_timeout(Duration::from_secs(300)).unwrap();
        connection.execute_batch("BEGIN IMMEDIATE").unwrap();
        connection
    }

    /// Returns the commands in the audit, oldest first.
    fn audited(&self) -> Vec<String> {
        let reader = StoreReader::open(&self.folder.path().join("store")).unwrap();
        let rows = reader.audit(100).unwrap().into_iter().rev();
        rows.map(|row| row.command).collect()
    }
}

#[tokio::test]
async fn off_waits_neither_for_the_disk_nor_behind_other_commands() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    power(&daemon, "a", 1_000).await.unwrap();
    while rig.audited().is_empty() {
        nap().await;
    }
    let lock = rig.lock_database();
    let clock = Clock::stop();
    // The device's task waits for the store, and all other commands for the task.
    let lookup = RlLookup {
        version: 1,
        ..prior()
    };
    let blob = lookup.to_bytes().to_vec();
    let asking = daemon.clone();
    let push = tokio::spawn(async move {
        let push = asking.command("bench", "a", Command::LookupPush { blob });
        push.await
    });
    nap().await;
    let powers: Vec<_> = (0..WAITING)
        .map(|_| {
            let asking = daemon.clone();
            tokio::spawn(async move { power(&asking, "a", 1_500).await })
        })
        .collect();
    nap().await;
    daemon.command("bench", "b", Command::Off).await.unwrap();
    assert_eq!(rig.bench().asked_w(), 0);
    assert_eq!(daemon.view().device("bench").unwrap().asked_by_daemon_w, 0);
    assert!(powers.iter().all(|power| !power.is_finished()));
    assert_eq!(rig.audited(), ["power 1000 W"]);
    drop(lock);
    for power in powers {
        let refused = power.await.unwrap().unwrap_err().to_string();
        assert!(refused.contains("`off` came before"), "{refused}");
    }
    // It does not heat: either outcome is right.
    let _ = push.await.unwrap();
    assert_eq!(rig.bench().asked_w(), 0);
    power(&daemon, "a", 700).await.unwrap();
    assert_eq!(rig.bench().asked_w(), 700);
    clock.go_on();
    daemon.stop().await;
    let audited = rig.audited();
    assert_eq!(audited.len(), WAITING + 4);
    assert_eq!(audited[..2], ["power 1000 W", "off"]);
    assert_eq!(audited.last().unwrap(), "power 700 W");
}

#[tokio::test]
async fn off_ends_a_sweep_for_good() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    let clock = Clock::stop();
    let powers_w = vec![800, 1_200];
    let sweep = Command::Sweep { powers_w };
    daemon.command("bench", "a", sweep).await.unwrap();
    while rig.bench().asked_w() != 800 {
        clock.pass(Duration::from_millis(3)).await;
    }
    daemon.command("bench", "b", Command::Off).await.unwrap();
    let report = daemon.view().device("bench").unwrap();
    assert_eq!(report.sweep_left_w, [0; 0]);
    // Long enough for the next power of the sweep.
    for _ in 0..9 {
        clock.pass(Duration::from_millis(900)).await;
        let_hob_run(rig.bench(), 0.5).await;
        assert_eq!(rig.bench().asked_w(), 0);
    }
    let report = until(&daemon, |r| r.sweep_left_w.is_empty()).await;
    assert!(!report.sweep_is_complete);
    daemon.stop().await;
}

/// Its power is the panel's: no lease ends.
#[tokio::test(flavor = "multi_thread")]
async fn an_off_without_an_answer_is_tried_again_until_the_hob_is_off() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    rig.bench().panel(6);
    until_state(&daemon, DeviceState::Learning).await;
    rig.bench().mute.store(true, Ordering::Relaxed);
    let off = daemon.command("bench", "b", Command::Off).await;
    off.expect_err("nothing was answered");
    assert!(rig.bench().asked_w() > 0);
    rig.bench().mute.store(false, Ordering::Relaxed);
    until(&daemon, |_| rig.bench().asked_w() == 0).await;
    daemon.stop().await;
}

#[tokio::test]
async fn a_command_whose_client_leaves_is_carried_out_and_audited() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    {
        let mut asked = std::pin::pin!(power(&daemon, "a", 700));
        tokio::select! {
            biased;
            _ = &mut asked => panic!("nobody had the time to answer"),
            () = std::future::ready(()) => {}
        }
    }
    while rig.audited().is_empty() {
        nap().await;
    }
    assert_eq!(rig.audited(), ["power 700 W"]);
    assert_eq!(rig.bench().asked_w(), 700);
    daemon.stop().await;
}

/// Until its disk answers again, and after.
#[tokio::test]
async fn what_was_refused_because_the_store_is_stuck_does_not_happen_later() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    let push = |version| {
        let lookup = RlLookup { version, ..prior() };
        let blob = lookup.to_bytes().to_vec();
        Command::LookupPush { blob }
    };
    command_stored(&daemon, push(1)).await.unwrap();
    // A row that is still to be written would wait for the lock, and reads behind it.
    while rig.audited().is_empty() || daemon.upkeep().figures().store_waiting > 0 {
        nap().await;
    }
    let audited = rig.audited().len();
    let lock = rig.lock_database();
    let clock = Clock::stop();
    for command in [push(2), Command::LookupReset] {
        let asking = daemon.clone();
        let asked = tokio::spawn(async move { asking.command("bench", "a", command).await });
        while !asked.is_finished() {
            clock.pass(Duration::from_millis(100)).await;
        }
        let refused = asked.await.unwrap().unwrap_err().to_string();
        assert!(refused.contains("the store "), "{refused}");
    }
    drop(lock);
    // The audit comes after what waited for the store.
    while rig.audited().len() < audited + 2 {
        clock.pass(Duration::from_millis(100)).await;
    }
    clock.go_on();
    let report = daemon.view().device("bench").unwrap();
    assert_eq!(report.lookup.on_device, Some(1));
    // In the store, which the report shows only after the next change.
    let rows = daemon.view().lookups("bench").await.unwrap();
    let is_present =
        |row: &&LookupRow| matches!(row.state, LookupState::Active | LookupState::Pending);
    let present: Vec<_> = rows.iter().filter(is_present).collect();
    assert_eq!((present.len(), present[0].version), (1, 1), "{present:?}");
    daemon.stop().await;
}
