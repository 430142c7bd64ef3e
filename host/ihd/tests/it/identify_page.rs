//! The report of `ihd identify --out report.html`.

use std::path::Path;

use serde_json::Value;

use crate::identify::{ihd, long_capture, table};

/// Table with names that are marks of HTML, as three columns; the names of voltage and current.
fn hostile_table(folder: &Path) -> (std::path::PathBuf, [&'static str; 2]) {
    let (path, _) = table(folder);
    let names = [
        "<script>alert(1)</script>",
        "i'\"&<img src=x onerror=alert(2)>",
    ];
    let text = std::fs::read_to_string(&path).expect("the table");
    let (_, rows) = text.split_once('\n').expect("a heading");
    let heading = names.map(|name| format!("\"{}\"", name.replace('"', "\"\"")));
    let hostile = folder.join("<script>alert(3)&'\".csv");
    let text = format!("seconds,{},{}\n{rows}", heading[0], heading[1]);
    std::fs::write(&hostile, text).expect("a temporary file");
    (hostile, names)
}

/// Elements of a page between two marks.
fn between<'a>(page: &'a str, from: &str, to: &str) -> Vec<&'a str> {
    let parts = page.split(from).skip(1);
    parts
        .filter_map(|part| part.split_once(to))
        .map(|p| p.0)
        .collect()
}

/// Text as it stands in a page.
fn in_page(text: &str) -> String {
    let marks = [
        ("&", "&amp;"),
        ("<", "&lt;"),
        (">", "&gt;"),
        ("\"", "&quot;"),
        ("'", "&#39;"),
    ];
    marks.iter().fold(text.to_owned(), |text, (mark, escaped)| {
        text.replace(mark, escaped)
    })
}

/// The page of a capture whose names are hostile, and the results as JSON.
fn page(folder: &Path) -> (String, Value) {
    let (path, [v, _]) = hostile_table(folder);
    let output = ihd()
        .current_dir(folder)
        .args(["identify", "--json", "--method", "ekf-paper,least-squares"])
        .args(["--out", "report.html", "--input"])
        .arg(format!("columns=1,{v},3"))
        .arg(&path)
        .output()
        .expect("it runs");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(7), "{stderr}");
    let page = std::fs::read_to_string(folder.join("report.html")).expect("the report");
    (page, serde_json::from_slice(&output.stdout).expect("JSON"))
}

#[test]
fn a_report_has_the_numbers_of_the_json() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (page, found) = page(folder.path());
    let rows = between(&page, "<tr", "</tr>");
    let mut compared = 0;
    for entry in found.as_array().expect("an array") {
        let method = entry["method"].as_str().expect("a name");
        let values = |key: &str| -> Vec<f64> {
            let values = entry[key].as_array().expect("an array");
            values
                .iter()
                .map(|x| x.as_f64().unwrap_or(f64::NAN))
                .collect()
        };
        let t = values("t_s");
        for half in entry["half_cycles"].as_array().expect("verdicts") {
            let from_s = half["from_s"].as_f64().expect("a time");
            let of_half = |row: &&&str| {
                row.contains(&format!("<td>{method}</td>"))
                    && row.contains(&format!(">{:.2}</td>", from_s * 1e3))
            };
            let row = rows.iter().find(of_half).expect("a row a half-cycle");
            for why in half["why"].as_array().expect("reasons") {
                assert!(row.contains(&in_page(why.as_str().expect("text"))), "{row}");
            }
            // The crest of a half-cycle of 50 Hz, if it was captured.
            let off = |k: &usize| (t[*k] - from_s - 5e-3).abs();
            let crest = (0..t.len()).min_by(|a, b| off(a).total_cmp(&off(b)));
            let Some(k) = crest.filter(|k| off(k) < 0.1e-3) else {
                continue;
            };
            for (key, scale) in [("r_ohm", 1.0), ("l_h", 1e6), ("r_sigma_ohm", 1.0)] {
                if let Some(x) = values(key).get(k).filter(|x| x.is_finite()) {
                    let cell = format!(">{:.4}</td>", x * scale);
                    assert!(row.contains(&cell), "{key} {cell} in {row}");
                    compared += 1;
                }
            }
        }
        for finding in entry["findings"].as_array().expect("findings") {
            if finding["severity"] != "info" {
                let text = in_page(finding["text"].as_str().expect("text"));
                assert!(page.contains(&text), "{text}");
            }
        }
    }
    assert!(compared >= 8, "{compared} numbers");
}

#[test]
fn a_report_is_one_file_and_takes_no_marks_from_names() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (page, _) = page(folder.path());
    for outside in [
        "http:", "https:", "//cdn", " src=\"", "href=", "url(", "@import", "xmlns",
    ] {
        assert!(!page.contains(outside), "{outside}");
    }
    assert!(page.contains("default-src 'none'"));
    assert_eq!(between(&page, "<script", "</script>").len(), 1);
    assert!(!page.contains("<img") && !page.contains("<script>alert"));
    for name in ["<script>alert(1)</script>", "<script>alert(3)&'\".csv"] {
        assert!(page.contains(&in_page(name)), "{name}");
    }
    // Two panels of R and L, two of waveforms; with the curves of both methods in each.
    let panels = between(&page, "<svg class=\"panel\"", "</svg>");
    assert_eq!(panels.len(), 4);
    for panel in panels {
        assert!(panel.contains("#d62728") && panel.matches("<path").count() >= 2);
    }
}

#[test]
fn a_report_of_a_capture_in_parts_has_each_half_cycle_once() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    long_capture(folder.path(), 0.09);
    let output = ihd()
        .current_dir(&folder)
        .args(["identify", "long.mcap", "--out", "report.html"])
        .output()
        .expect("it runs");
    assert_eq!(output.status.code(), Some(0));
    let page = std::fs::read_to_string(folder.path().join("report.html")).expect("the report");
    assert_eq!(page.matches("<td>pass</td>").count(), 9);
}
