//! Verdict on an estimate and the findings behind it.

use ihd_signal::{Remark, Severity};
use serde::{Deserialize, Serialize};

/// Decision on an estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The estimate can be used.
    Pass,
    /// The estimate must not be used.
    Refuse,
    /// The capture does not carry enough to judge the estimate, so that it must not be used either.
    CannotTell,
}

/// Numbers of a method's estimates by verdict, one estimate a stretch. A stretch on which the method failed has none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct VerdictTally {
    /// Estimates that can be used.
    pub passed: usize,
    /// Estimates that are refused.
    pub refused: usize,
    /// Estimates too short to be judged.
    pub open: usize,
}

impl VerdictTally {
    /// Counts a verdict.
    pub fn count(&mut self, verdict: Verdict) {
        match verdict {
            Verdict::Pass => self.passed += 1,
            Verdict::Refuse => self.refused += 1,
            Verdict::CannotTell => self.open += 1,
        }
    }

    /// Number of estimates that must not be used; a stub beside a stretch that passes is none.
    pub fn unfit(self) -> usize {
        match self.passed {
            0 => self.refused + self.open,
            _ => self.refused,
        }
    }

    /// Verdict on all together; `None` without an estimate.
    pub fn verdict(self) -> Option<Verdict> {
        match self {
            Self { refused: 1.., .. } => Some(Verdict::Refuse),
            Self { passed: 1.., .. } => Some(Verdict::Pass),
            Self { open: 1.., .. } => Some(Verdict::CannotTell),
            _ => None,
        }
    }
}

/// Code of the finding that leaves the verdict open.
pub const TOO_SHORT: &str = "too_short";

/// Verdict and its reasons.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Gate {
    /// Decision on the estimate.
    pub verdict: Verdict,
    /// Texts of the findings that refuse or leave the verdict open; empty if the estimate passes.
    pub why: Vec<String>,
}

impl Gate {
    /// Derives the verdict from findings: an error refuses, [`TOO_SHORT`] leaves it open.
    pub fn from_findings<'a>(findings: impl Iterator<Item = &'a Remark> + Clone) -> Self {
        let texts = |verdict, of: &dyn Fn(&Remark) -> bool| Self {
            verdict,
            why: (findings.clone().filter(|f| of(f)))
                .map(|f| f.text.clone())
                .collect(),
        };
        let refused = texts(Verdict::Refuse, &|f| f.severity == Severity::Error);
        let open = texts(Verdict::CannotTell, &|f| f.code == TOO_SHORT);
        let decided = [refused, open].into_iter().find(|g| !g.why.is_empty());
        decided.unwrap_or(Self {
            verdict: Verdict::Pass,
            why: Vec::new(),
        })
    }

    /// Returns `true` if the estimate can be used.
    pub fn passes(&self) -> bool {
        self.verdict == Verdict::Pass
    }
}

/// Verdict on one half-cycle.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HalfCycleVerdict {
    /// Zero crossing at which it begins, in seconds on the capture's clock.
    pub from_s: f64,
    /// Share of its middle 80 % that was captured, 0 to 1.
    pub seen: f64,
    /// Verdict and reasons.
    #[serde(flatten)]
    pub gate: Gate,
}

/// Findings about an estimate, and the verdicts that follow from them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Judgement {
    /// Findings, worst first.
    pub findings: Vec<Remark>,
    /// Verdict on the whole estimate: that of its worst half-cycle, stubs left out.
    pub gate: Gate,
    /// Verdicts by half-cycle, in order of time; empty if there is no estimate.
    pub half_cycles: Vec<HalfCycleVerdict>,
}

impl Judgement {
    /// Derives the verdict from findings.
    pub fn from_findings(mut findings: Vec<Remark>) -> Self {
        findings.sort_by_key(|f| std::cmp::Reverse(f.severity));
        Self {
            gate: Gate::from_findings(findings.iter()),
            findings,
            half_cycles: Vec::new(),
        }
    }

    /// Findings of severity warning and error.
    pub fn doubts(&self) -> impl Iterator<Item = &Remark> {
        self.findings
            .iter()
            .filter(|f| f.severity >= Severity::Warning)
    }
}

impl std::fmt::Display for Gate {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.verdict {
            Verdict::Pass => f.write_str("pass"),
            Verdict::Refuse => write!(f, "refuse: {}", self.why.join("; ")),
            Verdict::CannotTell => write!(f, "cannot tell: {}", self.why.join("; ")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stub_leaves_the_verdict_to_the_other_stretches() {
        let (pass, open, refuse) = (Verdict::Pass, Verdict::CannotTell, Verdict::Refuse);
        let together = |verdicts: &[Verdict]| {
            let mut tally = VerdictTally::default();
            verdicts.iter().for_each(|v| tally.count(*v));
            let unfit = tally.unfit() > 0;
            assert!(tally.verdict().is_none_or(|v| (v != pass) == unfit));
            tally.verdict()
        };
        assert_eq!(together(&[]), None);
        assert_eq!(together(&[open]), Some(open));
        assert_eq!(together(&[open, pass]), Some(pass));
        assert_eq!(together(&[pass, refuse, open]), Some(refuse));
    }

    #[test]
    fn an_error_refuses_and_a_warning_does_not() {
        let remark = |severity, text: &str| Remark::new("uncertain", severity, text);
        let doubtful = Judgement::from_findings(vec![
            remark(Severity::Info, "a"),
            remark(Severity::Warning, "b"),
        ]);
        assert_eq!(doubtful.gate.verdict, Verdict::Pass);
        assert_eq!(doubtful.findings[0].text, "b");
        assert_eq!(doubtful.doubts().count(), 1);
        let wrong = Judgement::from_findings(vec![
            remark(Severity::Warning, "b"),
            remark(Severity::Error, "c"),
        ]);
        assert_eq!(wrong.gate.to_string(), "refuse: c");
        let open = Remark::new(TOO_SHORT, Severity::Warning, "d");
        assert_eq!(
            Judgement::from_findings(vec![open]).gate.to_string(),
            "cannot tell: d"
        );
        assert_eq!(
            serde_json::to_value(&wrong.gate).unwrap(),
            serde_json::json!({"verdict": "refuse", "why": ["c"]})
        );
    }
}
