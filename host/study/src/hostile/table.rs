//! The study as Markdown, for docs/identification.md, and its verdict.

use std::collections::BTreeSet;
use std::fmt::Write;

use ihd_identify::Method;
use serde::Serialize;

use super::case::CaptureGroup;
use super::run::HostileRun;
use super::score::{LIMIT_L_PCT, LIMIT_R_PCT, ResultJudgement, StretchErrors, larger};

/// First line of the section in docs/identification.md.
pub const BEGIN: &str = "<!-- ihd-study hostile: begin -->";

/// Last line of the section.
pub const END: &str = "<!-- ihd-study hostile: end -->";

/// Largest share of false refusals among correct runs of clean captures, in percent.
pub const FALSE_REFUSALS_PCT: f64 = 2.0;

/// Sums of the study, of one method or all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct HostileSums {
    /// Number of runs.
    pub runs: usize,
    /// Number of runs of clean captures.
    pub clean: usize,
    /// Number of clean runs that were correct, refused or not.
    pub clean_right: usize,
    /// Number of clean runs refused although correct.
    pub falsely_refused: usize,
    /// Number of clean runs that were correct and passed with a warning.
    pub warned: usize,
    /// Number of runs that were wrong without a finding.
    pub silent: usize,
    /// Number of runs that were wrong without a finding, of a defect that no capture can show.
    pub invisible: usize,
    /// Largest error over σ of these.
    pub invisible_per_sigma: Option<f64>,
    /// Largest error over σ of the others without a finding.
    pub worst_per_sigma: Option<f64>,
}

impl HostileSums {
    /// Sums some runs.
    pub fn summarise<'a>(runs: impl IntoIterator<Item = &'a HostileRun>) -> Self {
        let mut sum = Self::default();
        for run in runs {
            sum.runs += 1;
            sum.worst_per_sigma = larger(sum.worst_per_sigma, run.unremarked_per_sigma);
            let clean = usize::from(run.group == CaptureGroup::Clean);
            sum.clean += clean;
            match run.judged {
                ResultJudgement::Right => sum.clean_right += clean,
                ResultJudgement::Warned => {
                    sum.clean_right += clean;
                    sum.warned += clean;
                }
                ResultJudgement::FalselyRefused => {
                    sum.clean_right += clean;
                    sum.falsely_refused += clean;
                }
                ResultJudgement::Silent => sum.silent += 1,
                ResultJudgement::Invisible => {
                    sum.invisible += 1;
                    let own = run.errors.and_then(|e| e.per_sigma);
                    sum.invisible_per_sigma = larger(sum.invisible_per_sigma, own);
                }
                ResultJudgement::Said | ResultJudgement::Careful => {}
            }
        }
        sum
    }

    /// False refusals among the correct runs of clean captures in percent.
    pub fn false_refusals_pct(&self) -> f64 {
        share_pct(self.falsely_refused, self.clean_right)
    }

    /// Returns `true` if the goals are met.
    pub fn is_met(&self) -> bool {
        self.silent == 0 && self.false_refusals_pct() <= FALSE_REFUSALS_PCT
    }
}

fn share_pct(part: usize, whole: usize) -> f64 {
    100.0 * part as f64 / whole.max(1) as f64
}

/// Section without its marks.
pub fn markdown(runs: &[HostileRun], seeds: u64) -> String {
    let methods: Vec<Method> = (Method::ALL.into_iter())
        .filter(|m| runs.iter().any(|r| r.method == *m))
        .collect();
    let mut out = String::new();
    let _ = writeln!(
        out,
        "{} captures × {seeds} seeds of noise, one where there is none. A cell is the error of R/L in % over the middle 80 % of the \
         worst half-cycle, then |error|/σ (rms, the larger of R and L), both the worst of all seeds, and what came of it: nothing \
         right and passed, w right and warned, s wrong and said (warned or refused), c right but refused, of a faulty capture, **F** \
         right but refused, of a clean one, **SILENT** wrong ({LIMIT_R_PCT} % of R, {LIMIT_L_PCT} % of L) without a word, **u** the \
         same where no capture can show it: another gain is another capacitor; – no estimate. False refusals and warnings are of \
         the clean runs that were right.\n",
        cases(runs).len()
    );
    out.push_str(&sums(runs, &methods));
    for (is_clean, title) in [(true, "Nothing wrong"), (false, "Something wrong")] {
        let of_group = |r: &&HostileRun| (r.group == CaptureGroup::Clean) == is_clean;
        let own: Vec<&HostileRun> = runs.iter().filter(of_group).collect();
        if !own.is_empty() {
            let _ = writeln!(out, "\n### {title}\n");
            out.push_str(&matrix(&own, &methods));
        }
    }
    out
}

/// Names of the cases, in order.
fn cases(runs: &[HostileRun]) -> Vec<&str> {
    let mut names: Vec<&str> = runs.iter().map(|r| r.case.as_str()).collect();
    names.dedup();
    names
}

/// One line per method, and one for all.
fn sums(runs: &[HostileRun], methods: &[Method]) -> String {
    let mut out = String::from(
        "| method | false refusals | warned of, clean and right | silent | cannot be seen | worst error/σ without a word, of the others |\n\
         |---|---:|---:|---:|---:|---:|\n",
    );
    let mut line = |name: &str, sum: &HostileSums| {
        let invisible = match sum.invisible_per_sigma {
            Some(x) => format!("{} (up to {}σ)", sum.invisible, number(x)),
            None => sum.invisible.to_string(),
        };
        let _ = writeln!(
            out,
            "| {name} | {} of {right} ({:.1} %) | {} of {right} ({:.1} %) | {} of {} | {invisible} | {} |",
            sum.falsely_refused,
            sum.false_refusals_pct(),
            sum.warned,
            share_pct(sum.warned, sum.clean_right),
            sum.silent,
            sum.runs,
            sum.worst_per_sigma.map_or("–".to_owned(), number),
            right = sum.clean_right,
        );
    };
    for &method in methods {
        line(
            method.name(),
            &HostileSums::summarise(runs.iter().filter(|r| r.method == method)),
        );
    }
    line("all", &HostileSums::summarise(runs));
    out
}

fn matrix(runs: &[&HostileRun], methods: &[Method]) -> String {
    let mut out = String::from("| capture |");
    methods.iter().for_each(|m| {
        let _ = write!(out, " {m} |");
    });
    out.push_str(" said |\n|---|");
    out.push_str(&"---:|".repeat(methods.len()));
    out.push_str("---|\n");
    let mut names: Vec<&str> = runs.iter().map(|r| r.case.as_str()).collect();
    names.dedup();
    for name in names {
        let own: Vec<&HostileRun> = runs.iter().copied().filter(|r| r.case == name).collect();
        let _ = write!(out, "| {name} |");
        for method in methods {
            let of_method: Vec<&HostileRun> = own
                .iter()
                .copied()
                .filter(|r| r.method == *method)
                .collect();
            let _ = write!(out, " {} |", cell(&of_method));
        }
        let codes: BTreeSet<&str> = own
            .iter()
            .flat_map(|r| r.codes.iter().map(String::as_str))
            .collect();
        let codes: Vec<&str> = codes.into_iter().collect();
        let _ = writeln!(out, " {} |", codes.join(", "));
    }
    out
}

/// All seeds of a method on a case.
fn cell(runs: &[&HostileRun]) -> String {
    if runs.is_empty() {
        return "not run".to_owned();
    }
    let errors = runs
        .iter()
        .filter_map(|r| r.errors)
        .reduce(StretchErrors::or_worse);
    let mut text = match errors {
        Some(e) => {
            let per_sigma = e
                .per_sigma
                .map_or(String::new(), |x| format!(" {}σ", number(x)));
            format!("{}/{}{per_sigma}", number(e.r_pct), number(e.l_pct))
        }
        None => "–".to_owned(),
    };
    if let Some(worst) = runs.iter().map(|r| r.judged).max() {
        let count = runs.iter().filter(|r| r.judged == worst).count();
        let mark = match worst {
            ResultJudgement::Right => return text,
            ResultJudgement::Warned => "w",
            ResultJudgement::Said => "s",
            ResultJudgement::Careful => "c",
            ResultJudgement::FalselyRefused => "**F**",
            ResultJudgement::Invisible => "**u**",
            ResultJudgement::Silent => "**SILENT**",
        };
        let _ = match count == runs.len() {
            true => write!(text, " {mark}"),
            false => write!(text, " {mark} {count}/{}", runs.len()),
        };
    }
    text
}

/// Formats two significant digits.
fn number(x: f64) -> String {
    match x {
        x if !x.is_finite() => "∞".to_owned(),
        x if x >= 1e4 => "> 10⁴".to_owned(),
        x if x >= 9.95 => format!("{x:.0}"),
        x if x >= 0.995 => format!("{x:.1}"),
        x => format!("{x:.2}").trim_start_matches('0').to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(group: CaptureGroup, seed: u64, r_pct: f64, judged: ResultJudgement) -> HostileRun {
        HostileRun {
            case: "a".into(),
            group,
            seed,
            method: Method::Lockin,
            stretches: 1,
            errors: Some(StretchErrors {
                r_pct,
                l_pct: 0.1,
                per_sigma: Some(2.0),
            }),
            refused: false,
            codes: vec!["skew".into()],
            judged,
            unremarked_per_sigma: None,
            why: None,
            elapsed_s: 0.0,
        }
    }

    #[test]
    fn the_goals_allow_two_percent_of_false_refusals_and_no_silent_error() {
        let mut runs: Vec<_> = (0..50)
            .map(|s| run(CaptureGroup::Clean, s, 0.1, ResultJudgement::Right))
            .collect();
        runs[0].judged = ResultJudgement::FalselyRefused;
        assert!(HostileSums::summarise(&runs).is_met(), "2 %");
        runs[1].judged = ResultJudgement::FalselyRefused;
        assert!(!HostileSums::summarise(&runs).is_met(), "4 %");
        let silent = [run(CaptureGroup::Faulty, 1, 3.0, ResultJudgement::Silent)];
        assert_eq!(HostileSums::summarise(&silent).silent, 1);
        assert!(!HostileSums::summarise(&silent).is_met());
    }

    #[test]
    fn a_wrong_clean_run_does_not_dilute_the_false_refusals() {
        let mut runs: Vec<_> = (0..50)
            .map(|s| run(CaptureGroup::Clean, s, 0.1, ResultJudgement::Right))
            .collect();
        runs[0].judged = ResultJudgement::FalselyRefused;
        runs[1].judged = ResultJudgement::Said;
        let sum = HostileSums::summarise(&runs);
        assert_eq!((sum.clean, sum.clean_right), (50, 49));
        assert!(!sum.is_met(), "1 of 49 is more than 2 %");
    }

    #[test]
    fn what_no_capture_shows_is_neither_silent_nor_said() {
        let mut invisible = run(CaptureGroup::Invisible, 1, 3.0, ResultJudgement::Invisible);
        invisible.codes.clear();
        let sum = HostileSums::summarise([&invisible]);
        assert_eq!((sum.silent, sum.invisible), (0, 1));
        assert_eq!(sum.invisible_per_sigma, Some(2.0));
        let text = markdown(&[invisible], 1);
        assert!(text.contains("| a | 3.0/.10 2.0σ **u** |  |"), "{text}");
    }

    #[test]
    fn a_method_that_was_not_run_on_a_capture_is_no_failed_one() {
        let mut other = run(CaptureGroup::Clean, 1, 0.1, ResultJudgement::Right);
        (other.case, other.method) = ("b".into(), Method::Firmware);
        let runs = [
            run(CaptureGroup::Clean, 1, 0.1, ResultJudgement::Right),
            other,
        ];
        let text = markdown(&runs, 1);
        assert!(
            text.contains("| a | .10/.10 2.0σ | not run | skew |"),
            "{text}"
        );
    }

    #[test]
    fn a_cell_shows_the_worst_seed_and_how_many_it_befell() {
        let runs = [
            run(CaptureGroup::Faulty, 1, 0.5, ResultJudgement::Right),
            run(CaptureGroup::Faulty, 2, 2.0, ResultJudgement::Silent),
        ];
        let text = markdown(&runs, 2);
        assert!(
            text.contains("| a | 2.0/.10 2.0σ **SILENT** 1/2 | skew |"),
            "{text}"
        );
    }
}
