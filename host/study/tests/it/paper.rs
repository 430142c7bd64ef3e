//! `ihd-study paper` on a part of its cells: the field model at 45 kHz. Bounds are the project's targets.
use std::path::Path;

use assert_cmd::Command;
use serde_json::Value;

/// Runs the part in `folder`; returns its cells.
fn study(folder: &Path) -> Vec<Value> {
    let output = Command::cargo_bin("ihd-study")
        .expect("the command is built")
        .args(["paper", "--json", "--seeds", "1", "--khz", "45"])
        .args(["--load", "field", "--snr", "none,30", "--preset"])
        .arg("hybrid,hybrid-all-harmonics,hybrid-fractional")
        .arg("--out")
        .arg(folder)
        .output()
        .expect("it runs");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    let cells: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    cells.as_array().expect("an array").clone()
}

/// (R, L) of a group of errors of the contender's cell, with noise or without.
fn errors(cells: &[Value], name: &str, noisy: bool, group: &str) -> (f64, f64) {
    let of = |cell: &&Value| {
        let job = &cell["job"];
        let who = [&job["contender"]["pinn"], &job["contender"]["other"]];
        who.contains(&&Value::from(name)) && job["snr_db"].is_number() == noisy
    };
    let cell = cells.iter().find(of).expect(name);
    let number = |key: &str| cell[group][key].as_f64().expect("a number");
    (number("r_pct"), number("l_pct"))
}

#[test]
fn a_part_of_the_study_meets_the_targets_and_goes_on_from_its_files() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let cells = study(folder.path());
    // Three presets, least squares, the EKF and the lock-in; without noise and with.
    assert_eq!(cells.len(), 12);
    for (noisy, limit) in [(false, 0.5), (true, 1.0)] {
        let (r, l) = errors(&cells, "hybrid", noisy, "whole");
        assert!(r <= limit && l <= limit, "hybrid: {r} {l}");
        let lockin = errors(&cells, "lockin", noisy, "whole");
        assert!(r <= lockin.0 && l <= lockin.1, "{r} {l} and {lockin:?}");
        // Sinusoidal current: L within 2 %, P/I² too. R cannot be, and no further off than 4 %.
        let (r, l) = errors(&cells, "hybrid", noisy, "describing");
        assert!(l <= 2.0 && (1.0..4.0).contains(&r), "{r} {l}");
        // The impedance law takes the harmonics' error of L at least to a half.
        let (_, all) = errors(&cells, "hybrid-all-harmonics", noisy, "whole");
        let (_, law) = errors(&cells, "hybrid-fractional", noisy, "whole");
        assert!(law < 0.5 * all, "{law} and {all}");
    }
    let hybrid = &cells[0];
    assert_eq!(hybrid["job"]["contender"]["pinn"], "hybrid");
    assert!(hybrid["power_describing_pct"].as_f64().expect("P/I²") <= 2.0);
    assert!(hybrid["power_r_pct"].as_f64().expect("P/I²") <= 0.2);

    // Harmonics up to the 7th lack what the filter takes from the reference too: behind it they miss less.
    let nmse_v = |key: &str| hybrid[key][0].as_f64().expect("NMSE of v");
    assert!(nmse_v("nmse_filtered_pct") < 0.5 * nmse_v("nmse_pct"));
    assert!(nmse_v("nmse_both_filtered_pct") < nmse_v("nmse_filtered_pct"));

    let report = std::fs::read_to_string(folder.path().join("report.md")).expect("a report");
    assert!(report.contains("| 45 | hybrid-fractional |") && !report.contains("| 50 |"));
    assert!(report.contains("- `hybrid-fractional`: "));
    assert!(report.contains("in 4 pairs of operating point"), "{report}");
    assert!(report.contains("| field, 30 dB: hybrid | "), "{report}");
    for figure in ["load-field-45kHz-clean.svg", "loss-field-45kHz-30dB.svg"] {
        assert!(report.contains(figure) && folder.path().join(figure).exists());
    }
    // The second run reads what the first one kept: the wall-clock times are the same too.
    assert_eq!(study(folder.path()), cells);
}
