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
}

/// Verdict and its reasons.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Gate {
    /// Decision on the estimate.
    pub verdict: Verdict,
    /// Texts of the findings that refuse; empty if the estimate passes.
    pub why: Vec<String>,
}

impl Gate {
    /// Returns `true` if the estimate must not be used.
    pub fn refuses(&self) -> bool {
        self.verdict == Verdict::Refuse
    }
}

/// Findings about an estimate, and the verdict that follows from them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Judgement {
    /// Findings, worst first.
    pub findings: Vec<Remark>,
    /// Verdict that follows from the findings.
    pub gate: Gate,
}

impl Judgement {
    /// Derives the verdict from findings: one of severity error refuses.
    pub fn of(mut findings: Vec<Remark>) -> Self {
        findings.sort_by_key(|f| std::cmp::Reverse(f.severity));
        let errors = findings.iter().filter(|f| f.severity == Severity::Error);
        let why: Vec<_> = errors.map(|f| f.text.clone()).collect();
        let verdict = if why.is_empty() {
            Verdict::Pass
        } else {
            Verdict::Refuse
        };
        Self {
            findings,
            gate: Gate { verdict, why },
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
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_refuses_and_a_warning_does_not() {
        let remark = |severity, text: &str| Remark::new("uncertain", severity, text);
        let doubtful = Judgement::of(vec![
            remark(Severity::Info, "a"),
            remark(Severity::Warning, "b"),
        ]);
        assert_eq!(doubtful.gate.verdict, Verdict::Pass);
        assert_eq!(doubtful.findings[0].text, "b");
        assert_eq!(doubtful.doubts().count(), 1);
        let wrong = Judgement::of(vec![
            remark(Severity::Warning, "b"),
            remark(Severity::Error, "c"),
        ]);
        assert_eq!(wrong.gate.to_string(), "refuse: c");
        assert_eq!(
            serde_json::to_value(&wrong.gate).unwrap(),
            serde_json::json!({"verdict": "refuse", "why": ["c"]})
        );
    }
}
