//! Leases: one holder commands, and without a lease the hob is off.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use ihd_daemon::lease::LEASE_S;
use ihd_model::{Command, CommandError, DeviceState, EventKind};

use super::rig::{Clock, PATIENCE, Rig, nap, power, until_state, wait_for_event};

#[tokio::test]
async fn power_ends_with_the_lease_that_nobody_renews() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    let mut events = daemon.watch();
    let clock = Clock::stop();
    power(&daemon, "a", 1_000).await.unwrap();
    assert_eq!(rig.bench().asked_w(), 1_000);
    // Renewed once, it lasts longer than ten seconds.
    clock.pass(Duration::from_secs(6)).await;
    daemon.take_lease("bench", "a", false).await.unwrap();
    let nearly = Duration::from_secs(LEASE_S) - Duration::from_millis(200);
    clock.pass(nearly).await;
    let report = daemon.view().device("bench").unwrap();
    assert_eq!(
        (rig.bench().asked_w(), report.asked_by_daemon_w),
        (1_000, 1_000)
    );
    // Off a tick after its end; the session may need further ticks, and the link's thread real time.
    let patience = std::time::Instant::now() + PATIENCE;
    while daemon.view().device("bench").unwrap().asked_by_daemon_w != 0 {
        assert!(std::time::Instant::now() < patience, "the power stays");
        clock.pass(Duration::from_millis(50)).await;
    }
    // The link's thread sends the request.
    let off = async {
        while rig.bench().asked_w() != 0 {
            nap().await;
        }
    };
    clock.go_on();
    let off = tokio::time::timeout(PATIENCE, off).await;
    off.expect("the hob is off");
    wait_for_event(&mut events, |kind| match kind {
        EventKind::Lease { holder, .. } if holder.is_empty() => Some(()),
        _ => None,
    })
    .await;
    daemon.stop().await;
}

/// The hob ends its power by itself then; whoever asked for it is told that it does not heat any more.
#[tokio::test(flavor = "multi_thread")]
async fn a_link_that_is_cut_ends_the_lease_with_its_power() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    let mut events = daemon.watch();
    power(&daemon, "a", 1_000).await.unwrap();
    rig.bench().unplugged.store(true, Ordering::Relaxed);
    let why = wait_for_event(&mut events, |kind| match kind {
        EventKind::Lease { holder, why, .. } if holder.is_empty() => Some(why.clone()),
        _ => None,
    })
    .await;
    assert!(why.contains("ends its power by itself"), "{why}");
    let report = until_state(&daemon, DeviceState::Searching).await;
    assert_eq!(report.lease, None);
    assert_eq!((report.live, report.pot_temperature), (None, None));
    // Until it is heard again nobody can confirm that it is off.
    rig.bench().unplugged.store(false, Ordering::Relaxed);
    let report = until_state(&daemon, DeviceState::Idle).await;
    assert_eq!((report.asked_by_daemon_w, rig.bench().asked_w()), (0, 0));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn one_commands_until_another_takes_it_by_force_and_is_told() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    let (mut first, mut second) = (daemon.watch(), daemon.watch());
    power(&daemon, "a", 1_000).await.unwrap();
    match power(&daemon, "b", 500).await {
        Err(CommandError::Leased { holder, .. }) => assert_eq!(holder, "a"),
        other => panic!("{other:?}"),
    }
    assert!(daemon.take_lease("bench", "b", false).await.is_err());
    let lease = daemon.take_lease("bench", "b", true).await.unwrap();
    assert_eq!(lease.holder, "b");
    // Power that the previous holder requested ends with its lease.
    assert_eq!(rig.bench().asked_w(), 0);
    for observer in [&mut first, &mut second] {
        let from = wait_for_event(observer, |kind| match kind {
            EventKind::Lease {
                holder, taken_from, ..
            } if holder == "b" => Some(taken_from.clone()),
            _ => None,
        });
        assert_eq!(from.await, "a");
    }
    assert!(power(&daemon, "a", 500).await.is_err());
    power(&daemon, "b", 500).await.unwrap();
    assert_eq!(rig.bench().asked_w(), 500);
    // Switching off needs no lease.
    daemon.command("bench", "c", Command::Off).await.unwrap();
    assert_eq!(rig.bench().asked_w(), 0);
    assert!(daemon.release_lease("bench", "a").await.is_err());
    power(&daemon, "b", 500).await.unwrap();
    daemon.release_lease("bench", "b").await.unwrap();
    assert_eq!(rig.bench().asked_w(), 0);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn stopping_leaves_off_what_was_asked_for_and_leaves_the_panel_alone() {
    let rig = Rig::new(&["bench", "other"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    let other = &rig.benches["other"];
    other.panel(5);
    power(&daemon, "a", 1_000).await.unwrap();
    until_state(&daemon, DeviceState::Learning).await;
    daemon.stop().await;
    assert_eq!(rig.bench().asked_w(), 0);
    assert_eq!(other.asked_w(), 700);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_of_a_moment_leaves_the_lease_free() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    daemon
        .command("bench", "a", Command::ClearFault)
        .await
        .unwrap();
    assert_eq!(daemon.view().device("bench").unwrap().lease, None);
    let refused = power(&daemon, "a", 60_000).await.unwrap_err().to_string();
    assert!(refused.contains("10000 W"), "{refused}");
    assert_eq!(daemon.view().device("bench").unwrap().lease, None);
    assert!(matches!(
        daemon.command("nobody", "a", Command::Off).await,
        Err(CommandError::NoDevice { .. })
    ));
    daemon.stop().await;
}

/// The lease has the power that the hob took: a check of the device's power does not end it.
#[tokio::test]
async fn power_above_the_rating_is_the_rating_and_is_told() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    let clock = Clock::stop();
    let reply = power(&daemon, "a", 3_000).await.unwrap();
    let text = "3000 W asked, 2500 W is the most this hob gives";
    assert_eq!((reply.text.as_str(), reply.granted_w), (text, Some(2_500)));
    // The daemon compares the device's power with the lease's every two seconds.
    for _ in 0..4 {
        clock.pass(Duration::from_secs(3)).await;
        daemon.take_lease("bench", "a", false).await.unwrap();
    }
    let report = daemon.view().device("bench").unwrap();
    assert_eq!(report.asked_by_daemon_w, 2_500, "{report:#?}");
    assert!(report.lease.is_some(), "{report:#?}");
    assert_eq!(rig.bench().asked_w(), 2_500);
    let reply = power(&daemon, "a", 900).await.unwrap();
    assert_eq!(
        (reply.text.as_str(), reply.granted_w),
        ("900 W asked for", Some(900))
    );
    daemon.stop().await;
}

/// The daemon's clock is slowed down: a sweep has time-outs, and on a busy machine a simulated hob is slow.
#[tokio::test]
async fn a_sweep_takes_one_power_after_the_other_and_ends_off() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    let powers_w = vec![800, 1_200, 3_000];
    let clock = Clock::stop();
    let sweep = Command::Sweep { powers_w };
    daemon.command("bench", "a", sweep).await.unwrap();
    let mut seen = Vec::new();
    let deadline = Instant::now() + PATIENCE;
    loop {
        daemon.take_lease("bench", "a", false).await.unwrap();
        let asked_w = rig.bench().asked_w();
        if asked_w > 0 && seen.last() != Some(&asked_w) {
            seen.push(asked_w);
        }
        let report = daemon.view().device("bench").unwrap();
        if report.sweep_left_w.is_empty() && report.asked_by_daemon_w == 0 {
            assert!(report.windows.stored >= 9, "{:?}", report.windows);
            assert!(report.sweep_is_complete);
            break;
        }
        assert!(Instant::now() < deadline, "{report:#?}");
        clock.pass(Duration::from_millis(3)).await;
    }
    assert_eq!(seen, [800, 1_200, 2_500]);
    assert_eq!(rig.bench().asked_w(), 0);
    daemon.stop().await;
}
