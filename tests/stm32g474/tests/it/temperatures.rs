//! Thermistors at ADC4, and conversions that they must not affect.

use ihd_shared::board::FAN_PIN;
use ihd_sim::behavioural::PotKind;
use ihd_sim::temperatures::NTCS;
use ihd_stm32g474::registers::adc4;

use crate::board::{assert_no_violations, connect, with_pot};

/// Temperatures of heat sink, glass and coil.
const TEMPERATURES_C: [f64; 3] = [25.0, 85.0, 150.0];

/// Channels of heat sink, glass and coil (docs/board.md).
const CHANNELS: [usize; 3] = [3, 4, 5];

#[test]
fn each_thermistor_is_converted_every_four_milliseconds_beside_the_others() {
    let bench = with_pot(PotKind::Ferromagnetic);
    bench.with(|machine| machine.chip().pins.temperatures_c = TEMPERATURES_C);
    let mut client = connect(&bench);
    client.set_power(1_200).unwrap();
    bench.run_s(0.3);
    let counts = |bench: &crate::board::Bench| {
        bench.with(|machine| [2, 3].map(|adc| machine.chip().conversions(adc)))
    };
    let [slow_before, before] = counts(&bench);
    bench.run_s(0.3);
    let [slow_after, after] = counts(&bench);
    // One of four each millisecond, twice, processed after the block in which it ends: up to three periods of 34 kHz later.
    for channel in CHANNELS {
        let taken = after[channel] - before[channel];
        assert!((136..=152).contains(&taken), "channel {channel}: {taken}");
    }
    // Bus and mains in turn at f_sw * 61 / 3, as without the thermistors.
    let [bus, mains] = [1, 12].map(|channel| slow_after[channel] - slow_before[channel]);
    assert!(bus.abs_diff(mains) <= 1, "{bus} {mains}");
    assert!(bus > 100_000, "{bus}");
    // On the reference board ratios to 10 kΩ: 1 of the heat sink at 25 °C, 1.09 of the glass at 85, 0.200 of the coil at 150.
    let mut found = Vec::new();
    for _ in 0..30 {
        bench.run_s(0.000_7);
        found.push(bench.with(|machine| machine.chip().file.word(adc4::dr::ADDRESS)));
    }
    found.sort_unstable();
    found.dedup();
    let thermistors = [0, 1, 2].map(|place| u32::from(NTCS[place].code(TEMPERATURES_C[place])));
    // The reference at 3.3 V.
    let mut expected = [&thermistors[..], &[1505]].concat();
    expected.sort_unstable();
    assert_eq!(found, expected);
    assert_no_violations(&bench);
}

#[test]
fn a_warm_heat_sink_switches_the_fan_on_and_no_other_does() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let fan_at = |temperatures_c| {
        bench.with(move |machine| machine.chip().pins.temperatures_c = temperatures_c);
        bench.run_s(0.01);
        bench.with(|machine| machine.chip().driven(FAN_PIN))
    };
    bench.run_s(0.1);
    let at = [[25.0, 65.0, 65.0], [65.0, 25.0, 25.0], [25.0; 3]];
    assert_eq!(at.map(fan_at), [false, true, false]);
}
