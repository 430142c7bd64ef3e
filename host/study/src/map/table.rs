//! The study as Markdown, for docs/map.md.

use std::fmt::Write;

use ihd_sim::perturbation::Perturbation;
use ihd_train::lookup::{CellErrors, LookupAccuracy};
use serde::Serialize;

use super::{LookupJudgement, MapPlan, MapRun};
use crate::load_name::load_name;

/// First line of the section in docs/map.md.
pub const BEGIN: &str = "<!-- ihd-study map: begin -->";

/// Last line of the section.
pub const END: &str = "<!-- ihd-study map: end -->";

/// Limits of the mean and the worst error of R in unseen cells, in percent; half of that for L.
pub const GOAL_R_PCT: (f64, f64) = (2.0, 5.0);

/// Builder of the lookups of a column.
pub type Builder = (&'static str, fn(&MapRun) -> Option<&LookupJudgement>);

/// Builders, in the order of columns.
pub const BUILDERS: [Builder; 2] = [
    ("the map", |r| r.map.as_ref()),
    ("the closed loop", |r| r.learned.as_ref()),
];

/// Errors over all seeds of a pot: mean of the means, and the worst of all.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MapLine {
    /// Name of the pot and its place.
    pub pot: String,
    /// Departure from the standard model.
    pub perturbation: Option<Perturbation>,
    /// Builder of the lookup.
    pub builder: &'static str,
    /// Number of cells that the hob reaches.
    pub reached: usize,
    /// Number of seeds.
    pub seeds: usize,
    /// Number of seeds without a lookup that a device accepts.
    pub refused: usize,
    /// Reason for the first of these.
    pub why: Option<String>,
    /// Errors of the accepted lookups; if there are none, of the others.
    pub error: Option<LookupAccuracy>,
    /// `true` if every seed has a lookup within the goal in its unseen cells; `None` if one has no such cell.
    pub met: Option<bool>,
}

/// Lines, by builder and pot.
pub fn lines(runs: &[MapRun]) -> Vec<MapLine> {
    let mut lines = Vec::new();
    for (builder, verdict) in BUILDERS {
        let mut groups: Vec<Vec<&MapRun>> = Vec::new();
        for run in runs
            .iter()
            .filter(|r| r.reached == 0 || verdict(r).is_some())
        {
            match groups.last_mut() {
                Some(g) if g[0].pot == run.pot && g[0].perturbation == run.perturbation => {
                    g.push(run)
                }
                _ => groups.push(vec![run]),
            }
        }
        // Pots that are not heated say nothing of a builder that was not run.
        if groups.iter().any(|g| verdict(g[0]).is_some()) {
            lines.extend(groups.iter().map(|g| line(builder, g, verdict)));
        }
    }
    lines
}

fn line(
    builder: &'static str,
    runs: &[&MapRun],
    verdict: fn(&MapRun) -> Option<&LookupJudgement>,
) -> MapLine {
    let verdicts: Vec<&LookupJudgement> = runs.iter().filter_map(|r| verdict(r)).collect();
    let is_refused = |v: &&&LookupJudgement| v.refused.is_some();
    let refused = verdicts.iter().filter(is_refused).count();
    let all_refused = refused == verdicts.len();
    let errors: Vec<LookupAccuracy> = verdicts
        .iter()
        .filter(|v| all_refused || v.refused.is_none())
        .filter_map(|v| v.error)
        .collect();
    let error = merged(&errors);
    let within: Vec<_> = errors.iter().map(|e| is_within_goal(&e.unseen)).collect();
    let is_missed = refused > 0 || within.is_empty() || within.contains(&Some(false));
    MapLine {
        pot: runs[0].pot.clone(),
        perturbation: runs[0].perturbation,
        builder,
        reached: runs[0].reached,
        seeds: runs.len(),
        refused,
        why: verdicts.iter().find_map(|v| v.refused.clone()),
        met: match is_missed {
            true => Some(false),
            false => (!within.contains(&None)).then_some(true),
        },
        error,
    }
}

/// Returns `true` if the errors are within the goal; `None` without cells.
fn is_within_goal(e: &CellErrors) -> Option<bool> {
    Some(
        e.r_mean_pct? <= GOAL_R_PCT.0
            && e.r_worst_pct? <= GOAL_R_PCT.1
            && e.l_mean_pct? <= 0.5 * GOAL_R_PCT.0
            && e.l_worst_pct? <= 0.5 * GOAL_R_PCT.1,
    )
}

fn merged(errors: &[LookupAccuracy]) -> Option<LookupAccuracy> {
    let first = errors.first()?;
    let cells = |of: fn(&LookupAccuracy) -> &CellErrors| {
        let mean = |pct: fn(&CellErrors) -> Option<f64>| {
            let all: Vec<f64> = errors.iter().filter_map(|e| pct(of(e))).collect();
            (!all.is_empty()).then(|| all.iter().sum::<f64>() / all.len() as f64)
        };
        let worst = |pct: fn(&CellErrors) -> Option<f64>| {
            let all = errors.iter().filter_map(|e| pct(of(e)));
            all.max_by(f64::total_cmp)
        };
        CellErrors {
            cells: of(first).cells,
            r_mean_pct: mean(|e| e.r_mean_pct),
            r_worst_pct: worst(|e| e.r_worst_pct),
            l_mean_pct: mean(|e| e.l_mean_pct),
            l_worst_pct: worst(|e| e.l_worst_pct),
        }
    };
    let z: Vec<f64> = errors.iter().filter_map(|e| e.z_rms).collect();
    let square = z.iter().map(|z| z * z).sum::<f64>() / z.len().max(1) as f64;
    Some(LookupAccuracy {
        observed: cells(|e| &e.observed),
        unseen: cells(|e| &e.unseen),
        z_rms: (!z.is_empty()).then(|| square.sqrt()),
    })
}

/// Section without its marks.
pub fn markdown(plan: &MapPlan, runs: &[MapRun]) -> String {
    let mut out = String::new();
    let powers: Vec<String> = plan.powers_w.iter().map(ToString::to_string).collect();
    let _ = writeln!(
        out,
        "Load {}, shown at {} W, noise {} dB, {} seed{}. Errors in % of the true R and L, mean/worst over the cells that the hob \
         reaches, mean of the seeds and worst of all. Goal in unseen cells: R {}/{}, L {}/{}.\n",
        load_name(plan.load),
        powers.join("/"),
        plan.snr_db,
        plan.seeds,
        if plan.seeds == 1 { "" } else { "s" },
        GOAL_R_PCT.0,
        GOAL_R_PCT.1,
        0.5 * GOAL_R_PCT.0,
        0.5 * GOAL_R_PCT.1,
    );
    let lines = lines(runs);
    for (builder, _) in BUILDERS {
        let own: Vec<&MapLine> = lines.iter().filter(|l| l.builder == builder).collect();
        if own.is_empty() {
            continue;
        }
        let _ = writeln!(out, "### By {builder}\n");
        out.push_str(
            "| pot | cells | observed | R | L | unseen | R | L | z rms | |\n\
             |---|---:|---:|---:|---:|---:|---:|---:|---:|---|\n",
        );
        for line in own {
            out.push_str(&row(line));
        }
        out.push('\n');
    }
    out
}

fn row(line: &MapLine) -> String {
    let pair = |mean: Option<f64>, worst: Option<f64>| match (mean, worst) {
        (Some(mean), Some(worst)) => format!("{mean:.2}/{worst:.2}"),
        _ => "–".into(),
    };
    let cells = |e: Option<&CellErrors>| match e {
        Some(e) => format!(
            "{} | {} | {}",
            e.cells,
            pair(e.r_mean_pct, e.r_worst_pct),
            pair(e.l_mean_pct, e.l_worst_pct)
        ),
        None => "– | – | –".into(),
    };
    let error = line.error.as_ref();
    let z = error.and_then(|e| e.z_rms);
    let name = match line.perturbation {
        Some(p) => format!("{}, {p}", line.pot),
        None => line.pot.clone(),
    };
    let verdict = match (line.reached, line.refused) {
        (0, _) => "not heated".into(),
        (_, 0) => match line.met {
            Some(true) => "met".into(),
            Some(false) => "**missed**".into(),
            None => "not judged".into(),
        },
        (_, n) => {
            let why = line.why.as_deref().unwrap_or("no reason");
            // The advice in a reason is left out of the table.
            let why = why.split(';').next().unwrap_or(why);
            format!("**refused** {n} of {}: {why}", line.seeds)
        }
    };
    format!(
        "| {name} | {} | {} | {} | {} | {verdict} |\n",
        line.reached,
        cells(error.map(|e| &e.observed)),
        cells(error.map(|e| &e.unseen)),
        z.map_or("–".into(), |z| format!("{z:.1}")),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(pot: &str, seed: u64, r_mean: f64, r_worst: f64, refused: Option<&str>) -> MapRun {
        let unseen = CellErrors {
            cells: 9,
            r_mean_pct: Some(r_mean),
            r_worst_pct: Some(r_worst),
            l_mean_pct: Some(0.1),
            l_worst_pct: Some(0.2),
        };
        let error = LookupAccuracy {
            observed: CellErrors::default(),
            unseen,
            z_rms: Some(1.5),
        };
        MapRun {
            pot: pot.into(),
            perturbation: None,
            seed,
            reached: 9,
            shown: Vec::new(),
            map: Some(LookupJudgement {
                refused: refused.map(str::to_owned),
                error: Some(error),
                cells: Vec::new(),
            }),
            learned: None,
        }
    }

    #[test]
    fn seeds_are_merged_and_one_beyond_the_goal_misses_it() {
        let runs = [run("a", 1, 1.0, 3.0, None), run("a", 2, 1.6, 4.0, None)];
        let line = &lines(&runs)[0];
        let unseen = line.error.unwrap().unseen;
        assert_eq!(
            (unseen.r_mean_pct, unseen.r_worst_pct),
            (Some(1.3), Some(4.0))
        );
        assert_eq!((line.met, line.refused), (Some(true), 0));
        let runs = [run("a", 1, 1.0, 3.0, None), run("a", 2, 1.0, 5.1, None)];
        assert_eq!(lines(&runs)[0].met, Some(false));
    }

    #[test]
    fn a_refused_lookup_is_never_met_and_says_why() {
        let runs = [
            run("a", 1, 0.1, 0.2, Some("cell 9 differs; move it")),
            run("b", 1, 0.1, 0.2, None),
        ];
        let lines = lines(&runs);
        assert_eq!((lines[0].met, lines[1].met), (Some(false), Some(true)));
        let text = row(&lines[0]);
        assert!(
            text.contains("**refused** 1 of 1: cell 9 differs |"),
            "{text}"
        );
    }

    #[test]
    fn a_lookup_without_an_unseen_cell_is_not_judged_and_hides_no_miss() {
        let unseen = |seed, errors| {
            let mut run = run("a", seed, 9.0, 9.0, None);
            let judgement = run.map.as_mut().unwrap();
            judgement.error.as_mut().unwrap().unseen = errors;
            run
        };
        let none = unseen(1, CellErrors::default());
        let line = &lines(std::slice::from_ref(&none))[0];
        assert_eq!(line.met, None);
        assert!(row(line).ends_with("not judged |\n"));
        let missed = run("a", 2, 9.0, 9.0, None);
        assert_eq!(lines(&[none, missed])[0].met, Some(false));
    }

    #[test]
    fn a_pot_that_is_not_heated_is_said_to_be_so() {
        let mut none = run("plate", 1, 0.0, 0.0, None);
        (none.reached, none.map) = (0, None);
        let runs = [run("a", 1, 1.0, 3.0, None), none];
        let lines = lines(&runs);
        assert_eq!(lines.len(), 2);
        assert!(row(&lines[1]).contains("not heated"));
        assert_eq!(lines[1].met, Some(false));
    }
}
