//! Part of the report on what is doubted: findings on the capture and on each result, with the remedy.

use ihd_gate::codes;
use ihd_signal::{Remark, Severity};

use super::super::report::ReportedCapture;
use super::html::{TableColumn, TableRow, table};

/// Doubt, with the number of parts that have it.
struct Doubt {
    subject: String,
    code: &'static str,
    severity: Severity,
    text: String,
    parts: usize,
}

/// Doubts of all parts; those of one code on one subject are one, with the text of the first part.
#[derive(Default)]
pub struct DoubtList(Vec<Doubt>);

impl DoubtList {
    /// Adds the doubts of a part.
    pub fn take(&mut self, reported: &ReportedCapture<'_>) {
        let (before, examined) = (self.0.len(), reported.examined);
        let mut seen = vec![false; before];
        let mut add = |subject: &str, code, severity, text: &str| {
            self.add(subject, code, severity, text, &mut seen);
        };
        for finding in &examined.survey.findings {
            if finding.severity() > Severity::Info {
                let text = finding.to_string();
                add("capture", finding.code(), finding.severity(), &text);
            }
        }
        let is_doubt = |r: &&Remark| r.severity > Severity::Info;
        for remark in examined.sensors.iter().filter(is_doubt) {
            add("capture", remark.code, remark.severity, &remark.text);
        }
        for outcome in &examined.outcomes {
            let method = outcome.method.name();
            match &outcome.result {
                Err(error) => add(method, "failed", Severity::Error, &error.to_string()),
                Ok(estimate) => {
                    for note in &estimate.notes {
                        add(method, "note", Severity::Warning, note);
                    }
                }
            }
            for remark in outcome.judgement.doubts() {
                let of_survey = examined.survey.findings.iter();
                let is_of_capture = of_survey.map(|f| f.code()).any(|c| c == remark.code)
                    || examined.sensors.iter().any(|r| r.code == remark.code);
                // An error decides the verdict of this result alone.
                if !is_of_capture || remark.severity == Severity::Error {
                    add(method, remark.code, remark.severity, &remark.text);
                }
            }
        }
    }

    /// Adds the reason why a part of the capture is missing.
    pub fn file(&mut self, text: &str) {
        self.add(
            "capture",
            "incomplete",
            Severity::Error,
            text,
            &mut Vec::new(),
        );
    }

    fn add(
        &mut self,
        subject: &str,
        code: &'static str,
        severity: Severity,
        text: &str,
        seen: &mut Vec<bool>,
    ) {
        let same = |d: &Doubt| d.subject == subject && d.code == code;
        // Two of one code in one part are two.
        let earlier = (0..self.0.len()).find(|k| {
            same(&self.0[*k]) && (seen.get(*k) == Some(&false) || self.0[*k].text == text)
        });
        if let Some(k) = earlier {
            if let Some(seen) = seen.get_mut(k).filter(|seen| !**seen) {
                *seen = true;
                self.0[k].parts += 1;
            }
            return;
        }
        self.0.push(Doubt {
            subject: subject.to_owned(),
            code,
            severity,
            text: text.to_owned(),
            parts: 1,
        });
        seen.push(true);
    }

    /// Table of the doubts, worst first.
    pub fn html(&mut self, in_parts: bool) -> String {
        if self.0.is_empty() {
            return "<p>Nothing.</p>\n".into();
        }
        self.0.sort_by_key(|d| std::cmp::Reverse(d.severity));
        let mut columns = vec![
            TableColumn::Text("On"),
            TableColumn::Text("Severity"),
            TableColumn::Long("Finding"),
            TableColumn::Long("Remedy"),
            TableColumn::Text("Code"),
        ];
        if in_parts {
            columns.push(TableColumn::Number("Parts"));
        }
        let row = |d: &Doubt| TableRow {
            class: match d.severity {
                Severity::Error => "error",
                _ => "warning",
            },
            cells: vec![
                d.subject.clone(),
                d.severity.to_string(),
                d.text.clone(),
                codes::find(d.code).map_or(String::new(), |c| c.advice.to_owned()),
                d.code.to_owned(),
                d.parts.to_string(),
            ],
        };
        let rows: Vec<TableRow> = self.0.iter().map(row).collect();
        table(&columns, &rows)
    }
}
