//! The report as text.

use std::fmt::Write;

use ihd_doctor::{Check, CheckGroup, CheckResult, Report};

use crate::report;

/// Width of the column before a finding.
const INDENT: usize = 32;

/// Limit of a line's width.
const WIDTH: usize = 118;

/// Formats a report.
pub(super) fn render(report: &Report) -> String {
    let mut text = String::new();
    for group in &report.groups {
        of_group(&mut text, group, report.device.as_deref());
    }
    let counts = report.counts;
    let _ = writeln!(
        text,
        "{} passed, {} failed, {} not tested",
        counts.pass, counts.fail, counts.not_tested
    );
    text
}

fn of_group(text: &mut String, group: &CheckGroup, device: Option<&str>) {
    let heading = match (group.name, device) {
        ("machine", _) | (_, None) => group.name.replace('_', " "),
        (name, Some(device)) => format!("{}: {device}", name.replace('_', " ")),
    };
    let _ = writeln!(text, "{heading}");
    for checks in group.checks.chunk_by(are_alike) {
        match checks {
            [one] => of_check(text, one),
            [first, ..] => of_alike(text, checks, first),
            [] => {}
        }
    }
    text.push('\n');
}

/// Returns `true` if two checks were not tested for the same reason, which is then printed once.
fn are_alike(a: &Check, b: &Check) -> bool {
    a.verdict == CheckResult::NotTested && (a.verdict, &a.finding) == (b.verdict, &b.finding)
}

/// Formats checks that were not tested for the same reason.
fn of_alike(text: &mut String, checks: &[Check], first: &Check) {
    let names: Vec<_> = checks.iter().map(|check| check.name).collect();
    let line = format!("{}: {}", first.finding, names.join(", "));
    let head = format!("  {:<17} {:<10}", "…", first.verdict.as_str());
    for (n, line) in wrapped(&line).iter().enumerate() {
        let before = if n == 0 { head.as_str() } else { "" };
        let _ = writeln!(text, "{before:<INDENT$}{line}");
    }
}

fn of_check(text: &mut String, check: &Check) {
    let head = format!("  {:<17} {:<10}", check.name, check.verdict.as_str());
    let mut lines = wrapped(&check.finding);
    if let Some(remedy) = check
        .remedy
        .as_ref()
        .filter(|_| check.verdict != CheckResult::Pass)
    {
        lines.extend(wrapped(&format!("→ {remedy}")));
    }
    for (n, line) in lines.iter().enumerate() {
        let before = if n == 0 { head.as_str() } else { "" };
        let _ = writeln!(text, "{before:<INDENT$}{line}");
    }
}

/// Wraps text to the width of the findings.
fn wrapped(text: &str) -> Vec<String> {
    report::wrapped(text, WIDTH - INDENT, "")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_not_tested_for_one_reason_is_told_once() {
        let mut report = Report::new(None);
        let none = |name| Check::not_tested(name, "no device");
        let checks = ["idle", "clocks", "noise"].map(none).into();
        report.add(CheckGroup {
            name: "board",
            checks,
        });
        let text = render(&report);
        assert_eq!(text.matches("no device").count(), 1, "{text}");
        assert!(text.contains("no device: idle, clocks, noise"), "{text}");
    }

    #[test]
    fn what_failed_says_what_to_do_and_lines_fit() {
        let mut report = Report::new(Some("usb:A1".into()));
        let long = "a very long finding of many words ".repeat(8);
        report.add(CheckGroup {
            name: "board",
            checks: vec![
                Check::fail("clocks", long.trim(), "turn it"),
                Check::pass("noise", "fine").with_remedy("not shown"),
            ],
        });
        let text = render(&report);
        assert!(
            text.lines().all(|line| line.chars().count() <= WIDTH),
            "{text}"
        );
        assert!(
            text.starts_with("board: usb:A1\n  clocks            FAIL        a very"),
            "{text}"
        );
        assert!(text.contains("→ turn it"), "{text}");
        assert!(!text.contains("not shown"), "{text}");
        assert!(
            text.ends_with("1 passed, 1 failed, 0 not tested\n"),
            "{text}"
        );
    }
}
