//! Reads the closing lines of test runners: how many tests passed, failed and were skipped.

use std::fmt;
use std::ops::AddAssign;

/// Tests by how they ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    pub passed: u64,
    pub failed: u64,
    pub skipped: u64,
}

impl AddAssign for Counts {
    fn add_assign(&mut self, other: Self) {
        self.passed += other.passed;
        self.failed += other.failed;
        self.skipped += other.skipped;
    }
}

/// The plain closing line that CI reads.
impl fmt::Display for Counts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} passed, {} failed", self.passed, self.failed)?;
        if self.skipped > 0 {
            write!(f, ", {} skipped", self.skipped)?;
        }
        Ok(())
    }
}

/// Who runs the tests. It must be known: nextest shows a failed test's output, and in that output stands a closing
/// line of libtest, which would count the same test twice.
#[derive(Clone, Copy, Debug)]
pub enum Runner {
    /// `cargo nextest run`
    Nextest,
    /// `cargo test`
    Libtest,
}

impl Runner {
    /// The counts in `line`, if it is this runner's closing line.
    pub fn closing_line(self, line: &str) -> Option<Counts> {
        let plain = without_colour(line);
        let plain = plain.trim();
        match self {
            Self::Nextest => {
                let (_seconds, rest) = plain.strip_prefix("Summary [")?.split_once(']')?;
                let (ran, ended) = rest.split_once(" run:")?;
                ran.contains("test").then(|| nextest(ended))
            }
            Self::Libtest => {
                let (_verdict, ended) = plain.strip_prefix("test result: ")?.split_once(". ")?;
                Some(libtest(ended))
            }
        }
    }
}

/// `45 passed (1 slow, 2 flaky), 1 failed, 1 timed out, 3 skipped`: what is in brackets is counted already.
fn nextest(ended: &str) -> Counts {
    let mut counts = Counts::default();
    for (number, how) in items(&without_brackets(ended), ',') {
        match how.as_str() {
            "passed" => counts.passed += number,
            "skipped" => counts.skipped += number,
            // failed, exec failed, timed out: whatever else nextest names did not pass.
            _ => counts.failed += number,
        }
    }
    counts
}

/// `12 passed; 0 failed; 1 ignored; 0 measured; 2 filtered out; finished in 0.00s`
fn libtest(ended: &str) -> Counts {
    let mut counts = Counts::default();
    for (number, how) in items(ended, ';') {
        match how.as_str() {
            "passed" | "measured" => counts.passed += number,
            "failed" => counts.failed += number,
            "ignored" | "filtered out" => counts.skipped += number,
            _ => {}
        }
    }
    counts
}

/// `3 passed` and the like, separated by `mark`; what starts with no number is left out.
fn items(list: &str, mark: char) -> Vec<(u64, String)> {
    list.split(mark)
        .filter_map(|item| {
            let (number, how) = item.trim().split_once(' ')?;
            Some((number.parse().ok()?, how.trim().to_owned()))
        })
        .collect()
}

fn without_brackets(text: &str) -> String {
    let mut depth = 0_u32;
    let outside = |c: &char| {
        match c {
            '(' => depth += 1,
            ')' => depth = depth.saturating_sub(1),
            _ => return depth == 0,
        }
        false
    };
    text.chars().filter(outside).collect()
}

/// Without the escape sequences that colour a terminal: `ESC [ … letter`.
fn without_colour(line: &str) -> String {
    let mut plain = String::with_capacity(line.len());
    let mut rest = line;
    while let Some((before, escape)) = rest.split_once('\x1b') {
        plain.push_str(before);
        let end = escape.find(|c: char| c.is_ascii_alphabetic());
        rest = end.map_or("", |end| &escape[end + 1..]);
    }
    plain + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counts(passed: u64, failed: u64, skipped: u64) -> Option<Counts> {
        Some(Counts {
            passed,
            failed,
            skipped,
        })
    }

    #[test]
    fn reads_nextest() {
        let line = "     Summary [   0.012s] 45 tests run: 45 passed, 0 skipped";
        assert_eq!(Runner::Nextest.closing_line(line), counts(45, 0, 0));
        let line = "     Summary [   0.001s] 1 test run: 1 passed, 2 skipped";
        assert_eq!(Runner::Nextest.closing_line(line), counts(1, 0, 2));
    }

    #[test]
    fn reads_nextest_with_every_kind_of_failure() {
        let line = "Summary [  9.1s] 9 tests run: 4 passed (1 slow, 2 flaky, 1 leaky), 1 failed, \
                    1 exec failed, 3 timed out, 7 skipped";
        assert_eq!(Runner::Nextest.closing_line(line), counts(4, 5, 7));
    }

    #[test]
    fn reads_nextest_cut_short() {
        let line = "Summary [   0.2s] 2/45 tests run: 1 passed, 1 failed, 3 skipped";
        assert_eq!(Runner::Nextest.closing_line(line), counts(1, 1, 3));
    }

    #[test]
    fn reads_nextest_in_colour() {
        let line = "\x1b[32;1m     Summary\x1b[0m [   0.012s] \x1b[1m2\x1b[0m tests run: \
                    \x1b[1m2\x1b[0m \x1b[32;1mpassed\x1b[0m, \x1b[1m0\x1b[0m \x1b[33;1mskipped\x1b[0m";
        assert_eq!(Runner::Nextest.closing_line(line), counts(2, 0, 0));
    }

    #[test]
    fn reads_cargo_test() {
        let line = "test result: ok. 12 passed; 0 failed; 1 ignored; 0 measured; 2 filtered out; \
                    finished in 0.00s";
        assert_eq!(Runner::Libtest.closing_line(line), counts(12, 0, 3));
        let line = "test result: FAILED. 3 passed; 2 failed; 0 ignored; 0 measured; 0 filtered out";
        assert_eq!(Runner::Libtest.closing_line(line), counts(3, 2, 0));
    }

    #[test]
    fn other_lines_hold_no_counts() {
        for line in [
            "",
            "running 3 tests",
            "Summary of the study: 3 passed",
            "test wire::golden ... ok",
        ] {
            assert_eq!(Runner::Nextest.closing_line(line), None, "{line}");
            assert_eq!(Runner::Libtest.closing_line(line), None, "{line}");
        }
    }

    #[test]
    fn a_failed_test_shown_by_nextest_is_not_counted_twice() {
        let shown =
            "    test result: FAILED. 0 passed; 1 failed; 0 ignored; 0 measured; 44 filtered out";
        assert_eq!(Runner::Nextest.closing_line(shown), None);
    }

    #[test]
    fn adds_up_and_prints_the_plain_line() {
        let mut sum = counts(2, 0, 0).unwrap();
        assert_eq!(sum.to_string(), "2 passed, 0 failed");
        sum += counts(1, 1, 4).unwrap();
        assert_eq!(sum.to_string(), "3 passed, 1 failed, 4 skipped");
    }
}
