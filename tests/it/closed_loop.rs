//! The firmware closed over the simulated plant: power, and what stands on the coil.

use ihd_firmware::pwm;
use ihd_link::{Event, LinkError};
use ihd_shared::fault::Fault;
use ihd_shared::hob::RATED_POWER_W;
use ihd_shared::wire::messages::{Outcome, Pot, State, Telemetry};
use ihd_sim::behavioural::PotKind;
use ihd_sim::hob::HobConfig;
use ihd_tests::simulated_hob::Kitchen;

/// Half-cycles after which a request must be met.
const SETTLED_AFTER: usize = 60;

fn watt(t: &Telemetry) -> f64 {
    f64::from(t.power_mw) * 1e-3
}

/// Above resonance by the firmware's own phase and by the true load, and no number is missing.
fn assert_sound(kitchen: &Kitchen, seen: &[Telemetry]) {
    for t in seen {
        assert_eq!(t.fault, Fault::NONE, "{t:?}");
        if t.f_sw_hz > 0 {
            let resonance_hz = kitchen.resonance_hz(t.half_cycle);
            assert!(f64::from(t.f_sw_hz) > resonance_hz, "{resonance_hz}: {t:?}");
            assert!(t.phase_mrad > 0, "{t:?}");
        }
    }
    for pair in seen.windows(2) {
        assert_eq!(pair[1].seq, pair[0].seq + 1);
        assert_eq!(pair[1].half_cycle, pair[0].half_cycle + 1);
    }
}

/// Asks for power, and checks that it is reached and kept.
fn assert_reaches(kitchen: &mut Kitchen, asked_w: u16) {
    kitchen.client.set_power(asked_w).unwrap();
    let seen = kitchen.watch(SETTLED_AFTER + 50);
    assert_sound(kitchen, &seen);
    for t in &seen[SETTLED_AFTER..] {
        assert_eq!((t.state, t.pot), (State::Heating, Pot::Ferromagnetic));
        let error = watt(t) / f64::from(asked_w) - 1.0;
        assert!(error.abs() <= 0.03, "{asked_w} W: {} W", watt(t));
    }
}

#[test]
fn the_asked_power_is_reached_and_kept_on_either_mains() {
    for mains_hz in [50.0, 60.0] {
        let mut kitchen = Kitchen::new(HobConfig {
            mains_hz,
            ..HobConfig::default()
        });
        assert_reaches(&mut kitchen, 1_500);
        let status = kitchen.client.status().unwrap();
        assert_eq!(status.state, State::Heating);
        assert_eq!((status.asked_w, status.telemetry_dropped), (1_500, 0));
        assert_eq!(kitchen.client.counters().telemetry.missing, 0);
    }
}

#[test]
fn power_follows_requests_up_and_down() {
    let mut kitchen = Kitchen::new(HobConfig::default());
    for asked_w in [700, 2_000, 1_000, 1_800, 500] {
        assert_reaches(&mut kitchen, asked_w);
    }
    kitchen.client.set_power(0).unwrap();
    let last = kitchen.watch(3).pop().unwrap();
    assert_eq!((last.state, last.f_sw_hz), (State::Idle, 0));
}

/// What a board's timers cannot make, the simulated one does not make either.
#[test]
fn every_frequency_is_one_that_a_board_can_make() {
    let mut kitchen = Kitchen::new(HobConfig::default());
    kitchen.client.set_power(1_500).unwrap();
    let seen = kitchen.watch(SETTLED_AFTER);
    assert_eq!(seen.last().unwrap().state, State::Heating);
    for t in seen.iter().filter(|t| t.f_sw_hz > 0) {
        assert_eq!(t.f_sw_hz, pwm::nearest_hz(t.f_sw_hz), "{t:?}");
    }
}

#[test]
fn the_rating_is_reached_above_resonance() {
    let mut kitchen = Kitchen::new(HobConfig::default());
    assert_reaches(&mut kitchen, RATED_POWER_W);
}

/// The hob is off, reports why, and stays off until the fault is cleared.
fn assert_faulted(kitchen: &mut Kitchen, fault: Fault) {
    let reported = kitchen
        .events
        .iter()
        .any(|e| matches!(e, Event::Fault(f) if f.fault == fault));
    assert!(reported, "{fault:?} was not reported");
    let status = kitchen.client.status().unwrap();
    assert_eq!(
        (status.state, status.fault, status.f_sw_hz),
        (State::LockedOut, fault, 0)
    );
    let Err(LinkError::Refused {
        outcome, detail, ..
    }) = kitchen.client.set_power(1_000)
    else {
        panic!("power must be refused while a fault is active");
    };
    assert_eq!(
        (outcome, detail),
        (Outcome::FaultActive, u32::from(fault.number()))
    );
    for t in &kitchen.watch(5)[1..] {
        assert_eq!((t.f_sw_hz, t.state, t.fault), (0, State::LockedOut, fault));
    }
    kitchen.client.clear_fault().unwrap();
    assert_eq!(kitchen.client.status().unwrap().state, State::Idle);
    kitchen.client.set_power(1_000).unwrap();
}

#[test]
fn what_cannot_be_heated_is_refused_at_switch_on() {
    for (pot, fault) in [
        (PotKind::None, Fault::NO_POT),
        (PotKind::Aluminium, Fault::UNSUITABLE_POT),
        (PotKind::Stainless, Fault::UNSUITABLE_POT),
    ] {
        let mut kitchen = Kitchen::with_pot(pot);
        kitchen.client.set_power(1_500).unwrap();
        let seen = kitchen.watch(10);
        assert!(
            seen.iter().all(|t| t.state != State::Heating),
            "{pot}: {seen:?}"
        );
        assert_faulted(&mut kitchen, fault);
        // With a pot the same hob heats.
        kitchen.hob.lock().set_pot(PotKind::Ferromagnetic).unwrap();
        kitchen.client.set_power(0).unwrap();
        kitchen.watch(3);
        assert_reaches(&mut kitchen, 1_000);
    }
}

/// A small pot takes some 200 W at the lowest frequency: less than the half of the rating that it
/// may get.
#[test]
fn more_than_a_small_pot_takes_ends_at_the_lowest_frequency() {
    let mut kitchen = Kitchen::with_pot(PotKind::Small);
    kitchen.client.set_power(RATED_POWER_W).unwrap();
    let seen = kitchen.watch(150);
    assert_sound(&kitchen, &seen);
    for t in &seen[20..] {
        assert_eq!((t.state, t.pot), (State::Heating, Pot::Small), "{t:?}");
        assert!(watt(t) <= f64::from(RATED_POWER_W / 2), "{t:?}");
    }
    for t in &seen[120..] {
        assert_eq!(t.f_sw_hz, pwm::LOWEST_HZ);
        assert!(watt(t) > 150.0, "{t:?}");
    }
}

/// Exchanges the pot while heating; returns the fault and after how many half-cycles it came.
fn exchange(power_w: u16, pot: PotKind) -> (Kitchen, Fault, usize) {
    let mut kitchen = Kitchen::heating(power_w);
    kitchen.hob.lock().set_pot(pot).unwrap();
    let seen = kitchen.watch(20);
    let after = seen.iter().position(|t| t.fault != Fault::NONE);
    let after = after.expect("a fault");
    println!("{power_w} W {pot}: {:?} after {after}", seen[after].fault);
    let fault = seen[after].fault;
    (kitchen, fault, after)
}

#[test]
fn a_pot_taken_away_is_noticed_within_a_few_half_cycles() {
    for power_w in [500, 1_500, 2_200] {
        let (mut kitchen, fault, after) = exchange(power_w, PotKind::None);
        assert_eq!(fault, Fault::POT_REMOVED, "{power_w} W");
        assert!(after <= 3, "{power_w} W: after {after} half-cycles");
        assert_faulted(&mut kitchen, fault);
    }
}

/// At high power aluminium draws more than the trip level before anybody can look at it.
#[test]
fn a_pot_exchanged_for_aluminium_stops_the_heating() {
    for (power_w, expected) in [
        (500, Fault::UNSUITABLE_POT),
        (1_000, Fault::UNSUITABLE_POT),
        (2_000, Fault::OVER_CURRENT),
    ] {
        let (mut kitchen, fault, after) = exchange(power_w, PotKind::Aluminium);
        assert_eq!(fault, expected, "{power_w} W");
        assert!(after <= 3, "{power_w} W: after {after} half-cycles");
        assert_faulted(&mut kitchen, fault);
    }
}
