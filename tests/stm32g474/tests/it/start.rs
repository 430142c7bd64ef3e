//! Start from power-on to the first response, dead time, and rate of the sampling interrupt.

use ihd_firmware::drive::pwm::DEAD_TIME_NS;
use ihd_shared::wire::messages::State;
use ihd_sim::behavioural::PotKind;

use crate::board::{assert_no_violations, connect, with_pot};

/// Regression test for the interrupt livelock of 78153fe: the sampling interrupt pended itself for ever, and the thread never ran.
#[test]
fn it_boots_and_says_what_it_is() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    let hello = client.hello();
    assert_eq!(hello.board.as_str(), "stm32g474");
    assert_eq!(hello.reset_reason, 0, "power-on");
    assert_eq!(client.status().unwrap().state, State::Idle);
    let resets = bench.with(|machine| machine.resets.clone());
    assert!(resets.is_empty(), "{resets:?}");
    assert_no_violations(&bench);
}

/// The dead time in HRTIM is the library's, in whole cycles.
#[test]
fn the_dead_time_is_that_of_the_library() {
    let bench = with_pot(PotKind::Ferromagnetic);
    drop(connect(&bench));
    for dead_time_s in bench.with(|machine| machine.chip().hrtim.dead_times_s()) {
        let more_ns = dead_time_s * 1e9 - f64::from(DEAD_TIME_NS);
        assert!((0.0..6.0).contains(&more_ns), "{dead_time_s}");
    }
}

/// One entry of the sampling interrupt per block, and no other.
#[test]
fn the_sampling_interrupt_comes_once_a_block() {
    let bench = with_pot(PotKind::Ferromagnetic);
    drop(connect(&bench));
    let entries = |bench: &crate::board::Bench| {
        bench.with(|machine| machine.chip().nvic.entries[crate::board::SAMPLING])
    };
    let before = entries(&bench);
    bench.run_s(0.1);
    let blocks = 0.1 * 79_911.0 / 3.0;
    let taken = (entries(&bench) - before) as f64;
    assert!(
        (taken / blocks - 1.0).abs() < 1e-3,
        "{taken} entries for {blocks} blocks"
    );
}
