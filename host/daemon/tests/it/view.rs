//! Read model: history, scope, training, map and journal of a heating hob.

use std::time::Instant;

use ihd_daemon::{Daemon, DaemonError, JournalFilter};
use ihd_model::{Command, DeviceState, EventKind, Fit, History, Live, Scope, WindowQuery};
use ihd_sim::behavioural::PotKind;

use super::rig::{
    PATIENCE, Rig, command_stored, keep_lease, nap, power, until, until_state, wait_for_event,
};

/// Query for a whole window.
const WHOLE: WindowQuery = WindowQuery {
    which: None,
    from_s: 0.0,
    to_s: f64::INFINITY,
    columns: 1_200,
};

fn now_ms() -> i64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    since.unwrap().as_millis() as i64
}

async fn kinds(daemon: &Daemon, kind: &str) -> Vec<String> {
    let filter = JournalFilter {
        device: Some("bench".to_owned()),
        kind: Some(kind.to_owned()),
        ..JournalFilter::default()
    };
    let entries = daemon.view().journal(filter).await.unwrap();
    entries.into_iter().map(|entry| entry.text).collect()
}

/// Returns a window that passed, with its truth and all curves.
async fn passed_window(daemon: &Daemon) -> Scope {
    let deadline = Instant::now() + PATIENCE;
    loop {
        for window in daemon.view().windows("bench", 100).await.unwrap() {
            let which = Some((window.boot, window.seq));
            let query = WindowQuery { which, ..WHOLE };
            let scope = daemon.view().scope("bench", query).await;
            let scope = scope.unwrap().expect("its samples are kept");
            let is_whole = scope.network.is_some() && scope.truth.is_some();
            if scope.pass == Some(true) && scope.r_true_mean_ohm.is_some() && is_whole {
                return scope;
            }
        }
        assert!(Instant::now() < deadline, "none passed");
        nap().await;
    }
}

/// Checks samples, the device's own filter, the network and the truth of a window.
fn check_scope(scope: &Scope, live: &Live) {
    assert_eq!(scope.t_s.len(), 1_200);
    let m = &scope.measured;
    assert!(m.periods > 300, "{m:?}");
    // A burst or a step of the power control may lie between the two.
    assert!(
        (m.power_w.unwrap() / live.power_w - 1.0).abs() < 0.2,
        "{m:?} {live:?}"
    );
    assert!(m.phase_deg.unwrap() > 5.0 && m.phase_deg.unwrap() < 90.0);
    let error = |x: Option<f64>, truth: Option<f64>| (x.unwrap() / truth.unwrap() - 1.0).abs();
    assert!(
        error(scope.r_mean_ohm, scope.r_true_mean_ohm) < 0.01,
        "R of {}",
        scope.seq
    );
    assert!(
        error(scope.l_mean_h, scope.l_true_mean_h) < 0.01,
        "L of {}",
        scope.seq
    );
    let (network, truth) = (
        scope.network.as_ref().unwrap(),
        scope.truth.as_ref().unwrap(),
    );
    assert_eq!((network.t_s.len(), truth.t_s.len()), (128, 128));
    assert_eq!(network.r_sigma_ohm.len(), 128);
    assert!(truth.t_s[0].abs() < 1e-9, "from the first pair on");
    assert!(scope.ekf.t_s.len() > 100 && scope.ekf.r_ohm.len() == scope.ekf.t_s.len());
    // In the middle, where the current is large, filter, network and truth agree.
    let near = |t_s: &[f64], x: &[f64]| {
        let k = t_s.partition_point(|t| *t < scope.duration_s / 2.0);
        x[k.min(x.len() - 1)]
    };
    let crest_ohm = near(&truth.t_s, &truth.r_ohm);
    for (name, t_s, r_ohm) in [
        ("network", &network.t_s, &network.r_ohm),
        ("filter", &scope.ekf.t_s, &scope.ekf.r_ohm),
    ] {
        let r_ohm = near(t_s, r_ohm);
        assert!(
            (r_ohm / crest_ohm - 1.0).abs() < 0.03,
            "{name}: {r_ohm} {crest_ohm}"
        );
    }
}

/// Checks the fits with their truth.
async fn check_training(daemon: &Daemon) {
    let fits = daemon.view().training("bench", 50).await.unwrap();
    let with_truth = |fit: &&Fit| fit.pass && fit.r_error_pct.is_some();
    let fit = fits.iter().find(with_truth).unwrap();
    assert!(!fit.steps.is_empty() && fit.seconds.unwrap() > 0.0);
    assert_eq!(fit.steps.last().unwrap().step, fit.iterations);
    assert!(fit.r_error_pct.unwrap().abs() < 1.0 && fit.l_error_pct.unwrap().abs() < 1.0);
    assert_eq!(daemon.view().training("bench", 1).await.unwrap().len(), 1);
}

/// Checks the map's known cells, their deviations and ages, and the built-in lookup.
///
/// No physical pot has this load's law, so one frequency tells little of the rows beside it: few cells are known from it, or none.
/// A second power brings a second frequency, and the cells between both become known.
async fn check_map(daemon: &Daemon, began_ms: i64) {
    let deadline = Instant::now() + PATIENCE;
    power(daemon, "me", 1_800).await.unwrap();
    let map = loop {
        let map = daemon.view().map("bench", None).await.unwrap().unwrap();
        let confidence = map.confidence.as_ref().expect("built by this daemon");
        let known = map.observed.iter().flatten();
        let seen = confidence.iter().flatten().map(|c| *c > 0.4999);
        let both = known.zip(seen).filter(|(known, seen)| **known && *seen);
        let both = both.count();
        if both > 5 {
            break map;
        }
        assert!(Instant::now() < deadline, "{both} cells are known");
        nap().await;
    };
    // Known is what its deviations make known: 3 % of R and 1.5 % of L.
    let sigma = |of: &Option<Vec<Vec<f64>>>| of.as_ref().unwrap().concat();
    let (sigma_r, sigma_l) = (sigma(&map.sigma_r_pct), sigma(&map.sigma_l_pct));
    let known = map.observed.concat();
    assert_eq!((sigma_r.len(), sigma_l.len()), (known.len(), known.len()));
    for (k, known) in known.into_iter().enumerate() {
        let (r, l) = (sigma_r[k], sigma_l[k]);
        assert!(
            !known || (r > 0.0 && r < 3.01 && l > 0.0 && l < 1.51),
            "{k}: {r} {l}"
        );
        assert!(known || r > 2.99 || l > 1.49, "{k}: {r} {l}");
    }
    let ages = map.age_s.iter().flatten().flatten();
    let at_most_s = 1.0 + (now_ms() - began_ms) as f64 * 1e-3;
    assert!(ages.clone().count() > 5 && ages.clone().all(|age| *age <= at_most_s));
    let prior = daemon.view().map("bench", Some(0)).await.unwrap().unwrap();
    assert_eq!((prior.state.as_str(), prior.confidence), ("prior", None));
    assert_eq!((prior.sigma_r_pct, prior.sigma_l_pct), (None, None));
    assert!(
        daemon
            .view()
            .map("bench", Some(4_000_000))
            .await
            .unwrap()
            .is_none()
    );
}

/// Returns the history since a time.
async fn history_since(daemon: &Daemon, began_ms: i64) -> History {
    let view = daemon.view();
    let history = view.history("bench", began_ms, now_ms(), 600).await;
    history.unwrap()
}

/// Returns the seconds of a history in which the hob heated.
fn heated_seconds(history: &History) -> Vec<usize> {
    (0..history.at_ms.len())
        .filter(|k| history.r_ohm.mean[*k].is_some())
        .collect()
}

/// Waits for the events of a heating that ended with a lifted pot; they are stored shortly after.
async fn check_journal(daemon: &Daemon) {
    let deadline = Instant::now() + PATIENCE;
    for (kind, expected) in [
        ("pot", "lifted"),
        ("state", "waiting-for-pot"),
        ("lookup", "is active"),
        ("lease", "me commands it"),
        ("command", "off: off"),
    ] {
        while !kinds(daemon, kind)
            .await
            .iter()
            .any(|text| text.contains(expected))
        {
            assert!(Instant::now() < deadline, "no {expected} in the journal");
            nap().await;
        }
    }
}

/// Checks the history of a heating that has ended.
async fn check_history(daemon: &Daemon, history: &History) {
    // Results have the times of their windows.
    let came = daemon.view().windows("bench", 1_000).await.unwrap();
    let came: Vec<_> = came.iter().map(|window| window.at_ms).collect();
    let results = &history.results;
    assert!(results.of >= 3 && results.at_ms.len() as u64 == results.of);
    for at_ms in &results.at_ms {
        assert!(came.contains(at_ms), "{at_ms} of {came:?}");
    }
    let powers_w = history.power_w.max.iter().flatten().copied();
    let largest_w = powers_w.fold(0.0, f64::max);
    assert!(largest_w > 1_000.0, "{largest_w}");
    let heated = heated_seconds(history);
    assert!(heated.len() >= 2 && heated.len() < history.at_ms.len());
    assert!(history.phase_deg[heated[1]].is_some());
    assert_eq!(history.state.last().map(String::as_str), Some("Idle"));
    let unknown = daemon.view().history("nobody", 0, 1, 1).await;
    assert!(matches!(unknown, Err(DaemonError::NoDevice(_))));
}

/// Checks what a daemon shows of the time before its start: nothing is lost by a stop.
async fn check_restart(daemon: &Daemon, after: &History, before: &History, scope: &Scope) {
    // The last second may not have been over.
    let common = before.at_ms.len() - 1;
    assert_eq!(after.at_ms[..common], before.at_ms[..common]);
    assert_eq!(after.half_cycles[..common], before.half_cycles[..common]);
    assert!(after.results.of >= before.results.of);
    let which = Some((scope.boot, scope.seq));
    let again = daemon
        .view()
        .scope("bench", WindowQuery { which, ..WHOLE })
        .await;
    assert!(again.unwrap().unwrap().truth.is_some());
    let fits = daemon.view().training("bench", 50).await.unwrap();
    assert!(
        fits.iter().any(|f| f.pass && f.steps.is_empty()),
        "as the store has them"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_hob_does_is_seen_from_all_sides_and_after_a_restart() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    let began_ms = now_ms();
    until_state(&daemon, DeviceState::Idle).await;
    let mut events = daemon.watch();
    power(&daemon, "me", 1_200).await.unwrap();
    let held = keep_lease(&daemon, "me");
    wait_for_event(&mut events, |kind| {
        matches!(kind, EventKind::LookupActive { .. }).then_some(())
    })
    .await;
    let report = until(&daemon, |r| {
        // The reported power is the mean of a second, which begins with none.
        let is_steady = r.live.as_ref().is_some_and(|live| live.power_w > 1_100.0);
        r.windows.learned >= 3 && r.lookup.on_device == r.lookup.active && is_steady
    })
    .await;

    let windows = daemon.view().windows("bench", 100).await.unwrap();
    assert!(windows.len() >= 3 && windows.is_sorted_by(|a, b| a.seq > b.seq));
    let scope = passed_window(&daemon).await;
    check_scope(&scope, &report.live.unwrap());
    let unknown = WindowQuery {
        which: Some((1, 4_000_000)),
        ..WHOLE
    };
    assert!(
        daemon
            .view()
            .scope("bench", unknown)
            .await
            .unwrap()
            .is_none()
    );
    check_training(&daemon).await;
    check_map(&daemon, began_ms).await;

    // A pot that is lifted, after some whole seconds of heating for the history to show.
    let deadline = Instant::now() + PATIENCE;
    while heated_seconds(&history_since(&daemon, began_ms).await).len() < 2 {
        assert!(Instant::now() < deadline, "no seconds of heating");
        nap().await;
    }
    rig.bench().hob().set_pot(PotKind::None).unwrap();
    until_state(&daemon, DeviceState::WaitingForPot).await;
    drop(held);
    daemon.command("bench", "me", Command::Off).await.unwrap();
    until_state(&daemon, DeviceState::Idle).await;
    let off_ms = now_ms();
    check_journal(&daemon).await;
    let before = loop {
        // It includes the last seconds, which are not written yet.
        let before = history_since(&daemon, began_ms).await;
        if before.at_ms.last() >= Some(&off_ms) {
            break before;
        }
        assert!(Instant::now() < deadline, "it ends before {off_ms}");
        nap().await;
    };
    check_history(&daemon, &before).await;
    daemon.stop().await;

    let daemon = rig.daemon().await;
    let after = history_since(&daemon, began_ms).await;
    check_restart(&daemon, &after, &before, &scope).await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn any_earlier_version_can_be_gone_back_to() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    let cells = |version| {
        let mut lookup = ihd_shared::lookup::prior::prior();
        lookup.version = version;
        lookup.r[3][5] += version as u16;
        lookup.mark_observed(3, 5);
        lookup
    };
    for version in [1, 2, 3] {
        let blob = cells(version).to_bytes().to_vec();
        let push = Command::LookupPush { blob };
        command_stored(&daemon, push).await.unwrap();
    }
    let back = |version| Command::LookupRollback {
        version: Some(version),
    };
    command_stored(&daemon, back(1)).await.unwrap();
    let report = until(&daemon, |r| r.lookup.active == Some(4)).await;
    assert_eq!(report.lookup.on_device, Some(4));
    let map = daemon.view().map("bench", None).await.unwrap().unwrap();
    let first = daemon.view().map("bench", Some(1)).await.unwrap().unwrap();
    assert_eq!(
        (map.version, &map.why, &map.r_ohm),
        (4, &"rolled back to version 1".to_owned(), &first.r_ohm)
    );
    let refused = daemon.command("bench", "me", back(77)).await.unwrap_err();
    assert!(
        refused.to_string().contains("no lookup of version 77"),
        "{refused}"
    );
    // The built-in cells, under a new version.
    daemon.command("bench", "me", back(0)).await.unwrap();
    until(&daemon, |r| r.lookup.active == Some(5)).await;
    let prior = daemon.view().map("bench", Some(0)).await.unwrap().unwrap();
    assert_eq!(
        daemon
            .view()
            .map("bench", Some(5))
            .await
            .unwrap()
            .unwrap()
            .l_h,
        prior.l_h
    );
    daemon.stop().await;
}
