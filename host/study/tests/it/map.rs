//! `ihd-study map` on a few pots.

use assert_cmd::Command;
use serde_json::Value;

fn answer(args: &str) -> (Value, String) {
    let mut command = Command::cargo_bin("ihd-study").expect("the binary is built with its tests");
    let output = command.args(args.split(' ')).output().expect("ihd runs");
    let stdout = String::from_utf8_lossy(&output.stdout).into_owned();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    let answer = serde_json::from_str(&stdout).unwrap_or_else(|e| panic!("{e}: {stdout} {stderr}"));
    (answer, stdout)
}

fn number(value: &Value, pointer: &str) -> f64 {
    let found = value.pointer(pointer).and_then(Value::as_f64);
    found.unwrap_or_else(|| panic!("no number at {pointer} in {value:#}"))
}

/// Taught cells hold what the pot shows, within the noise of 40 dB and the grid; a plate that no hob heats has no cells.
#[test]
fn taught_cells_are_right_and_a_plate_has_none() {
    let args = "map --pot ferritic-18,aluminium-21 --seeds 1 --json";
    let (study, text) = answer(args);
    assert_eq!(answer(args).1, text, "the same seed, the same digits");
    let lines = study["lines"].as_array().expect("lines");
    let of = |pot: &str| lines.iter().filter(|l| l["pot"] == pot).collect::<Vec<_>>();
    for line in of("ferritic-18") {
        let reached = number(line, "/reached");
        let observed = number(line, "/error/observed/cells");
        assert_eq!(observed + number(line, "/error/unseen/cells"), reached);
        assert!(
            (40.0..100.0).contains(&reached) && observed > 9.0,
            "{line:#}"
        );
        assert!(number(line, "/error/observed/r_mean_pct") < 1.0, "{line:#}");
        assert!(number(line, "/error/observed/l_mean_pct") < 1.0, "{line:#}");
    }
    for line in of("aluminium-21") {
        assert_eq!((&line["reached"], &line["met"]), (&0.into(), &false.into()));
    }
    assert!(!of("ferritic-18").is_empty() && !of("aluminium-21").is_empty());
    // Every reached cell is told, with its error.
    let cells = study["runs"][0]["map"]["cells"].as_array().expect("cells");
    assert_eq!(cells.len() as f64, number(&lines[0], "/reached"));
}
