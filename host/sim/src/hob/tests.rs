use std::f64::consts::TAU;

use ihd_firmware::sense::mains::MAINS_DELAY_NS;
use ihd_shared::sampling::{AMPERE_PER_CODE, ANTI_ALIAS_HZ};

use super::*;
use crate::adc::ConverterNoise;
use crate::injection::{FaultChannel, Injection};
use crate::inverter::supply::SupplyParts;

/// The detector's pair is late by what the firmware takes off. A code's noise is one code, which the mains passes in 1.9 µs.
#[test]
fn a_zero_crossing_is_late_by_its_filters() {
    for mains_hz in [47.3, 50.0, 60.0] {
        let mut hob = SimHob::new(&HobConfig {
            mains_hz,
            // A line rings with C1 after the rectifier's current, which moves the crossing by half a microsecond.
            supply: SupplyParts::NONE,
            ..HobConfig::default()
        });
        let mains = hob.plant.mains();
        let half_cycle_s = mains.half_cycle_s();
        let (mut late_s, mut dt_s) = (Vec::new(), 0.0);
        while late_s.len() < 200 {
            let mut times_s = Vec::new();
            hob.plant.block(|plant| times_s.push(plant.t_s()));
            dt_s = times_s[1] - times_s[0];
            let slow = hob.slow_adc.block(hob.plant.divided());
            if let Some(at) = hob.zero_crossing.on_block(slow.mains) {
                let since_s = mains.since_crossing_s(times_s[usize::from(at)]);
                late_s.push((since_s + 0.5 * half_cycle_s) % half_cycle_s - 0.5 * half_cycle_s);
            }
        }
        let mean_s = late_s.iter().sum::<f64>() / late_s.len() as f64;
        // Both channels of the coil are late, too.
        let expected_s = f64::from(MAINS_DELAY_NS) * 1e-9 + 1.0 / (TAU * f64::from(ANTI_ALIAS_HZ));
        assert!((mean_s - expected_s).abs() < 0.25 * dt_s + 0.3e-6);
        for late_s in late_s {
            assert!((late_s - expected_s).abs() < 0.5 * dt_s + 5.0 * 1.9e-6);
        }
    }
}

/// Blocks that stop for a time while the bridge switches.
fn blocks_lost(hob: &mut SimHob, for_s: f64) {
    let mut number = 0;
    hob.inject(|all| {
        number = all.start(Injection {
            kind: InjectionKind::LostBlocks,
            value: 1.0,
            channel: FaultChannel::Current,
        });
    });
    let until_s = hob.t_s() + for_s;
    while hob.t_s() < until_s {
        hob.step();
    }
    hob.inject(|all| all.end(number));
    hob.step();
}

/// The board's converter task returns before it has a drive (`firmware/src/board/stm32g474/adc.rs`).
#[test]
fn a_lost_block_does_not_take_the_soft_start_on() {
    let mut hob = SimHob::new(&HobConfig::default());
    hob.panel(PanelEvent::Level(7));
    while !hob.drive.0.is_switching() {
        hob.step();
    }
    let (drive, share) = hob.drive;
    let mut number = 0;
    hob.inject(|all| {
        number = all.start(Injection {
            kind: InjectionKind::LostBlocks,
            value: 1.0,
            channel: FaultChannel::Current,
        });
    });
    hob.step();
    assert_eq!(hob.drive, (drive, share));
    hob.inject(|all| all.end(number));
    hob.step();
    assert_eq!(hob.drive.1, share + 1);
}

/// 40 V on the bus: past the rectifier, and at its own voltage at each edge.
#[test]
fn a_bench_supply_warms_no_rectifier() {
    let mut hob = SimHob::new(&HobConfig {
        bench_supply_v: Some(40.0),
        ..HobConfig::default()
    });
    let before_c = hob.temperatures().heat_sink_c;
    let reading = MeterReading {
        duration_s: 0.01,
        energy_j: 10.0,
        ..MeterReading::default()
    };
    hob.warm_up(&reading);
    assert_eq!(hob.temperatures().heat_sink_c, before_c);
}

/// docs/board.md, "Protection": the sampling watchdog needs no software, the other one resets after 60 ms.
#[test]
fn without_blocks_the_bridge_opens_after_half_a_millisecond_and_the_program_is_reset() {
    let heating = || {
        let mut hob = SimHob::new(&HobConfig::default());
        hob.panel(PanelEvent::Level(7));
        while hob.t_s() < 1.0043 {
            hob.step();
        }
        assert!(hob.sampling_path().drive().is_switching());
        hob
    };
    let (mut hob, last_block_s) = (heating(), heating().t_s());
    blocks_lost(&mut hob, 0.02);
    assert_eq!(hob.sampling_path().fault(), Fault::SAMPLES_LOST);
    let off_after_s = hob.open_since_s().unwrap() - last_block_s;
    assert!((off_after_s - 0.5e-3).abs() < 1e-6, "{off_after_s}");
    assert_eq!(hob.watchdog_bites(), 0);
    let mut hob = heating();
    let boot_id = hob.boot_id;
    blocks_lost(&mut hob, 0.1);
    assert_eq!((hob.watchdog_bites(), hob.boot_id), (1, boot_id + 1));
    assert_eq!(hob.sampling_path().drive(), Drive::OFF);
}

/// docs/control.md: a fault of the controller itself locks out over a reset, also where control had no time to record it.
#[test]
fn a_reset_at_once_after_a_fault_of_the_controller_leaves_it_locked_out() {
    for (fault, is_locked_out) in [(Fault::PROGRAM_FLOW, true), (Fault::MAINS_LOST, false)] {
        let mut hob = SimHob::new(&HobConfig::default());
        hob.sampling_path.raise(fault);
        hob.restart();
        let kept = hob.housekeeping().control().retained();
        assert_eq!(kept.locked_out, is_locked_out, "{fault:?}");
    }
}

/// Time in seconds from a fault of supply or reference until both switches are open while it heats, and the fault's number.
fn off_after_s(kind: InjectionKind, value: f64, at_s: f64) -> (f64, Fault) {
    let mut hob = SimHob::new(&HobConfig::default());
    hob.panel(PanelEvent::Level(7));
    while hob.t_s() < at_s {
        hob.step();
    }
    assert!(hob.sampling_path().drive().is_switching());
    let t_s = hob.t_s();
    hob.inject(|all| {
        all.start(Injection {
            kind,
            value,
            channel: FaultChannel::Current,
        });
    });
    while hob.sampling_path().fault() == Fault::NONE {
        hob.step();
        assert!(hob.t_s() < t_s + 0.1);
    }
    hob.step();
    (
        hob.open_since_s().unwrap() - t_s,
        hob.sampling_path().fault(),
    )
}

/// docs/board.md: 16 ms from a reference that is off, which is converted every 4 ms; the chip's detector acts at once.
#[test]
fn a_wrong_reference_is_found_within_16_ms_and_a_low_supply_at_once() {
    for at_s in [1.0, 1.0033, 1.0071] {
        let (late_s, fault) = off_after_s(InjectionKind::Reference, 0.95, at_s);
        assert_eq!(fault, Fault::SUPPLY_RANGE);
        assert!((8e-3..16e-3).contains(&late_s), "{late_s}");
    }
    let low = off_after_s(InjectionKind::Supply, 0.87, 1.0033);
    assert_eq!(low, (0.0, Fault::SUPPLY_LOW));
}

/// A supply of 0.95 of its voltage shows 325.3 V of mains, and of the bus, as 342.4 V.
#[test]
fn a_low_supply_raises_the_codes_of_the_mains_and_of_the_bus() {
    let mut hob = SimHob::new(&HobConfig::default());
    let crests = |hob: &mut SimHob| {
        let end_s = hob.t_s() + 0.02;
        let mut crests = [0.0f64; 2];
        while hob.t_s() < end_s {
            let (_, slow) = hob.run_block();
            let codes = [f64::from(slow.mains), f64::from(slow.bus)];
            crests = std::array::from_fn(|k| crests[k].max(codes[k]));
        }
        crests
    };
    crests(&mut hob);
    let nominal = crests(&mut hob);
    hob.inject(|injections| {
        injections.start(Injection {
            kind: InjectionKind::Supply,
            value: 0.95,
            channel: FaultChannel::Current,
        });
    });
    // Noise of a code lifts each crest by 2 to 4 of 1,400 codes.
    for (low, nominal) in crests(&mut hob).into_iter().zip(nominal) {
        assert!((low / nominal * 0.95 - 1.0).abs() < 3e-3, "{low} {nominal}");
    }
}

/// Trigger of 0x60 ticks of 735 ps, and 4.625 cycles of 42.5 MHz until the hold: 179.4 ns.
#[test]
fn a_pair_is_held_when_the_boards_converters_hold_it() {
    let mut hob = SimHob::new(&HobConfig {
        anti_alias_hz: 0.0,
        noise: ConverterNoise::default(),
        ..HobConfig::default()
    });
    hob.plant.set_drive(Drive::switching(50_000));
    while hob.plant.t_s() < 5e-3 {
        hob.plant.block(|_| ());
    }
    let held = 179.4e-9 / hob.plant.dt_s();
    let mut last_a = 0.0;
    hob.plant.sample(|i_a| last_a = i_a);
    for _ in 0..ADC_LOCK_P {
        let mut seen_a = vec![last_a];
        let pair = hob.plant.sample(|i_a| seen_a.push(i_a));
        let before = held as usize;
        let held_a = seen_a[before] + held.fract() * (seen_a[before + 1] - seen_a[before]);
        let error_a = f64::from(pair.i) * AMPERE_PER_CODE - held_a;
        assert!(error_a.abs() <= 0.52 * AMPERE_PER_CODE, "{error_a} A");
        last_a = *seen_a.last().unwrap();
    }
}

/// Code 1943 of 2048 for 1.65 V on 4.12 Ω behind 1 : 200.
#[test]
fn the_trip_level_is_that_of_the_schematics_burden() {
    let trip_a = comparator_a(SupplyScale::NOMINAL, &Injections::default());
    let expected_a = 1_943.0 / 2_048.0 * 1.65 / 4.12 * 200.0;
    assert!((trip_a - expected_a).abs() < 1e-3, "{trip_a} {expected_a}");
}
