//! How long the sampling path and the thread take, by published timings of the processor and a model of the flash
//! (src/cpu/instructions.rs, src/cpu/flash_accelerator.rs).

use ihd_sim::behavioural::PotKind;
use ihd_stm32g474::cpu::{CycleModel, HandlerTime};
use ihd_stm32g474::time::seconds;

use crate::board::{Bench, SAMPLING, assert_no_violations, connect, with_pot};

/// Mean and worst share of a block that the sampling interrupt takes, and the block's cycles.
fn load(bench: &Bench, duration_s: f64) -> (f64, f64, f64) {
    bench.with(|machine| machine.timing().handlers.insert(SAMPLING, HandlerTime::default()));
    bench.run_s(duration_s);
    let (time, f_sw_hz) = bench.with(|machine| {
        let time = machine.timing().handlers[&SAMPLING];
        (time, machine.chip().hrtim.f_sw_hz())
    });
    let block = 3.0 / f_sw_hz * 170e6;
    (time.cycles as f64 / time.runs as f64 / block, time.worst as f64 / block, block)
}

#[test]
fn a_block_is_done_within_its_budget() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    client.stream(1, 10).unwrap();
    client.set_power(500).unwrap();
    bench.run_s(0.1);
    let (mean, worst, block) = load(&bench, 0.1);
    println!("79.9 kHz: mean {:.1} %, worst {:.1} % of {block:.0} cycles", mean * 100.0, worst * 100.0);
    client.set_power(1_400).unwrap();
    bench.run_s(0.5);
    let (mean_50, worst_50, block_50) = load(&bench, 0.1);
    let f_sw_hz = bench.with(|machine| machine.chip().hrtim.f_sw_hz());
    println!("{f_sw_hz:.0} Hz: mean {:.1} %, worst {:.1} % of {block_50:.0} cycles", mean_50 * 100.0, worst_50 * 100.0);
    assert!(mean <= 0.60, "{mean}");
    assert!(worst <= 1.0, "{worst}");
    assert!((47e3..53e3).contains(&f_sw_hz), "{f_sw_hz}");
    assert!(mean_50 <= 0.45, "{mean_50}");
    assert_no_violations(&bench);
}

/// Pins that a control step starved the watchdog of 60 ms at CPI 2.
#[test]
fn the_watchdog_is_fed_in_time_at_two_cycles_an_instruction() {
    let bench = with_pot(PotKind::Ferromagnetic);
    bench.with(|machine| machine.set_cycle_model(CycleModel::PerInstruction(2)));
    let mut client = connect(&bench);
    client.stream(1, 10).unwrap();
    client.set_power(1_200).unwrap();
    bench.run_s(0.5);
    let (gap, resets) = bench.with(|machine| (machine.chip().watchdog.longest_gap, machine.resets.clone()));
    let gap_ms = seconds(gap) * 1e3;
    println!("longest time between two feeds: {gap_ms:.2} ms");
    assert!(resets.is_empty(), "{resets:?}");
    assert!(gap > 0 && gap_ms <= 20.0, "{gap_ms} ms");
}
