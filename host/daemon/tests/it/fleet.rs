//! An edge of a fleet, without a server: windows that are due, and results that come from elsewhere, honest or not.

use ihd_daemon::Daemon;
use ihd_daemon::fleet::{FleetConfig, ReceiveError, Received, TRUSTED_FOR};
use ihd_daemon::learning::{Numbers, Studied};
use ihd_daemon::model::DeviceState;
use ihd_store::{DueWindow, ResultFilter, Sent};
use tokio::time::Instant;

use super::rig::{PATIENCE, Rig, power, until_state};

async fn edge(rig: &Rig) -> Daemon {
    let fleet = FleetConfig {
        url: "nats://127.0.0.1:1".to_owned(),
        edge: Some("kitchen".to_owned()),
        nkey_file: None,
        token_file: None,
        ca: None,
        captures: false,
    };
    let config = ihd_daemon::Config {
        fleet: Some(fleet),
        ..rig.config()
    };
    let daemon = rig.daemon_with(config).await;
    until_state(&daemon, DeviceState::Idle).await;
    daemon
}

/// Heats until so many windows are due at the fleet, which answers all the time, then ends it.
async fn heat_until_due(daemon: &Daemon, count: usize) -> Vec<DueWindow> {
    let heated = async {
        loop {
            daemon.trust_fleet(Some(Instant::now() + TRUSTED_FOR));
            power(daemon, "a", 1_000).await.unwrap();
            let due = daemon.due(100).await.unwrap();
            if due.len() >= count {
                return due;
            }
            tokio::time::sleep(std::time::Duration::from_millis(50)).await;
        }
    };
    let due = tokio::time::timeout(PATIENCE, heated).await;
    daemon.release_lease("bench", "a").await.unwrap();
    due.expect("windows come while it heats")
}

fn result(seq: u32) -> Studied {
    Studied::of_numbers((seq, 20 * seq), 45_000, Numbers::NONE)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_result_teaches_only_if_its_window_was_sent() {
    let rig = Rig::new(&["bench"]);
    let daemon = edge(&rig).await;
    let due = heat_until_due(&daemon, 2).await;
    let (boot, seq) = (due[0].boot, due[0].seq);
    // A window that the hob has not made yet, and one that the fleet has not got.
    let early = daemon.receive("bench", boot, result(seq + 10_000)).await;
    assert_eq!(early.unwrap(), Received::Unasked);
    let unsent = daemon.receive("bench", boot, result(seq)).await;
    assert!(matches!(unsent, Err(ReceiveError::NotSent)), "{unsent:?}");
    let elsewhere = daemon.receive("bench", boot ^ 1, result(seq)).await;
    assert_eq!(elsewhere.unwrap(), Received::Foreign);
    let all = ResultFilter::default();
    assert_eq!(daemon.results(all.clone()).await.unwrap().len(), 0);

    let sent = due.iter().map(|due| (due.clone(), Sent::Window)).collect();
    daemon.sent(sent).await.unwrap();
    let asked = daemon.receive("bench", boot, result(seq)).await;
    assert_eq!(asked.unwrap(), Received::Stored);
    let again = daemon.receive("bench", boot, result(seq)).await;
    assert_eq!(again.unwrap(), Received::Known);
    assert_eq!(daemon.results(all).await.unwrap().len(), 1);
    daemon.stop().await;
}

/// All that was due was answered before the daemon was started again, on the same day: what comes next is due.
#[tokio::test(flavor = "multi_thread")]
async fn an_edge_that_was_started_again_goes_on_sending() {
    let rig = Rig::new(&["bench"]);
    let daemon = edge(&rig).await;
    for due in heat_until_due(&daemon, 1).await {
        daemon
            .sent(vec![(due.clone(), Sent::Window)])
            .await
            .unwrap();
        let received = daemon.receive("bench", due.boot, result(due.seq)).await;
        assert_eq!(received.unwrap(), Received::Stored);
    }
    daemon.stop().await;

    let daemon = edge(&rig).await;
    // Those that came while it was switched off.
    let late = daemon.due(100).await.unwrap();
    let late = late.into_iter().map(|due| (due, Sent::Result)).collect();
    daemon.sent(late).await.unwrap();
    assert_eq!(daemon.due(100).await.unwrap(), []);
    assert!(!heat_until_due(&daemon, 1).await.is_empty());
    daemon.stop().await;
}
