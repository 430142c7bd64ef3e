//! Lock-out of the hob: services that stay available, and its end by the panel or the mains only.

use ihd_link::LinkError;
use ihd_shared::board::MAINS_VOLTAGE_V;
use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::{Outcome, Program, State};
use ihd_sim::behavioural::PotKind;
use ihd_stm32g474::chip::Reset;
use ihd_stm32g474::chip::hrtim::Bridge;
use ihd_stm32g474::registers::syscfg;

use crate::board::{
    Bench, assert_no_violations, connect, resets, set_mains, take_mains_off, with_pot,
};

/// Board that locked out while it heated, by a lock-up of the processor that has ended.
fn locked_out() -> Bench {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    client.set_power(1_200).unwrap();
    bench.run_s(0.12);
    bench.with(|machine| machine.chip().system_fault(syscfg::cfgr2::CLL));
    bench.run_s(0.002);
    let status = client.status().unwrap();
    assert_eq!(
        (status.state, status.fault, status.asked_w),
        (State::LockedOut, Fault::CORE_LOCKUP, 1_200)
    );
    bench
}

/// Asserts on a new connection that the board is locked out by that fault; power is refused, and no switch closes.
fn assert_locked_out(bench: &Bench) {
    let mut client = connect(bench);
    bench.with(|machine| machine.chip().hrtim.off_at = None);
    match client.set_power(1_200) {
        Err(LinkError::Refused { outcome, .. }) => assert_eq!(outcome, Outcome::LockedOut),
        other => panic!("{other:?}"),
    }
    let status = client.status().unwrap();
    assert_eq!(
        (status.state, status.fault, status.tries_left),
        (State::LockedOut, Fault::CORE_LOCKUP, 0)
    );
    for _ in 0..10 {
        bench.run_s(0.002);
        let bridge = bench.with(|machine| machine.chip().pins.bridge());
        assert_eq!(bridge, Bridge::Open);
    }
    let off_at = bench.with(|machine| machine.chip().hrtim.off_at);
    assert_eq!(off_at, None, "it was on in between");
}

#[test]
fn service_tests_a_board_that_locked_out_while_heating() {
    let bench = locked_out();
    let mut client = connect(&bench);
    client.channels().unwrap();
    let found = client.comparators().unwrap();
    assert!(
        found.positive_tripped && found.negative_tripped,
        "{found:?}"
    );
    assert_locked_out(&bench);
    assert_no_violations(&bench);
}

#[test]
fn no_reset_ends_a_lock_out_but_the_loss_of_power() {
    let bench = locked_out();
    connect(&bench).restart(Program::Firmware).unwrap();
    bench.run_s(0.25);
    assert_locked_out(&bench);
    // Into the bootloader and back, as after a flash by DFU; the reset pin and a debug probe have the same effect.
    take_mains_off(&bench);
    connect(&bench).restart(Program::Bootloader).unwrap();
    bench.run_s(0.2);
    bench.with(|machine| machine.chip().reset = Some(Reset::Software));
    bench.run_s(0.1);
    assert_locked_out(&bench);
    // The last one: a supply that sags, with its RAM intact.
    for reset in [Reset::Watchdog, Reset::Power] {
        bench.with(move |machine| machine.chip().reset = Some(reset));
        bench.run_s(0.1);
        assert_locked_out(&bench);
    }
    assert_eq!(
        resets(&bench),
        [
            Reset::Software,
            Reset::Software,
            Reset::Software,
            Reset::Watchdog,
            Reset::Power
        ]
    );
    bench.with(|machine| machine.power_cycle().unwrap());
    set_mains(&bench, f64::from(MAINS_VOLTAGE_V));
    bench.run_s(0.1);
    let mut client = connect(&bench);
    client.set_power(1_200).unwrap();
    bench.run_s(0.2);
    assert_eq!(client.status().unwrap().state, State::Heating);
    assert_no_violations(&bench);
}
