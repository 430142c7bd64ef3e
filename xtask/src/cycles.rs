//! `cargo xtask cycles`: instruction counts of the firmware on an emulated Cortex-M4F, against their
//! ceilings and into docs/performance.md.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use anyhow::{Context, ensure};

use crate::budget::{BudgetLimits, verdict};
use crate::emulator;
use crate::workspace::{Workspace, spelled};

/// Document, and the section in it, that this command writes.
const DOCUMENT: &str = "docs/performance.md";
const BEGIN: &str = "<!-- cargo xtask cycles: begin -->\n";
const END: &str = "<!-- cargo xtask cycles: end -->\n";

/// A block at 70 kHz in cycles of 170 MHz: 3 / 70 000 s.
const BLOCK_CYCLES: f64 = 3.0 / 70e3 * 170e6;

/// Subjects, in the order of the table, with the meaning of one count of each.
#[rustfmt::skip]
const SUBJECTS: [(&str, &str); 9] = [
    ("pair", "demodulating one sample pair"),
    ("boxcars", "both boxcars, per phasor pair"),
    ("ekf", "one EKF update, fixed point"),
    ("ekf-f32", "one EKF update, f32 (comparison only)"),
    ("block", "the whole sampling path, per block, window recorded"),
    ("block-at-crossing", "the same for the block with the zero crossing"),
    ("lookup", "one lookup, bilinear"),
    ("search-step", "longest step of the search for a frequency"),
    ("window-chunk", "encoding one window chunk of 960 bytes"),
];

/// Counts, by subject.
pub type InstructionCounts = BTreeMap<String, f64>;

/// Runs the counting image in the emulator `qemu`.
pub fn count(qemu: &Path, image: &Path) -> anyhow::Result<InstructionCounts> {
    let mut qemu = emulator::an386(qemu, "enable=on,target=native", image);
    qemu.args(["-icount", "shift=0"]);
    let line = spelled(&qemu);
    let output = qemu.output();
    let output = output.with_context(|| format!("could not start `{line}`"))?;
    let printed = [output.stdout, output.stderr].concat();
    let text = String::from_utf8_lossy(&printed);
    let status = output.status;
    ensure!(status.success(), "`{line}` failed ({status}):\n{text}");
    let counts = parse(&text);
    for (subject, _) in SUBJECTS {
        let counted = counts.contains_key(subject);
        ensure!(counted, "the image did not count {subject}:\n{text}");
    }
    Ok(counts)
}

fn parse(text: &str) -> InstructionCounts {
    let count = |line: &str| {
        let (name, count) = line.strip_prefix("count ")?.split_once(' ')?;
        Some((name.to_owned(), count.parse().ok()?))
    };
    text.lines().filter_map(count).collect()
}

/// Returns every count outside its limits.
pub fn check(counts: &InstructionCounts, limits: &BudgetLimits) -> Vec<String> {
    let verdict = |(subject, _): &(&str, _)| {
        let what = format!("{subject} instructions");
        verdict(&what, counts[*subject], limits.instructions.get(*subject))
    };
    SUBJECTS.iter().filter_map(verdict).collect()
}

/// Table of docs/performance.md.
pub fn table(counts: &InstructionCounts, limits: &BudgetLimits) -> String {
    let short = |count: f64| format!("{count:.*}", usize::from(count < 100.0));
    let mut table = String::from("| subject | instructions | ceiling |\n|---|---:|---:|\n");
    for (subject, what) in SUBJECTS {
        let ceiling = limits.instructions.get(subject).copied().unwrap_or(0.0);
        let (count, ceiling) = (short(counts[subject]), short(ceiling));
        table += &format!("| {what} | {count} | {ceiling} |\n");
    }
    let block = counts["block"];
    table += &format!(
        "\nA block of 61 pairs at f_sw = 70 kHz has {BLOCK_CYCLES:.0} cycles of 170 MHz. The sampling \
         path takes {block:.0} instructions of it: {:.1} % at one instruction a cycle.\n",
        100.0 * block / BLOCK_CYCLES,
    );
    table
}

/// Writes the table into the document, or checks that it is the one there.
pub fn document(workspace: &Workspace, table: &str, write: bool) -> anyhow::Result<Option<String>> {
    let path = workspace.root.join(DOCUMENT);
    let text = fs::read_to_string(&path).context(DOCUMENT)?;
    let lacks = || format!("{DOCUMENT} has no lines\n{BEGIN}{END}");
    let (before, rest) = text.split_once(BEGIN).with_context(lacks)?;
    let (kept, after) = rest.split_once(END).with_context(lacks)?;
    if write {
        fs::write(&path, [before, BEGIN, table, END, after].concat())?;
        return Ok(None);
    }
    let stale = stale(kept, table);
    Ok(stale.map(|line| format!("{DOCUMENT} says {line:?}: run `cargo xtask cycles --write`")))
}

/// Relative tolerance for another compiler's counts against the document's: Debian's needs 18 % less for the f32 filter. The limits
/// themselves are strict.
const TOLERANCE: f64 = 0.25;

/// First line of the stored table that does not describe the new one.
fn stale(kept: &str, made: &str) -> Option<String> {
    fn rows(text: &str) -> Vec<Vec<&str>> {
        let rows = text.lines().filter(|line| line.starts_with("| "));
        rows.map(|row| row.split('|').map(str::trim).collect())
            .collect()
    }
    let (kept, made) = (rows(kept), rows(made));
    if kept.len() != made.len() {
        return Some(format!("{} rows", kept.len()));
    }
    let same_cell = |(a, b): (&&str, &&str)| match (a.parse::<f64>(), b.parse::<f64>()) {
        (Ok(a), Ok(b)) => (a / b - 1.0).abs() <= TOLERANCE,
        _ => a == b,
    };
    let mut pairs = kept.iter().zip(&made);
    let differs = pairs.find(|(kept, made)| !kept.iter().zip(*made).all(same_cell));
    differs.map(|(kept, _)| kept.join(" | "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_read_from_among_other_lines() {
        let counts = parse("count pair 15.6\nno count\ncount ekf 1471.0\n");
        assert_eq!((counts["pair"], counts["ekf"]), (15.6, 1471.0));
        assert_eq!(counts.len(), 2);
    }

    #[test]
    fn a_table_of_another_compiler_still_describes_this_one() {
        let kept = "| subject | count |\n|---|---|\n| pair | 16.1 |\ntext 42 %\n";
        assert_eq!(stale(kept, &kept.replace("16.1", "18.0")), None);
        assert_eq!(stale(kept, &kept.replace("42 %", "43 %")), None);
        assert!(stale(kept, &kept.replace("16.1", "22.0")).is_some());
        assert!(stale(kept, &kept.replace("pair", "block")).is_some());
        assert!(stale(kept, "").is_some());
    }
}
