//! A bridge that heats is switched off at a zero crossing, whatever is requested meanwhile; one that probes, at once.

use ihd_shared::wire::messages::State;
use ihd_sim::hob::{HobConfig, PanelEvent, SimHob};

/// Crest of the mains, in decivolt.
const CREST_DV: f64 = 10.0 * 230.0 * std::f64::consts::SQRT_2;

fn is_switching(hob: &SimHob) -> bool {
    hob.sampling_path().drive().is_switching()
}

fn run(hob: &mut SimHob, duration_s: f64) {
    let end_s = hob.t_s() + duration_s;
    while hob.t_s() < end_s {
        hob.step();
    }
}

/// Off and on within a half-cycle, as from a host that says hello and requests its power at once. A bridge that opens at the crest leaves
/// the coil's energy in the link, and the half-cycle that ends is no probe.
#[test]
fn power_that_is_requested_again_at_once_waits_for_the_crossing() {
    let mut hob = SimHob::new(&HobConfig::default());
    hob.panel(PanelEvent::Level(9));
    for after_s in [2e-3, 5e-3, 8e-3] {
        run(&mut hob, 0.7);
        assert!(is_switching(&hob));
        let mains = hob.mains();
        let left_s = mains.half_cycle_s() - mains.since_crossing_s(hob.t_s());
        run(&mut hob, left_s + after_s);
        for level in [0, 9] {
            hob.panel(PanelEvent::Level(level));
        }
        while is_switching(&hob) {
            hob.step();
        }
        let since_s = mains.since_crossing_s(hob.t_s());
        assert!(since_s < 0.5e-3, "open {since_s} s after a crossing");
        let end_s = hob.t_s() + 0.5;
        while hob.t_s() < end_s {
            hob.step();
            let bus_dv = hob.housekeeping().summary().bus_peak_dv;
            assert!(f64::from(bus_dv) < 1.1 * CREST_DV, "{bus_dv} dV");
        }
        assert_eq!(hob.housekeeping().control().state(), State::Heating);
    }
}

/// At most as much as the whole probe takes (docs/control.md).
#[test]
fn off_in_a_probe_between_two_bursts_ends_the_probe() {
    let mut hob = SimHob::new(&HobConfig::default());
    hob.panel(PanelEvent::Level(1));
    run(&mut hob, 1.5);
    let mut open_since_s = hob.t_s();
    while hob.t_s() < open_since_s + 0.2 || !is_switching(&hob) {
        hob.step();
        if is_switching(&hob) && hob.t_s() < open_since_s + 0.2 {
            open_since_s = hob.t_s();
        }
    }
    run(&mut hob, 1e-3);
    hob.take_reading();
    hob.panel(PanelEvent::Level(0));
    let (end_s, mut energy_j) = (hob.t_s() + 0.1, 0.0);
    while hob.t_s() < end_s {
        hob.step();
        energy_j += hob.take_reading().map_or(0.0, |reading| reading.energy_j);
    }
    assert!(energy_j < 2.0, "{energy_j} J");
    assert_eq!(hob.housekeeping().control().state(), State::Idle);
}
