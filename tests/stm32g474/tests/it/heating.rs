//! Heating of a pot with the requested power.

use ihd_shared::wire::messages::{Pot, State};
use ihd_sim::behavioural::PotKind;
use ihd_stm32g474::time::seconds;

use crate::board::{Bench, assert_no_violations, connect, with_pot};

/// Mean power over a time in watt, by a wattmeter at the coil.
fn watt_over(bench: &Bench, duration_s: f64) -> f64 {
    let read = |bench: &Bench| bench.with(|machine| machine.chip().pins.wattmeter);
    let before = read(bench);
    bench.run_s(duration_s);
    let after = read(bench);
    (after.0 - before.0) / (after.1 - before.1)
}

/// Regression test: at 78153fe the state never left Probing (80,000 Hz requested, 79,911 Hz generated).
#[test]
fn it_heats_a_pot_with_the_power_asked_for() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    client.set_power(1_200).unwrap();
    bench.run_s(0.4);
    let watt = watt_over(&bench, 0.1);
    let status = client.status().unwrap();
    assert_eq!(
        (status.state, status.pot),
        (State::Heating, Pot::Ferromagnetic),
        "{status:?}"
    );
    assert!((watt / 1_200.0 - 1.0).abs() < 0.05, "{watt} W, {status:?}");
    assert_no_violations(&bench);
    client.set_power(0).unwrap();
    bench.run_s(0.05);
    assert!(watt_over(&bench, 0.05) < 1.0);
    assert_eq!(client.status().unwrap().state, State::Idle);
}

#[test]
fn it_refuses_to_heat_aluminium_and_air() {
    for pot in [PotKind::Aluminium, PotKind::None] {
        let bench = with_pot(pot);
        let mut client = connect(&bench);
        client.set_power(1_200).unwrap();
        bench.run_s(0.15);
        let status = client.status().unwrap();
        assert_eq!(status.state, State::WaitingForPot, "{pot:?}: {status:?}");
        assert!(watt_over(&bench, 0.02) < 1.0, "{pot:?}");
        assert_no_violations(&bench);
    }
}

#[test]
fn a_pot_that_is_taken_away_ends_the_heating() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    client.set_power(1_200).unwrap();
    bench.run_s(0.2);
    bench.with(|machine| {
        machine.chip().hrtim.off_at = None;
        machine.chip().pins.plant.set_pot(PotKind::None).unwrap();
    });
    let lifted_s = bench.now_s();
    bench.run_s(0.06);
    let off = bench.with(|machine| machine.chip().hrtim.off_at);
    let off_ms = (seconds(off.expect("the bridge opened")) - lifted_s) * 1e3;
    println!("pot taken away: off after {off_ms:.1} ms");
    assert!(off_ms < 40.0, "{off_ms}");
    let status = client.status().unwrap();
    assert_eq!(status.state, State::WaitingForPot, "{status:?}");
    assert_no_violations(&bench);
}
