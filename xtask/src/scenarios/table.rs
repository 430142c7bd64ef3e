//! What the scenarios showed: for the terminal, and as docs/control.md's table.

use std::fs;

use anyhow::{Context, ensure};

use super::Scenario;
use super::limits::{Checked, Measured};
use crate::workspace::Workspace;

const DOCUMENT: &str = "docs/control.md";
const BEGIN: &str = "<!-- cargo xtask scenarios: begin -->\n";
const END: &str = "<!-- cargo xtask scenarios: end -->\n";

/// A scenario's limits over all its variants.
pub struct Result {
    name: String,
    title: String,
    runs: usize,
    rows: Vec<Row>,
    /// Variants that did not run, and limits that were missed.
    failures: Vec<String>,
    missed: usize,
}

/// One limit over all variants that have it in the same form.
struct Row {
    name: String,
    allowed: String,
    numbers: Vec<f64>,
    words: Vec<String>,
    ok: bool,
}

/// The folder of a scenario.
pub fn family(name: &str) -> &str {
    name.split('/').next().unwrap_or(name)
}

/// The family's figure, from the root of the workspace.
pub fn figure(family: &str) -> String {
    format!("docs/scenarios/{family}.svg")
}

impl Result {
    /// Gathers what each variant showed.
    pub fn of(scenario: &Scenario, ran: &[(usize, &anyhow::Result<Vec<Checked>>)]) -> Self {
        let mut result = Self {
            name: scenario.name.clone(),
            title: scenario.title.clone(),
            runs: ran.len(),
            rows: Vec::new(),
            failures: Vec::new(),
            missed: 0,
        };
        for (variant, checked) in ran {
            let variant = &scenario.variants[*variant].name;
            match checked {
                Ok(all) => all.iter().for_each(|checked| result.add(variant, checked)),
                Err(why) => {
                    result.missed += 1;
                    result.failures.push(format!("{variant}: {why:#}"));
                }
            }
        }
        result
    }

    fn add(&mut self, variant: &str, checked: &Checked) {
        let row = match self
            .rows
            .iter_mut()
            .position(|row| row.name == checked.name && row.allowed == checked.allowed)
        {
            Some(at) => &mut self.rows[at],
            None => {
                self.rows.push(Row {
                    name: checked.name.clone(),
                    allowed: checked.allowed.clone(),
                    numbers: Vec::new(),
                    words: Vec::new(),
                    ok: true,
                });
                self.rows.last_mut().expect("just pushed")
            }
        };
        let shown = match &checked.measured {
            Measured::Numbers(numbers) => {
                row.numbers.extend(numbers);
                let all: Vec<String> = numbers.iter().map(|n| short(*n)).collect();
                all.join(", ")
            }
            Measured::Word(word) => {
                if !row.words.contains(word) {
                    row.words.push(word.clone());
                }
                word.clone()
            }
        };
        row.ok &= checked.ok;
        if !checked.ok {
            self.missed += 1;
            let Checked { name, allowed, .. } = checked;
            self.failures
                .push(format!("{variant}: {name} is {shown}, allowed {allowed}"));
        }
    }

    /// Limits that were missed, and variants that did not run.
    pub fn missed(&self) -> usize {
        self.missed
    }

    /// For the terminal.
    pub fn text(&self) -> String {
        let verdict = if self.missed == 0 { "ok" } else { "MISSED" };
        let mut text = format!("{:<28} {:>3} runs  {verdict}\n", self.name, self.runs);
        for failure in &self.failures {
            text += &format!("    {failure}\n");
        }
        text
    }
}

impl Row {
    fn measured(&self) -> String {
        if self.numbers.is_empty() {
            return self.words.join(", ");
        }
        let finite = || self.numbers.iter().copied().filter(|n| n.is_finite());
        let least = short(finite().fold(f64::INFINITY, f64::min));
        let most = short(finite().fold(f64::NEG_INFINITY, f64::max));
        let never = match self.numbers.iter().any(|n| n.is_nan()) {
            true => ", never",
            false => "",
        };
        match (finite().count(), least == most) {
            (0, _) => "never".to_owned(),
            (_, true) => format!("{least}{never}"),
            (_, false) => format!("{least} to {most}{never}"),
        }
    }
}

/// Three digits, and no more than are there.
fn short(number: f64) -> String {
    match number.abs() {
        x if x.is_nan() => "never".to_owned(),
        x if x >= 100.0 => format!("{number:.0}"),
        x if x >= 10.0 => format!("{number:.1}"),
        x if x == x.round() => format!("{number:.0}"),
        x if x >= 1.0 => format!("{number:.2}"),
        _ => format!("{number:.3}"),
    }
}

/// The section between the markers.
fn section(results: &[Result]) -> String {
    let mut text = String::new();
    let mut last = "";
    for result in results {
        let family = family(&result.name);
        if family != last {
            last = family;
            text += &format!("\n### {family}\n\n![{family}](scenarios/{family}.svg)\n\n");
            text +=
                "| scenario | runs | what | allowed | measured | |\n|---|---:|---|---|---|---|\n";
        }
        for (n, row) in result.rows.iter().enumerate() {
            let head = match n {
                0 => format!("{} | {}", result.title, result.runs),
                _ => " | ".to_owned(),
            };
            let verdict = if row.ok { "" } else { "missed" };
            let (name, allowed) = (&row.name, &row.allowed);
            let measured = row.measured();
            text += &format!("| {head} | {name} | {allowed} | {measured} | {verdict} |\n");
        }
    }
    text + "\n"
}

/// Puts the table into docs/control.md, or says that it is not the one there.
pub fn document(workspace: &Workspace, results: &[Result], write: bool) -> anyhow::Result<()> {
    let path = workspace.root.join(DOCUMENT);
    let text = fs::read_to_string(&path).context(DOCUMENT)?;
    let lacks = || format!("{DOCUMENT} has no lines\n{BEGIN}{END}");
    let (before, rest) = text.split_once(BEGIN).with_context(lacks)?;
    let (kept, after) = rest.split_once(END).with_context(lacks)?;
    let made = section(results);
    if write {
        fs::write(&path, [before, BEGIN, &made, END, after].concat())?;
        return Ok(());
    }
    let differs = kept
        .lines()
        .zip(made.lines())
        .find(|(kept, made)| kept != made);
    if let Some((kept, _)) = differs {
        anyhow::bail!("{DOCUMENT} says {kept:?}: run `cargo xtask scenarios`");
    }
    ensure!(
        kept == made,
        "{DOCUMENT} has another table: run `cargo xtask scenarios`"
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_missed_by_one_variant_is_missed() {
        let scenario = Scenario {
            name: "steps/all".to_owned(),
            title: "Steps".to_owned(),
            variants: super::super::variants::of(
                toml::from_str("[[matrix]]\n\"mains.hz\" = [50, 60]\n").unwrap(),
            )
            .unwrap(),
        };
        let checked = |number: f64, ok| {
            Ok(vec![Checked {
                name: "error_pct".to_owned(),
                allowed: "[0, 3]".to_owned(),
                measured: Measured::Numbers(vec![number]),
                ok,
            }])
        };
        let (good, bad) = (checked(1.25, true), checked(f64::NAN, false));
        let result = Result::of(&scenario, &[(0, &good), (1, &bad)]);
        assert_eq!(result.missed(), 1);
        assert!(
            result
                .text()
                .contains("60: error_pct is never, allowed [0, 3]")
        );
        let row = "| Steps | 2 | error_pct | [0, 3] | 1.25, never | missed |";
        assert!(section(&[result]).contains(row));
    }
}
