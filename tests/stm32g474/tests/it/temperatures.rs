//! Thermistors at ADC4, and what must not suffer from them.

use ihd_sim::behavioural::PotKind;
use ihd_stm32g474::registers::adc4;

use crate::board::{assert_no_violations, connect, with_pot};

/// Channels of heat sink, glass and coil (docs/board.md).
const CHANNELS: [usize; 3] = [3, 4, 5];

#[test]
fn each_thermistor_is_converted_every_four_milliseconds_beside_the_others() {
    let bench = with_pot(PotKind::Ferromagnetic);
    bench.with(|machine| machine.chip().pins.temperatures_c = [25.0, 85.0, 150.0]);
    let mut client = connect(&bench);
    client.set_power(1_200).unwrap();
    bench.run_s(0.3);
    let counts = |bench: &crate::board::Bench| {
        bench.with(|machine| [2, 3].map(|adc| machine.chip().conversions(adc)))
    };
    let [slow_before, before] = counts(&bench);
    bench.run_s(0.3);
    let [slow_after, after] = counts(&bench);
    for channel in CHANNELS {
        let taken = after[channel] - before[channel];
        assert!((71..=76).contains(&taken), "channel {channel}: {taken}");
    }
    // Bus and mains in turn at f_sw * 61 / 3, as without them.
    let [bus, mains] = [1, 12].map(|channel| slow_after[channel] - slow_before[channel]);
    assert!(bus.abs_diff(mains) <= 1, "{bus} {mains}");
    assert!(bus > 100_000, "{bus}");
    // Ratios to 10 kΩ: 1 of the heat sink at 25 °C, 1.09 of the glass at 85, 0.200 of the coil at 150.
    let mut found = Vec::new();
    for _ in 0..30 {
        bench.run_s(0.000_7);
        found.push(bench.with(|machine| machine.chip().file.word(adc4::dr::ADDRESS)));
    }
    found.sort_unstable();
    found.dedup();
    // And the reference at 3.3 V.
    assert_eq!(found, [682, 1505, 2048, 2133]);
    assert_no_violations(&bench);
}
