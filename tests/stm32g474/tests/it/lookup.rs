//! Lookup in flash: kept through a reset, and through a loss of power at any time of its writing.

use ihd_shared::fault::Fault;
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_shared::wire::messages::State;
use ihd_sim::behavioural::PotKind;
use ihd_stm32g474::chip::Reset;
use ihd_stm32g474::chip::flash::Pages;
use ihd_stm32g474::chip::hrtim::Bridge;
use ihd_stm32g474::registers::flash::{flash_eccr, flash_optr};
use ihd_stm32g474::time::us;

use crate::board::{Bench, assert_no_violations, connect, resets, with_pot};

fn version(version: u32) -> RlLookup {
    RlLookup { version, ..prior() }
}

/// Pushes a lookup and waits until it is stored: an erasure of 22 ms and 70 double words.
fn push(bench: &Bench, number: u32) {
    let mut client = connect(bench);
    client.push_lookup(&version(number)).unwrap();
    bench.run_s(0.045);
}

/// Pushes a lookup after a start, whose first save need not wait.
fn push_anew(bench: &Bench, number: u32) {
    bench.with(|machine| machine.power_cycle().unwrap());
    push(bench, number);
}

fn active(bench: &Bench) -> u32 {
    connect(bench).read_lookup().unwrap().version
}

#[test]
fn a_lookup_is_back_after_the_power_was_gone() {
    let bench = with_pot(PotKind::Ferromagnetic);
    push_anew(&bench, 1);
    push_anew(&bench, 2);
    assert_eq!(active(&bench), 2);
    bench.with(|machine| machine.power_cycle().unwrap());
    assert_eq!(active(&bench), 2);
    assert_no_violations(&bench);
}

/// Each save wears the flash: one a minute at the most. A lookup that waits for its save is in use.
#[test]
fn a_second_lookup_within_a_minute_is_in_use_and_not_saved_yet() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let operations = || bench.with(|machine| machine.chip().flash.operations);
    push(&bench, 1);
    let before = operations();
    for number in 2..5 {
        push(&bench, number);
        assert_eq!((active(&bench), operations()), (number, before));
    }
    bench.with(|machine| machine.power_cycle().unwrap());
    assert_eq!(active(&bench), 1);
}

/// A lookup that is saved as heating begins, and whose page turns out to be damaged.
#[test]
fn a_page_that_is_damaged_as_heating_begins_is_no_fault() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    bench.run_s(0.3);
    let begun = bench.with(|machine| machine.chip().flash.operations);
    client.push_lookup(&version(1)).unwrap();
    while bench.with(|machine| machine.chip().flash.operations) == begun {
        bench.run_s(1e-4);
    }
    client.set_power(1_200).unwrap();
    let bridge = bench.with(move |machine| {
        // The second operation begins once the page is erased.
        while machine.chip().flash.operations < begun + 2 {
            machine.run_for(us(20)).unwrap();
        }
        machine.chip().flash.pages.damage(64);
        let (mut bridge, mut idle) = (Bridge::Open, 0);
        while idle < 5 {
            if machine.chip().flash.next().is_some() {
                (bridge, idle) = (machine.chip().pins.bridge(), 0);
            } else {
                idle += 1;
            }
            machine.run_for(us(20)).unwrap();
        }
        bridge
    });
    assert_ne!(bridge, Bridge::Open, "it heats as the page is read back");
    bench.run_s(0.1);
    let status = client.status().unwrap();
    assert_eq!((status.state, status.fault), (State::Heating, Fault::NONE));
    // The page is no lookup to the next start.
    bench.with(|machine| machine.power_cycle().unwrap());
    assert_eq!(active(&bench), 0);
    assert_eq!(resets(&bench), [Reset::Power]);
}

/// RM0440, 3.3.2: FLASH_ECCR keeps the first error, here one of the program that the read corrected, until it is cleared.
#[test]
fn a_damaged_page_is_empty_whatever_was_corrected_before() {
    let bench = with_pot(PotKind::Ferromagnetic);
    push(&bench, 1);
    bench.with(|machine| {
        machine.chip().flash.pages.damage(64);
        machine.power_cycle().unwrap();
        machine.bites_at_start.clear();
        while machine.bites_at_start.is_empty() {
            machine.run_for(us(10)).unwrap();
        }
        machine.chip().file.set(flash_eccr::ECCC, 1);
    });
    assert_eq!(active(&bench), 0);
    assert_eq!(resets(&bench), [Reset::Power]);
    assert_no_violations(&bench);
}

/// Regression test: a half-written record raised NMI at every start. The power is cut at the erasure, at a double word in the
/// middle, and at the last two.
#[test]
fn the_power_may_go_while_a_lookup_is_written() {
    let (pages, operations) = written();
    let kept = cuts(&pages, [1, operations / 2, operations - 1, operations]);
    assert!(kept > 0);
}

/// Power cuts at the erasure and at each of the double words.
#[test]
fn the_power_may_go_at_any_operation_of_a_write_all_variants() {
    let (pages, operations) = written();
    // Two boards share the work.
    let halves: Vec<_> = [0, 1]
        .map(|first| {
            let pages = pages.clone();
            std::thread::spawn(move || cuts(&pages, (1 + first..=operations).step_by(2)))
        })
        .into_iter()
        .map(|half| half.join().expect("no cut fails"))
        .collect();
    let kept: u32 = halves.iter().sum();
    println!(
        "{operations} cuts: the old one came back {kept} times, the new one {} times",
        operations as u32 - kept
    );
    assert!(kept > 0);
}

/// Pages with two lookups, and the number of operations to write a third.
fn written() -> (Pages, u64) {
    let bench = with_pot(PotKind::Ferromagnetic);
    push_anew(&bench, 1);
    push_anew(&bench, 2);
    bench.with(|machine| machine.power_cycle().unwrap());
    let (pages, before) = bench.with(|machine| {
        (
            machine.chip().flash.pages.clone(),
            machine.chip().flash.operations,
        )
    });
    push(&bench, 3);
    let operations = bench.with(move |machine| machine.chip().flash.operations - before);
    assert!((60..100).contains(&operations), "{operations}");
    (pages, operations)
}

/// Cuts the power at each of these operations; returns the number of times that the old lookup came back.
fn cuts(pages: &Pages, at: impl IntoIterator<Item = u64>) -> u32 {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut old = 0;
    for cut in at {
        restart_with(&bench, pages.clone());
        bench.with(move |machine| {
            let done = machine.chip().flash.operations;
            machine.chip().flash.cut_at_operation = Some(done + cut);
        });
        // The power may be cut before the response.
        let _ = connect(&bench).push_lookup(&version(3));
        bench.run_s(0.06);
        assert_eq!(
            resets(&bench),
            [Reset::Power, Reset::Power],
            "cut {cut}: one power-up, one cut, nothing besides"
        );
        let found = active(&bench);
        assert!(found == 2 || found == 3, "cut {cut}: version {found}");
        old += u32::from(found == 2);
        // The next lookup is stored too; checked at few cuts, as it takes time.
        if cut % 16 == 1 {
            push(&bench, 4);
            bench.with(|machine| machine.power_cycle().unwrap());
            assert_eq!(active(&bench), 4, "cut {cut}");
        }
    }
    old
}

/// Restarts the board at power-on with other pages.
fn restart_with(bench: &Bench, pages: Pages) {
    bench.with(move |machine| {
        machine.chip().flash.pages = pages;
        machine.power_cycle().unwrap();
        machine.resets.truncate(0);
        machine.resets.push((0, Reset::Power));
    });
}

/// One bank, which would stall the program while a lookup is written; or RAM without parity, as chips are delivered. The board
/// must report it, not restart for ever.
#[test]
fn wrong_option_bytes_are_reported_and_nothing_is_driven() {
    for (option, value) in [(flash_optr::DBANK, 0), (flash_optr::SRAM_PE, 1)] {
        let bench = with_pot(PotKind::Ferromagnetic);
        bench.with(move |machine| {
            machine.chip().set_option(option, value);
            machine.power_cycle().unwrap();
            machine.resets.clear();
        });
        let mut client = connect(&bench);
        let refused = client.set_power(1_000);
        bench.run_s(0.1);
        let status = client.status().unwrap();
        assert_eq!(status.fault, Fault::OPTION_BYTES, "{status:?}");
        assert!(refused.is_err(), "power is refused");
        let (resets, bridge) =
            bench.with(|machine| (machine.resets.clone(), machine.chip().pins.bridge()));
        assert!(resets.is_empty(), "{resets:?}");
        assert_eq!(bridge, Bridge::Open);
        assert_no_violations(&bench);
    }
}
