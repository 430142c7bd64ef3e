//! The panel's buttons and lights on the board's pins.

use ihd_shared::wire::messages::State;
use ihd_sim::behavioural::PotKind;
use ihd_stm32g474::registers::{gpioc, syscfg};

use crate::board::{Bench, assert_no_violations, connect, with_pot};

const ON_OFF: [bool; 3] = [true, false, false];
const PLUS: [bool; 3] = [false, true, false];

/// Presses a button for 60 ms, and lets go.
fn press(bench: &Bench, button: [bool; 3]) {
    for pressed in [button, [false; 3]] {
        bench.with(move |machine| machine.chip().pins.pressed = pressed);
        bench.run_s(0.06);
    }
}

/// Lights of power and fault.
fn lights(bench: &Bench) -> [bool; 2] {
    bench.with(|machine| {
        let out = machine.chip().file.word(gpioc::odr::ADDRESS);
        [10, 11].map(|pin| out >> pin & 1 == 1)
    })
}

#[test]
fn a_person_at_the_panel_ends_a_lock_out_and_heats_without_a_host() {
    let bench = with_pot(PotKind::Ferromagnetic);
    // Plus is held while the power comes on, and let go: nothing.
    bench.with(|machine| machine.chip().pins.pressed = PLUS);
    bench.run_s(0.15);
    press(&bench, [false; 3]);
    press(&bench, PLUS);
    let mut client = connect(&bench);
    assert_eq!(client.status().unwrap().asked_w, 0);
    client.set_power(1_200).unwrap();
    bench.run_s(0.12);
    bench.with(|machine| machine.chip().system_fault(syscfg::cfgr2::CLL));
    bench.run_s(0.005);
    assert_eq!(client.status().unwrap().state, State::LockedOut);
    assert!(lights(&bench)[1]);
    // Off, awake, on.
    press(&bench, ON_OFF);
    press(&bench, ON_OFF);
    assert_eq!(client.status().unwrap().state, State::LockedOut);
    press(&bench, PLUS);
    bench.run_s(0.1);
    let status = client.status().unwrap();
    assert_eq!((status.state, status.panel_level), (State::Heating, 1));
    assert!(!lights(&bench)[1]);
    press(&bench, ON_OFF);
    assert_eq!(client.status().unwrap().state, State::Idle);
    assert_no_violations(&bench);
}
