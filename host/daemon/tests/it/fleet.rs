//! Edge of a fleet, without a server: due windows, and workers' answers, right or wrong.

use std::sync::atomic::Ordering;
use std::time::Duration;

use ihd_daemon::Daemon;
use ihd_daemon::fleet::{DELEGATION_TIME, FleetConfig, LookupCheck, ReceiveError, ReceiveOutcome};
use ihd_daemon::learning::WorkerAnswer;
use ihd_link::Window;
use ihd_model::{DeviceReport, DeviceState};
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_sim::hob::HobConfig;
use ihd_store::{DeliveryState, DueWindow, OutboxItem, ResultFilter};
use ihd_train::NetworkConfig;
use tokio::time::Instant;

use super::rig::{PATIENCE, Rig, nap, power, until, until_state};

async fn edge(rig: &Rig) -> Daemon {
    let daemon = edge_without_hob(rig).await;
    until_state(&daemon, DeviceState::Idle).await;
    daemon
}

async fn edge_without_hob(rig: &Rig) -> Daemon {
    let fleet = FleetConfig {
        url: "nats://127.0.0.1:1".to_owned(),
        edge: Some("kitchen".to_owned()),
        nkey_file: None,
        token_file: None,
        ca: None,
        captures: false,
    };
    let config = ihd_daemon::DaemonConfig {
        fleet: Some(fleet),
        ..rig.config()
    };
    rig.daemon_with(config).await
}

/// Heats under a delegation until `count` windows are due at the fleet, then ends the lease.
async fn heat_until_due(daemon: &Daemon, count: usize) -> Vec<DueWindow> {
    let heated = async {
        loop {
            daemon
                .fleet()
                .delegate_until(Some(Instant::now() + DELEGATION_TIME), [].into());
            power(daemon, "a", 1_000).await.unwrap();
            let due = daemon
                .fleet()
                .due_windows(vec!["bench".to_owned()], 100)
                .await
                .unwrap();
            if due.len() >= count {
                return due;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    let due = tokio::time::timeout(PATIENCE, heated).await;
    daemon.release_lease("bench", "a").await.unwrap();
    due.expect("windows come while it heats")
}

/// Returns an answer without a result.
fn answer_without_result() -> WorkerAnswer {
    WorkerAnswer {
        by: "w".to_owned(),
        skew_s: None,
        load: Err("nothing found".to_owned()),
        busy: Duration::ZERO,
    }
}

/// Reads a due window as a worker receives it.
async fn read(daemon: &Daemon, due: &DueWindow) -> Box<Window> {
    match daemon.fleet().read_due(due.clone()).await.unwrap() {
        OutboxItem::Window(window) => window,
        other => panic!("{due:?} is {other:?}"),
    }
}

/// Returns a correct answer to a due window.
async fn honest_answer(daemon: &Daemon, due: &DueWindow) -> WorkerAnswer {
    let window = read(daemon, due).await;
    let network = NetworkConfig {
        deterministic: true,
        ..NetworkConfig::default()
    };
    WorkerAnswer::compute(
        "w".to_owned(),
        &window,
        daemon.fleet().skew_s("bench"),
        network,
    )
}

#[tokio::test(flavor = "multi_thread")]
async fn an_answer_counts_only_if_its_window_was_sent() {
    let rig = Rig::new(&["bench"]);
    let daemon = edge(&rig).await;
    let due = heat_until_due(&daemon, 2).await;
    let (boot, seq) = (due[0].boot, due[0].seq);
    // A window that does not exist yet, and one that was not sent.
    let early = daemon
        .fleet()
        .receive("bench", boot, seq + 10_000, answer_without_result())
        .await;
    assert_eq!(early.unwrap(), ReceiveOutcome::Unrequested);
    let unsent = daemon
        .fleet()
        .receive("bench", boot, seq, answer_without_result())
        .await;
    assert!(matches!(unsent, Err(ReceiveError::NotSent)), "{unsent:?}");
    let elsewhere = daemon
        .fleet()
        .receive("bench", boot ^ 1, seq, answer_without_result())
        .await;
    assert_eq!(elsewhere.unwrap(), ReceiveOutcome::Foreign);
    let all = ResultFilter::default();
    assert_eq!(daemon.view().results(all.clone()).await.unwrap().len(), 0);

    let sent = due
        .iter()
        .map(|due| (due.clone(), DeliveryState::Window))
        .collect();
    daemon.fleet().mark_sent(sent).await.unwrap();
    let asked = daemon
        .fleet()
        .receive("bench", boot, seq, answer_without_result())
        .await;
    assert_eq!(asked.unwrap(), ReceiveOutcome::Stored);
    let again = daemon
        .fleet()
        .receive("bench", boot, seq, answer_without_result())
        .await;
    assert_eq!(again.unwrap(), ReceiveOutcome::Duplicate);
    // The edge has identified the window itself.
    let results = daemon.view().results(all).await.unwrap();
    assert_eq!(results.len(), 1);
    assert!(results[0].pass, "{results:?}");
    daemon.stop().await;
}

/// Function that makes an answer wrong.
type Lie = fn(&mut WorkerAnswer);

/// Wrong answers to sent windows leave the stored results as without a worker.
#[tokio::test(flavor = "multi_thread")]
async fn a_lie_is_refuted_named_and_identified_here() {
    let rig = Rig::new(&["bench"]);
    let daemon = edge(&rig).await;
    let due = heat_until_due(&daemon, 6).await;
    let lies: [(&str, Lie); 4] = [
        ("R 15 % high", |a| each(a, |r, _| *r *= 1.15)),
        ("R and L exchanged", |a| {
            each(a, |r, l| (*r, *l) = (*l, *r));
        }),
        ("L 1 % low", |a| each(a, |_, l| *l *= 0.99)),
        ("times of yesterday", |a| {
            a.load.as_mut().unwrap().t_s.fill(-86_400.0);
        }),
    ];
    let mut stored = Vec::new();
    for (k, due) in due[..6].iter().enumerate() {
        let i_a = read(&daemon, due).await.segment().i_a;
        let i_rms_a = (i_a.iter().map(|i| i * i).sum::<f64>() / i_a.len() as f64).sqrt();
        let correct = honest_answer(&daemon, due).await;
        let mut answer = correct.clone();
        // Each wrong answer comes from another worker, so that none is distrusted.
        if let Some((name, lie)) = lies.get(k) {
            answer.by = format!("liar-{k}");
            lie(&mut answer);
            println!("{name}");
        }
        daemon
            .fleet()
            .mark_sent(vec![(due.clone(), DeliveryState::Window)])
            .await
            .unwrap();
        let received = daemon
            .fleet()
            .receive("bench", due.boot, due.seq, answer)
            .await;
        assert_eq!(received.unwrap(), ReceiveOutcome::Stored);
        stored.push((due.seq, i_rms_a, correct.load.unwrap()));
    }
    let workers = daemon.fleet().workers();
    assert_eq!((workers["w"].confirmed, workers["w"].refuted), (2, 0));
    for k in 0..lies.len() {
        let liar = &workers[&format!("liar-{k}")];
        assert_eq!((liar.confirmed, liar.refuted), (0, 1), "{}", lies[k].0);
        assert!(!liar.why.is_empty());
    }
    let results = daemon
        .view()
        .results(ResultFilter::default())
        .await
        .unwrap();
    for (seq, i_rms_a, load) in stored {
        let result = results.iter().find(|r| r.seq == seq).expect("stored");
        let crest = load.r_ohm[load.r_ohm.len() / 2];
        assert!(
            result.pass && (result.r_ohm / crest - 1.0).abs() < 0.1,
            "{result:?}"
        );
        // P = R·I²: L takes no power over a half-cycle.
        let expected_w = result.r_ohm * i_rms_a * i_rms_a;
        let power_w = result.power_w.expect("a window knows its power");
        assert!(
            (power_w / expected_w - 1.0).abs() < 0.03,
            "{power_w} W, not {expected_w} W"
        );
    }
    daemon.stop().await;
}

/// A lookup from the fleet is checked against the hob's own windows.
#[tokio::test(flavor = "multi_thread")]
async fn a_lookup_from_elsewhere_must_not_contradict_what_the_hob_has_shown() {
    let rig = Rig::new(&["bench"]);
    let daemon = edge(&rig).await;
    let built_in = prior();
    let check = async |lookup: &RlLookup| loop {
        match daemon.fleet().check_lookup("bench", lookup) {
            LookupCheck::Unavailable => nap().await,
            advice => return advice,
        }
    };
    // Without windows nothing contradicts it.
    assert_eq!(check(&built_in).await, LookupCheck::Agrees);
    for due in heat_until_due(&daemon, 2).await {
        let answer = honest_answer(&daemon, &due).await;
        daemon
            .fleet()
            .mark_sent(vec![(due.clone(), DeliveryState::Window)])
            .await
            .unwrap();
        let received = daemon
            .fleet()
            .receive("bench", due.boot, due.seq, answer)
            .await;
        assert_eq!(received.unwrap(), ReceiveOutcome::Stored);
    }
    let learned = async {
        loop {
            let rows = daemon.view().lookups("bench").await.unwrap();
            // The first may rest on one window alone, which the second contradicts.
            if let Some(row) = rows.last() {
                let lookup = RlLookup::from_bytes(&row.blob).unwrap();
                if check(&lookup).await == LookupCheck::Agrees {
                    return lookup;
                }
            }
            nap().await;
        }
    };
    let learned = tokio::time::timeout(PATIENCE, learned).await.unwrap();
    let mut lie = learned.clone();
    lie.r.iter_mut().flatten().for_each(|r| *r += *r / 7);
    match check(&lie).await {
        LookupCheck::Contradicts(place) => println!("{place}"),
        other => panic!("{other:?}"),
    }
    daemon.stop().await;
}

fn each(answer: &mut WorkerAnswer, change: impl Fn(&mut f64, &mut f64)) {
    let load = answer.load.as_mut().expect("an honest answer");
    let values = load.r_ohm.iter_mut().zip(&mut load.l_h);
    values.for_each(|(r, l)| change(r, l));
}

/// Windows of an earlier boot, answered after the hob and then the edge were started again, have results and teach nothing.
#[tokio::test(flavor = "multi_thread")]
async fn an_edge_that_was_started_again_learns_nothing_of_an_earlier_boot() {
    let rig = Rig::new(&["bench"]);
    let daemon = edge(&rig).await;
    let mut answers = Vec::new();
    for due in heat_until_due(&daemon, 2).await {
        let answer = honest_answer(&daemon, &due).await;
        answers.push((due.seq, answer));
        let sent = vec![(due, DeliveryState::Window)];
        daemon.fleet().mark_sent(sent).await.unwrap();
    }
    let before = HobConfig::default().seed as u32;
    rig.bench().replace(&HobConfig {
        seed: 77,
        ..HobConfig::default()
    });
    let boot = |r: &DeviceReport| r.identity.as_ref().map(|i| i.boot_id);
    until(&daemon, |r| boot(r) == Some(77)).await;
    until_state(&daemon, DeviceState::Idle).await;
    daemon.stop().await;

    rig.bench().unplugged.store(true, Ordering::Relaxed);
    let daemon = edge_without_hob(&rig).await;
    for (seq, answer) in answers {
        let received = daemon.fleet().receive("bench", before, seq, answer).await;
        assert_eq!(received.unwrap(), ReceiveOutcome::Stored);
    }
    let results = daemon.view().results(ResultFilter::default()).await;
    for result in results.unwrap() {
        assert!(result.pass && !result.changed_lookup, "{result:?}");
    }
    daemon.stop().await;
}

/// All due windows were answered before the daemon was restarted on the same day: new ones are due.
#[tokio::test(flavor = "multi_thread")]
async fn an_edge_that_was_started_again_goes_on_sending() {
    let rig = Rig::new(&["bench"]);
    let daemon = edge(&rig).await;
    for due in heat_until_due(&daemon, 1).await {
        daemon
            .fleet()
            .mark_sent(vec![(due.clone(), DeliveryState::Window)])
            .await
            .unwrap();
        let received = daemon
            .fleet()
            .receive("bench", due.boot, due.seq, answer_without_result())
            .await;
        assert_eq!(received.unwrap(), ReceiveOutcome::Stored);
    }
    daemon.stop().await;

    let daemon = edge(&rig).await;
    // Windows that came while the power was switched off.
    let late = daemon
        .fleet()
        .due_windows(vec!["bench".to_owned()], 100)
        .await
        .unwrap();
    let late = late
        .into_iter()
        .map(|due| (due, DeliveryState::Result))
        .collect();
    daemon.fleet().mark_sent(late).await.unwrap();
    assert_eq!(
        daemon
            .fleet()
            .due_windows(vec!["bench".to_owned()], 100)
            .await
            .unwrap(),
        []
    );
    assert!(!heat_until_due(&daemon, 1).await.is_empty());
    daemon.stop().await;
}
