//! Report: groups of checks, each with its verdict, evidence and remedy.

use ihd_signal::printable;
use serde::Serialize;

/// Result of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CheckResult {
    /// The check passed.
    Pass,
    /// The check failed.
    Fail,
    /// The check could not be made; the finding has the reason.
    NotTested,
}

impl CheckResult {
    /// Text in the report.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Fail => "FAIL",
            Self::NotTested => "not tested",
        }
    }
}

/// Measured number with its limits.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Measurement {
    /// Name of the measured quantity.
    pub name: &'static str,
    /// Measured value.
    pub value: f64,
    /// Unit; empty for a count.
    pub unit: &'static str,
    /// Lower limit, included; `None` if there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min: Option<f64>,
    /// Upper limit, included; `None` if there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max: Option<f64>,
}

impl Measurement {
    /// Creates a number without limits; it does not affect the verdict.
    pub fn informative(name: &'static str, value: f64, unit: &'static str) -> Self {
        Self {
            name,
            value,
            unit,
            min: None,
            max: None,
        }
    }

    /// Creates a number with two limits, both included.
    pub fn between(name: &'static str, value: f64, unit: &'static str, min: f64, max: f64) -> Self {
        Self {
            min: Some(min),
            max: Some(max),
            ..Self::informative(name, value, unit)
        }
    }

    /// Creates a number with an upper limit, included.
    pub fn at_most(name: &'static str, value: f64, unit: &'static str, max: f64) -> Self {
        Self {
            max: Some(max),
            ..Self::informative(name, value, unit)
        }
    }

    /// Creates a number with a lower limit, included.
    pub fn at_least(name: &'static str, value: f64, unit: &'static str, min: f64) -> Self {
        Self {
            min: Some(min),
            ..Self::informative(name, value, unit)
        }
    }

    /// Returns `true` if it is finite and within its limits.
    pub fn is_good(&self) -> bool {
        self.value.is_finite()
            && self.min.is_none_or(|min| self.value >= min)
            && self.max.is_none_or(|max| self.value <= max)
    }

    /// Number, unit and limits as text.
    pub fn text(&self) -> String {
        let unit = match self.unit {
            "" | "%" => self.unit.to_owned(),
            unit => format!(" {unit}"),
        };
        let value = format!("{} {}{unit}", self.name, number(self.value));
        match (self.min, self.max) {
            (Some(min), Some(max)) => format!("{value} ({} to {})", number(min), number(max)),
            (Some(min), None) => format!("{value} (at least {})", number(min)),
            (None, Some(max)) => format!("{value} (at most {})", number(max)),
            (None, None) => value,
        }
    }
}

/// Formats four significant digits at most.
fn number(x: f64) -> String {
    let digits = match x.abs() {
        a if a >= 1000.0 || a == 0.0 || a.fract() == 0.0 => 0,
        a if a >= 100.0 => 1,
        a if a >= 10.0 => 2,
        _ => 3,
    };
    let text = format!("{x:.digits$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

/// One check.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Check {
    /// Stable name: `clocks`.
    pub name: &'static str,
    /// Result.
    pub verdict: CheckResult,
    /// Finding as printable text.
    pub finding: String,
    /// Numbers that the verdict rests on.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub evidence: Vec<Measurement>,
    /// Remedy; `None` if nothing is to be done.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub remedy: Option<String>,
}

impl Check {
    fn new(name: &'static str, verdict: CheckResult, finding: impl AsRef<str>) -> Self {
        Self {
            name,
            verdict,
            finding: printable(finding.as_ref()).to_string(),
            evidence: Vec::new(),
            remedy: None,
        }
    }

    /// Creates a check that passed.
    pub fn pass(name: &'static str, finding: impl AsRef<str>) -> Self {
        Self::new(name, CheckResult::Pass, finding)
    }

    /// Creates a check that failed, with a remedy.
    pub fn fail(name: &'static str, finding: impl AsRef<str>, remedy: impl AsRef<str>) -> Self {
        Self::new(name, CheckResult::Fail, finding).with_remedy(remedy)
    }

    /// Creates a check that could not be made, with the reason.
    pub fn not_tested(name: &'static str, why: impl AsRef<str>) -> Self {
        Self::new(name, CheckResult::NotTested, why)
    }

    /// Creates a check that passes if every number is within its limits, and otherwise fails with this remedy.
    pub fn measured(
        name: &'static str,
        finding: impl AsRef<str>,
        evidence: Vec<Measurement>,
        remedy: impl AsRef<str>,
    ) -> Self {
        let bad: Vec<_> = evidence.iter().filter(|e| !e.is_good()).collect();
        let check = match bad.as_slice() {
            [] => Self::pass(name, finding),
            bad => {
                let texts: Vec<_> = bad.iter().map(|e| e.text()).collect();
                Self::fail(name, texts.join("; "), remedy)
            }
        };
        Self { evidence, ..check }
    }

    /// Adds a remedy.
    pub fn with_remedy(self, remedy: impl AsRef<str>) -> Self {
        Self {
            remedy: Some(printable(remedy.as_ref()).to_string()),
            ..self
        }
    }

    /// Adds numbers that do not affect the verdict.
    pub fn with_evidence(self, evidence: Vec<Measurement>) -> Self {
        Self { evidence, ..self }
    }
}

/// Group of related checks.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CheckGroup {
    /// Stable name: machine, firmware, board, first_switching.
    pub name: &'static str,
    /// Checks, in the order made.
    pub checks: Vec<Check>,
}

/// Number of checks by verdict.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct VerdictCounts {
    /// Checks passed.
    pub pass: usize,
    /// Checks failed.
    pub fail: usize,
    /// Checks not made.
    pub not_tested: usize,
}

/// Report of an examination.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Version of this document; names and meanings stay within a version.
    pub format: u32,
    /// Device examined, as on the command line; `None` if there was none.
    pub device: Option<String>,
    /// Groups of checks.
    pub groups: Vec<CheckGroup>,
    /// Number of checks by verdict.
    pub counts: VerdictCounts,
    /// Reason for an early end of the examination; `None` if it is complete.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ended_by: Option<String>,
}

impl Report {
    /// Creates an empty report.
    pub fn new(device: Option<String>) -> Self {
        Self {
            format: 1,
            device: device.map(|d| printable(&d).to_string()),
            groups: Vec::new(),
            counts: VerdictCounts::default(),
            ended_by: None,
        }
    }

    /// Adds a group.
    pub fn add(&mut self, group: CheckGroup) {
        for check in &group.checks {
            match check.verdict {
                CheckResult::Pass => self.counts.pass += 1,
                CheckResult::Fail => self.counts.fail += 1,
                CheckResult::NotTested => self.counts.not_tested += 1,
            }
        }
        self.groups.push(group);
    }

    /// Returns the check of this name from any group.
    pub fn check(&self, name: &str) -> Option<&Check> {
        let mut checks = self.groups.iter().flat_map(|group| &group.checks);
        checks.find(|check| check.name == name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_decide_and_a_verdict_follows() {
        let limits = |value| vec![Measurement::between("offset", value, "codes", -12.0, 12.0)];
        let verdict = |value| Check::measured("offset", "x", limits(value), "turn it").verdict;
        for good in [-12.0, 0.0, 12.0] {
            assert_eq!(verdict(good), CheckResult::Pass, "{good}");
        }
        for bad in [-12.001, 12.001, f64::NAN, f64::INFINITY] {
            assert_eq!(verdict(bad), CheckResult::Fail, "{bad}");
        }
        let failed = Check::measured("offset", "x", limits(13.5), "turn it");
        assert_eq!(failed.finding, "offset 13.5 codes (-12 to 12)");
        assert_eq!(failed.remedy.as_deref(), Some("turn it"));
    }

    #[test]
    fn what_only_is_told_decides_nothing() {
        let told = vec![Measurement::informative("rate", 3.0, "kB/s")];
        assert_eq!(
            Check::measured("r", "x", told, "").verdict,
            CheckResult::Pass
        );
    }

    #[test]
    fn a_device_s_strings_are_escaped_wherever_they_come_in() {
        let check = Check::fail("a", "\u{1b}[2J", "do \u{7}");
        let report = Report::new(Some("usb:\u{1b}]0;x".into()));
        let all = format!("{check:?} {report:?}");
        assert!(!all.chars().any(char::is_control), "{all}");
    }

    #[test]
    fn the_document_is_pinned() {
        let mut report = Report::new(Some("sim".into()));
        report.add(CheckGroup {
            name: "board",
            checks: vec![
                Check::measured(
                    "clocks",
                    "fine",
                    vec![Measurement::between("lsi", 32.0, "kHz", 29.5, 34.0)],
                    "",
                ),
                Check::not_tested("noise", "no board"),
            ],
        });
        assert_eq!(
            serde_json::to_value(&report).unwrap(),
            serde_json::json!({
                "format": 1,
                "device": "sim",
                "groups": [{"name": "board", "checks": [
                    {"name": "clocks", "verdict": "pass", "finding": "fine", "evidence":
                        [{"name": "lsi", "value": 32.0, "unit": "kHz", "min": 29.5, "max": 34.0}]},
                    {"name": "noise", "verdict": "not_tested", "finding": "no board"},
                ]}],
                "counts": {"pass": 1, "fail": 0, "not_tested": 1},
            })
        );
    }

    #[test]
    fn numbers_have_four_digits_at_most() {
        for (x, text) in [
            (0.0, "0"),
            (12.0, "12"),
            (0.5004, "0.5"),
            (31.9999, "32"),
            (1234.56, "1235"),
            (-3.24159, "-3.242"),
        ] {
            assert_eq!(number(x), text);
        }
    }
}
