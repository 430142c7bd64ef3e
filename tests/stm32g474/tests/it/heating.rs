//! From power-on to a pot that is heated with the power asked for, over the serial port.

use ihd_shared::wire::messages::{Pot, State};
use ihd_sim::behavioural::PotKind;

use crate::board::{assert_no_violations, connect, with_pot};

#[test]
fn it_boots_and_says_what_it_is() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let client = connect(&bench);
    let hello = client.hello();
    assert_eq!(hello.board.as_str(), "stm32g474");
    assert_eq!(hello.reset_reason, 0, "power-on");
    let status = connect(&bench).status().unwrap();
    assert_eq!(status.state, State::Idle);
    bench.with(|machine| assert!(machine.resets.is_empty(), "{:?}", machine.resets));
    assert_no_violations(&bench);
}

#[test]
fn it_heats_a_pot_with_the_power_asked_for() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    client.set_power(1_200).unwrap();
    for _ in 0..16 { bench.run_s(0.025);
    let status = client.status().unwrap();
    let f = bench.with(|m| { let f = m.chip().hrtim.f_sw_hz(); (f, m.chip().pins.bridge()) });
    println!("{f:?} {status:?}"); }
    let status = client.status().unwrap();
    println!("{status:?}");
    println!("{:?}", bench.with(|m| m.resets.clone()));
    assert_eq!((status.state, status.pot), (State::Heating, Pot::Ferromagnetic));
}
