//! Requests of power in the half-cycle in which a soft limit has acted.

use super::*;
use crate::limits::SOFT_STEP_PERMILLE;

/// A pot that is heated at a settled frequency.
fn settled() -> Bench {
    let mut bench = heating();
    bench.run(40);
    bench
}

/// Steps of a search between two half-cycles.
fn search(bench: &mut Bench) {
    for _ in 0..crate::control::power::STEPS_PER_SEARCH {
        let action = bench.control.advance(&prior(), &bench.status());
        bench.act(action);
    }
}

/// The limit raises drive and request at once ([`crate::drive::sequencer::DriveSequencer::raise_frequency`]); the last half-cycle's load
/// was measured before it.
#[test]
fn a_request_does_not_undo_a_soft_limit_that_has_just_acted() {
    for power_w in [1_000, 1_500, 2_000, 2_500] {
        let mut bench = settled();
        let limited_hz = bench.drive.f_sw_hz;
        let raised_hz = pwm::nearest_hz(limited_hz + limited_hz * SOFT_STEP_PERMILLE / 1_000);
        bench.drive.f_sw_hz = raised_hz;
        bench.wanted.f_sw_hz = raised_hz;
        bench.ask(power_w);
        search(&mut bench);
        assert_eq!(bench.wanted.f_sw_hz, raised_hz, "{power_w} W");
    }
}

/// The limit acts while the search is under way.
#[test]
fn a_search_that_a_soft_limit_overtakes_is_dropped() {
    let mut bench = settled();
    bench.ask(2_500);
    let action = bench.control.advance(&prior(), &bench.status());
    assert_eq!(action, Action::Keep, "one step of several");
    let raised_hz = pwm::nearest_hz(bench.drive.f_sw_hz * (1_000 + SOFT_STEP_PERMILLE) / 1_000);
    (bench.drive.f_sw_hz, bench.wanted.f_sw_hz) = (raised_hz, raised_hz);
    search(&mut bench);
    assert_eq!(bench.wanted.f_sw_hz, raised_hz);
    bench.run(1);
    assert!(
        bench.wanted.f_sw_hz < raised_hz,
        "the next half-cycle's load counts"
    );
}

#[test]
fn without_one_a_request_is_followed_within_the_half_cycle() {
    let mut bench = settled();
    let before_hz = bench.wanted.f_sw_hz;
    bench.ask(300);
    search(&mut bench);
    assert!(bench.wanted.f_sw_hz > before_hz);
}
