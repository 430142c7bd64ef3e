//! The firmware lib in closed loop with the field model, and with the table made from it.

use std::time::Duration;

use ihd_link::{Client, DeviceEvent};
use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::{Pot, State, Telemetry};
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::inverter::supply::SupplyParts;
use ihd_sim::recording::settings::LoadKind;
use ihd_sim::transport::SharedHob;

/// Asks a hob for 1200 W and returns its telemetry over a number of half-cycles.
fn heat(load: LoadKind, half_cycles: usize) -> (SharedHob, Vec<Telemetry>) {
    // The field model takes minutes for a second: a bus that is not charged starts at once.
    let supply = match load {
        LoadKind::Field => SupplyParts::NONE,
        _ => SupplyParts::SCHEMATIC,
    };
    let config = HobConfig {
        load,
        supply,
        ..HobConfig::default()
    };
    let hob = SharedHob::new(SimHob::new(&config));
    let mut client = Client::connect(Box::new(hob.clone())).unwrap();
    client.stream(1, 0).unwrap();
    client.set_power(1200).unwrap();
    let mut seen = Vec::new();
    while seen.len() < half_cycles {
        match client.next_event(Duration::from_secs(1)).unwrap() {
            Some(DeviceEvent::Telemetry(t)) => seen.push(t),
            Some(_) => {}
            None => panic!("the hob fell silent after {} half-cycles", seen.len()),
        }
        if seen.len() % 20 == 19 {
            // The hob switches off when it does not hear from its host.
            client.status().unwrap();
        }
    }
    (hob, seen)
}

#[test]
fn the_firmware_regulates_power_into_the_reduced_field_model() {
    let (hob, seen) = heat(LoadKind::Surrogate, 150);
    let last = seen.last().unwrap();
    println!("{last:?}");
    assert_eq!((last.state, last.fault), (State::Heating, Fault::NONE));
    assert_eq!(last.pot, Pot::Ferromagnetic);
    assert!(
        (f64::from(last.power_mw) / 1.2e6 - 1.0).abs() < 0.05,
        "{last:?}"
    );
    // The estimate at the crest, against the truth there.
    let hob = hob.lock();
    let truth = hob.truth(last.half_cycle).unwrap();
    let (r_ohm, l_h) = truth.at(5e-3).unwrap();
    println!("truth {r_ohm} {l_h}");
    assert!(
        (last.r.ohm() / r_ohm - 1.0).abs() < 0.05,
        "{r_ohm} {last:?}"
    );
    assert!((last.l.henry() / l_h - 1.0).abs() < 0.03, "{l_h} {last:?}");
}

#[test]
fn the_firmware_sees_the_pot_of_the_field_model_and_starts_to_heat() {
    let (_, seen) = heat(LoadKind::Field, 9);
    let last = seen.last().unwrap();
    println!("{last:?}");
    assert_eq!((last.state, last.fault), (State::Heating, Fault::NONE));
    assert_eq!(last.pot, Pot::Ferromagnetic);
    assert!(last.power_mw > 100_000, "{last:?}");
}
