//! The firmware closed over the simulated plant: power, and what stands on the coil.

use ihd_firmware::drive::pwm;
use ihd_link::DeviceEvent;
use ihd_shared::fault::Fault;
use ihd_shared::hob::RATED_POWER_W;
use ihd_shared::sampling::ADC_LOCK_Q;
use ihd_shared::wire::messages::{Pot, State, Telemetry};
use ihd_sim::behavioural::PotKind;
use ihd_sim::hob::{HobConfig, PanelEvent, SimHob};
use ihd_sim::pot::SimulatedPot as PotOnCoil;
use ihd_sim::recording::settings::LoadKind;
use ihd_tests::simulated_hob::Kitchen;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

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

/// The simulated board makes only frequencies that a board's timers can make.
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

/// Timers, like the board's, take new periods when the block that runs has ended, so the block after a decision is of the
/// frequency before it. The length of a block tells its frequency.
#[test]
fn new_periods_begin_a_block_after_the_one_that_runs() {
    let mut hob = SimHob::new(&HobConfig::default());
    hob.panel(PanelEvent::Level(7));
    let off = hob.sampling_path().drive();
    let (mut before, mut last, mut changes) = (off, off, 0);
    while hob.t_s() < 0.5 {
        let start_s = hob.t_s();
        hob.step();
        let block_s = hob.t_s() - start_s;
        if before.is_switching() && last.is_switching() {
            let is_hz = f64::from(ADC_LOCK_Q) / block_s;
            let off_by = is_hz / f64::from(before.f_sw_hz) - 1.0;
            assert!(
                off_by.abs() < 1e-4,
                "{is_hz} Hz at {start_s} s, not {before:?}"
            );
            changes += u32::from(before.f_sw_hz != last.f_sw_hz);
        }
        (before, last) = (last, hob.sampling_path().drive());
    }
    assert!(changes > 10, "{changes}");
}

/// The hob waits: the bridge is off but for a look now and then, nothing heats and nothing is a fault.
fn assert_waits(kitchen: &mut Kitchen, pot: Pot) {
    let seen = kitchen.watch(100);
    // A look begins with a half-cycle and is over before its crest: no telemetry shows one.
    assert!(seen.iter().all(|t| t.f_sw_hz == 0 && t.power_mw < 200_000));
    for t in &seen {
        let state = (t.state, t.fault, t.pot);
        assert_eq!(state, (State::WaitingForPot, Fault::NONE, pot), "{t:?}");
    }
}

/// A pot is put on: it is heated within 1.5 s, and nobody has to ask for it. The power follows
/// within another.
fn assert_resumes(kitchen: &mut Kitchen) {
    kitchen.hob.lock().set_pot(PotKind::Ferromagnetic).unwrap();
    let heats = |t: &Telemetry| t.state == State::Heating;
    let in_time = (0..15).any(|_| kitchen.watch(10).iter().any(heats));
    assert!(in_time, "it does not heat 1.5 s after the pot came");
    let meets = |t: &Telemetry| (watt(t) / f64::from(t.asked_w) - 1.0).abs() < 0.03;
    let met = (0..10).any(|_| kitchen.watch(10).iter().all(meets));
    assert!(met, "the power does not come back");
}

#[test]
fn what_cannot_be_heated_is_waited_over_from_switch_on() {
    for (kind, pot) in [
        (PotKind::None, Pot::Absent),
        (PotKind::Aluminium, Pot::Unsuitable),
        (PotKind::Stainless, Pot::Unsuitable),
    ] {
        let mut kitchen = Kitchen::with_pot(kind);
        kitchen.client.set_power(1_500).unwrap();
        let seen = kitchen.watch(10);
        assert!(
            seen.iter().all(|t| t.state != State::Heating),
            "{kind}: {seen:?}"
        );
        assert_waits(&mut kitchen, pot);
        assert_resumes(&mut kitchen);
    }
}

/// A pot of 12 cm takes more than the half of the rating that it may get.
#[test]
fn a_small_pot_gets_half_of_the_rating() {
    let mut kitchen = Kitchen::with_pot(PotKind::Small);
    kitchen.client.set_power(RATED_POWER_W).unwrap();
    let seen = kitchen.watch(150);
    assert_sound(&kitchen, &seen);
    let most = f64::from(RATED_POWER_W / 2);
    for t in &seen[120..] {
        assert_eq!((t.state, t.pot), (State::Heating, Pot::Small), "{t:?}");
        assert!((watt(t) / most - 1.0).abs() < 0.03, "{t:?}");
    }
}

/// Exchanges the pot while heating; returns what the hob does then, and after how many half-cycles.
fn exchange(power_w: u16, pot: PotKind) -> (Kitchen, Telemetry, usize) {
    let mut kitchen = Kitchen::heating(power_w);
    kitchen.hob.lock().set_pot(pot).unwrap();
    let mut seen = kitchen.watch(20);
    let after = seen.iter().position(|t| t.state != State::Heating);
    let after = after.expect("it must stop");
    let first = seen.swap_remove(after);
    (kitchen, first, after)
}

#[test]
fn a_pot_taken_away_is_noticed_within_a_few_half_cycles() {
    for power_w in [700, 2_200] {
        let (mut kitchen, stopped, after) = exchange(power_w, PotKind::None);
        assert_eq!(stopped.state, State::WaitingForPot, "{power_w} W");
        assert!(after <= 3, "{power_w} W: after {after} half-cycles");
        assert_waits(&mut kitchen, Pot::Absent);
        assert_resumes(&mut kitchen);
    }
}

/// At high power aluminium may draw more than the trip level before anybody can look at it: then a pause
/// comes first.
#[test]
fn a_pot_exchanged_for_aluminium_stops_the_heating() {
    for power_w in [700, 2_000] {
        let (mut kitchen, stopped, after) = exchange(power_w, PotKind::Aluminium);
        assert!(after <= 3, "{power_w} W: after {after} half-cycles");
        if stopped.state == State::Pausing {
            let faults = [Fault::OVER_CURRENT, Fault::HARDWARE_OVER_CURRENT];
            assert!(faults.contains(&stopped.fault), "{power_w} W");
            kitchen.watch(120);
        }
        assert_waits(&mut kitchen, Pot::Unsuitable);
        assert_resumes(&mut kitchen);
    }
}

/// A cook turns the knob and moves the pot at any moment of a half-cycle: none of it is a fault, and the last power is reached.
#[test]
fn whatever_a_cook_does_at_any_moment_is_no_fault() {
    (0..SEEDS_OF_COOKS).for_each(cook);
    // A pot lifted at the crest, whose coil charges the link to 407 V.
    cook(71);
}

#[test]
fn whatever_a_cook_does_at_any_moment_is_no_fault_at_length() {
    (SEEDS_OF_COOKS..100).for_each(cook);
}

/// Seeds of a test run: a pot of each kind of load.
const SEEDS_OF_COOKS: u64 = 2;

fn cook(seed: u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (name, load) = [
        ("ferritic-21", LoadKind::Behavioural),
        ("ferritic-21", LoadKind::Surrogate),
        ("ferritic-18", LoadKind::Surrogate),
        ("cast-iron-21", LoadKind::Surrogate),
    ][seed as usize % 4];
    let pot: PotOnCoil = name.parse().unwrap();
    let mut kitchen = Kitchen::new(HobConfig {
        pot,
        load,
        seed,
        ..HobConfig::default()
    });
    for act in 0..12 {
        match rng.random_range(0..6) {
            0 => kitchen.hob.lock().set_pot(PotOnCoil::NONE).unwrap(),
            1 | 2 => kitchen.hob.lock().set_pot(pot).unwrap(),
            3 => drop(kitchen.client.set_power(0).unwrap()),
            _ => {
                let asked_w = rng.random_range(200..=1_800);
                kitchen.client.set_power(asked_w).unwrap();
            }
        }
        // Blocks of a half-cycle: the next act comes anywhere in it.
        for _ in 0..rng.random_range(0..410) {
            kitchen.hob.lock().step();
        }
        let half_cycles = rng.random_range(1..60);
        for t in kitchen.watch(half_cycles) {
            assert_eq!(t.fault, Fault::NONE, "seed {seed}, act {act}: {t:?}");
        }
    }
    kitchen.hob.lock().set_pot(pot).unwrap();
    kitchen.client.set_power(1_200).unwrap();
    kitchen.watch(200);
    for t in kitchen.watch(20) {
        assert_eq!(t.fault, Fault::NONE, "seed {seed}: {t:?}");
        let error = watt(&t) / 1_200.0 - 1.0;
        assert!(error.abs() <= 0.03, "seed {seed}: {t:?}");
    }
    let faults = kitchen
        .events
        .iter()
        .filter(|e| matches!(e, DeviceEvent::Fault(_)));
    assert_eq!(faults.count(), 0, "seed {seed}");
}
