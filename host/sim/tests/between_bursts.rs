//! Little power comes in bursts: what is done between two of them is seen before the next, or within a second where none is due.

use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::{Pot, State};
use ihd_sim::hob::{HobConfig, PanelEvent, SimHob};
use ihd_sim::pot::SimulatedPot;
use ihd_sim::recording::settings::LoadKind;

/// Longest half-cycle, in seconds.
const HALF_CYCLE_S: f64 = 0.01;

/// Energy of the probes of three seconds, in joule, and of one mains cycle with power.
const PROBES_J: f64 = 20.0;

fn hob() -> SimHob {
    SimHob::new(&HobConfig {
        pot: "ferritic-21".parse().unwrap(),
        load: LoadKind::Surrogate,
        ..HobConfig::default()
    })
}

/// Lets time pass; returns the energy that the load took, in joule.
fn run(hob: &mut SimHob, duration_s: f64) -> f64 {
    let (end_s, mut energy_j) = (hob.t_s() + duration_s, 0.0);
    while hob.t_s() < end_s {
        hob.step();
        energy_j += hob.take_reading().map_or(0.0, |reading| reading.energy_j);
    }
    energy_j
}

/// Lets time pass until a burst has been over for so many half-cycles.
fn run_into_gap(hob: &mut SimHob, half_cycles: u32) {
    let mut off = u32::MAX;
    while off != half_cycles {
        if run(hob, HALF_CYCLE_S) > 0.2 * 700.0 * HALF_CYCLE_S {
            off = 0;
        } else {
            off = off.saturating_add(1);
        }
    }
}

fn state(hob: &SimHob) -> (State, Pot) {
    let control = hob.housekeeping().control();
    (control.state(), control.pot())
}

/// A lid or foil is refused at the first probe, and a pot that is heated is not probed.
#[test]
fn what_takes_a_pots_place_between_two_bursts_is_not_heated() {
    assert_is_not_heated(3, "foil-8");
}

#[test]
fn what_takes_a_pots_place_between_two_bursts_is_not_heated_all_variants() {
    for (level, sheet) in [(1, "lid-12"), (1, "foil-14"), (4, "lid-14")] {
        assert_is_not_heated(level, sheet);
    }
}

fn assert_is_not_heated(level: u8, sheet: &str) {
    let sheet: SimulatedPot = sheet.parse().unwrap();
    let mut hob = hob();
    hob.prepare(&sheet).unwrap();
    hob.panel(PanelEvent::Level(level));
    run(&mut hob, 2.0);
    run_into_gap(&mut hob, 12);
    hob.set_pot(sheet).unwrap();
    let energy_j = run(&mut hob, 3.0);
    let seen = (State::WaitingForPot, Pot::Unsuitable);
    let what = format!("{sheet} at level {level}: {energy_j} J");
    assert_eq!(state(&hob), seen, "{what}");
    assert!(energy_j < PROBES_J, "{what}");
}

/// Another pot goes on without a break.
#[test]
fn a_pot_that_takes_a_pots_place_is_heated() {
    let mut hob = hob();
    hob.panel(PanelEvent::Level(2));
    run(&mut hob, 2.0);
    run_into_gap(&mut hob, 12);
    hob.set_pot("ferritic-12".parse::<SimulatedPot>().unwrap())
        .unwrap();
    let energy_j = run(&mut hob, 6.0);
    assert_eq!(state(&hob), (State::Heating, Pot::Small));
    assert!((energy_j / 1_200.0 - 1.0).abs() < 0.05, "{energy_j} J");
}

/// A small pot is heated at a frequency at which a larger one takes more than the trip level.
#[test]
fn a_larger_pot_in_a_small_ones_place_trips_nothing() {
    assert_trips_nothing(265.0, "ferritic-10", "ferritic-21");
}

#[test]
fn a_larger_pot_in_a_small_ones_place_trips_nothing_all_variants() {
    assert_trips_nothing(230.0, "ferritic-12", "clad-18");
}

fn assert_trips_nothing(mains_v: f64, small: &str, large: &str) {
    let mut hob = SimHob::new(&HobConfig {
        pot: small.parse().unwrap(),
        load: LoadKind::Surrogate,
        mains_v,
        ..HobConfig::default()
    });
    let large: SimulatedPot = large.parse().unwrap();
    hob.prepare(&large).unwrap();
    hob.panel(PanelEvent::Level(1));
    run(&mut hob, 2.0);
    run_into_gap(&mut hob, 12);
    hob.set_pot(large).unwrap();
    let mut i_peak_a: f64 = 0.0;
    let end_s = hob.t_s() + 3.0;
    while hob.t_s() < end_s {
        hob.step();
        i_peak_a = hob
            .take_reading()
            .map_or(i_peak_a, |reading| i_peak_a.max(reading.i_peak_a));
        assert_eq!(hob.sampling_path().fault(), Fault::NONE, "{large}");
    }
    assert!(i_peak_a < 60.0, "{large}: {i_peak_a} A");
}

/// A dip of the mains opens the bridge at once, and a pot that is lifted there shows no more half-cycles with power.
#[test]
fn a_burst_whose_last_half_cycle_is_cut_short_is_followed_by_others() {
    for lifted in [false, true] {
        let mut hob = SimHob::new(&HobConfig::default());
        let (pot, mains) = (hob.pot(), hob.mains());
        hob.panel(PanelEvent::Level(2));
        run(&mut hob, 1.5);
        let ends = |hob: &SimHob| {
            let path = hob.sampling_path();
            path.drive().is_switching() && !path.requested_drive().is_switching()
        };
        while !ends(&hob) {
            hob.step();
        }
        if lifted {
            hob.set_pot(SimulatedPot::NONE).unwrap();
            run(&mut hob, 1.0);
            assert_eq!(state(&hob), (State::WaitingForPot, Pot::Absent));
            hob.set_pot(pot).unwrap();
        } else {
            run(&mut hob, 0.2 * HALF_CYCLE_S);
            hob.set_mains(0.0, mains.frequency_hz);
            run(&mut hob, 0.3 * HALF_CYCLE_S);
            hob.set_mains(mains.v_rms_v(), mains.frequency_hz);
        }
        run(&mut hob, 1.0);
        let energy_j = run(&mut hob, 3.0);
        assert_eq!(state(&hob), (State::Heating, Pot::Ferromagnetic));
        assert!((energy_j / 600.0 - 1.0).abs() < 0.1, "{energy_j} J");
    }
}

/// Kept warm and too hot for any power, a pot is missed all the same.
#[test]
fn a_pot_that_is_taken_away_while_no_burst_is_due_is_missed_within_a_second() {
    let mut hob = hob();
    hob.temperatures().set_glass(85.0);
    run(&mut hob, 1.5);
    hob.panel(PanelEvent::KeepWarm);
    let energy_j = run(&mut hob, 3.0);
    assert_eq!(state(&hob), (State::Heating, Pot::Ferromagnetic));
    assert!(energy_j < PROBES_J, "{energy_j} J");
    hob.set_pot(SimulatedPot::NONE).unwrap();
    run(&mut hob, 1.0);
    assert_eq!(state(&hob), (State::WaitingForPot, Pot::Absent));
}

/// Bursts on either side of it are half-cycles of one operating point, in which the sag is none.
#[test]
fn a_sag_within_a_burst_is_no_drift_of_a_gain() {
    let mut hob = SimHob::new(&HobConfig::default());
    let mains = hob.mains();
    hob.panel(PanelEvent::Level(1));
    run(&mut hob, 1.2);
    run_into_gap(&mut hob, 12);
    while run(&mut hob, HALF_CYCLE_S) < 0.5 * 700.0 * HALF_CYCLE_S {}
    hob.set_mains(120.0, mains.frequency_hz);
    run(&mut hob, 6.0 * HALF_CYCLE_S);
    hob.set_mains(mains.v_rms_v(), mains.frequency_hz);
    let end_s = hob.t_s() + 4.0;
    while hob.t_s() < end_s {
        hob.step();
        assert_eq!(hob.sampling_path().fault(), Fault::NONE);
    }
    assert_eq!(state(&hob), (State::Heating, Pot::Ferromagnetic));
}
