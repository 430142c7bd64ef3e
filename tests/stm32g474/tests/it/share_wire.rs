//! Wire to a second zone of a shared supply.

use ihd_shared::board::SHARE_WIRE_PIN;
use ihd_shared::wire::messages::State;
use ihd_sim::behavioural::PotKind;

use crate::board::{Bench, assert_no_violations, connect, with_pot};

/// A board pulls the wire while it draws power, releases it when the other zone accepts its offer, and pulls it again afterwards.
#[test]
fn a_shared_supply_is_left_to_the_other_zone() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    let pulls = |bench: &Bench| !bench.with(|machine| machine.chip().driven(SHARE_WIRE_PIN));
    bench.with(|machine| machine.chip().pins.share_wire = Some(true));
    bench.run_s(0.3);
    assert!(!pulls(&bench));
    client.set_power(1_000).unwrap();
    bench.run_s(0.4);
    assert_eq!(client.status().unwrap().state, State::Heating);
    // At each crossing it offers the supply for a moment.
    let pulls_within = |bench: &Bench, limit_ms: u32| {
        (0..limit_ms).any(|_| {
            bench.run_s(0.001);
            pulls(bench)
        })
    };
    assert!(pulls_within(&bench, 20));
    // The other zone pulls as soon as the wire is released.
    let offered = (0..2_000).any(|_| {
        bench.run_s(0.001);
        !pulls(&bench)
    });
    assert!(offered);
    bench.with(|machine| machine.chip().pins.share_wire = Some(false));
    bench.run_s(0.03);
    bench.with(|machine| machine.chip().hrtim.off_at = None);
    bench.run_s(0.5);
    assert_eq!(bench.with(|machine| machine.chip().hrtim.off_at), None);
    bench.with(|machine| machine.chip().pins.share_wire = Some(true));
    assert!(pulls_within(&bench, 200));
    client.set_power(0).unwrap();
    bench.run_s(0.02);
    assert!(!pulls(&bench));
    assert_no_violations(&bench);
}

/// The board starts while the other zone heats: it knows of the wire before it draws power.
#[test]
fn a_board_that_starts_while_the_other_zone_heats_waits() {
    let bench = with_pot(PotKind::Ferromagnetic);
    bench.with(|machine| machine.chip().pins.share_wire = Some(false));
    let mut client = connect(&bench);
    client.set_power(1_000).unwrap();
    bench.run_s(1.0);
    let status = client.status().unwrap();
    assert_eq!((status.state, status.f_sw_hz), (State::Heating, 0));
    bench.with(|machine| machine.chip().pins.share_wire = Some(true));
    bench.run_s(0.2);
    assert!(client.status().unwrap().f_sw_hz > 0);
    assert_no_violations(&bench);
}
