//! Live telemetry of subscribers with different periods.

use std::time::Duration;

use ihd_model::DeviceState;

use super::rig::{Rig, until, until_state};

#[tokio::test(flavor = "multi_thread")]
async fn each_watcher_counts_every_half_cycle_at_its_own_pace() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    let mut quick = daemon.view().live().every(Duration::from_millis(100));
    let mut slow = daemon.view().live().every(Duration::from_millis(100));
    rig.bench().panel(6);
    until(&daemon, |r| {
        r.live.as_ref().is_some_and(|l| l.power_w > 500.0)
    })
    .await;
    let (mut half_cycles, mut largest_w) = (0, 0.0f64);
    // Ten takes at least, and more half-cycles than takes: on a busy machine the simulated hob is slow.
    let mut takes = 0;
    while takes < 10 || half_cycles <= 10 {
        takes += 1;
        tokio::time::sleep(Duration::from_millis(100)).await;
        if let Some(bench) = quick.take().devices.get("bench") {
            half_cycles += bench.half_cycles;
            largest_w = largest_w.max(bench.power_w[1]);
            assert!(bench.power_w[0] <= bench.power_w[1]);
        }
    }
    let taken = slow.take();
    let bench = &taken.devices["bench"];
    assert!(bench.skipped >= 8, "{}", bench.skipped);
    assert!(bench.half_cycles >= half_cycles);
    assert!(
        bench.power_w[1] >= largest_w && bench.power_w[0] < 1.0,
        "{:?}",
        bench.power_w
    );
    // The simulated pot has 2-3 ohm and some 20 microhenry at some 45 kHz; the hob stays above resonance.
    let (phase_deg, resonance_hz) = (bench.phase_deg.unwrap(), bench.resonance_hz.unwrap());
    assert!(phase_deg > 5.0 && phase_deg < 85.0, "{phase_deg}");
    assert!(
        resonance_hz < f64::from(bench.last.f_sw_hz),
        "{resonance_hz}"
    );
    let [least_h, largest_h] = bench.l_h.unwrap();
    assert!(least_h > 5e-6 && largest_h < 60e-6 && least_h <= largest_h);
    daemon.stop().await;
}
