//! Limits of a short record, each met and missed.

use super::*;
use crate::scenario::record::{FaultRecord, PowerStep, Summary, TrueHalfCycle};

/// Two bursts, of two half-cycles and of one. The first starts soft and has an edge later, the second starts hard.
fn record() -> Record {
    let half_cycle = |(n, power_w): (usize, f64)| TrueHalfCycle {
        t_s: n as f64 * 0.01,
        asked_w: 1000.0,
        power_w,
        state: "Heating".to_owned(),
        hard_edges: u32::from(n == 4) * 2 + u32::from(n == 2),
        bridge_on: power_w > 0.0,
        ..TrueHalfCycle::default()
    };
    let powers = [0.0, 950.0, 1050.0, 0.0, 900.0, 0.0];
    let step = PowerStep {
        at_s: 0.0,
        power_w: 1000.0,
        settled_after_s: None,
        overshoot_pct: None,
        error_pct: None,
    };
    Record {
        half_cycles: powers.into_iter().enumerate().map(half_cycle).collect(),
        faults: Vec::new(),
        summary: Summary {
            energy_j: 29.0,
            steps: vec![step],
            ..Summary::default()
        },
    }
}

fn check(limits: &str, record: &Record) -> Vec<LimitCheck> {
    toml::from_str::<Limits>(limits).unwrap().check(record)
}

#[test]
fn each_limit_is_two_sided() {
    for (inside, outside) in [
        ("latched = false", "latched = true"),
        ("fault = \"None\"", "fault = \"OverCurrent\""),
        ("state = \"Idle|Heating\"", "state = \"Idle\""),
        ("whole_cycles = false", "whole_cycles = true"),
        ("starts = [2, 2]", "starts = [0, 1]"),
        ("hard_edges_steady = [1, 1]", "hard_edges_steady = [0, 0]"),
        ("hard_edges_start = [0, 2]", "hard_edges_start = [0, 1]"),
        (
            "energy_per_start_j = [14, 15]",
            "energy_per_start_j = [0, 14]",
        ),
        ("burst_w = [960, 970]", "burst_w = [0, 960]"),
        ("longest_on_s = [0.019, 0.021]", "longest_on_s = [0, 0.019]"),
        (
            "power_w_at = [[0.01, 0.03, 999, 1001]]",
            "power_w_at = [[0.01, 0.03, 999, 1001], [0.0, 0.03, 999, 1001]]",
        ),
        (
            "power_share_at = [[0.01, 0.03, 0.99, 1.01]]",
            "power_share_at = [[0.01, 0.03, 1.1, 2]]",
        ),
        (
            "start_every_s = [0.02, 0.04]",
            "start_every_s = [0.0, 0.02]",
        ),
    ] {
        assert!(check(inside, &record())[0].ok, "{inside}");
        assert!(!check(outside, &record())[0].ok, "{outside}");
    }
}

#[test]
fn what_never_happened_is_outside_of_every_range() {
    for limit in [
        "settled_after_s = [0.0, 10.0]",
        "off_after_s = [0.0, 1.0]",
        "power_w_at = [[7.0, 8.0, 0.0, 1e9]]",
    ] {
        let checked = &check(limit, &record())[0];
        assert!(!checked.ok, "{limit}");
        let shown = checked.to_string();
        assert!(shown.contains(" is never, allowed ["), "{shown}");
    }
}

#[test]
fn times_of_a_fault_are_bounded() {
    let mut record = record();
    record.faults.push(FaultRecord {
        t_s: 0.5,
        name: "OverCurrent".to_owned(),
        off_after_s: Some(0.25),
    });
    let limits = "fault_at_s = [0.5, 0.5]\nfaults = [1, 1]\noff_after_s = [0.3, 1]";
    let checked = check(limits, &record);
    let ok: Vec<bool> = checked.iter().map(|c| c.ok).collect();
    assert_eq!(ok, [true, true, false]);
    assert_eq!(
        checked[2].to_string(),
        "off_after_s is 0.250, allowed [0.3, 1]"
    );
}

#[test]
fn what_is_no_limit_is_refused_by_name() {
    for (text, word) in [
        ("overshot_pct = [0, 1]", "overshoot_pct"),
        ("overshoot_pct = true", "latched"),
        ("latched = [0, 1]", "unknown"),
        ("power_w_at = [0, 1]", "unknown"),
        ("power_w_at = [[0, 1, 2]]", "[from_s, to_s, least, most]"),
        ("faults = [0]", "[least, most]"),
        ("faults = [\"0\", 1]", "[least, most]"),
        ("faults = 0", "[least, most]"),
        ("faults = []", "[least, most]"),
    ] {
        let why = toml::from_str::<Limits>(text).unwrap_err().to_string();
        let name = text.split(' ').next().unwrap();
        assert!(why.contains(name) && why.contains(word), "{text}: {why}");
    }
}
