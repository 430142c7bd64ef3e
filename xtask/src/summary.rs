//! What `cargo xtask test` closes with: a table of the steps, what went wrong, and the line that CI reads.

use std::fmt::Write;

use crate::count::Counts;
use crate::steps::{Ended, Outcome};

/// The table, the failures by step, and `N passed, N failed` alone on the last line.
pub fn render(outcomes: &[Outcome]) -> String {
    let mut text = String::from("\n━━ summary\n");
    text += &table(outcomes);
    for outcome in outcomes {
        if let Ended::Failed(why) = &outcome.ended {
            // Infallible: a String takes any text.
            let _ = writeln!(text, "{}: {}", outcome.step, why.trim_end());
        }
    }
    let _ = writeln!(text, "{}", tally(outcomes));
    text
}

fn table(outcomes: &[Outcome]) -> String {
    let mut text = String::from("step       result    seconds   passed   failed  skipped\n");
    for Outcome {
        step,
        ended,
        elapsed,
        counts,
    } in outcomes
    {
        let result = match ended {
            Ended::Passed => "ok",
            Ended::Failed(_) => "FAILED",
            Ended::NotRun => "not run",
        };
        let name = step.to_string();
        let _ = write!(
            text,
            "{name:<10} {result:<8} {:>8.1}",
            elapsed.as_secs_f64()
        );
        if let Some(Counts {
            passed,
            failed,
            skipped,
        }) = counts
        {
            let _ = write!(text, " {passed:>8} {failed:>8} {skipped:>8}");
        }
        text.push('\n');
    }
    text
}

/// All tests; a step that failed without a failing test counts as one failure, so that the line never says
/// `0 failed` under a red run.
fn tally(outcomes: &[Outcome]) -> Counts {
    let mut sum = Counts::default();
    for outcome in outcomes {
        let counts = outcome.counts.unwrap_or_default();
        sum += counts;
        if outcome.failed() && counts.failed == 0 {
            sum.failed += 1;
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::steps::Step;

    fn outcome(step: Step, ended: Ended, counts: Option<(u64, u64)>) -> Outcome {
        Outcome {
            step,
            ended,
            elapsed: Duration::from_millis(1500),
            counts: counts.map(|(passed, failed)| Counts {
                passed,
                failed,
                skipped: 0,
            }),
        }
    }

    #[test]
    fn the_last_line_is_the_sum_of_all_tests() {
        let text = render(&[
            outcome(Step::Fmt, Ended::Passed, None),
            outcome(Step::Tests, Ended::Passed, Some((40, 0))),
            outcome(Step::Doctests, Ended::Passed, Some((2, 0))),
        ]);
        assert!(text.ends_with("\n42 passed, 0 failed\n"), "{text}");
    }

    #[test]
    fn a_red_step_without_a_failing_test_still_counts() {
        let text = render(&[
            outcome(Step::Clippy, Ended::Failed("two warnings".into()), None),
            outcome(Step::Tests, Ended::Failed("exit 100".into()), Some((3, 2))),
            outcome(Step::Firmware, Ended::NotRun, None),
        ]);
        assert!(text.ends_with("\n3 passed, 3 failed\n"), "{text}");
        assert!(text.contains("clippy: two warnings\n"), "{text}");
        assert!(text.contains("firmware   not run"), "{text}");
    }
}
