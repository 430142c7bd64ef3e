//! The study as Markdown, for docs/map.md.

use std::fmt::Write;

use ihd_sim::perturbation::Perturbation;
use ihd_train::lookup::LookupAccuracy;
use serde::Serialize;

use super::hobs::ASKED_W;
use super::{LibraryContents, PotsPlan, PotsRun, TaughtLookup};
use crate::load_name::load_name;

/// First line of the section in docs/map.md.
pub const BEGIN: &str = "<!-- ihd-study pots: begin -->";

/// Last line of the section.
pub const END: &str = "<!-- ihd-study pots: end -->";

/// Share of the reached cells marked as known from which on a map counts as complete.
const MIN_KNOWN_SHARE: f64 = 0.75;

/// Errors after one window and after the last one, over pots and seeds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PotsLine {
    /// Name of the pot, or of a departure for all pots.
    pub pots: String,
    /// Contents of the library.
    pub library: LibraryContents,
    /// Number of runs.
    pub runs: usize,
    /// Errors after the first window.
    pub first: PotsSums,
    /// Errors after the last window.
    pub last: PotsSums,
    /// Mean number of windows until the map was complete; a map that never was counts as one more than there were.
    pub windows_to_taught: f64,
    /// Number of runs whose map never was complete.
    pub never_taught: usize,
}

/// Errors over runs; `None` without a value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PotsSums {
    /// Mean error of R in cells that were not seen, in percent.
    pub r_mean_pct: Option<f64>,
    /// Largest error of R in unseen cells, in percent.
    pub r_worst_pct: Option<f64>,
    /// Mean error of L in unseen cells, in percent.
    pub l_mean_pct: Option<f64>,
    /// Largest error of L in unseen cells, in percent.
    pub l_worst_pct: Option<f64>,
    /// Root mean square of (cell − truth)/σ over every reached cell.
    pub z_rms: Option<f64>,
    /// Share of the reached cells that are marked as known.
    pub known: Option<f64>,
    /// Largest error in marked cells, of R and of L in percent.
    pub worst_known_pct: [Option<f64>; 2],
    /// Number of runs whose lookup no device would accept.
    pub refused: usize,
}

impl PotsSums {
    fn summarise<'a>(after: impl Iterator<Item = &'a TaughtLookup>) -> Self {
        let all: Vec<&TaughtLookup> = after.collect();
        let errors: Vec<LookupAccuracy> = all.iter().filter_map(|a| a.error).collect();
        let mean_of = |of: fn(&LookupAccuracy) -> Option<f64>| mean(errors.iter().filter_map(of));
        let worst_of =
            |of: fn(&LookupAccuracy) -> Option<f64>| errors.iter().filter_map(of).reduce(f64::max);
        let known = || all.iter().filter_map(|a| a.worst_known_pct);
        Self {
            r_mean_pct: mean_of(|e| e.unseen.r_mean_pct),
            r_worst_pct: worst_of(|e| e.unseen.r_worst_pct),
            l_mean_pct: mean_of(|e| e.unseen.l_mean_pct),
            l_worst_pct: worst_of(|e| e.unseen.l_worst_pct),
            z_rms: mean_of(|e| e.z_rms.map(|z| z * z)).map(f64::sqrt),
            known: mean(all.iter().map(|a| a.known)),
            worst_known_pct: [0, 1].map(|x| known().map(|pct| pct[x]).reduce(f64::max)),
            refused: all.len() - errors.len(),
        }
    }

    /// Cells of the table.
    fn cells(&self) -> [String; 5] {
        let number =
            |x: Option<f64>, digits| x.map_or("–".to_owned(), |x| format!("{x:.digits$}"));
        let pair = |a, separator: &str, b, digits| match (a, b) {
            (None, None) => "–".to_owned(),
            (a, b) => number(a, digits) + separator + &number(b, digits),
        };
        let [r_pct, l_pct] = self.worst_known_pct;
        [
            pair(self.r_mean_pct, "/", self.r_worst_pct, 2),
            pair(self.l_mean_pct, "/", self.l_worst_pct, 2),
            number(self.z_rms, 1),
            self.known
                .map_or("–".to_owned(), |share| format!("{:.0} %", 100.0 * share)),
            pair(r_pct, ", ", l_pct, 1),
        ]
    }
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, n) = values.fold((0.0, 0u32), |(sum, n), x| (sum + x, n + 1));
    (n > 0).then(|| sum / f64::from(n))
}

impl PotsLine {
    fn summarise(pots: String, library: LibraryContents, runs: &[&PotsRun]) -> Self {
        let taught = |run: &&PotsRun| {
            let at = run.after.iter().position(|a| a.known >= MIN_KNOWN_SHARE);
            at.map_or(run.after.len() + 1, |k| k + 1)
        };
        let never = |run: &&&PotsRun| run.after.iter().all(|a| a.known < MIN_KNOWN_SHARE);
        let windows: Vec<usize> = runs.iter().map(taught).collect();
        Self {
            pots,
            library,
            runs: runs.len(),
            first: PotsSums::summarise(runs.iter().filter_map(|r| r.after.first())),
            last: PotsSums::summarise(runs.iter().filter_map(|r| r.after.last())),
            windows_to_taught: windows.iter().sum::<usize>() as f64 / windows.len().max(1) as f64,
            never_taught: runs.iter().filter(never).count(),
        }
    }
}

/// All pots of one departure, by library.
pub fn summary(plan: &PotsPlan, runs: &[PotsRun]) -> Vec<PotsLine> {
    let mut lines = Vec::new();
    for perturbation in &plan.perturbations {
        for library in LibraryContents::ALL {
            let own: Vec<&PotsRun> = known_to_first(runs)
                .filter(|r| r.perturbation == *perturbation && r.library == library)
                .collect();
            if !own.is_empty() {
                lines.push(PotsLine::summarise(departure(*perturbation), library, &own));
            }
        }
    }
    lines
}

/// Every pot, without a library and with the one that holds it among others.
pub fn by_pot(plan: &PotsPlan, runs: &[PotsRun]) -> Vec<PotsLine> {
    let mut lines = Vec::new();
    for perturbation in &plan.perturbations {
        for pot in &plan.pots {
            for library in [LibraryContents::Nothing, LibraryContents::Among] {
                let of_pot = |r: &&PotsRun| r.pot == pot.name && r.perturbation == *perturbation;
                let own: Vec<&PotsRun> = known_to_first(runs)
                    .filter(of_pot)
                    .filter(|r| r.library == library)
                    .collect();
                if !own.is_empty() {
                    let name = match perturbation {
                        Some(p) => format!("{}, {p}", pot.name),
                        None => pot.name.clone(),
                    };
                    lines.push(PotsLine::summarise(name, library, &own));
                }
            }
        }
    }
    lines
}

fn known_to_first(runs: &[PotsRun]) -> impl Iterator<Item = &PotsRun> {
    runs.iter().filter(|r| r.told)
}

fn departure(perturbation: Option<Perturbation>) -> String {
    perturbation.map_or_else(|| "standard".to_owned(), |p| p.to_string())
}

/// Section without its marks.
pub fn markdown(plan: &PotsPlan, runs: &[PotsRun]) -> String {
    let mut out = String::new();
    let load = load_name(plan.load);
    let asked: Vec<String> = ASKED_W.iter().map(ToString::to_string).collect();
    let _ = writeln!(
        out,
        "Load {load}, {} seed{}, windows at {} W. Errors in cells that were not seen, in % of the true R and L, mean/worst, mean and \
         worst of pots and seeds.\n",
        plan.seeds,
        if plan.seeds == 1 { "" } else { "s" },
        asked.join("/"),
    );
    let heading = "| | library | R 1st | L 1st | z | known | wrong at most | taught after | R last | L last | z | known | wrong at most |\n\
                   |---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|\n";
    out.push_str(heading);
    summary(plan, runs)
        .iter()
        .for_each(|l| out.push_str(&row(l)));
    out.push_str("\nPot by pot:\n\n");
    out.push_str(heading);
    by_pot(plan, runs)
        .iter()
        .for_each(|l| out.push_str(&row(l)));
    let silent = silent(runs);
    if !silent.is_empty() {
        let _ = writeln!(
            out,
            "\nOf which the first hob had nothing to tell: {}.",
            silent.join(", ")
        );
    }
    out.push('\n');
    out
}

/// Pots for which the first hob has no entry.
fn silent(runs: &[PotsRun]) -> Vec<String> {
    let none = runs
        .iter()
        .filter(|r| !r.told && r.library == LibraryContents::Nothing);
    let name = |r: &PotsRun| format!("{} ({}, seed {})", r.pot, departure(r.perturbation), r.seed);
    none.map(name).collect()
}

fn row(line: &PotsLine) -> String {
    let library = match line.library {
        LibraryContents::Nothing => "none",
        LibraryContents::Same => "the pot",
        LibraryContents::Among => "the pot among others",
        LibraryContents::Others => "others only",
        LibraryContents::NearMiss => "a near miss",
        LibraryContents::Lie => "a lie",
    };
    let taught = match line.never_taught {
        0 => format!("{:.1}", line.windows_to_taught),
        n => format!("{:.1}, {n} of {} never", line.windows_to_taught, line.runs),
    };
    let refused = match (line.first.refused, line.last.refused) {
        (0, 0) => String::new(),
        (first, last) => format!(", refused 1st {first}, last {last} of {}", line.runs),
    };
    format!(
        "| {} | {library}{refused} | {} | {taught} | {} |\n",
        line.pots,
        line.first.cells().join(" | "),
        line.last.cells().join(" | "),
    )
}

#[cfg(test)]
mod tests {
    use ihd_sim::recording::settings::LoadKind;
    use ihd_train::lookup::CellErrors;

    use super::*;

    fn after(r_mean: f64, known: f64) -> TaughtLookup {
        let unseen = CellErrors {
            cells: 9,
            r_mean_pct: Some(r_mean),
            r_worst_pct: Some(2.0 * r_mean),
            l_mean_pct: Some(0.1),
            l_worst_pct: Some(0.2),
        };
        TaughtLookup {
            windows: 1,
            error: Some(LookupAccuracy {
                observed: CellErrors::default(),
                unseen,
                z_rms: Some(1.0),
            }),
            known,
            worst_known_pct: Some([r_mean, 0.1]),
            recognised: 0.0,
        }
    }

    fn run(library: LibraryContents, after: Vec<TaughtLookup>) -> PotsRun {
        PotsRun {
            pot: "ferritic-18".into(),
            perturbation: None,
            library,
            seed: 1,
            reached: 9,
            told: true,
            after,
        }
    }

    #[test]
    fn a_map_that_is_never_taught_counts_beyond_the_last_window_and_is_said() {
        let runs = [
            run(
                LibraryContents::Nothing,
                vec![after(4.0, 0.1), after(2.0, 0.76)],
            ),
            run(
                LibraryContents::Nothing,
                vec![after(2.0, 0.1), after(1.0, 0.74)],
            ),
        ];
        let line = PotsLine::summarise(
            "all".into(),
            LibraryContents::Nothing,
            &runs.iter().collect::<Vec<_>>(),
        );
        assert_eq!((line.windows_to_taught, line.never_taught), (2.5, 1));
        assert_eq!(
            (line.first.r_mean_pct, line.first.r_worst_pct),
            (Some(3.0), Some(8.0))
        );
        assert_eq!(line.last.r_mean_pct, Some(1.5));
        let text = row(&line);
        assert!(text.contains("| 4.0, 0.1 | 2.5, 1 of 2 never |"), "{text}");
        assert!(text.ends_with("| 75 % | 2.0, 0.1 |\n"), "{text}");
    }

    #[test]
    fn a_refused_lookup_has_no_errors_and_is_counted_after_the_last_window_too() {
        let refused = TaughtLookup {
            error: None,
            worst_known_pct: None,
            ..after(0.0, 0.0)
        };
        let line = PotsLine::summarise(
            "all".into(),
            LibraryContents::Nothing,
            &[&run(
                LibraryContents::Nothing,
                vec![after(4.0, 1.0), refused],
            )],
        );
        let text = row(&line);
        assert!(
            text.contains("| none, refused 1st 0, last 1 of 1 |"),
            "{text}"
        );
        assert!(text.ends_with("| – | – | – | 0 % | – |\n"), "{text}");
    }

    #[test]
    fn pots_of_which_nothing_was_told_are_named_and_in_no_mean() {
        let plan = PotsPlan {
            pots: vec!["ferritic-18".parse().unwrap()],
            perturbations: vec![None],
            others: Vec::new(),
            load: LoadKind::Surrogate,
            seeds: 1,
        };
        let mut none = run(LibraryContents::Nothing, Vec::new());
        none.told = false;
        let text = markdown(&plan, &[none]);
        assert!(text.contains("nothing to tell: ferritic-18 (standard, seed 1)"));
        assert!(summary(&plan, &[]).is_empty());
    }
}
