//! Scenarios of tests/ against the limits in their files, with a table of what came of them. Tests of other packages include this file by
//! its path.

use std::collections::BTreeSet;
use std::path::Path;

use ihd_sim::scenario::limits::{LimitCheck, MeasuredValues, three_digits};
use ihd_sim::scenario::record::Record;
use ihd_sim::scenario::variants::{self, Variant};

/// Variants of a file, by its path in tests/ without ending.
pub fn read(name: &str) -> Vec<Variant> {
    let above = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors();
    let folder = above
        .map(|folder| folder.join("tests"))
        .find(|folder| folder.join("scenarios").is_dir());
    let path = folder.expect("tests/scenarios").join(name);
    variants::read(&path.with_extension("toml")).unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// Limits of all files that were run.
pub struct ScenarioTable<R> {
    run: R,
    text: String,
    /// Lines of limits that were missed.
    missed: Vec<String>,
}

impl<R: Fn(&Variant) -> Record> ScenarioTable<R> {
    /// Begins with the name of the first column, and what runs a variant.
    pub fn new(first: &str, run: R) -> Self {
        let text = format!(
            "| {first} | runs | what | allowed | measured | |\n|---|---:|---|---|---|---|\n"
        );
        Self {
            run,
            text,
            missed: Vec::new(),
        }
    }

    /// Runs variants of a file.
    ///
    /// # Panics
    /// If one has no limits.
    pub fn run(&mut self, file: &str, variants: &[Variant]) {
        let mut limits = FileLimits::default();
        for variant in variants {
            let name = &variant.name;
            let checked = variant.scenario.file.limits.check(&(self.run)(variant));
            assert!(!checked.is_empty(), "{name}: no [limits]");
            for checked in checked {
                if !checked.ok {
                    self.missed.push(format!("{file} {name}: {checked}"));
                }
                limits.add(checked);
            }
        }
        self.text += &limits.lines(&variants[0].scenario.file.title, variants.len());
    }

    /// Returns the table.
    ///
    /// # Panics
    /// If a limit was missed.
    pub fn finish(self) -> String {
        let missed = self.missed;
        assert!(missed.is_empty(), "limits missed:\n{}", missed.join("\n"));
        self.text
    }
}

/// Limits of a file's runs.
#[derive(Default)]
struct FileLimits(Vec<Row>);

/// A limit over all variants that have it in the same form.
struct Row {
    name: &'static str,
    allowed: String,
    numbers: Vec<f64>,
    words: BTreeSet<String>,
}

impl FileLimits {
    /// Takes a limit of a run.
    fn add(&mut self, checked: LimitCheck) {
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
    fn lines(&self, title: &str, runs: usize) -> String {
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
