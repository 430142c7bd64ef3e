//! A sheet that takes the pot's place while it is heated.

use super::*;

/// Foil of 16 cm: R and L of a pot at heating frequencies.
const FOIL: Load = (2.7, 18.6, 50.0);

/// Exponent of R with the frequency in a sheet.
const SHEET: f64 = 0.2;

/// Half-cycles with power of so many with [`FOIL`].
fn heated(bench: &mut Bench, half_cycles: u32) -> u32 {
    let mut on = 0;
    let of_highest = |f_sw_hz: u32| f64::from(f_sw_hz) / f64::from(pwm::MAX_HZ);
    for _ in 0..half_cycles {
        bench.load = FOIL;
        if let Some(probe) = bench.probe_requested {
            // The bench has the R of a skin already.
            bench.load.0 *= of_highest(probe.f_sw_hz()).powf(SHEET - 0.5);
        } else {
            bench.load.0 *= of_highest(bench.drive.f_sw_hz).powf(SHEET);
            bench.load.1 *= of_highest(bench.drive.f_sw_hz).powf(-0.3);
        }
        bench.half_cycle();
        on += u32::from(bench.drive.is_switching());
    }
    on
}

/// Half-cycles with power of a hundred after the exchange, and the state after them.
fn after_exchange(power_w: u16, gap: u32) -> (u32, State) {
    let mut bench = heating();
    bench.ask(power_w);
    bench.run(40);
    bench.load = AIR;
    bench.run(gap);
    let on = heated(&mut bench, 100);
    (on, bench.control.state())
}

#[test]
fn a_sheet_in_the_pots_place_is_heated_for_a_moment_only() {
    for power_w in [1_000, 1_500, 2_500] {
        for gap in [0, 1] {
            let (on, state) = after_exchange(power_w, gap);
            assert_eq!(state, State::WaitingForPot, "{power_w} W, {gap}");
            assert!(on <= 5, "{power_w} W, {gap}: {on} half-cycles");
        }
    }
}

/// It ends with a whole cycle of the mains.
#[test]
fn a_sheet_that_comes_within_a_burst_ends_it() {
    let mut bench = Bench::new(POT);
    bench.ask(300);
    bench.run(105);
    while !bench.drive.is_switching() {
        bench.half_cycle();
    }
    bench.half_cycle();
    let on = heated(&mut bench, 20);
    assert_eq!(bench.control.state(), State::WaitingForPot);
    assert!(on <= 5, "{on}");
}
