//! Tables of the study.

use std::fmt::Write;

use serde::Serialize;

use super::{CookingKind, TemperatureRun};

/// First line of the section.
pub const BEGIN: &str = "<!-- ihd-study temperature: begin -->";

/// Last line of the section.
pub const END: &str = "<!-- ihd-study temperature: end -->";

/// Goal: largest distance of the reported from the true boil, in seconds.
const BOIL_GOAL_S: f64 = 20.0;

/// Smallest move that must be reported, in mm: 0.6 % of R and 1.2 % of L.
const MOVE_MM: f64 = 0.2;

/// Time before the truth from which on an early report of a plateau or a boil counts as false, in seconds.
const FALSE_BEFORE_S: f64 = 60.0;

/// Temperature of the base in °C below which a report of overheating is false.
const OVERHEATS_C: f64 = 170.0;

/// Sums of all runs with one spread of alloys.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct TemperatureSums {
    /// Number of runs.
    pub runs: usize,
    /// ΔT in K rms, over the runs that boil; `None` without any.
    pub boiling_rms_k: Option<f64>,
    /// ΔT in K rms, over the runs that do not boil.
    pub quiet_rms_k: Option<f64>,
    /// Errors over the stated deviations, rms.
    pub z_rms: Option<f64>,
    /// Number of boils.
    pub boils: usize,
    /// Number of reported boils.
    pub boils_found: usize,
    /// Median time from the true to the reported boil, in seconds.
    pub boil_median_s: Option<f64>,
    /// 90th percentile of its magnitude.
    pub boil_p90_s: Option<f64>,
    /// Largest magnitude.
    pub boil_worst_s: Option<f64>,
    /// Number of boils reported within 20 s.
    pub boils_within_goal: usize,
    /// Median time from the true plateau (bubbles carry half of the heat) to its report, in seconds.
    pub bubbles_median_s: Option<f64>,
    /// Largest magnitude of it.
    pub bubbles_worst_s: Option<f64>,
    /// Number of boils reported without one, or more than a minute too early: they count as false alone.
    pub false_boils: usize,
    /// Number of plateaus reported without one, or more than a minute too early: they count as false alone.
    pub false_bubbles: usize,
    /// Number of moves of more than 0.2 mm.
    pub moves: usize,
    /// Number of reported moves.
    pub moves_found: usize,
    /// Number of reported moves that did not happen.
    pub false_moves: usize,
    /// Number of runs with overheating reported while the base was below 170 °C.
    pub false_overheats: usize,
}

fn rms(square: f64, readings: u32) -> Option<f64> {
    (readings > 0).then(|| (square / f64::from(readings)).sqrt())
}

/// Value below which a share of the values lies.
fn quantile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    values.get((share * last as f64).round() as usize).copied()
}

/// True and reported time of an event, in seconds.
type EventTimes = (Option<f64>, Option<f64>);

fn is_false((truth_s, reported_s): EventTimes) -> bool {
    reported_s.is_some_and(|reported_s| {
        truth_s.is_none_or(|truth_s| reported_s < truth_s - FALSE_BEFORE_S)
    })
}

/// Times from the truth to its report in seconds, and the number of false reports.
fn compare(runs: &[TemperatureRun], times: fn(&TemperatureRun) -> EventTimes) -> (Vec<f64>, usize) {
    let (wrong, right): (Vec<_>, Vec<_>) = runs.iter().map(times).partition(|t| is_false(*t));
    let off = |(truth_s, reported_s): EventTimes| Some(reported_s? - truth_s?);
    (right.into_iter().filter_map(off).collect(), wrong.len())
}

impl TemperatureSums {
    /// Sums the runs.
    pub fn summarise(runs: &[TemperatureRun]) -> Self {
        let over = |boils: bool| {
            let of = runs
                .iter()
                .filter(|r| CookingKind::BOILS.contains(&r.kind) == boils);
            of.fold((0.0, 0), |(s, n), r| (s + r.squares_k2, n + r.readings))
        };
        let (boiling, quiet) = (over(true), over(false));
        let z: f64 = runs.iter().map(|r| r.z_squares).sum();
        let (boils, false_boils) = compare(runs, |r| (r.boils_s, r.boils_reported_s));
        let (bubbles, false_bubbles) = compare(runs, |r| (r.bubbles_s, r.bubbles_reported_s));
        let apart = |x: &[f64]| x.iter().map(|x| x.abs()).collect::<Vec<_>>();
        let has_moved = |r: &&TemperatureRun| r.moved_mm.abs() > MOVE_MM;
        Self {
            runs: runs.len(),
            boiling_rms_k: rms(boiling.0, boiling.1),
            quiet_rms_k: rms(quiet.0, quiet.1),
            z_rms: rms(z, boiling.1 + quiet.1),
            boils: runs.iter().filter(|r| r.boils_s.is_some()).count(),
            boils_found: boils.len(),
            boil_median_s: quantile(boils.clone(), 0.5),
            boil_p90_s: quantile(apart(&boils), 0.9),
            boil_worst_s: quantile(apart(&boils), 1.0),
            boils_within_goal: boils.iter().filter(|x| x.abs() <= BOIL_GOAL_S).count(),
            bubbles_median_s: quantile(bubbles.clone(), 0.5),
            bubbles_worst_s: quantile(apart(&bubbles), 1.0),
            false_boils,
            false_bubbles,
            moves: runs.iter().filter(has_moved).count(),
            moves_found: runs
                .iter()
                .filter(has_moved)
                .filter(|r| r.moves_reported > 0)
                .count(),
            false_moves: runs.iter().map(|r| r.moves_wrong as usize).sum(),
            false_overheats: runs
                .iter()
                .filter(|r| r.overheat_reported_c.is_some_and(|c| c < OVERHEATS_C))
                .count(),
        }
    }
}

fn number(x: Option<f64>, digits: usize) -> String {
    x.map_or("–".to_owned(), |x| format!("{x:.digits$}"))
}

/// A row of the sums: its name, the cell of a sum, and the goal.
type SumRow = (&'static str, fn(&TemperatureSums) -> String, &'static str);

const SUM_ROWS: [SumRow; 14] = [
    ("runs", |s| s.runs.to_string(), ""),
    (
        "ΔT up to 150 °C, runs that boil, K rms",
        |s| number(s.boiling_rms_k, 1),
        "5",
    ),
    (
        "ΔT up to 150 °C, runs that do not, K rms",
        |s| number(s.quiet_rms_k, 1),
        "5",
    ),
    (
        "error over the σ that is said, rms",
        |s| number(s.z_rms, 2),
        "1",
    ),
    (
        "boils found",
        |s| format!("{} of {}", s.boils_found, s.boils),
        "all",
    ),
    (
        "boil, said after the true one: median s",
        |s| number(s.boil_median_s, 0),
        "",
    ),
    (
        "boil, away from the true one: 90 % · worst s",
        |s| pair(s.boil_p90_s, s.boil_worst_s),
        "20",
    ),
    (
        "boils within 20 s",
        |s| s.boils_within_goal.to_string(),
        "all",
    ),
    (
        "plateau of the base, said after it began: median · worst s",
        |s| pair(s.bubbles_median_s, s.bubbles_worst_s),
        "",
    ),
    (
        "false boils: none true, or over 60 s early; in no row above",
        |s| s.false_boils.to_string(),
        "0",
    ),
    (
        "false plateaus: the same",
        |s| s.false_bubbles.to_string(),
        "",
    ),
    (
        "moves of 0.2 mm and more found",
        |s| format!("{} of {}", s.moves_found, s.moves),
        "",
    ),
    (
        "moves told that were none",
        |s| s.false_moves.to_string(),
        "",
    ),
    (
        "said to overheat below 170 °C",
        |s| s.false_overheats.to_string(),
        "",
    ),
];

fn pair(a: Option<f64>, b: Option<f64>) -> String {
    format!("{} · {}", number(a, 0), number(b, 0))
}

/// Section: sums side by side, and a line for each kind of the first.
pub fn markdown(sums: &[(String, Vec<TemperatureRun>)]) -> String {
    let mut out = String::new();
    let all: Vec<TemperatureSums> = sums
        .iter()
        .map(|(_, runs)| TemperatureSums::summarise(runs))
        .collect();
    let names: Vec<&str> = sums.iter().map(|(name, _)| name.as_str()).collect();
    let _ = writeln!(out, "| | {} | goal |", names.join(" | "));
    let _ = writeln!(out, "|---|{}---:|", "---:|".repeat(names.len()));
    for (what, cell, goal) in SUM_ROWS {
        let cells: Vec<String> = all.iter().map(cell).collect();
        let _ = writeln!(out, "| {what} | {} | {goal} |", cells.join(" | "));
    }
    if let Some((name, runs)) = sums.first() {
        out += &kinds(name, runs);
    }
    out
}

/// Table with a row for each kind of cooking.
fn kinds(name: &str, runs: &[TemperatureRun]) -> String {
    let mut out = String::new();
    let _ = writeln!(
        out,
        "\n| {name} | runs | ΔT up to 150 °C, K rms | worst K | boils said | true |"
    );
    let _ = writeln!(out, "|---|---:|---:|---:|---:|---:|");
    for kind in CookingKind::BOILS.into_iter().chain(CookingKind::QUIET) {
        let of: Vec<&TemperatureRun> = runs.iter().filter(|r| r.kind == kind).collect();
        let readings = of.iter().map(|r| r.readings).sum();
        let square = of.iter().map(|r| r.squares_k2).sum();
        let _ = writeln!(
            out,
            "| {} | {} | {} | {} | {} | {} |",
            kind.name(),
            of.len(),
            number(rms(square, readings), 1),
            number(quantile(of.iter().map(|r| r.worst_k).collect(), 1.0), 0),
            of.iter().filter(|r| r.boils_reported_s.is_some()).count(),
            of.iter().filter(|r| r.boils_s.is_some()).count(),
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(truth_s: Option<f64>, reported_s: Option<f64>) -> TemperatureRun {
        TemperatureRun {
            seed: 1,
            kind: CookingKind::Boil,
            pot: String::new(),
            contents: String::new(),
            power_w: 1000.0,
            squares_k2: 400.0,
            readings: 100,
            z_squares: 100.0,
            worst_k: 3.0,
            bubbles_s: None,
            bubbles_reported_s: None,
            boils_s: truth_s,
            boils_reported_s: reported_s,
            moved_mm: 0.3,
            moves_reported: 0,
            moves_wrong: 1,
            overheat_reported_c: Some(169.0),
        }
    }

    #[test]
    fn false_and_missed_boils_are_counted_as_such() {
        let runs = [
            run(Some(300.0), Some(310.0)),
            run(Some(300.0), Some(260.0)),
            run(Some(300.0), Some(100.0)),
            run(Some(300.0), None),
            run(None, Some(50.0)),
            run(None, None),
        ];
        let sum = TemperatureSums::summarise(&runs);
        assert_eq!((sum.boils, sum.boils_found, sum.false_boils), (4, 2, 2));
        assert_eq!((sum.boils_within_goal, sum.boil_worst_s), (1, Some(40.0)));
        assert_eq!((sum.boiling_rms_k, sum.z_rms), (Some(2.0), Some(1.0)));
        assert_eq!((sum.moves, sum.moves_found, sum.false_moves), (6, 0, 6));
        assert_eq!(sum.false_overheats, 6);
        let text = markdown(&[("a".into(), runs.to_vec())]);
        assert!(text.contains("in no row above | 2 | 0 |"), "{text}");
    }

    #[test]
    fn a_plateau_without_bubbles_is_false_and_so_is_one_a_minute_early() {
        let plateau = |bubbles_s, bubbles_reported_s| TemperatureRun {
            bubbles_s,
            bubbles_reported_s,
            ..run(None, None)
        };
        let runs = [
            plateau(Some(100.0), Some(130.0)),
            plateau(Some(100.0), Some(39.0)),
            plateau(None, Some(50.0)),
            plateau(Some(100.0), None),
        ];
        let sum = TemperatureSums::summarise(&runs);
        assert_eq!((sum.false_bubbles, sum.false_boils), (2, 0));
        assert_eq!(sum.bubbles_worst_s, Some(30.0));
    }

    /// A pot that overheats later was not yet hot when that was said.
    #[test]
    fn overheating_is_judged_at_its_report() {
        let at = |overheat_reported_c| TemperatureRun {
            overheat_reported_c,
            ..run(None, None)
        };
        let runs = [at(Some(171.0)), at(Some(150.0)), at(None)];
        assert_eq!(TemperatureSums::summarise(&runs).false_overheats, 1);
    }
}
