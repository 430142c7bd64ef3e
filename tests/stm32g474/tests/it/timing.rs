//! Durations of the sampling path and of the thread, by published timings of the processor and a model of the flash
//! (src/cpu/instructions.rs, src/cpu/flash_accelerator.rs).

use std::time::Duration;

use ihd_link::DeviceEvent;
use ihd_shared::hob::RATED_POWER_W;
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q};
use ihd_shared::wire::messages::Configure;
use ihd_sim::adc::HOLD_DELAY_S;
use ihd_sim::behavioural::PotKind;
use ihd_sim::comparator::FAULT_FILTER_S;
use ihd_stm32g474::cpu::trace::{Trace, TracedRun};
use ihd_stm32g474::cpu::{CycleModel, HandlerTime};
use ihd_stm32g474::registers::dma1::cndtr1;
use ihd_stm32g474::time::{seconds, us};

use crate::board::{Bench, SAMPLING, assert_no_violations, connect, with_pot};

/// Power that is delivered at, or just below, the highest frequency: blocks are shortest there.
const LITTLE_W: u16 = RATED_POWER_W / 5;

/// Cycles of the processor in a block at a switching frequency.
fn block_cycles(f_sw_hz: f64) -> f64 {
    3.0 / f_sw_hz * 170e6
}

/// Mean and worst cycles of the sampling interrupt per block.
fn cycles(bench: &Bench, duration_s: f64) -> (f64, f64) {
    bench.with(|machine| {
        machine
            .timing()
            .handlers
            .insert(SAMPLING, HandlerTime::default())
    });
    bench.run_s(duration_s);
    let time = bench.with(|machine| machine.timing().handlers[&SAMPLING]);
    (time.cycles as f64 / time.runs as f64, time.worst as f64)
}

#[test]
fn a_block_is_done_within_its_budget() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    let (mean, _) = cycles(&bench, 0.1);
    let f_sw_hz = bench.with(|machine| machine.chip().hrtim.f_sw_hz());
    let open = 100.0 * mean / block_cycles(f_sw_hz);
    println!("bridge open, {f_sw_hz:.0} Hz: mean {mean:.0} cycles, {open:.1} %");
    client.stream(1, 10).unwrap();
    client.set_power(LITTLE_W).unwrap();
    bench.run_s(0.1);
    let (mean, worst) = cycles(&bench, 0.1);
    let (share, worst_share) = (mean / block_cycles(80e3), worst / block_cycles(80e3));
    println!(
        "80 kHz: mean {mean:.0} cycles, {:.1} %; worst {:.1} %",
        share * 100.0,
        worst_share * 100.0
    );
    client.set_power(RATED_POWER_W * 14 / 25).unwrap();
    bench.run_s(0.5);
    let f_sw_hz = bench.with(|machine| machine.chip().hrtim.f_sw_hz());
    assert!((47e3..58e3).contains(&f_sw_hz), "{f_sw_hz}");
    let (mean, worst_50) = cycles(&bench, 0.1);
    let share_50 = mean / block_cycles(50e3);
    let worst_50 = worst_50 / block_cycles(f_sw_hz);
    println!(
        "at {f_sw_hz:.0} Hz, of a block at 50 kHz: mean {:.1} %; worst {:.1} %",
        share_50 * 100.0,
        worst_50 * 100.0
    );
    assert!(share <= 0.54, "{share}");
    assert!(share_50 <= 0.34, "{share_50}");
    assert!(
        worst_share <= 0.70 && worst_50 <= 0.45,
        "{worst_share} {worst_50}"
    );
    assert_no_violations(&bench);
}

/// Regression test: at two cycles per instruction, a control step starved the watchdog of 60 ms.
#[test]
fn the_watchdog_is_fed_in_time_at_two_cycles_an_instruction() {
    let bench = with_pot(PotKind::Ferromagnetic);
    bench.with(|machine| machine.set_cycle_model(CycleModel::PerInstruction(2)));
    let mut client = connect(&bench);
    client.stream(1, 10).unwrap();
    // Meanwhile a page is erased, 22 ms, and the lookup is written.
    let lookup = RlLookup {
        version: 1,
        ..prior()
    };
    client.push_lookup(&lookup).unwrap();
    bench.run_s(0.06);
    client.set_power(1_200).unwrap();
    bench.run_s(0.5);
    let kept = bench.with(|machine| machine.chip().flash.operations);
    assert!(kept > 60, "{kept} operations of the flash");
    let (gap, resets) =
        bench.with(|machine| (machine.chip().watchdog.longest_gap, machine.resets.clone()));
    let gap_ms = seconds(gap) * 1e3;
    println!("longest time between two feeds: {gap_ms:.2} ms");
    assert!(resets.is_empty(), "{resets:?}");
    assert!(gap > 0 && gap_ms <= 20.0, "{gap_ms} ms");
}

/// The board measures its load with the cycle counter of DWT; the emulator, which advances that counter, measures from outside.
/// The board's figure begins when the task is polled: it excludes the entry and the return of the interrupt and the executor's
/// way to the task, some 240 cycles.
#[test]
fn the_load_that_it_reports_is_the_load_that_it_has() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    client.set_power(LITTLE_W).unwrap();
    // Waits for a constant frequency: the shares are of blocks at one frequency.
    bench.run_s(0.25);
    client.utilisation().unwrap();
    let f_sw_hz = bench.with(|machine| machine.chip().hrtim.f_sw_hz());
    let (mean, worst) = cycles(&bench, 0.1);
    let (mean, worst) = (mean / block_cycles(f_sw_hz), worst / block_cycles(f_sw_hz));
    let told = client.utilisation().unwrap();
    println!(
        "{told:?}; from outside {:.1} % and {:.1} %",
        mean * 100.0,
        worst * 100.0
    );
    assert!(told.blocks > 2_000, "{told:?}");
    let told_mean = f64::from(told.mean_permille) / 1_000.0;
    assert!(
        (0.0..0.05).contains(&(mean - told_mean)),
        "{mean} against {told:?}"
    );
    assert!(
        f64::from(told.worst_permille) / 1_000.0 <= worst + 0.02,
        "{worst} against {told:?}"
    );
    assert!((1..20_000).contains(&told.longest_gap_us), "{told:?}");
}

/// The library assumes one frequency in a block.
#[test]
fn new_periods_begin_with_a_block() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    client.set_power(1_200).unwrap();
    let found = bench.with(|machine| {
        let mut f_sw_hz = machine.chip().hrtim.f_sw_hz();
        let mut found = Vec::new();
        while found.len() < 4 {
            let before = machine.now();
            machine.run_for(us(1) / 2).unwrap();
            let now_hz = machine.chip().hrtim.f_sw_hz();
            if now_hz != f_sw_hz {
                let left = machine.chip().file.word(cndtr1::ADDRESS) as usize % ADC_LOCK_P;
                let within_s = seconds(machine.now() - before);
                let pair_s = ADC_LOCK_Q as f64 / ADC_LOCK_P as f64 / now_hz;
                found.push(((ADC_LOCK_P - left) % ADC_LOCK_P, within_s / pair_s));
                f_sw_hz = now_hz;
            }
        }
        found
    });
    // All pairs are there, or those that fit the time in which it was seen, and one: the first of the next block is triggered 70 ns
    // after that tick, and converted half a microsecond later.
    assert!(
        found
            .iter()
            .all(|(pairs, within)| *pairs as f64 <= 1.0 + within.floor()),
        "pairs of the next block, and within the time of so many: {found:?}"
    );
}

/// Runs of the sampling interrupt within a time.
fn runs(bench: &Bench, duration_s: f64) -> Vec<TracedRun> {
    bench.with(|machine| machine.timing().trace = Some(Trace::new(SAMPLING)));
    bench.run_s(duration_s);
    let trace = bench.with(|machine| machine.timing().trace.take());
    trace.expect("begun above").runs
}

/// Blocks have a constant period; a handler that begins late was delayed by masked interrupts. Regression test: the thread copied
/// a chunk of a window byte by byte in 2,650 cycles, so that two blocks were processed in a row, 129 % of one.
#[test]
fn the_thread_holds_no_block_up_for_long() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    client.stream(1, 10).unwrap();
    client.set_power(LITTLE_W).unwrap();
    // Waits for a constant frequency.
    bench.run_s(0.25);
    let block = block_cycles(bench.with(|machine| machine.chip().hrtim.f_sw_hz()));
    let runs = runs(&bench, 0.25);
    // Includes the entry, the end of an instruction and the return of another exception, which delay some of the blocks.
    let late = |pair: &[TracedRun]| (pair[1].begun - pair[0].begun) as f64 - block;
    let (most, at) = runs
        .windows(2)
        .map(|pair| (late(pair), pair[1].interrupted))
        .fold(
            (0.0, 0),
            |most, one| if one.0 > most.0 { one } else { most },
        );
    println!("a block begins at most {most:.0} cycles late, with what is at {at:#x}");
    assert!(runs.len() > 6_000, "{}", runs.len());
    assert!(most <= 1_000.0, "{most:.0} cycles, with what is at {at:#x}");
}

/// Compare 3 of 0x60 ticks of 735 ps; at 42.5 MHz a latency of 2.125 and a sampling time of 2.5 cycles (DS12288, t_LATR; RM0440,
/// 21.7.6).
#[test]
fn a_pair_is_held_after_trigger_latency_and_sampling_time() {
    let bench = with_pot(PotKind::Ferromagnetic);
    drop(connect(&bench));
    let held_ns = bench.with(|machine| machine.chip().hold_delay_s()) * 1e9;
    assert!((held_ns - (70.6 + 108.8)).abs() < 1.0, "{held_ns}");
    // `ihd hob` holds its pairs at the same time, and filters its comparators alike.
    assert!((held_ns - HOLD_DELAY_S * 1e9).abs() < 1.0, "{held_ns}");
    let comparators = bench.with(|machine| machine.chip().pins.comparators);
    for comparator in comparators {
        let filter_s = comparator.expect("both compare").filter_s;
        assert!((filter_s - FAULT_FILTER_S).abs() < 1e-12, "{filter_s}");
    }
}

/// Another frequency at every second half-cycle, and windows that end and begin at the same time.
#[test]
fn a_zero_crossing_with_another_frequency_is_done_within_its_block() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    let dither_permille = *Configure::DITHER_PERMILLE.end();
    client
        .configure(&Configure {
            dither_permille,
            ..Configure::DEFAULT
        })
        .unwrap();
    client.stream(1, 4).unwrap();
    client.set_power(RATED_POWER_W * 9 / 25).unwrap();
    bench.run_s(0.2);
    let mut f_sw_hz = Vec::new();
    let mut longest: Option<TracedRun> = None;
    // The serial port carries a window in 0.6 s, and none is recorded meanwhile.
    for _ in 0..360 {
        let runs = runs(&bench, 0.005);
        let one = runs.into_iter().max_by_key(|run| run.cycles);
        longest = longest.into_iter().chain(one).max_by_key(|run| run.cycles);
        f_sw_hz.push(bench.with(|machine| machine.chip().hrtim.f_sw_hz()));
    }
    let mut windows = 0;
    while let Some(event) = client.next_event(Duration::from_millis(1)).unwrap() {
        windows += u32::from(matches!(event, DeviceEvent::Window(_)));
    }
    let changes = f_sw_hz.windows(2).filter(|f| f[0] != f[1]).count();
    let longest = longest.expect("blocks came");
    // The work is the same at each frequency, and the time for it shortest at the highest.
    let share = longest.cycles as f64 / block_cycles(80e3);
    let most: Vec<_> = longest.most_at(8).iter().map(hex).collect();
    println!(
        "{windows} windows, {changes} changes: longest block {} cycles, {:.1} % at 80 kHz; most of it at {most:?}",
        longest.cycles,
        share * 100.0,
    );
    assert!(windows >= 2 && changes >= 60, "{windows} {f_sw_hz:?}");
    // The rest is for a block that begins late: the thread masks interrupts for up to 1 000 cycles.
    assert!(share <= 0.75, "{share}");
    assert_no_violations(&bench);
}

fn hex((address, cycles): &(u32, u32)) -> String {
    format!("{address:#x}: {cycles}")
}
