//! The study as Markdown, for docs/map.md.

use std::fmt::Write;

use ihd_sim::perturbation::Perturbation;
use ihd_sim::recording::settings::LoadKind;
use ihd_train::lookup::LookupAccuracy;
use serde::Serialize;

use super::hobs::ASKED_W;
use super::{LibraryContents, PotsPlan, PotsRun, TaughtLookup};

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

/// Errors over runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PotsSums {
    /// Mean error of R in cells that were not seen, in percent.
    pub r_mean_pct: f64,
    /// Largest error of R in unseen cells, in percent.
    pub r_worst_pct: f64,
    /// Mean error of L in unseen cells, in percent.
    pub l_mean_pct: f64,
    /// Largest error of L in unseen cells, in percent.
    pub l_worst_pct: f64,
    /// Root mean square of (cell − truth)/σ over every reached cell.
    pub z_rms: f64,
    /// Share of the reached cells that are marked as known.
    pub known: f64,
    /// Largest error in marked cells, of R and of L in percent.
    pub worst_known_pct: [f64; 2],
    /// Number of runs whose lookup no device would accept.
    pub refused: usize,
}

impl PotsSums {
    fn summarise<'a>(after: impl Iterator<Item = &'a TaughtLookup>) -> Self {
        let all: Vec<&TaughtLookup> = after.collect();
        let errors: Vec<LookupAccuracy> = all.iter().filter_map(|a| a.error).collect();
        let mean = |of: &dyn Fn(&LookupAccuracy) -> Option<f64>| {
            let some: Vec<f64> = errors.iter().filter_map(of).collect();
            some.iter().sum::<f64>() / some.len().max(1) as f64
        };
        let worst = |of: &dyn Fn(&LookupAccuracy) -> Option<f64>| {
            errors.iter().filter_map(of).fold(0.0, f64::max)
        };
        let most = |x: usize| all.iter().map(|a| a.worst_known_pct[x]).fold(0.0, f64::max);
        Self {
            r_mean_pct: mean(&|e| e.unseen.r_mean_pct),
            r_worst_pct: worst(&|e| e.unseen.r_worst_pct),
            l_mean_pct: mean(&|e| e.unseen.l_mean_pct),
            l_worst_pct: worst(&|e| e.unseen.l_worst_pct),
            z_rms: mean(&|e| e.z_rms.map(|z| z * z)).sqrt(),
            known: all.iter().map(|a| a.known).sum::<f64>() / all.len().max(1) as f64,
            worst_known_pct: [most(0), most(1)],
            refused: all.len() - errors.len(),
        }
    }
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
    let load = match plan.load {
        LoadKind::Field => "field",
        LoadKind::Surrogate => "reduced",
        LoadKind::Behavioural => "behavioural",
    };
    let asked: Vec<String> = ASKED_W.iter().map(ToString::to_string).collect();
    let _ = writeln!(
        out,
        "Load {load}, {} seed{}, windows at {} W. Errors in cells that were not seen, in % of the true R and L, mean/worst, mean and \
         worst of pots and seeds.\n",
        plan.seeds,
        if plan.seeds == 1 { "" } else { "s" },
        asked.join("/"),
    );
    let heading = "| | library | R 1st | L 1st | z | known | wrong at most | taught after | R last | L last | z | known |\n\
                   |---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|\n";
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
    let PotsSums {
        worst_known_pct: [r_pct, l_pct],
        ..
    } = line.first;
    let taught = match line.never_taught {
        0 => format!("{:.1}", line.windows_to_taught),
        n => format!("{:.1}, {n} of {} never", line.windows_to_taught, line.runs),
    };
    let refused = match line.first.refused {
        0 => String::new(),
        n => format!(", {n} refused"),
    };
    format!(
        "| {} | {library}{refused} | {:.2}/{:.2} | {:.2}/{:.2} | {:.1} | {:.0} % | {r_pct:.1}, {l_pct:.1} | {taught} | {:.2}/{:.2} | {:.2}/{:.2} | {:.1} | {:.0} % |\n",
        line.pots,
        line.first.r_mean_pct,
        line.first.r_worst_pct,
        line.first.l_mean_pct,
        line.first.l_worst_pct,
        line.first.z_rms,
        100.0 * line.first.known,
        line.last.r_mean_pct,
        line.last.r_worst_pct,
        line.last.l_mean_pct,
        line.last.l_worst_pct,
        line.last.z_rms,
        100.0 * line.last.known,
    )
}

#[cfg(test)]
mod tests {
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
            worst_known_pct: [r_mean, 0.1],
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
        assert_eq!((line.first.r_mean_pct, line.first.r_worst_pct), (3.0, 8.0));
        assert_eq!(line.last.r_mean_pct, 1.5);
        assert!(row(&line).contains("2.5, 1 of 2 never"));
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
