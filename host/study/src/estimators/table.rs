//! The study as Markdown, for docs/accuracy.md.

use std::fmt::Write;

use ihd_identify::Method;

use super::{ComparisonLoad, EstimatorsCell, F_SW_HZ, RlErrors, SNR_DB, published};

/// First and last line of all tables in docs/accuracy.md.
pub const MARKS: (&str, &str) = (
    "<!-- ihd-study estimators: begin -->",
    "<!-- ihd-study estimators: end -->",
);

/// First and last line of the overview there.
pub const OVERVIEW_MARKS: (&str, &str) = (
    "<!-- ihd-study estimators, overview: begin -->",
    "<!-- ihd-study estimators, overview: end -->",
);

/// Section without its marks: a table per method and reference, and the statements on all cells.
pub fn markdown(cells: &[EstimatorsCell], seeds: u64) -> String {
    let mut out = String::new();
    let _ = writeln!(
        out,
        "Last of two mains half-cycles, 50 MS/s, {seeds} seeds of noise a cell (mean over them). A cell is \
         R/L in % over the whole half-cycle · over its middle 80 % · weighted with |i|².\n"
    );
    for reference in ComparisonLoad::ALL {
        if !cells.iter().any(|c| c.reference == reference) {
            continue;
        }
        let _ = writeln!(out, "### {}\n", title(reference));
        let of_reference: Vec<&EstimatorsCell> =
            cells.iter().filter(|c| c.reference == reference).collect();
        if reference == ComparisonLoad::Behavioural {
            for method in methods(&of_reference) {
                let own = of_reference.iter().filter(|c| c.method == method);
                out.push_str(&method_table(method, &own.copied().collect::<Vec<_>>()));
            }
        } else {
            out.push_str(&field_table(&of_reference));
        }
    }
    out.push_str(&verdicts(cells));
    out
}

fn title(reference: ComparisonLoad) -> &'static str {
    match reference {
        ComparisonLoad::Behavioural => {
            "Behavioural reference load: v = R·i + L·di/dt holds exactly"
        }
        ComparisonLoad::FieldWaveform => "Field model, against the waveform's own fundamental",
        ComparisonLoad::FieldDescribing => "Field model, against the describing function",
    }
}

fn snr(snr_db: Option<f64>) -> String {
    snr_db.map_or("noiseless".into(), |s| format!("{s:.0} dB"))
}

/// Formats two significant digits.
fn pct(x: f64) -> String {
    if x >= 1000.0 {
        "> 1000".into()
    } else if x >= 9.95 {
        format!("{x:.0}")
    } else if x >= 0.995 {
        format!("{x:.1}")
    } else {
        format!("{x:.2}").trim_start_matches('0').to_owned()
    }
}

fn pair(e: RlErrors) -> String {
    format!("{}/{}", pct(e.r_pct), pct(e.l_pct))
}

/// Methods that have cells, in the order of tables.
fn methods(cells: &[&EstimatorsCell]) -> Vec<Method> {
    let known = |m: &Method| cells.iter().any(|c| c.method == *m);
    Method::ALL.into_iter().filter(known).collect()
}

fn heading(name: &str) -> String {
    let mut out = format!("| {name} |");
    for f in F_SW_HZ {
        let _ = write!(out, " {:.0} kHz |", f * 1e-3);
    }
    out.push_str("\n|---|---:|---:|---:|---:|\n");
    out
}

/// One line: a method at one SNR, over the frequencies.
fn row(name: &str, cells: &[&EstimatorsCell], snr_db: Option<f64>) -> String {
    let mut out = format!("| {name} |");
    for f in F_SW_HZ {
        let cell = cells.iter().find(|c| c.f_sw_hz == f && c.snr_db == snr_db);
        let text = text(cell.copied(), |c| {
            [c.whole, c.middle, c.weighted].map(pair).join(" · ")
        });
        let _ = write!(out, " {text} |");
    }
    out.push('\n');
    out
}

/// Errors of a cell, and how many of its runs failed.
fn text(cell: Option<&EstimatorsCell>, errors: impl Fn(&EstimatorsCell) -> String) -> String {
    match cell {
        Some(c) if c.runs == 0 => "failed".to_owned(),
        Some(c) if c.failed > 0 => {
            format!(
                "{} ({} of {} failed)",
                errors(c),
                c.failed,
                c.failed + c.runs
            )
        }
        Some(c) => errors(c),
        None => "–".to_owned(),
    }
}

/// All SNRs of one method.
fn method_table(method: Method, cells: &[&EstimatorsCell]) -> String {
    let mut out = heading(method.name());
    for snr_db in SNR_DB {
        out.push_str(&row(&snr(snr_db), cells, snr_db));
    }
    let failure = cells.iter().find_map(|c| c.failure.as_ref());
    if let Some(failure) = failure {
        let _ = writeln!(out, "\nWhy it failed: {failure}");
    }
    out.push('\n');
    out
}

/// All methods without noise and at the largest; the noise between is in the JSON.
fn field_table(cells: &[&EstimatorsCell]) -> String {
    let mut out = heading("method");
    for method in methods(cells) {
        let own: Vec<&EstimatorsCell> = cells
            .iter()
            .filter(|c| c.method == method)
            .copied()
            .collect();
        for snr_db in [SNR_DB[0], SNR_DB[SNR_DB.len() - 1]] {
            out.push_str(&row(&format!("{method}, {}", snr(snr_db)), &own, snr_db));
        }
    }
    out.push('\n');
    out
}

/// One line a method, of a few cells over the whole half-cycle, from the least error of R with noise on.
pub fn overview(cells: &[EstimatorsCell]) -> String {
    let columns = [
        (ComparisonLoad::Behavioural, 45e3),
        (ComparisonLoad::Behavioural, 70e3),
        (ComparisonLoad::FieldWaveform, 45e3),
    ];
    let cell = |method, (reference, f_sw_hz), snr_db| {
        let is_it = |c: &&EstimatorsCell| {
            c.method == method
                && c.reference == reference
                && c.f_sw_hz == f_sw_hz
                && c.snr_db == snr_db
        };
        cells.iter().find(is_it)
    };
    let with_noise = |method: &Method| {
        let with_estimate = cell(*method, columns[0], Some(30.0)).filter(|c| c.runs > 0);
        with_estimate.map_or(f64::INFINITY, |c| c.whole.r_pct)
    };
    let mut methods = methods(&cells.iter().collect::<Vec<_>>());
    methods.sort_by(|a, b| with_noise(a).total_cmp(&with_noise(b)));
    let mut out = String::from(
        "| method | behavioural, 45 kHz: noiseless | 30 dB | 70 kHz: noiseless | 30 dB | field, 45 kHz: noiseless | 30 dB |\n\
         |---|---:|---:|---:|---:|---:|---:|\n",
    );
    for method in methods {
        let _ = write!(out, "| `{method}` |");
        for column in columns {
            for snr_db in [None, Some(30.0)] {
                let text = text(cell(method, column, snr_db), |c| pair(c.whole));
                let _ = write!(out, " {text} |");
            }
        }
        out.push('\n');
    }
    out
}

/// Targets: method, noise, and the largest errors.
const TARGETS: [(Method, Option<f64>, RlErrors); 3] = [
    (Method::LeastSquares, None, limit(0.1, 0.3)),
    (Method::LeastSquares, Some(30.0), limit(0.5, 0.6)),
    (Method::Lockin, None, limit(0.2, 0.15)),
];

const fn limit(r_pct: f64, l_pct: f64) -> RlErrors {
    RlErrors { r_pct, l_pct }
}

/// Targets, each with the cell nearest to its limit, and the EKF beside the paper's.
fn verdicts(cells: &[EstimatorsCell]) -> String {
    let mut out =
        String::from("### Targets on the behavioural reference load, whole half-cycle\n\n");
    let own = |method: Method| {
        let is_own =
            |c: &&EstimatorsCell| c.reference == ComparisonLoad::Behavioural && c.method == method;
        cells.iter().filter(is_own).collect::<Vec<_>>()
    };
    for (method, snr_db, target) in TARGETS {
        let mut of_snr = own(method);
        of_snr.retain(|c| c.snr_db == snr_db);
        if !of_snr.is_empty() {
            let verdict = verdict(&of_snr, target);
            let _ = writeln!(out, "- {method}, {}: {verdict}", snr(snr_db));
        }
    }
    out.push_str(&beside_the_paper(&own(Method::Ekf)));
    out
}

/// Returns `true` if every run of the cell has an estimate.
fn is_whole(cell: &EstimatorsCell) -> bool {
    cell.runs > 0 && cell.failed == 0
}

fn verdict(cells: &[&EstimatorsCell], target: RlErrors) -> String {
    let largest = |value: fn(&EstimatorsCell) -> f64| {
        let values = cells.iter().filter(|c| c.runs > 0).map(|c| value(c));
        let largest = values.reduce(f64::max);
        largest.map_or("–".to_owned(), |pct| format!("{pct:.2}"))
    };
    let is_within =
        |c: &&EstimatorsCell| c.whole.r_pct <= target.r_pct && c.whole.l_pct <= target.l_pct;
    let verdict = if !cells.iter().all(is_within) {
        "not met"
    } else if cells.iter().all(|c| is_whole(c)) {
        "met"
    } else {
        "not judged, runs failed"
    };
    format!(
        "at most {}/{} %; target {}/{} %: {verdict}",
        largest(|c| c.whole.r_pct),
        largest(|c| c.whole.l_pct),
        target.r_pct,
        target.l_pct,
    )
}

/// Number of cells in which the EKF's error is smaller than that of the paper's.
fn beside_the_paper(cells: &[&EstimatorsCell]) -> String {
    let compared: Vec<(&EstimatorsCell, RlErrors)> = cells
        .iter()
        .filter_map(|c| Some((*c, published::ekf(c.f_sw_hz, c.snr_db)?.mre)))
        .collect();
    if compared.is_empty() {
        return String::new();
    }
    let judged: Vec<_> = compared.iter().filter(|(c, _)| is_whole(c)).collect();
    let is_below =
        |(c, p): &(&EstimatorsCell, RlErrors)| c.whole.r_pct < p.r_pct && c.whole.l_pct < p.l_pct;
    let ratio = |(c, p): &(&EstimatorsCell, RlErrors)| {
        (c.whole.r_pct / p.r_pct).max(c.whole.l_pct / p.l_pct)
    };
    let nearest = judged.iter().map(|pair| ratio(pair)).reduce(f64::max);
    format!(
        "- ekf against the paper's EKF (Tables 1 and 2): below it in {} of {} cells, at the nearest {} of its error\n",
        judged.iter().filter(|pair| is_below(pair)).count(),
        compared.len(),
        nearest.map_or("–".to_owned(), |ratio| format!("{ratio:.2}")),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cell of the behavioural load at 45 kHz.
    fn cell(method: Method, snr_db: Option<f64>, error_pct: f64) -> EstimatorsCell {
        let errors = RlErrors {
            r_pct: error_pct,
            l_pct: error_pct,
        };
        EstimatorsCell {
            reference: ComparisonLoad::Behavioural,
            method,
            f_sw_hz: 45e3,
            snr_db,
            runs: 1,
            failed: 0,
            failure: None,
            whole: errors,
            worst: errors,
            middle: errors,
            weighted: errors,
        }
    }

    #[test]
    fn a_target_that_is_missed_is_reported() {
        let lockin = |error_pct| markdown(&[cell(Method::Lockin, None, error_pct)], 1);
        assert!(lockin(0.1).contains("target 0.2/0.15 %: met"));
        assert!(lockin(0.16).contains("target 0.2/0.15 %: not met"));
    }

    /// A cell without an estimate has no error, and one with a failed run not all of it.
    #[test]
    fn a_target_is_not_judged_where_runs_failed() {
        let found = cell(Method::Lockin, None, 0.1);
        let failed = EstimatorsCell {
            runs: 0,
            failed: 1,
            f_sw_hz: 50e3,
            ..cell(Method::Lockin, None, 0.0)
        };
        let half = EstimatorsCell {
            failed: 1,
            ..found.clone()
        };
        for cells in [&[found, failed][..], &[half]] {
            let text = markdown(cells, 1);
            assert!(text.contains("0.2/0.15 %: not judged"), "{text}");
        }
    }

    /// Below is below: a cell as good as the paper's is not, nor is one without an estimate.
    #[test]
    fn the_ekf_is_below_the_papers_where_its_errors_are_smaller() {
        let paper = published::ekf(45e3, Some(30.0)).unwrap().mre;
        let ekf = |errors| EstimatorsCell {
            whole: errors,
            ..cell(Method::Ekf, Some(30.0), 0.0)
        };
        let text = |cell| markdown(&[cell], 1);
        assert!(text(ekf(paper)).contains("below it in 0 of 1 cells, at the nearest 1.00"));
        let half = limit(0.5 * paper.r_pct, 0.5 * paper.l_pct);
        assert!(text(ekf(half)).contains("below it in 1 of 1 cells, at the nearest 0.50"));
        let failed = EstimatorsCell {
            runs: 0,
            failed: 1,
            ..ekf(half)
        };
        assert!(text(failed).contains("below it in 0 of 1 cells, at the nearest –"));
    }

    #[test]
    fn the_overview_begins_with_the_least_error() {
        let cells = [
            cell(Method::Ekf, Some(30.0), 0.5),
            cell(Method::Lockin, Some(30.0), 0.3),
            EstimatorsCell {
                failed: 2,
                ..cell(Method::Lockin, None, 12.0)
            },
        ];
        let lines: Vec<String> = overview(&cells).lines().map(str::to_owned).collect();
        assert_eq!(
            lines[2..],
            [
                "| `lockin` | 12/12 (2 of 3 failed) | .30/.30 | – | – | – | – |",
                "| `ekf` | – | .50/.50 | – | – | – | – |",
            ]
        );
    }
}
