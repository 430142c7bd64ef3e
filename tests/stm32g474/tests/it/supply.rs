//! Analogue supply and the chip's reference voltage: readings by them are correct, or heating stops.

use ihd_firmware::limits::TRIES;
use ihd_firmware::sense::codes::TRIP_CODE;
use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::State;
use ihd_sim::behavioural::PotKind;
use ihd_sim::injection::InjectionKind;
use ihd_sim::scenario::surroundings::ChangeableHob;
use ihd_stm32g474::registers::dac1;

use crate::board::{Bench, assert_no_violations, connect, inject, with_pot};

/// Mean power into the pot over a time in watt, by a meter that does not depend on the supply.
fn delivered_w(bench: &Bench, while_s: f64) -> f64 {
    bench.with(|machine| machine.chip().pins.wattmeter = (0.0, 0.0));
    bench.run_s(while_s);
    let (energy_j, time_s) = bench.with(|machine| machine.chip().pins.wattmeter);
    energy_j / time_s
}

fn end_injection(bench: &Bench, number: u32) {
    bench.with(move |machine| machine.chip().pins.inject(|all| all.end(number)));
}

#[test]
fn a_supply_that_drifts_changes_neither_power_nor_trip_and_one_that_is_wrong_is_a_fault() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    client.set_power(1_200).unwrap();
    bench.run_s(0.4);
    let nominal_w = delivered_w(&bench, 0.1);
    assert!((nominal_w / 1_200.0 - 1.0).abs() < 0.03, "{nominal_w}");
    for factor in [0.978, 1.022] {
        let number = bench.with(move |machine| inject(machine, InjectionKind::Supply, factor));
        bench.run_s(0.35);
        let power_w = delivered_w(&bench, 0.1);
        let code = bench.with(|machine| machine.chip().file.get(dac1::dac_dhr12r1::DACC1DHR));
        let trip = (f64::from(code) - 2_048.0) * factor / f64::from(TRIP_CODE);
        let load = client.utilisation().unwrap();
        println!("{} permille of the processor", load.mean_permille);
        println!("VDDA x {factor}: {power_w:.0} W of {nominal_w:.0}, trip x {trip:.4}");
        // The dead band is 2 %. Without the correction 4.5 % of power would be missing besides, and 2.2 % of the trip level.
        assert!((power_w / 1_200.0 - 1.0).abs() < 0.023, "{power_w}");
        assert!((trip - 1.0).abs() < 0.002, "{trip}");
        assert_eq!(client.status().unwrap().state, State::Heating);
        end_injection(&bench, number);
    }
    let wrong = [
        (InjectionKind::Supply, 0.95),
        (InjectionKind::Supply, 1.1),
        (InjectionKind::Reference, 0.95),
    ];
    for (kind, factor) in wrong {
        let number = bench.with(move |machine| inject(machine, kind, factor));
        bench.run_s(0.02);
        let status = client.status().unwrap();
        assert_eq!(
            (status.state, status.fault),
            (State::Pausing, Fault::SUPPLY_RANGE),
            "{kind} {factor}"
        );
        // The fault ends with its cause and costs no try.
        end_injection(&bench, number);
        bench.run_s(0.45);
        let status = client.status().unwrap();
        assert_eq!((status.state, status.tries_left), (State::Heating, TRIES));
    }
    assert_no_violations(&bench);
}
