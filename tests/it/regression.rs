//! Estimators on recorded captures, against thresholds on both sides: a metric that became much
//! better asks for an update as one that became worse does.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;

use ihd_capture::mcap;
use ihd_identify::Method;
use ihd_identify::accuracy::Accuracy;
use ihd_sim::recording::file::SETTINGS_KEY;
use ihd_sim::recording::settings::CaptureSpec;
use ihd_survey::{Hints, Survey};
use ihd_tests::regression_captures::{all, file, folder};

/// Estimators that are followed.
const METHODS: [Method; 3] = [Method::Firmware, Method::Lockin, Method::LeastSquares];

/// Largest change of a metric without an update.
const BAND: (f64, f64) = (0.7, 1.3);

/// Errors below this, in percent, are not followed downwards.
const FLOOR_PCT: f64 = 0.02;

const HEADING: &str = "capture,f_sw_khz,method,r_from_pct,r_to_pct,l_from_pct,l_to_pct";

/// (capture, switching frequency, method) and the mean relative errors of R and L in percent over
/// the middle 80 % of the half-cycles.
fn measured() -> BTreeMap<String, [f64; 2]> {
    let mut rows = BTreeMap::new();
    for (name, _) in all() {
        let capture = mcap::read(&file(name)).unwrap();
        let survey = Survey::from_capture(&capture, &Hints::default()).unwrap();
        for segment in survey.segments(&capture) {
            for method in METHODS {
                let settings = ihd_identify::IdentifyOptions::default();
                let estimate = ihd_identify::run(method, &segment, &settings);
                let estimate = estimate.unwrap_or_else(|e| panic!("{name}, {method}: {e}"));
                let accuracy =
                    Accuracy::measure(&estimate, &segment, &capture.truth, f64::NEG_INFINITY);
                let mre = accuracy
                    .unwrap_or_else(|| panic!("{name}: no truth"))
                    .middle;
                let khz = (segment.f_sw_hz / 1e3).round();
                rows.insert(format!("{name},{khz},{method}"), [mre.r_pct, mre.l_pct]);
            }
        }
    }
    rows
}

fn table(rows: &BTreeMap<String, [f64; 2]>) -> String {
    let mut text = format!("{HEADING}\n");
    for (row, errors) in rows {
        let [r, l] = errors.map(|e| {
            let from = if e < FLOOR_PCT { 0.0 } else { BAND.0 * e };
            format!("{from:.4},{:.4}", (BAND.1 * e).max(FLOOR_PCT))
        });
        let _ = writeln!(text, "{row},{r},{l}");
    }
    text
}

#[test]
fn every_estimator_stays_within_its_thresholds() {
    let path = folder().join("thresholds.csv");
    let rows = measured();
    if std::env::var_os("UPDATE_THRESHOLDS").is_some() {
        fs::write(&path, table(&rows)).unwrap();
    }
    let kept = fs::read_to_string(&path).unwrap();
    let mut lines = kept.lines();
    assert_eq!(lines.next(), Some(HEADING));
    let (mut out, mut seen) = (String::new(), 0);
    for line in lines {
        let fields: Vec<_> = line.split(',').collect();
        let row = fields[..3].join(",");
        let limits: Vec<f64> = fields[3..].iter().map(|f| f.parse().unwrap()).collect();
        let errors = rows.get(&row);
        let errors = errors.unwrap_or_else(|| panic!("{row} is not measured any more"));
        for (k, (what, error)) in ["R", "L"].iter().zip(errors).enumerate() {
            let (from, to) = (limits[2 * k], limits[2 * k + 1]);
            if *error < from || *error > to {
                let _ = writeln!(
                    out,
                    "{row}: {what} {error:.4} %, threshold {from} to {to} %"
                );
            }
        }
        seen += 1;
    }
    assert_eq!(seen, rows.len(), "a row has no thresholds");
    assert!(
        out.is_empty(),
        "{out}better is welcome: UPDATE_THRESHOLDS=1 cargo test -p ihd-tests regression"
    );
}

#[test]
fn the_captures_are_what_their_settings_say_and_small() {
    let mut bytes = 0;
    for (name, settings) in all() {
        let capture = mcap::read(&file(name)).unwrap();
        let made_with: CaptureSpec = serde_json::from_str(&capture.metadata[SETTINGS_KEY]).unwrap();
        assert_eq!(made_with, settings, "{name}: run the example make_captures");
        assert!(!capture.truth.is_empty());
        bytes += fs::metadata(file(name)).unwrap().len();
    }
    assert!(bytes <= 1_500_000, "{bytes}");
}

/// Each capture's purpose shows in its samples, independent of any estimator.
#[test]
fn each_capture_shows_what_it_is_named_for() {
    let read = |name: &str| mcap::read(&file(name)).unwrap();
    let start = read("start-up");
    assert!(start.i_a[..20].iter().all(|i| i.abs() < 1.0), "from rest");
    let saturated = read("saturation");
    let top = saturated.i_a.iter().filter(|i| i.abs() > 39.9).count();
    assert!(top > 100, "{top} samples at the end of the range");
    let steps: Vec<_> = read("frequency-steps")
        .f_sw
        .iter()
        .map(|s| s.f_sw_hz)
        .collect();
    assert_eq!(steps, [45e3, 52e3, 60e3]);
    let removal = read("pot-removal").truth;
    let l_h = |t_s: f64| removal.iter().find(|t| t.t_s > t_s).unwrap().l_h[0];
    assert!(
        l_h(15e-3) > 1.5 * l_h(8e-3),
        "without a pot L is that of the coil"
    );
}
