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
    bench.with(|machine| machine.chip().pins.share_wire_high = true);
    bench.run_s(0.3);
    assert!(!pulls(&bench));
    client.set_power(1_000).unwrap();
    bench.run_s(0.4);
    assert_eq!(client.status().unwrap().state, State::Heating);
    assert!(pulls(&bench));
    // The other zone pulls as soon as the wire is released.
    let offered = (0..2_000).any(|_| {
        bench.run_s(0.001);
        !pulls(&bench)
    });
    assert!(offered);
    bench.with(|machine| machine.chip().pins.share_wire_high = false);
    bench.run_s(0.03);
    bench.with(|machine| machine.chip().hrtim.off_at = None);
    bench.run_s(0.5);
    assert_eq!(bench.with(|machine| machine.chip().hrtim.off_at), None);
    bench.with(|machine| machine.chip().pins.share_wire_high = true);
    bench.run_s(0.2);
    assert!(pulls(&bench));
    client.set_power(0).unwrap();
    bench.run_s(0.02);
    assert!(!pulls(&bench));
    assert_no_violations(&bench);
}
