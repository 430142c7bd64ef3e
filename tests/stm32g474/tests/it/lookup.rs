//! The lookup in flash: kept through a reset, and a loss of power at any moment of its writing.

use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_sim::behavioural::PotKind;
use ihd_stm32g474::chip::Reset;
use ihd_stm32g474::chip::flash::Pages;
use ihd_stm32g474::registers::flash::flash_optr;

use crate::board::{Bench, assert_no_violations, connect, with_pot};

fn version(version: u32) -> RlLookup {
    RlLookup { version, ..prior() }
}

/// Pushes a lookup and waits until it is kept: an erasure of 22 ms and 70 double words.
fn push(bench: &Bench, number: u32) {
    let mut client = connect(bench);
    client.push_lookup(&version(number)).unwrap();
    bench.run_s(0.06);
}

fn active(bench: &Bench) -> u32 {
    connect(bench).read_lookup().unwrap().version
}

#[test]
fn a_lookup_is_back_after_the_power_was_gone() {
    let bench = with_pot(PotKind::Ferromagnetic);
    push(&bench, 1);
    push(&bench, 2);
    assert_eq!(active(&bench), 2);
    bench.with(|machine| machine.power_cycle().unwrap());
    assert_eq!(active(&bench), 2);
    assert_no_violations(&bench);
}

/// Pins that a half-written record raised NMI at every start. Every operation of a write is cut: the erasure, and each
/// of the double words.
#[test]
fn the_power_may_go_at_any_operation_of_a_write() {
    let bench = with_pot(PotKind::Ferromagnetic);
    push(&bench, 1);
    push(&bench, 2);
    let (pages, before) = bench.with(|machine| (machine.chip().flash.pages.clone(), machine.chip().flash.operations));
    push(&bench, 3);
    let operations = bench.with(move |machine| machine.chip().flash.operations - before);
    assert!((60..100).contains(&operations), "{operations}");
    let mut kept = [0; 4];
    for cut in 1..=operations {
        restart_with(&bench, pages.clone());
        bench.with(move |machine| {
            let done = machine.chip().flash.operations;
            machine.chip().flash.cut_at_operation = Some(done + cut);
        });
        let mut client = connect(&bench);
        // The power may go before the answer has come.
        let _ = client.push_lookup(&version(3));
        bench.run_s(0.08);
        let resets = bench.with(|machine| machine.resets.iter().map(|reset| reset.1).collect::<Vec<_>>());
        assert_eq!(resets, [Reset::Power, Reset::Power], "cut {cut}: one power-up, one cut, nothing besides");
        let found = active(&bench);
        assert!(found == 2 || found == 3, "cut {cut}: version {found}");
        kept[found as usize] += 1;
        // And the next one is kept.
        push(&bench, 4);
        bench.with(|machine| machine.power_cycle().unwrap());
        assert_eq!(active(&bench), 4, "cut {cut}");
    }
    println!("{operations} cuts: the old one {} times, the new one {}", kept[2], kept[3]);
    assert!(kept[2] > 0);
}

/// The board with other pages, from power-on.
fn restart_with(bench: &Bench, pages: Pages) {
    bench.with(move |machine| {
        machine.chip().flash.pages = pages;
        machine.power_cycle().unwrap();
        machine.resets.truncate(0);
        machine.resets.push((0, Reset::Power));
    });
}

/// DBANK = 0: the flash is one bank, and writing it would hold the program up. It must say so, not restart for ever.
#[test]
fn a_single_bank_is_reported_and_nothing_is_driven() {
    let bench = with_pot(PotKind::Ferromagnetic);
    bench.with(|machine| {
        machine.chip().set_option(flash_optr::DBANK, 0);
        machine.power_cycle().unwrap();
        machine.resets.clear();
    });
    let mut client = connect(&bench);
    bench.run_s(0.1);
    let status = client.status().unwrap();
    println!("{status:?}");
    assert_eq!(status.fault.number(), 16, "{status:?}");
    let resets = bench.with(|machine| machine.resets.clone());
    assert!(resets.is_empty(), "{resets:?}");
}
