//! Checks of `ihd doctor` on the image: the simulated hob has no clocks, comparators, supply or flash.

use ihd_doctor::{Check, CheckResult, board};
use ihd_shared::sampling::AMPERE_PER_CODE;
use ihd_sim::behavioural::PotKind;
use ihd_sim::injection::InjectionKind;
use ihd_stm32g474::machine::Machine;

use crate::board::{Bench, assert_no_violations, connect, inject, with_pot};

fn examine(bench: &Bench) -> Vec<Check> {
    // Long enough for the detection of the mains.
    bench.run_s(0.1);
    let examined = board::examine(&mut connect(bench));
    assert_eq!(examined.lost, None);
    for check in &examined.checks {
        println!(
            "{:<17} {:<10} {}",
            check.name,
            check.verdict.as_str(),
            check.finding
        );
    }
    examined.checks
}

fn names(checks: &[Check], verdict: CheckResult) -> Vec<&str> {
    let those = checks.iter().filter(|check| check.verdict == verdict);
    those.map(|check| check.name).collect()
}

#[test]
fn a_healthy_board_passes_every_check() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let checks = examine(&bench);
    let all: Vec<_> = checks.iter().map(|check| check.name).collect();
    assert_eq!(all, board::NAMES);
    assert_eq!(names(&checks, CheckResult::Fail), [""; 0]);
    assert_eq!(names(&checks, CheckResult::NotTested), [""; 0]);
    assert_no_violations(&bench);
}

type Defect = fn(&mut Machine);

// The self-test at start detects the last two as well.
const DEFECTS: [(&[&str], Defect); 3] = [
    (&["channels"], |machine| {
        inject(
            machine,
            InjectionKind::CurrentOffset,
            30.0 * AMPERE_PER_CODE,
        );
    }),
    (&["fault", "comparators"], |machine| {
        machine.chip().pins.dead_comparators = [false, true];
    }),
    (&["fault", "clocks"], |machine| {
        let now = machine.now();
        machine.chip().lsi.set_hz(36_000, now);
    }),
];

fn fails_its_own_check(&(expected, defect): &(&[&str], Defect)) {
    let bench = with_pot(PotKind::Ferromagnetic);
    bench.with(move |machine| {
        defect(machine);
        machine.power_cycle().unwrap();
    });
    assert_eq!(names(&examine(&bench), CheckResult::Fail), expected);
}

#[test]
fn what_is_broken_fails_its_own_check_all_variants() {
    DEFECTS.iter().for_each(fails_its_own_check);
}
