//! Plant against its laws, its instruments and its comparator.

use ihd_shared::hob::WINDING_R_OHM;
use ihd_shared::sampling::AMPERE_PER_CODE;

use super::*;
use crate::adc::ConverterNoise;
use crate::behavioural::{BehaviouralLoad, PotKind};

fn at_full_power(load: LoadKind) -> Plant {
    let adc = SimulatedAdc::new(ConverterNoise::default(), 1);
    let mut plant = Plant::with_load(SimulatedMains::new(50.0), PotKind::Ferromagnetic, load, adc);
    plant.set_drive(Drive::switching(50_000));
    while plant.t_s() < 5e-3 {
        plant.block(|_| ());
    }
    plant
}

#[test]
fn a_pair_shows_the_current_at_its_hold() {
    let mut plant = at_full_power(LoadKind::Behavioural);
    for steps in [0.0, 1.0, 5.0, 7.5] {
        plant.set_hold_delay(steps * plant.dt_s());
        let before_a = plant.inverter.instant().i_a;
        let mut seen_a = vec![before_a];
        let pair = plant.sample(|i_a| seen_a.push(i_a));
        let (whole, share) = (steps as usize, steps % 1.0);
        let held_a = seen_a[whole] + share * (seen_a[whole + 1] - seen_a[whole]);
        let error = f64::from(pair.i) * AMPERE_PER_CODE - held_a;
        assert!(error.abs() <= 0.51 * AMPERE_PER_CODE, "{steps}: {error} A");
    }
}

#[test]
fn the_load_point_is_the_law_at_the_envelope() {
    let point = at_full_power(LoadKind::Behavioural).load_point();
    let (r, l) = BehaviouralLoad::new(PotKind::Ferromagnetic, 50e3).r_l(point.i_a);
    assert!(point.i_a > 30.0, "{point:?}");
    assert_eq!((point.r_ohm, point.l_h), (r, l));
}

#[test]
fn the_wattmeter_reads_r_i_squared() {
    let adc = SimulatedAdc::new(ConverterNoise::default(), 1);
    let mut plant = Plant::new(SimulatedMains::new(50.0), PotKind::Aluminium, adc);
    plant.set_drive(Drive::switching(60_000));
    let mut readings = Vec::new();
    while readings.len() < 3 {
        plant.block(|_| ());
        readings.extend(plant.take_reading());
    }
    let (last, r_ohm) = (readings[2], 0.22 * (60.0f64 / 45.0).sqrt());
    let expected_w = r_ohm * last.i_square_a2;
    assert!((last.t_s - 0.02).abs() < 2e-6 && (last.duration_s - 0.01).abs() < 2e-6);
    assert!(last.i_peak_a > 20.0 && last.bridge_on(), "{last:?}");
    assert!(
        (last.power_w() / expected_w - 1.0).abs() < 2e-3,
        "{last:?} {expected_w}"
    );
    // The bus gave what the load took: the capacitor is empty at each zero crossing.
    let link_c = plant.link_charge_c();
    assert!(link_c > 0.0, "{link_c}");
}

#[test]
fn the_comparator_opens_after_its_delay_until_the_drive_has_been_open() {
    let mut plant = at_full_power(LoadKind::Behavioural);
    let mut last_a = 40.0f64;
    while last_a.abs() > 20.0 {
        plant.sample(|i_a| last_a = i_a);
    }
    plant.set_comparator(30.0);
    let (mut above_s, dt_s) = (None, plant.dt_s());
    while !plant.is_tripped() {
        let mut now_s = plant.t_s();
        plant.sample(|i_a| {
            now_s += dt_s;
            if i_a.abs() >= 30.0 {
                above_s.get_or_insert(now_s);
            }
        });
    }
    // Filter of the fault input, and comparator, gate driver and switch: 0.33 + 0.38 µs after a level that was passed within a step.
    let after_s = plant.open_since_s().unwrap() - above_s.unwrap();
    assert!((0.709e-6 - dt_s..0.711e-6).contains(&after_s), "{after_s}");
    let since_s = plant.open_since_s().unwrap();
    plant.set_comparator(f64::INFINITY);
    for drive in [Drive::switching(50_000), Drive::switching(60_000)] {
        plant.set_drive(drive);
        plant.block(|_| ());
        assert!(plant.is_tripped());
        assert_eq!(plant.open_since_s(), Some(since_s));
    }
    plant.set_drive(Drive::OFF);
    assert_eq!(
        (plant.is_tripped(), plant.open_since_s()),
        (false, Some(since_s))
    );
    // The trip is reported all the same, once.
    assert_eq!((plant.take_trip(), plant.take_trip()), (true, false));
    plant.set_drive(Drive::switching(50_000));
    assert_eq!(plant.open_since_s(), None);
}

#[test]
fn the_table_stands_for_the_field() {
    let field = at_full_power(LoadKind::Field).load_point();
    let table = at_full_power(LoadKind::Surrogate).load_point();
    println!("{field:?} {table:?}");
    assert!((table.l_h / field.l_h - 1.0).abs() < 0.03);
    assert!((table.r_ohm / field.r_ohm - 1.0).abs() < 0.06);
    assert!((table.i_a / field.i_a - 1.0).abs() < 0.1);
}

#[test]
fn r_drifts_upwards_as_the_pot_warms() {
    for load in [LoadKind::Behavioural, LoadKind::Field] {
        let mut plant = at_full_power(load);
        plant.enable_warming(PotContents::Food);
        plant.set_surroundings(20.0, 20.0);
        // 900 J/K, and 21 W/K of which little is lost in a tenth of a second.
        plant.coil.heat.heat(9.01e4, 0.1);
        let hot_c = plant.temperature_c().unwrap();
        assert!((hot_c - 120.0).abs() < 0.1, "{hot_c}");
        let cold = plant.load_point();
        let then_s = plant.t_s() + 1e-4;
        while plant.t_s() < then_s {
            plant.block(|_| ());
        }
        let hot = plant.load_point();
        let ratio = hot.r_ohm / cold.r_ohm;
        // ρ B_s: 1.11 · (1 − (100/660)²).
        assert!(
            (ratio / 1.0845f64.sqrt() - 1.0).abs() < 0.015,
            "{load:?} {ratio}"
        );
    }
}

#[test]
fn pots_are_exchanged_and_frequency_changed_in_operation() {
    for load in [LoadKind::Behavioural, LoadKind::Field] {
        let mut plant = at_full_power(load);
        let before = plant.load_point();
        plant.set_pot(PotKind::None).unwrap();
        plant.set_drive(Drive::switching(60_000));
        while plant.t_s() < 6e-3 {
            plant.block(|_| ());
        }
        let after = plant.load_point();
        assert!(after.l_h > 1.5 * before.l_h, "{before:?} {after:?}");
        assert!(after.r_ohm < 0.2 * before.r_ohm, "{before:?} {after:?}");
    }
}

/// A sensor's pulse of 90 A holds the comparator above its level when both switches open; it ends 10 ms before they close again.
#[test]
fn a_pulse_that_ended_while_open_trips_no_later_start() {
    let mut plant = at_full_power(LoadKind::Behavioural);
    plant.set_comparator(76.0);
    let run = |plant: &mut Plant, offset_a: f64, drive: Drive, until_s: f64| {
        let gain = 1.0;
        plant.set_current_sensor(CurrentSensor { gain, offset_a });
        plant.set_drive(drive);
        while plant.t_s() < until_s {
            plant.sample(|_| ());
        }
        plant.take_trip()
    };
    assert!(run(&mut plant, 90.0, Drive::switching(50_000), 5.1e-3));
    run(&mut plant, 90.0, Drive::OFF, 5.3e-3);
    run(&mut plant, 0.0, Drive::OFF, 15.3e-3);
    assert!(!run(&mut plant, 0.0, Drive::switching(50_000), 15.4e-3));
}

/// docs/board.md, "Pins": one sensor feeds converter and comparators.
#[test]
fn the_comparator_sees_the_current_by_its_sensor() {
    // Current at which the level was passed on the way down from zero: the filter of 0.33 µs and 0.38 µs before the bridge opened.
    let trip_at = |gain, offset_a| {
        let mut plant = at_full_power(LoadKind::Behavioural);
        let (mut last_a, mut falls) = (0.0, false);
        while !falls {
            plant.sample(|i_a| {
                falls |= last_a > 0.0 && i_a <= 0.0;
                last_a = i_a;
            });
        }
        plant.set_current_sensor(CurrentSensor { gain, offset_a });
        plant.set_comparator(30.0);
        let (mut seen, dt_s) = (Vec::new(), plant.dt_s());
        while !plant.is_tripped() {
            let mut now_s = plant.t_s();
            plant.sample(|i_a| {
                now_s += dt_s;
                seen.push((now_s, i_a));
            });
            assert!(seen.len() < 1_000, "no trip");
        }
        let passed_s = plant.open_since_s().unwrap() - 0.709e-6;
        let at = seen.partition_point(|(t_s, _)| *t_s < passed_s);
        seen[at].1
    };
    // 400 V on 16 µH for a step of 82 ns are 2 A.
    for (gain, offset_a, level_a) in [(1.0, 0.0, -30.0), (1.5, 0.0, -20.0), (1.0, -20.0, -10.0)] {
        let at_a = trip_at(gain, offset_a);
        assert!(
            (level_a - 2.2..=level_a + 0.1).contains(&at_a),
            "{level_a}: {at_a}"
        );
    }
}

/// Plug pulled at the crest with the bridge open: ngspice 39 of the schematic has 2.98, 2.92, 2.78 and 2.10 V at PB0 after 1, 10, 30 and
/// 200 ms, which is 1.65 V · (1 + mains / 399.8 V).
#[test]
fn behind_an_open_line_the_terminals_keep_a_dc_that_c1_holds() {
    let adc = SimulatedAdc::new(ConverterNoise::default(), 1);
    let mut plant = Plant::new(SimulatedMains::new(50.0), PotKind::Ferromagnetic, adc);
    let until = |plant: &mut Plant, t_s: f64| {
        while plant.t_s() < t_s {
            plant.block(|_| ());
        }
    };
    until(&mut plant, 5e-3);
    plant.set_line_open(true);
    for (after_s, expected_v) in [(1e-3, 2.98), (10e-3, 2.92), (30e-3, 2.78), (200e-3, 2.10)] {
        until(&mut plant, 5e-3 + after_s);
        let pin_v = 1.65 * (1.0 + plant.dividers().mains_v() / 399.8);
        assert!((pin_v - expected_v).abs() < 0.01, "{after_s}: {pin_v}");
    }
    // The dip of IEC 61000-4-11 empties C1; the ringing with the line ends with 2 · 0.8 mH / 0.4 ohm = 4 ms.
    plant.set_line_open(false);
    plant.change_mains(0.0, 50.0);
    until(&mut plant, 0.235);
    assert!(plant.dividers().mains_v().abs() < 5.0);
}

/// Energy is kept: what the coil takes heats the pot by R less the winding, and the winding.
#[test]
fn the_pot_gets_what_the_winding_leaves() {
    let adc = SimulatedAdc::new(ConverterNoise::default(), 1);
    let mut plant = Plant::new(SimulatedMains::new(50.0), PotKind::Stainless, adc);
    plant.enable_warming(PotContents::Food);
    plant.set_surroundings(20.0, 20.0);
    plant.set_drive(Drive::switching(60_000));
    let (mut taken_j, mut winding_j, mut readings) = (0.0, 0.0, 0);
    while readings < 4 {
        plant.block(|_| ());
        if let Some(reading) = plant.take_reading() {
            taken_j += reading.energy_j;
            winding_j += WINDING_R_OHM * reading.i_square_a2 * reading.duration_s;
            readings += 1;
        }
    }
    // 900 J/K, and next to nothing given to glass and room.
    let got_j = 900.0 * (plant.temperature_c().unwrap() - 20.0);
    assert!(winding_j > 0.04 * taken_j, "{winding_j} of {taken_j}");
    let lost = got_j / (taken_j - winding_j) - 1.0;
    assert!(lost.abs() < 0.01, "{got_j} {taken_j} {winding_j}");
}

/// The bare coil's R is the winding's, the shield's aside; of copper at 100 °C over 25 °C: 1.3144 / 1.0197.
#[test]
fn the_winding_takes_more_when_it_is_hot_at_any_frequency_and_with_any_pot() {
    let adc = SimulatedAdc::new(ConverterNoise::default(), 1);
    let mut plant = Plant::with_load(
        SimulatedMains::new(50.0),
        PotKind::Ferromagnetic,
        LoadKind::Surrogate,
        adc,
    );
    let r_ohm = |plant: &Plant| plant.inverter.load.law_at(10.0).unwrap().0;
    let rise_ohm = WINDING_R_OHM * (1.3144 / 1.01965 - 1.0);
    let cold_ohm = r_ohm(&plant);
    plant.set_winding_temperature(100.0);
    assert!((r_ohm(&plant) - cold_ohm - rise_ohm).abs() < 1e-6);
    plant.set_drive(Drive::switching(50_000));
    let hot_ohm = r_ohm(&plant);
    plant.set_winding_temperature(25.0);
    assert!((hot_ohm - r_ohm(&plant) - rise_ohm).abs() < 1e-6);
    plant.set_pot(PotKind::None).unwrap();
    let bare_ohm = r_ohm(&plant);
    plant.set_winding_temperature(100.0);
    assert!((r_ohm(&plant) - bare_ohm - rise_ohm).abs() < 1e-6);
}
