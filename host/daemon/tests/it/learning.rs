//! Learning from any heating, kept over a restart.

use std::time::Duration;

use ihd_model::{DeviceState, EventKind};
use ihd_pinn::PinnConfig;
use ihd_store::{DeviceId, LookupState, ResultFilter, Store};
use ihd_train::learning::Learning;

use super::rig::{Rig, until, until_state, wait_for_event};

#[tokio::test(flavor = "multi_thread")]
async fn what_the_panel_heats_is_learned_pushed_and_kept_over_a_restart() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    let mut events = daemon.watch();
    rig.bench().panel(7);
    let version = wait_for_event(&mut events, |kind| match kind {
        EventKind::LookupActive { version, .. } => Some(*version),
        _ => None,
    })
    .await;
    assert!(version >= 1);
    wait_for_event(&mut events, |kind| {
        matches!(kind, EventKind::ResultStored { pass: true, .. }).then_some(())
    })
    .await;
    let report = until(&daemon, |r| {
        r.windows.learned >= 3
            && r.lookup.on_device == r.lookup.active
            && r.lookup.pending.is_none()
    })
    .await;
    assert!(report.lookup.observed_cells > 0);
    assert_eq!(report.asked_by_daemon_w, 0, "it only watched");
    // A result is counted before it is stored.
    let results = loop {
        let results = daemon.view().results(ResultFilter::default());
        let results = results.await.unwrap();
        if results.len() >= 3 {
            break results;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    };
    // The simulated pot has 2-3 ohm and some 20 microhenry.
    let passed = results.iter().find(|r| r.pass).unwrap();
    assert!(
        passed.sigma_r_pct < 1.0 && passed.l_h > 5e-6 && passed.l_h < 60e-6,
        "{passed:?}"
    );
    rig.bench().panel(0);
    until_state(&daemon, DeviceState::Idle).await;
    until(&daemon, |r| {
        let w = r.windows;
        r.lookup.pending.is_none() && w.learned + w.unfit + w.unlearned == w.stored
    })
    .await;
    // The last result's lookup may be on its way yet.
    daemon.stop().await;
    let (known, versions) = (curves_in_the_store(&rig), versions_in_the_store(&rig));

    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    let newest = versions.iter().max().copied();
    until(&daemon, |r| {
        r.lookup.pending.is_none() && r.lookup.on_device == newest && r.lookup.active == newest
    })
    .await;
    let rows = daemon.view().lookups("bench").await.unwrap();
    let kept: Vec<_> = rows.iter().map(|row| row.version).collect();
    assert_eq!(kept, versions, "a restart learns and pushes nothing new");
    // Level 2 has other frequencies, but for the start's: a learner that forgot those of level 7 does not see them again.
    rig.bench().panel(2);
    until(&daemon, |r| r.windows.learned >= 3).await;
    let rows = daemon.view().lookups("bench").await.unwrap();
    let active = rows.iter().filter(|row| row.state == LookupState::Active);
    assert_eq!(active.count(), 1);
    daemon.stop().await;
    let again = curves_in_the_store(&rig);
    let kept = known.iter().filter(|f| again.contains(f)).count();
    // A full map drops its oldest curves.
    assert!(
        2 * kept > known.len(),
        "curves at {known:?} Hz before the restart, at {again:?} Hz after it"
    );
}

fn store(rig: &Rig) -> (Store, DeviceId) {
    let config = rig.config();
    let opened = Store::open(&config.store, &config.store_settings()).unwrap();
    let mut store = opened.store;
    let device = store.device("bench", "serial:bench").unwrap();
    (store, device)
}

/// Returns the versions of the stored lookups of the device `bench`, oldest first.
fn versions_in_the_store(rig: &Rig) -> Vec<u32> {
    let (store, device) = store(rig);
    let rows = store.lookups(device).unwrap();
    rows.iter().map(|row| row.version).collect()
}

/// Returns the switching frequencies in hertz at which the stored map of the device `bench` has curves.
fn curves_in_the_store(rig: &Rig) -> Vec<f64> {
    let (store, device) = store(rig);
    let state = store.learner_state(device).unwrap().expect("it learned");
    let learning = Learning::from_bytes(&state, PinnConfig::default()).unwrap();
    let curves = learning.map().curves().iter();
    curves.map(|curve| curve.f_sw_hz).collect()
}
