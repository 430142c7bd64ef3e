//! Table of all contenders: mean errors over the whole half-cycle, the best of each operating point, and the number of points at
//! which the `hybrid` preset is best or near it.

use std::collections::BTreeMap;
use std::fmt::Write;

use super::{Contender, PaperCell, distinct};
use crate::load_name::load_name;

/// Contender of the last line.
const OURS: &str = "hybrid";

/// Mean errors of R and L of one contender at one operating point, in percent.
struct Entry {
    contender: Contender,
    error_pct: [f64; 2],
}

/// Errors of all contenders at one operating point.
struct Row {
    name: String,
    entries: Vec<Entry>,
}

impl Row {
    /// Creates the row from cells of one operating point.
    fn new(cells: &[&PaperCell]) -> Self {
        let first = &cells[0].job;
        let load = load_name(first.load);
        let snr = first
            .snr_db
            .map_or("noiseless".into(), |db| format!("{db} dB"));
        let entry = |contender: Contender| {
            let of = || cells.iter().filter(|c| c.job.contender == contender);
            let mean = |error: fn(&PaperCell) -> f64| {
                of().map(|c| error(c)).sum::<f64>() / of().count().max(1) as f64
            };
            Entry {
                error_pct: [mean(|c| c.whole.r_pct), mean(|c| c.whole.l_pct)],
                contender,
            }
        };
        let contenders = distinct(cells, |c| c.job.contender.clone());
        Self {
            name: format!("{load}, {snr}, {} kHz", first.f_sw_hz * 1e-3),
            entries: contenders.into_iter().map(entry).collect(),
        }
    }

    /// Smallest error of R (0) or L (1).
    fn least(&self, quantity: usize) -> f64 {
        let errors = self.entries.iter().map(|e| e.error_pct[quantity]);
        errors.fold(f64::INFINITY, f64::min)
    }

    fn entry(&self, contender: &Contender) -> Option<&Entry> {
        self.entries.iter().find(|e| e.contender == *contender)
    }
}

/// Standing of the contenders over all rows.
struct Standing {
    /// Number of compared pairs of operating point and quantity.
    pairs: usize,
    /// Number of pairs in which each contender alone has the smallest error.
    best: BTreeMap<String, usize>,
    /// Number of pairs in which several have the smallest error.
    ties: usize,
    /// Largest distance of it from the best, in percent, and the place.
    behind: (f64, String),
}

impl Standing {
    fn tally(rows: &[Row]) -> Self {
        let mut standing = Self {
            pairs: 2 * rows.len(),
            best: BTreeMap::new(),
            ties: 0,
            behind: (0.0, String::new()),
        };
        for row in rows {
            for (quantity, word) in ["R", "L"].into_iter().enumerate() {
                let least = row.least(quantity);
                let mut winners = row
                    .entries
                    .iter()
                    .filter(|e| e.error_pct[quantity] <= least);
                match (winners.next(), winners.next()) {
                    (Some(winner), None) => {
                        let name = winner.contender.name();
                        *standing.best.entry(name.into()).or_default() += 1;
                    }
                    _ => standing.ties += 1,
                }
                let ours = row.entries.iter().find(|e| e.contender.name() == OURS);
                let Some(behind) = ours.map(|e| e.error_pct[quantity] - least) else {
                    continue;
                };
                if behind > standing.behind.0 {
                    standing.behind = (behind, format!("{word} at {}", row.name));
                }
            }
        }
        standing
    }
}

/// Table and conclusions; empty with fewer than two contenders.
pub(super) fn markdown(cells: &[PaperCell]) -> String {
    let cells: Vec<&PaperCell> = cells.iter().collect();
    let contenders = distinct(&cells, |c| c.job.contender.clone());
    if contenders.len() < 2 {
        return String::new();
    }
    let rows: Vec<Row> = distinct(&cells, |c| (c.job.load, c.job.snr_db, c.job.f_sw_hz))
        .into_iter()
        .map(|point| {
            let of = |c: &&&PaperCell| (c.job.load, c.job.snr_db, c.job.f_sw_hz) == point;
            Row::new(&cells.iter().filter(of).copied().collect::<Vec<_>>())
        })
        .collect();
    let mut out = String::from(
        "\n## Everybody in one table\n\nMRE of R/L in % over the whole half-cycle, mean over the seeds; the \
         least of each row is bold.\n\n|",
    );
    for contender in &contenders {
        let _ = write!(out, " | {}", contender.name());
    }
    let _ = writeln!(out, " |\n|---|{}", "---:|".repeat(contenders.len()));
    for row in &rows {
        let _ = write!(out, "| {}", row.name);
        for contender in &contenders {
            let _ = match row.entry(contender) {
                Some(entry) => write!(out, " | {}/{}", value(row, entry, 0), value(row, entry, 1)),
                None => write!(out, " | –"),
            };
        }
        out.push_str(" |\n");
    }
    out.push_str(&conclusions(&Standing::tally(&rows)));
    out
}

fn value(row: &Row, entry: &Entry, quantity: usize) -> String {
    let error = entry.error_pct[quantity];
    let text = match error {
        e if e >= 1e3 => format!("{e:.1e}"),
        e if e >= 9.95 => format!("{e:.0}"),
        e if e >= 0.995 => format!("{e:.2}"),
        e => format!("{e:.3}").trim_start_matches('0').to_owned(),
    };
    if error <= row.least(quantity) {
        format!("**{text}**")
    } else {
        text
    }
}

fn conclusions(standing: &Standing) -> String {
    let best = standing.best.iter();
    let best: Vec<String> = best.map(|(who, n)| format!("`{who}` {n}")).collect();
    let mut out = format!(
        "\nStrictly the least error, in {} pairs of operating point and R or L: {}; {} ties.\n",
        standing.pairs,
        best.join(", "),
        standing.ties
    );
    let (most, at) = &standing.behind;
    if *most > 0.0 {
        let _ = writeln!(out, "`{OURS}` is at most {most:.3} % behind ({at}).");
    }
    out
}

#[cfg(test)]
mod tests {
    use ihd_identify::Method;

    use super::*;
    use crate::paper::report::tests::cell;

    fn by(contender: Contender, r_pct: f64) -> PaperCell {
        let mut cell = cell(1, r_pct);
        cell.job.contender = contender;
        cell
    }

    #[test]
    fn the_least_is_bold_and_strict_wins_are_counted() {
        let ours = || Contender::Pinn(OURS.into());
        let other = || Contender::Other(Method::LeastSquares);
        // R is .005 % behind at 45 kHz and .02 % at 50 kHz; L is 1 % for both, so the same.
        let mut cells = vec![by(ours(), 0.305), by(other(), 0.3)];
        let farther = [by(ours(), 0.32), by(other(), 0.3)];
        cells.extend(farther.map(|mut cell| {
            cell.job.f_sw_hz = 50e3;
            cell
        }));
        let text = markdown(&cells);
        assert!(
            text.contains("| .305/**1.00** | **.300**/**1.00** |"),
            "{text}"
        );
        assert!(text.contains("in 4 pairs"), "{text}");
        assert!(text.contains("`least-squares` 2; 2 ties"), "{text}");
        assert!(
            text.contains("at most 0.020 % behind (R at behavioural, 30 dB, 50 kHz)"),
            "{text}"
        );
    }

    #[test]
    fn the_mean_is_over_the_seeds() {
        let mut second = by(Contender::Pinn(OURS.into()), 0.4);
        second.job.seed = 2;
        let other = by(Contender::Other(Method::Lockin), 0.5);
        let text = markdown(&[by(Contender::Pinn(OURS.into()), 0.2), second, other]);
        assert!(text.contains("| **.300**/"), "{text}");
    }
}
