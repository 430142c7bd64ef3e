//! Buttons and lights of the panel at the board's pins.

use ihd_firmware::limits::KEEP_WARM_W;
use ihd_shared::board::{LIGHT_FAULT_PIN, LIGHT_HOT_GLASS_PIN, LIGHT_POWER_PIN};
use ihd_shared::wire::messages::{Limit, State};
use ihd_sim::behavioural::PotKind;
use ihd_stm32g474::chip::hrtim::Bridge;
use ihd_stm32g474::registers::syscfg;

use crate::board::{Bench, assert_no_violations, connect, with_pot};

const ON_OFF: [bool; 4] = [true, false, false, false];
const PLUS: [bool; 4] = [false, true, false, false];
const MINUS: [bool; 4] = [false, false, true, false];
const TIMER: [bool; 4] = [false, false, false, true];

/// Presses a button for 60 ms and releases it for 60 ms.
fn press(bench: &Bench, button: [bool; 4]) {
    for pressed in [button, [false; 4]] {
        bench.with(move |machine| machine.chip().pins.pressed = pressed);
        bench.run_s(0.06);
    }
}

/// States of the lights of power, fault and hot glass.
fn lights(bench: &Bench) -> [bool; 3] {
    let pins = [LIGHT_POWER_PIN, LIGHT_FAULT_PIN, LIGHT_HOT_GLASS_PIN];
    bench.with(move |machine| pins.map(|pin| machine.chip().driven(pin)))
}

#[test]
fn a_person_at_the_panel_ends_a_lock_out_and_heats_without_a_host() {
    let bench = with_pot(PotKind::Ferromagnetic);
    // Plus is held at power-on and then released, without effect.
    bench.with(|machine| machine.chip().pins.pressed = PLUS);
    bench.run_s(0.15);
    press(&bench, [false; 4]);
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

/// The light follows the thermistor of the glass, with its hysteresis; the timer is in the status.
#[test]
fn hot_glass_is_lit_and_the_timer_is_set() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    let mut lit_at = |glass_c| {
        bench.with(move |machine| machine.chip().pins.temperatures_c[1] = glass_c);
        bench.run_s(0.01);
        (lights(&bench)[2], client.status().unwrap().glass_hot)
    };
    let seen = [25.0, 65.0, 55.0, 45.0, 55.0].map(&mut lit_at);
    assert_eq!(
        seen,
        [false, true, true, false, false].map(|lit| (lit, lit))
    );
    press(&bench, [false; 4]);
    press(&bench, ON_OFF);
    press(&bench, PLUS);
    press(&bench, TIMER);
    press(&bench, TIMER);
    assert_eq!(client.status().unwrap().timer_min, 20);
    press(&bench, ON_OFF);
    bench.run_s(1.0);
    assert_eq!(client.status().unwrap().timer_min, 0);
    assert_no_violations(&bench);
}

/// Awake, then minus. A base of 62 °C gets the full power of keeping warm, one of 94 °C none.
#[test]
fn what_stands_on_the_glass_is_kept_warm() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    bench.with(|machine| machine.chip().pins.temperatures_c[1] = 55.0);
    press(&bench, [false; 4]);
    press(&bench, ON_OFF);
    press(&bench, MINUS);
    bench.run_s(0.3);
    let status = client.status().unwrap();
    assert_eq!(
        (status.state, status.asked_w),
        (State::Heating, KEEP_WARM_W)
    );
    assert!(lights(&bench)[0]);
    bench.with(|machine| machine.chip().pins.temperatures_c[1] = 80.0);
    // A burst of 20 ms or more would come within a second; probes of 3.3 ms, .7 s apart, show the pot. Bursts end within seconds.
    let switches = |_: &u32| {
        bench.run_s(1e-3);
        let bridge = bench.with(|machine| machine.chip().pins.bridge());
        matches!(bridge, Bridge::Switching { .. })
    };
    let mut seconds = (0..6).map(|_| (0..1_100).filter(switches).count());
    let ends = seconds.any(|switching_ms| (1..=8).contains(&switching_ms));
    assert!(ends, "bursts go on");
    let status = client.status().unwrap();
    assert_eq!(
        (status.state, status.limit),
        (State::Heating, Limit::KeepWarm)
    );
    press(&bench, MINUS);
    assert_eq!(client.status().unwrap().state, State::Idle);
    assert_no_violations(&bench);
}
