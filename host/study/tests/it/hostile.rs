//! `ihd-study hostile` on a few of its captures: all of them are the step `hostile` of the full tier.

use assert_cmd::Command;
use serde_json::Value;

/// Some twenty captures with one seed, each with something else wrong: none fools a method without a word.
#[test]
fn the_short_form_meets_its_goals() {
    let mut command = Command::cargo_bin("ihd-study").expect("the binary is built with its tests");
    command.args(["hostile", "--short"]).assert().success();
}

fn study(only: &str) -> (Option<i32>, Value) {
    let mut command = Command::cargo_bin("ihd-study").expect("the binary is built with its tests");
    let args = "hostile --method least-squares,lockin --seeds 1 --json --only";
    command.args(args.split(' ')).arg(only);
    let output = command.output().expect("ihd runs");
    let stdout = String::from_utf8_lossy(&output.stdout);
    let stderr = String::from_utf8_lossy(&output.stderr);
    let answer = serde_json::from_str(&stdout).unwrap_or_else(|e| panic!("{e}: {stdout} {stderr}"));
    (output.status.code(), answer)
}

#[test]
fn a_sound_capture_passes_and_is_right() {
    let (code, answer) = study("mains 60 Hz, distorted");
    assert_eq!(code, Some(0), "{answer}");
    assert_eq!(
        (&answer["met"], &answer["sum"]["clean"]),
        (&true.into(), &2.into())
    );
    for run in answer["runs"].as_array().expect("runs") {
        assert_eq!(run["judged"], "right", "{run}");
        let r_pct = run["errors"]["r_pct"].as_f64().expect("an error of R");
        assert!((0.0..0.3).contains(&r_pct), "{run}");
    }
}

/// The current probe the wrong way round: R and L would have the wrong sign. The samples show it, so it is put right and told.
#[test]
fn a_turned_probe_is_corrected_with_a_warning() {
    let (code, answer) = study("current inverted");
    assert_eq!(code, Some(0), "{answer}");
    for run in answer["runs"].as_array().expect("runs") {
        assert_eq!(
            (&run["judged"], &run["said"][0]),
            (&"warned".into(), &"inverted".into()),
            "{run}"
        );
        assert!(run["errors"]["r_pct"].as_f64().expect("an error of R") < 0.3);
    }
}

/// A gain of the voltage and another capacitor are one: without the capacitor's value nothing can be said, which is counted apart.
#[test]
fn a_gain_beside_an_unknown_capacitor_is_wrong_and_cannot_be_seen() {
    let (code, answer) = study("C unknown");
    assert_eq!(code, Some(0), "{answer}");
    let sum = &answer["sum"];
    assert_eq!((&sum["silent"], &sum["invisible"]), (&0.into(), &2.into()));
    for run in answer["runs"].as_array().expect("runs") {
        assert_eq!(run["judged"], "invisible", "{run}");
        let r_pct = run["errors"]["r_pct"].as_f64().expect("an error of R");
        assert!((r_pct - 3.0).abs() < 0.2, "{run}");
    }
}
