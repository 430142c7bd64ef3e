//! First switching from a bench supply, against the numbers of docs/bring-up.md, E.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use ihd_doctor::{CheckResult, Measurement, first_switching as switching};
use ihd_link::Client;
use ihd_shared::wire::messages::State;
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::inverter::supply::SupplyParts;
use ihd_sim::transport::SharedHob;
use ihd_survey::calibration::ReferenceLoad;

use crate::desk::{Watched, complete, connected, failed, find_check, on_bench};

static GO: AtomicBool = AtomicBool::new(false);

fn number(evidence: &[Measurement], name: &str) -> f64 {
    let found = evidence.iter().find(|e| e.name == name);
    found
        .unwrap_or_else(|| panic!("no {name} in {evidence:?}"))
        .value
}

/// Volt on the bus; amplitude in ampere, R in ohm and L in microhenry of the table, its simulator's column.
const TABLE: [(f64, f64, f64, f64); 2] = [(40.0, 1.75, 7.1, 28.9), (60.0, 2.68, 6.9, 28.5)];

#[test]
fn the_load_and_the_edges_are_those_of_the_table() {
    for (bus_v, i_a, r_ohm, l_uh) in TABLE {
        let (mut client, _hob) = connected(&on_bench(bus_v));
        let (checks, lost) = switching::run(&mut client, None, &GO);
        complete(&checks, &switching::NAMES);
        assert_eq!((failed(&checks), lost), (vec![], None));
        let load = &find_check(&checks, "load").evidence;
        for (name, expected, share) in [
            ("current", i_a, 0.02),
            ("R", r_ohm, 0.01),
            ("L", l_uh, 0.01),
        ] {
            let found = number(load, name);
            assert!(
                (found / expected - 1.0).abs() < share,
                "{bus_v} V: {name} {found}"
            );
        }
        // 15 nF · V / I at turn-off, 1.9 A at 40 V and 2.9 at 60: 0.32 and 0.31 µs, seen to 0.2 µs.
        let edges = &find_check(&checks, "edges").evidence;
        for name in ["rise", "fall"] {
            let found_ns = number(edges, name);
            assert!(
                (110.0..520.0).contains(&found_ns),
                "{bus_v} V: {name} {found_ns} ns"
            );
        }
        let status = client.status().unwrap();
        assert_eq!(
            (status.asked_w, status.f_sw_hz),
            (0, 0),
            "{:?}",
            status.state
        );
    }
}

#[test]
fn a_known_load_gives_the_skew() {
    let (_, _, r_ohm, l_uh) = TABLE[0];
    let reference = ReferenceLoad::Load {
        r_ohm: Some(r_ohm),
        l_h: Some(l_uh * 1e-6),
    };
    let (mut client, _hob) = connected(&on_bench(40.0));
    let (checks, _) = switching::run(&mut client, Some(reference), &GO);
    let skew = find_check(&checks, "skew");
    // The simulated channels have none; R of the table is rounded to 1.4 %, which looks like 10 ns at most.
    assert!(number(&skew.evidence, "skew").abs() < 10.0, "{skew:?}");
    assert_eq!(skew.verdict, CheckResult::Pass, "{skew:?}");
}

/// A hob that tells which powers were asked for.
fn watched(config: &HobConfig) -> (Client, Watched) {
    let hob = SharedHob::new(SimHob::new(config));
    let watched = Watched::new(hob.clone());
    let mut other = Watched::new(hob);
    other.asked_w = watched.asked_w.clone();
    other.frames_left = watched.frames_left.clone();
    (Client::connect(Box::new(watched)).unwrap(), other)
}

#[test]
fn nothing_is_switched_from_the_mains_or_a_wrong_supply() {
    let mains = HobConfig {
        supply: SupplyParts::SCHEMATIC,
        ..HobConfig::default()
    };
    for config in [
        on_bench(20.0),
        on_bench(61.0),
        on_bench(120.0),
        on_bench(325.0),
        mains,
    ] {
        let (mut client, watched) = watched(&config);
        // A capacitor on the bus is charged by the first crest.
        let until = client.clock() + std::time::Duration::from_millis(50);
        while client.clock() < until {
            client
                .next_event(std::time::Duration::from_millis(5))
                .unwrap();
        }
        let (checks, _) = switching::run(&mut client, None, &GO);
        complete(&checks, &switching::NAMES);
        let bus_v = config.bench_supply_v;
        assert_ne!(
            find_check(&checks, "bench_supply").verdict,
            CheckResult::Pass,
            "{bus_v:?}"
        );
        assert_eq!(
            *watched.asked_w.lock().unwrap(),
            [] as [u16; 0],
            "{bus_v:?}"
        );
    }
}

#[test]
fn without_a_pot_it_says_so_and_switches_off() {
    let config = HobConfig {
        pot: "none".parse().unwrap(),
        ..on_bench(50.0)
    };
    let (mut client, _hob) = connected(&config);
    let (checks, _) = switching::run(&mut client, None, &GO);
    complete(&checks, &switching::NAMES);
    assert_eq!(failed(&checks), [] as [&str; 0]);
    assert_eq!(
        find_check(&checks, "switching").verdict,
        CheckResult::NotTested
    );
    assert_eq!(find_check(&checks, "power_off").verdict, CheckResult::Pass);
    assert_eq!(client.status().unwrap().asked_w, 0);
}

#[test]
fn an_interrupt_before_it_begins_switches_nothing_and_is_told() {
    let (mut client, watched) = watched(&on_bench(40.0));
    let (checks, _) = switching::run(&mut client, None, &AtomicBool::new(true));
    complete(&checks, &switching::NAMES);
    assert!(find_check(&checks, "switching").finding.contains("^C"));
    assert_eq!(find_check(&checks, "power_off").verdict, CheckResult::Pass);
    assert_eq!(*watched.asked_w.lock().unwrap(), [0]);
    assert_ne!(client.status().unwrap().state, State::Heating);
}

/// While it switches: by the wall's clock, as ^C comes.
#[test]
fn an_interrupt_while_it_switches_switches_off_and_is_told() {
    let (mut client, watched) = watched(&on_bench(40.0));
    let stop = Arc::new(AtomicBool::new(false));
    let (raise, asked_w) = (stop.clone(), watched.asked_w.clone());
    let person = std::thread::spawn(move || {
        while !asked_w.lock().unwrap().contains(&1) {
            std::thread::yield_now();
        }
        raise.store(true, Ordering::Relaxed);
    });
    let (checks, _) = switching::run(&mut client, None, &stop);
    person.join().unwrap();
    complete(&checks, &switching::NAMES);
    assert!(
        find_check(&checks, "switching").finding.contains("^C"),
        "{checks:#?}"
    );
    assert_eq!(find_check(&checks, "power_off").verdict, CheckResult::Pass);
    assert_eq!(*watched.asked_w.lock().unwrap(), [1, 0]);
}
