//! Short runs, and files that are wrong.

use std::path::PathBuf;

use super::file::Scenario;
use super::record::Record;
use super::run::run;
use super::timeline::{TimelineChange, timeline};

fn parse(text: &str) -> Scenario {
    Scenario::parse(text, PathBuf::new()).unwrap()
}

fn refusal(text: &str) -> String {
    let wrong = |s: Scenario| timeline(&s).map(drop).unwrap_err().to_string();
    Scenario::parse(text, PathBuf::new()).map_or_else(|e| e.to_string(), wrong)
}

const SAG: &str = r#"
    duration_s = 0.7
    load = "behavioural"
    [[event]]
    at_s = 0.0
    power_w = 800
    [[event]]
    at_s = 0.4
    mains = { v_rms = 200.0, for_s = 0.1 }
    [[event]]
    at_s = 0.6
    inject = "frozen-samples"
"#;

#[test]
fn what_is_wrong_is_named_with_line_and_what_is_allowed() {
    for (text, parts) in [
        (
            "duration_s = 1\nload = \"full\"",
            vec!["line 2", "full", "`reduced`", "`field`", "`behavioural`"],
        ),
        (
            "duration_s = 1\nspeed = 2",
            vec!["line 2", "speed", "duration_s", "event"],
        ),
        (
            "duration_s = 1\n[[event]]\nat_s = 0\npower = 5",
            vec!["line 4", "power", "power_w"],
        ),
        (
            "duration_s = 1\n[[event]]\nat_s = 0\nmains = { v_rms = 500 }",
            vec!["line 4", "500", "0 to 320 V"],
        ),
        (
            "duration_s = 1\npot = { name = \"copper-18\" }",
            vec!["line 2", "copper-18", "cast-iron-D"],
        ),
        (
            "duration_s = 1\npot = { name = \"none\", lift = 1 }",
            vec!["line 2", "lift", "lift_mm"],
        ),
        (
            "duration_s = 1\n[[event]]\nat_s = 0\nhost = \"quiet\"",
            vec!["line 4", "quiet", "`silent`"],
        ),
        (
            "duration_s = 1\n[[event]]\nat_s = 0\n\n[[event]]\nat_s = 0\npower_w = 5",
            vec!["event 1 (line 2)", "nothing happens"],
        ),
        (
            "duration_s = 1\n[[event]]\nat_s = 0\npower_w = 5\n[[event]]\nat_s = 0\ninject = \"bus-scale\"",
            vec!["event 2 (line 5)", "bus-scale", "0 to 10"],
        ),
        (
            "duration_s = 1\n[[event]]\nat_s = 0\npot = { name = \"ferritic-12\", offset_mm = 70 }",
            vec!["event 1", "60 mm"],
        ),
        (
            "duration_s = 1\n[[event]]\nat_s = 0\nhost = \"push-lookup\"\nr_ohm = 1",
            vec!["event 1", "l_uh"],
        ),
        (
            "duration_s = 1\npanel = false\n[[event]]\nat_s = 0\npanel = 3",
            vec!["event 1", "no panel"],
        ),
    ] {
        let why = refusal(text);
        for part in parts {
            assert!(why.contains(part), "{text}\n{why}\nlacks {part}");
        }
    }
}

#[test]
fn what_is_for_a_while_is_taken_back_in_order_of_time() {
    let scenario = parse(
        r#"
        duration_s = 1.0
        [[event]]
        at_s = 0.5
        pot = "none"
        for_s = 0.1
        [[event]]
        at_s = 0.55
        mains = { hz = 60.0, for_s = 0.01 }
    "#,
    );
    let all = timeline(&scenario).unwrap();
    let times: Vec<f64> = all.iter().map(|t| t.at_s).collect();
    assert_eq!(times, [0.5, 0.55, 0.56, 0.6]);
    assert!(matches!(all[2].change, TimelineChange::MainsBack(1)));
    assert!(matches!(all[3].change, TimelineChange::PotBack(0)));
}

#[test]
fn a_run_repeats_with_its_seed_and_its_json_comes_back() {
    let record = run(&parse(SAG), |_| ()).unwrap();
    assert_eq!(run(&parse(SAG), |_| ()).unwrap(), record);
    let other = format!("seed = 2\n{SAG}");
    assert_ne!(run(&parse(&other), |_| ()).unwrap(), record);
    let json = serde_json::to_string(&record).unwrap();
    assert_eq!(serde_json::from_str::<Record>(&json).unwrap(), record);
    // People's programs read these names.
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let names = |value: &serde_json::Value| -> Vec<String> {
        value.as_object().unwrap().keys().cloned().collect()
    };
    assert_eq!(names(&json), ["faults", "half_cycles", "summary"]);
    for name in [
        "t_s",
        "asked_w",
        "power_w",
        "measured_w",
        "f_sw_hz",
        "state",
        "fault",
        "pot",
        "r_ohm",
        "l_uh",
        "i_peak_a",
        "v_coil_peak_v",
        "i_turn_off_min_a",
        "hard_edges",
        "bridge_on",
    ] {
        assert!(json["half_cycles"][30].get(name).is_some(), "{name}");
    }
    for name in [
        "settled_after_s",
        "overshoot_pct",
        "error_pct",
        "latched",
        "energy_j",
    ] {
        assert!(json["summary"].get(name).is_some(), "{name}");
    }
}

#[test]
fn events_reach_the_plant_and_faults_are_timed_from_their_cause() {
    let record = run(&parse(SAG), |_| ()).unwrap();
    let half_cycles = &record.half_cycles;
    assert!(
        (68..=70).contains(&half_cycles.len()),
        "{}",
        half_cycles.len()
    );
    let at = |t_s: f64| half_cycles.iter().find(|h| h.t_s > t_s).unwrap();
    // The first half-cycle of the sag is driven as before it: (200/230)² of the power.
    let fell = at(0.405).power_w / at(0.385).power_w;
    assert!(
        (fell / (200.0f64 / 230.0).powi(2) - 1.0).abs() < 0.08,
        "{fell}"
    );
    assert!(at(0.385).bridge_on && at(0.385).f_sw_hz > 34e3);
    let seen = at(0.385);
    assert!(
        (seen.measured_w / seen.power_w - 1.0).abs() < 0.05,
        "{seen:?}"
    );
    let fault = &record.faults[0];
    assert_eq!(fault.name, "SamplesFrozen");
    let off_after_s = fault.off_after_s.unwrap();
    assert!((1e-4..0.1).contains(&off_after_s), "{fault:?}");
    assert!((fault.t_s - 0.6 - off_after_s).abs() < 1e-3, "{fault:?}");
    let energy_j: f64 = half_cycles.iter().map(|h| h.power_w * 0.01).sum();
    assert!((record.summary.energy_j / energy_j - 1.0).abs() < 1e-3);
    assert_eq!(record.summary.recoveries.len(), 2);
}

#[test]
fn a_silent_host_repeats_nothing_and_a_repeated_power_alternates() {
    let record = run(
        &parse(
            r#"
            duration_s = 0.3
            load = "behavioural"
            pot = "none"
            [[event]]
            at_s = 0.0
            host = "set-power-every"
            every_s = 0.04
            power_w = 1000
            toggle = true
            [[event]]
            at_s = 0.2
            host = "silent"
        "#,
        ),
        |_| (),
    )
    .unwrap();
    let asked: Vec<f64> = record.half_cycles.iter().map(|h| h.asked_w).collect();
    let changes = asked.windows(2).filter(|pair| pair[0] != pair[1]).count();
    assert_eq!(changes, 5, "{asked:?}");
    let last = asked[asked.len() - 1];
    assert!(asked[20..].iter().all(|w| *w == last), "{asked:?}");
}
