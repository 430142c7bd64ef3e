//! Self-tests (docs/board.md): each detects its fault, and none reports one on a healthy board.

use ihd_shared::board::LED_PIN;
use ihd_shared::fault::Fault;
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_sim::behavioural::PotKind;
use ihd_stm32g474::RegisterARM;
use ihd_stm32g474::chip::hrtim::Bridge;
use ihd_stm32g474::machine::Machine;
use ihd_stm32g474::time::{TICKS_PER_S, Ticks, seconds, us};

use crate::board::{Bench, assert_no_violations, connect, resets, with_pot};

/// Board with a defect from power-on on.
fn started_with(what: impl FnOnce(&mut Machine) + Send + 'static) -> Bench {
    let bench = with_pot(PotKind::Ferromagnetic);
    bench.with(move |machine| {
        what(machine);
        machine.power_cycle().unwrap();
        machine.resets.clear();
        machine.bites_at_start.clear();
    });
    bench
}

/// Board that heats.
fn heating() -> Bench {
    let bench = with_pot(PotKind::Ferromagnetic);
    connect(&bench).set_power(1_200).unwrap();
    bench.run_s(0.15);
    let bridge = bench.with(|machine| machine.chip().pins.bridge());
    assert!(matches!(bridge, Bridge::Switching { .. }), "{bridge:?}");
    bench
}

/// Applies `what` to a board that heats; returns the seconds until the outputs are off, at most `within_s` later.
fn off_after_s(
    bench: &Bench,
    within_s: f64,
    what: impl FnOnce(&mut Machine) + Send + 'static,
) -> f64 {
    bench.with(move |machine| {
        machine.chip().hrtim.off_at = None;
        let began = machine.now();
        what(machine);
        let until = began + (within_s * TICKS_PER_S as f64) as Ticks;
        while machine.chip().hrtim.off_at.is_none() && machine.now() < until {
            machine.run_for(us(1_000)).unwrap();
        }
        let off = machine.chip().hrtim.off_at.expect("the outputs went off");
        seconds(off.saturating_sub(began))
    })
}

/// Asserts a standing fault: it is reported, clearing does not end it, power is refused, nothing is driven.
fn assert_stands(bench: &Bench, fault: Fault) {
    let mut client = connect(bench);
    bench.run_s(0.05);
    assert_eq!(client.status().unwrap().fault, fault);
    let _ = client.clear_fault();
    assert!(client.set_power(1_000).is_err(), "power is refused");
    bench.run_s(0.05);
    assert_eq!(client.status().unwrap().fault, fault);
    let bridge = bench.with(|machine| machine.chip().pins.bridge());
    assert_eq!(bridge, Bridge::Open);
    assert_eq!(resets(bench), [], "it stays to tell");
}

/// Address of code that no run reaches.
fn unused_code(machine: &Machine) -> u32 {
    let panic = machine.image().symbol_like("panicking9panic_fmt");
    panic.expect("a panic in the image") & !3
}

fn flip(machine: &mut Machine, address: u32, bit: u32) {
    let byte = machine.memory(address, 1)[0] ^ 1 << bit;
    machine.set_memory(address, &[byte]);
}

#[test]
fn a_healthy_board_starts_and_heats_without_a_fault() {
    heats_without_a_fault(1);
}

#[test]
fn a_healthy_board_starts_and_heats_without_a_fault_at_length() {
    heats_without_a_fault(5);
}

fn heats_without_a_fault(seconds_of_heat: usize) {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    let started_s = bench.now_s();
    let tried_s = bench.with(|machine| machine.bites_at_start[0]);
    println!(
        "watchdog tried after {:.2} ms, first answer {:.1} ms after power-on",
        seconds(tried_s) * 1e3,
        started_s * 1e3
    );
    assert!(started_s < 0.3, "{started_s}");
    assert_eq!(client.hello().reset_reason, 0, "power-on, not the watchdog");
    client.set_power(1_200).unwrap();
    bench.run_s(0.3);
    // Meanwhile a lookup is stored and becomes active.
    let lookup = RlLookup {
        version: 1,
        ..prior()
    };
    client.push_lookup(&lookup).unwrap();
    for _ in 0..seconds_of_heat {
        bench.run_s(1.0);
        let status = client.status().unwrap();
        assert_eq!(status.fault, Fault::NONE);
        assert!(status.delivered_mw > 1_100_000, "{status:?}");
        client.set_power(1_200).unwrap();
    }
    let bites = bench.with(|machine| machine.bites_at_start.len());
    assert_eq!((resets(&bench), bites), (vec![], 1));
    assert_no_violations(&bench);
}

#[test]
fn a_bit_of_flash_that_flipped_while_the_power_was_off_is_found_at_start() {
    let bench = started_with(|machine| {
        let at = unused_code(machine);
        flip(machine, at, 7);
    });
    assert_stands(&bench, Fault::FLASH_CRC);
}

#[test]
fn a_bit_of_flash_that_flips_while_it_heats_is_found_at_length() {
    let bench = heating();
    let off_s = off_after_s(&bench, 60.0, |machine| {
        let at = unused_code(machine);
        flip(machine, at, 3);
    });
    println!("flash bit: off after {off_s:.2} s");
    assert!(off_s < 5.0, "{off_s}");
    assert_stands(&bench, Fault::FLASH_CRC);
}

#[test]
fn a_cell_of_the_ram_that_is_stuck_lets_nothing_run() {
    lets_nothing_run(&[0x2000_A7C4]);
}

#[test]
fn a_cell_of_the_ram_that_is_stuck_lets_nothing_run_all_variants() {
    // Stack, the end of SRAM2 with the crash record, CCM SRAM at both ends.
    lets_nothing_run(&[0x2000_0000, 0x2001_7FE4, 0x1000_0000, 0x1000_7FFC]);
}

fn lets_nothing_run(cells: &[u32]) {
    for &cell in cells {
        let bench = started_with(move |machine| machine.stick_bit(cell, 13));
        bench.run_s(1.5);
        let (bites, answered, lit) = bench.with(|machine| {
            let answered = !machine.chip().serial.sent.is_empty();
            let mut lit = Vec::new();
            for _ in 0..40 {
                machine.run_for(us(12_000)).unwrap();
                lit.push(machine.chip().driven(LED_PIN));
            }
            (machine.bites_at_start.len(), answered, lit)
        });
        // The test of the watchdog, then one reset after each 512 ms and the march test.
        assert!((3..=4).contains(&bites), "{cell:#x}: {bites} bites");
        assert!(!answered, "{cell:#x}");
        let changes = lit.windows(2).filter(|two| two[0] != two[1]).count();
        assert!((4..=9).contains(&changes), "{cell:#x}: {lit:?}");
        let running = bench.with(|machine| machine.chip().hrtim.is_running());
        assert!(!running, "{cell:#x}");
    }
}

#[test]
fn a_register_of_the_processor_that_is_stuck_lets_nothing_run() {
    use RegisterARM::{R7, S31};
    held_up_by(&[R7, S31], &[1]);
    // The stuck bits are the cause: without them the board starts.
    let bench = started_with(|machine| machine.stick_register(R7, 0));
    drop(connect(&bench));
}

#[test]
fn a_register_of_the_processor_that_is_stuck_lets_nothing_run_all_variants() {
    use RegisterARM::{LR, R0, R7, R12, S0, S31};
    held_up_by(&[R0, R7, R12, LR, S0, S31], &[1, 1 << 31]);
}

fn held_up_by(registers: &[RegisterARM], masks: &[u32]) {
    for &register in registers {
        for &mask in masks {
            let bench = started_with(move |machine| machine.stick_register(register, mask));
            bench.run_s(0.3);
            let (bites, running, sent) = bench.with(|machine| {
                let bites = machine.bites_at_start.len();
                let sent = machine.chip().serial.sent.len();
                (bites, machine.chip().hrtim.is_running(), sent)
            });
            assert_eq!((bites, running, sent), (0, false, 0), "{register:?}");
        }
    }
}

/// Cell in the unused part of the stack, which the test reaches soon after the start.
#[test]
fn a_cell_of_the_ram_that_sticks_while_it_heats_is_found() {
    is_found_while_it_heats(0x2000_1000, 3);
}

/// Cell that the test has passed already, and one in the last word before the crash record.
#[test]
fn a_cell_of_the_ram_that_sticks_while_it_heats_is_found_all_variants() {
    is_found_while_it_heats(0x2000_0180, 3);
    is_found_while_it_heats(0x2001_7FDC, 0);
}

fn is_found_while_it_heats(cell: u32, bit: u32) {
    let bench = heating();
    let off_s = off_after_s(&bench, 15.0, move |machine| machine.stick_bit(cell, bit));
    println!("RAM at {cell:#x}: off after {off_s:.2} s");
    assert!(off_s < 10.0, "{off_s}");
    assert_stands(&bench, Fault::RAM_TEST);
}

#[test]
fn a_ram_that_was_broken_is_reported_by_the_next_start_that_finds_it_whole() {
    let bench = started_with(|machine| machine.stick_bit(0x2000_A7C4, 13));
    bench.run_s(0.4);
    bench.with(|machine| machine.release_bits());
    bench.run_s(0.5);
    let client = connect(&bench);
    assert_eq!(client.hello().fault_before_reset, Fault::RAM_TEST.number());
}

/// An error of ten percent in the main clock appears as one of all other clocks: LSI × 1.1 is a main clock 9 % too slow, and so on.
#[test]
fn a_clock_that_is_ten_percent_off_is_found_at_start_and_while_it_heats() {
    clocks_are_found(&[28_800], &[35_200]);
}

/// Both ends of the range, and an oscillator that is stopped.
#[test]
fn a_clock_that_is_ten_percent_off_is_found_at_start_and_while_it_heats_all_variants() {
    clocks_are_found(&[29_091, 35_200, 35_556], &[28_800, 0]);
}

fn clocks_are_found(at_start: &[u64], while_it_heats: &[u64]) {
    for &lsi_hz in at_start {
        let bench = started_with(move |machine| {
            let now = machine.now();
            machine.chip().lsi.set_hz(lsi_hz, now);
        });
        assert_stands(&bench, Fault::CLOCK);
    }
    for &lsi_hz in while_it_heats {
        let bench = heating();
        let off_s = off_after_s(&bench, 2.0, move |machine| {
            let now = machine.now();
            machine.chip().lsi.set_hz(lsi_hz, now);
        });
        println!("LSI at {lsi_hz} Hz: off after {off_s:.3} s");
        assert!(off_s < 1.2, "{off_s}");
        assert_stands(&bench, Fault::CLOCK);
    }
}

#[test]
fn clocks_at_the_ends_of_their_tolerances_are_no_fault() {
    are_no_fault(&[34_000]);
}

#[test]
fn clocks_at_the_ends_of_their_tolerances_are_no_fault_all_variants() {
    are_no_fault(&[29_500, 34_000]);
}

fn are_no_fault(clocks_hz: &[u64]) {
    for &lsi_hz in clocks_hz {
        let bench = started_with(move |machine| {
            let now = machine.now();
            machine.chip().lsi.set_hz(lsi_hz, now);
        });
        let mut client = connect(&bench);
        // A wrong clock is detected within 1.2 s.
        bench.run_s(1.2);
        assert_eq!(client.status().unwrap().fault, Fault::NONE, "{lsi_hz}");
    }
}

#[test]
fn a_watchdog_that_does_not_bite_is_found_at_start() {
    let bench = started_with(|machine| machine.chip().watchdog.broken = true);
    assert_stands(&bench, Fault::WATCHDOG_TEST);
    let bites = bench.with(|machine| machine.bites_at_start.len());
    assert_eq!(bites, 0);
}

#[test]
fn a_stack_that_is_used_to_its_end_is_found() {
    canary_is_found(&[31]);
}

#[test]
fn a_stack_that_is_used_to_its_end_is_found_all_variants() {
    canary_is_found(&[0, 31]);
}

fn canary_is_found(words: &[u32]) {
    for &word in words {
        let bench = heating();
        let off_s = off_after_s(&bench, 0.1, move |machine| {
            machine.set_memory(0x2000_0000 + 4 * word, &[0; 4]);
        });
        println!("canary: off after {:.2} ms", off_s * 1e3);
        assert!(off_s < 0.01, "{off_s}");
        assert_stands(&bench, Fault::STACK_CANARY);
    }
}

#[test]
fn a_sampling_path_at_half_its_rate_is_found() {
    let bench = with_pot(PotKind::Ferromagnetic);
    drop(connect(&bench));
    bench.with(|machine| machine.chip().loses_triggers = true);
    bench.run_s(0.25);
    assert_stands(&bench, Fault::PROGRAM_FLOW);
    // While it heats, other tests may detect it first.
    let bench = heating();
    let off_s = off_after_s(&bench, 0.25, |machine| machine.chip().loses_triggers = true);
    println!("half the triggers lost: off after {:.1} ms", off_s * 1e3);
}

/// Registers as a debug probe leaves them: DebugCoreStop of CMSIS writes 0 to DEMCR, and probe-rs restores a DBGMCU_CR that was 0 on a blank
/// chip. Temperatures, fan and buttons stay in time.
#[test]
fn a_cycle_counter_that_a_probe_leaves_switched_off_goes_on() {
    for (register, name) in [(0x4_2004, "DBGMCU_CR"), (0xEDFC, "DEMCR")] {
        let bench = heating();
        let conversions = |bench: &Bench| bench.with(|machine| machine.chip().conversions(3));
        bench.with(move |machine| machine.chip().write_system(register, 4, 0));
        let before = conversions(&bench);
        bench.run_s(0.3);
        let taken: u32 = conversions(&bench).iter().sum::<u32>() - before.iter().sum::<u32>();
        assert!(taken >= 270, "{name}: {taken} conversions of ADC4");
        let bridge = bench.with(|machine| machine.chip().pins.bridge());
        assert!(matches!(bridge, Bridge::Switching { .. }), "{name}");
        let status = connect(&bench).status().unwrap();
        assert_eq!(status.fault, Fault::NONE, "{name}");
    }
}

#[test]
fn a_cycle_counter_that_stands_still_is_found() {
    let bench = heating();
    let off_s = off_after_s(&bench, 1.0, |machine| {
        machine.chip().cycle_counter.broken = true;
    });
    println!("cycle counter: off after {off_s:.2} s");
    assert!(off_s < 0.2, "{off_s}");
    assert_stands(&bench, Fault::PROGRAM_FLOW);
}

/// Address of the active lookup's cells in the RAM.
fn active_lookup(machine: &Machine, lookup: &RlLookup) -> u32 {
    let (begin, bytes) = (0x2000_3000, 0x14FE0);
    let ram = machine.memory(begin, bytes);
    let cells = lookup.to_bytes();
    let cells = &cells[9..9 + 64];
    let found = ram.windows(64).position(|window| window == cells);
    begin + found.expect("the cells are in RAM") as u32
}

#[test]
fn a_bit_of_the_active_lookup_that_flips_is_found() {
    let bench = heating();
    let off_s = off_after_s(&bench, 3.0, |machine| {
        let at = active_lookup(machine, &prior());
        flip(machine, at + 21, 1);
    });
    println!("lookup: off after {off_s:.2} s");
    assert!(off_s < 1.2, "{off_s}");
    assert_stands(&bench, Fault::DATA_CRC);
}

#[test]
fn a_bit_of_a_constant_or_table_in_ram_that_flips_is_found() {
    flip_before_is_found(&["__etables"]);
}

#[test]
fn a_bit_of_a_constant_or_table_in_ram_that_flips_is_found_all_variants() {
    flip_before_is_found(&["__eccm", "__etables"]);
}

fn flip_before_is_found(symbols: &'static [&'static str]) {
    for &symbol in symbols {
        let bench = heating();
        let off_s = off_after_s(&bench, 3.0, move |machine| {
            let end = machine.image().symbol(symbol).expect("named by the linker");
            flip(machine, end - 3, 0);
        });
        println!("{symbol}: off after {off_s:.2} s");
        assert!(off_s < 2.0, "{off_s}");
        assert_stands(&bench, Fault::DATA_CRC);
    }
}

#[test]
fn a_comparator_that_never_trips_is_found_at_start() {
    dead_comparators_are_found(&[[false, true]]);
}

#[test]
fn a_comparator_that_never_trips_is_found_at_start_all_variants() {
    dead_comparators_are_found(&[[true, false], [false, true]]);
}

fn dead_comparators_are_found(which: &[[bool; 2]]) {
    for &dead in which {
        let bench = started_with(move |machine| machine.chip().pins.dead_comparators = dead);
        assert_stands(&bench, Fault::COMPARATOR_TEST);
    }
}
