//! Who commands, and that the hob is off when nobody does.

use std::time::{Duration, Instant};

use ihd_daemon::lease::LEASE_S;
use ihd_daemon::model::{Command, CommandError, DeviceState, What};

use super::rig::{Rig, hear, power, until, until_state};

#[tokio::test(flavor = "multi_thread")]
async fn power_ends_with_the_lease_that_nobody_renews() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    let mut notices = daemon.watch();
    let asked = Instant::now();
    power(&daemon, "a", 1_000).await.unwrap();
    assert_eq!(rig.bench().asked_w(), 1_000);
    // Renewed once, it outlives its ten seconds.
    tokio::time::sleep(Duration::from_secs(6)).await;
    daemon.take_lease("bench", "a", false).await.unwrap();
    let renewed = Instant::now();
    tokio::time::sleep(Duration::from_secs(6)).await;
    assert!(asked.elapsed().as_secs() > LEASE_S);
    assert_eq!(rig.bench().asked_w(), 1_000);
    until(&daemon, |r| r.asked_by_daemon_w == 0).await;
    assert_eq!(rig.bench().asked_w(), 0);
    let took = renewed.elapsed().as_secs_f64();
    assert!(
        took >= LEASE_S as f64 && took < LEASE_S as f64 + 5.0,
        "{took} s"
    );
    hear(&mut notices, |what| match what {
        What::Lease { holder, .. } if holder.is_empty() => Some(()),
        _ => None,
    })
    .await;
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
    // What the other had asked for is not b's to answer for.
    assert_eq!(rig.bench().asked_w(), 0);
    for observer in [&mut first, &mut second] {
        let from = hear(observer, |what| match what {
            What::Lease { holder, taken_from } if holder == "b" => Some(taken_from.clone()),
            _ => None,
        });
        assert_eq!(from.await, "a");
    }
    assert!(power(&daemon, "a", 500).await.is_err());
    power(&daemon, "b", 500).await.unwrap();
    assert_eq!(rig.bench().asked_w(), 500);
    // Anybody may switch off.
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
    assert_eq!(daemon.device("bench").unwrap().lease, None);
    let refused = power(&daemon, "a", 60_000).await.unwrap_err().to_string();
    assert!(refused.contains("2500 W"), "{refused}");
    assert_eq!(daemon.device("bench").unwrap().lease, None);
    assert!(matches!(
        daemon.command("nobody", "a", Command::Off).await,
        Err(CommandError::NoDevice { .. })
    ));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_died_leaves_a_hob_that_the_next_one_switches_off() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    daemon.stop().await;
    // As a host that is gone has left it.
    rig.bench().hob().send(&set_power(900));
    let began = Instant::now();
    while rig.bench().asked_w() != 900 {
        assert!(began.elapsed() < Duration::from_secs(5));
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    assert_eq!(rig.bench().asked_w(), 0);
    daemon.stop().await;
}

fn set_power(power_w: u16) -> Vec<u8> {
    use ihd_shared::wire::frame::{MAX_ENCODED, encode};
    let mut frame = [0; MAX_ENCODED];
    let message = ihd_shared::wire::messages::SetPower { power_w };
    let length = encode(&message, 0, &mut frame).unwrap();
    frame[..length].to_vec()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sweep_takes_one_power_after_the_other_and_ends_off() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    let powers_w = vec![800, 1_200];
    let sweep = Command::Sweep { powers_w };
    daemon.command("bench", "a", sweep).await.unwrap();
    let mut seen = Vec::new();
    let began = Instant::now();
    loop {
        daemon.take_lease("bench", "a", false).await.unwrap();
        let asked_w = rig.bench().asked_w();
        if asked_w > 0 && seen.last() != Some(&asked_w) {
            seen.push(asked_w);
        }
        let report = daemon.device("bench").unwrap();
        if report.sweep_left_w.is_empty() && report.asked_by_daemon_w == 0 {
            assert!(report.windows.stored >= 6, "{:?}", report.windows);
            break;
        }
        assert!(began.elapsed() < super::rig::PATIENCE, "{report:#?}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert_eq!(seen, [800, 1_200]);
    assert_eq!(rig.bench().asked_w(), 0);
    daemon.stop().await;
}
