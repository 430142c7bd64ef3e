//! Table of scenarios: each limit of a file with what its runs showed. Tests of other packages include this file by its path.

use std::collections::BTreeSet;

use ihd_sim::scenario::limits::{LimitCheck, MeasuredValues, three_digits};

/// Head of the table, with the name of its first column.
pub fn head(first: &str) -> String {
    format!("| {first} | runs | what | allowed | measured | |\n|---|---:|---|---|---|---|\n")
}

/// Limits of a file's runs.
#[derive(Default)]
pub struct FileLimits(Vec<Row>);

/// A limit over all variants that have it in the same form.
struct Row {
    name: &'static str,
    allowed: String,
    numbers: Vec<f64>,
    words: BTreeSet<String>,
}

impl FileLimits {
    /// Takes a limit of a run.
    pub fn add(&mut self, checked: LimitCheck) {
        let rows = &mut self.0;
        let same = |row: &Row| row.name == checked.name && row.allowed == checked.allowed;
        let at = rows.iter().position(same).unwrap_or_else(|| {
            rows.push(Row {
                name: checked.name,
                allowed: checked.allowed.clone(),
                numbers: Vec::new(),
                words: BTreeSet::new(),
            });
            rows.len() - 1
        });
        match checked.measured {
            MeasuredValues::Numbers(numbers) => rows[at].numbers.extend(numbers),
            MeasuredValues::Word(word) => drop(rows[at].words.insert(word)),
        }
    }

    /// Lines of the table.
    pub fn lines(&self, title: &str, runs: usize) -> String {
        let line = |(n, row): (usize, &Row)| match n {
            0 => format!("| {title} | {runs} | {} |\n", row.text()),
            _ => format!("|  |  | {} |\n", row.text()),
        };
        self.0.iter().enumerate().map(line).collect()
    }
}

impl Row {
    fn text(&self) -> String {
        let words: Vec<&str> = self.words.iter().map(String::as_str).collect();
        let least = self.numbers.iter().copied().reduce(f64::min);
        let most = self.numbers.iter().copied().reduce(f64::max);
        let measured = match (least.map(three_digits), most.map(three_digits)) {
            (Some(least), Some(most)) if least == most => least,
            (Some(least), Some(most)) => format!("{least} to {most}"),
            _ => words.join(", "),
        };
        format!("{} | {} | {measured} | ", self.name, self.allowed)
    }
}
