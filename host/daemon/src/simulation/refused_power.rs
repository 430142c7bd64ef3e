//! Power that a hob refuses during a sweep.

use std::time::Duration;

use ihd_model::Command;
use tokio::time::sleep;

use super::calm::{asked_w, with_daemon};
use super::hob::HOBS;

#[test]
fn a_sweep_goes_on_after_a_refused_power_and_ends_off() {
    with_daemon(async |world, daemon| {
        let name = HOBS[0];
        let powers_w = vec![900, 1_200];
        let sweep = Command::Sweep { powers_w };
        daemon.command(name, "ada", sweep).await.expect("it begins");
        sleep(Duration::from_secs(1)).await;
        let more = Command::Power { power_w: 60_000 };
        let refused = daemon.command(name, "ada", more).await.unwrap_err();
        assert!(refused.to_string().contains("10000 W"), "{refused}");
        let report = daemon.view().device(name).unwrap();
        assert_eq!(report.sweep_left_w, [900, 1_200]);
        assert_eq!(asked_w(world), 900);
        for _ in 0..10 {
            daemon.take_lease(name, "ada", false).await.unwrap();
            sleep(Duration::from_secs(5)).await;
        }
        assert!(daemon.view().device(name).unwrap().sweep_is_complete);
        assert_eq!(asked_w(world), 0);
    });
}
