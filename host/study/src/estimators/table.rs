//! The study as Markdown, for docs/results/estimators.md.

use std::fmt::Write;

use ihd_identify::Method;

use super::{ComparisonLoad, EstimatorsCell, F_SW_HZ, RlErrors, SNR_DB, published};

/// First line of the section in docs/results/estimators.md.
pub const BEGIN: &str = "<!-- ihd-study estimators: begin -->";

/// Last line of the section.
pub const END: &str = "<!-- ihd-study estimators: end -->";

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
        let text = match cell {
            Some(c) if c.runs == 0 => "failed".into(),
            Some(c) => {
                let all = [c.whole, c.middle, c.weighted].map(pair).join(" · ");
                match c.failed {
                    0 => all,
                    n => format!("{all} ({n} of {} failed)", n + c.runs),
                }
            }
            None => "–".into(),
        };
        let _ = write!(out, " {text} |");
    }
    out.push('\n');
    out
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

/// Targets, each with the cell nearest to its limit.
fn verdicts(cells: &[EstimatorsCell]) -> String {
    let mut out =
        String::from("### Targets on the behavioural reference load, whole half-cycle\n\n");
    let own = |m: Method| {
        let of =
            move |c: &&EstimatorsCell| c.reference == ComparisonLoad::Behavioural && c.method == m;
        cells.iter().filter(of)
    };
    let limits: [(Method, Option<f64>, RlErrors); 3] = [
        (
            Method::LeastSquares,
            None,
            RlErrors {
                r_pct: 0.1,
                l_pct: 0.3,
            },
        ),
        (
            Method::LeastSquares,
            Some(30.0),
            RlErrors {
                r_pct: 0.5,
                l_pct: 0.6,
            },
        ),
        (
            Method::Lockin,
            None,
            RlErrors {
                r_pct: 0.2,
                l_pct: 0.15,
            },
        ),
    ];
    for (method, snr_db, limit) in limits {
        let of_snr: Vec<&EstimatorsCell> = own(method).filter(|c| c.snr_db == snr_db).collect();
        if of_snr.is_empty() {
            continue;
        }
        let largest =
            |value: fn(&EstimatorsCell) -> f64| of_snr.iter().map(|c| value(c)).fold(0.0, f64::max);
        let worst = RlErrors {
            r_pct: largest(|c| c.whole.r_pct),
            l_pct: largest(|c| c.whole.l_pct),
        };
        let met = worst.r_pct <= limit.r_pct && worst.l_pct <= limit.l_pct;
        let _ = writeln!(
            out,
            "- {method}, {}: at most {:.2}/{:.2} %; target {}/{} %: {}",
            snr(snr_db),
            worst.r_pct,
            worst.l_pct,
            limit.r_pct,
            limit.l_pct,
            if met { "met" } else { "not met" }
        );
    }
    let compared: Vec<(&EstimatorsCell, RlErrors)> = own(Method::Ekf)
        .filter_map(|c| Some((c, published::ekf(c.f_sw_hz, c.snr_db)?)))
        .collect();
    if !compared.is_empty() {
        let below = compared
            .iter()
            .filter(|(c, p)| c.failed == 0 && c.whole.r_pct <= p.r_pct && c.whole.l_pct <= p.l_pct)
            .count();
        let nearest = compared
            .iter()
            .map(|(c, p)| (c.whole.r_pct / p.r_pct).max(c.whole.l_pct / p.l_pct))
            .fold(0.0, f64::max);
        let _ = writeln!(
            out,
            "- ekf against the paper's EKF (Tables 1 and 2): below it in {below} of {} cells, at the \
             nearest {nearest:.2} of its error",
            compared.len()
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_target_that_is_missed_is_reported() {
        let errors = |x: f64| RlErrors { r_pct: x, l_pct: x };
        let cell = |x: f64| EstimatorsCell {
            reference: ComparisonLoad::Behavioural,
            method: Method::Lockin,
            f_sw_hz: 45e3,
            snr_db: None,
            runs: 1,
            failed: 0,
            failure: None,
            whole: errors(x),
            worst: errors(x),
            middle: errors(x),
            weighted: errors(x),
        };
        assert!(markdown(&[cell(0.1)], 1).contains("target 0.2/0.15 %: met"));
        assert!(markdown(&[cell(0.16)], 1).contains("target 0.2/0.15 %: not met"));
    }
}
