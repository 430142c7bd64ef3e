//! Verdicts of `ihd identify` on captures of another generator. Only this test counts what the gate says where the truth is known and
//! neither load, circuit nor sensors are those of `ihd-sim`.
//!
//! `cargo nextest run -p ihd-made-captures --profile full verdicts_at_length` counts 5 seeds of all kinds (`MADE_SEEDS`, `MADE_FIRST`, `MADE_ONLY`);
//! `UPDATE_DOCS=1` writes docs/identification.md.

#[path = "../../it/document.rs"]
mod document;
mod score;

use std::fmt::Write;

use ihd_made_captures::Kind;

use score::{Counts, Row, rows};

/// Short form: one capture each of seventeen kinds. The seed was chosen before anything was run.
const SHORT: [Kind; 17] = [
    Kind::Clean30Db,
    Kind::CleanStub,
    Kind::NeighbourMultiple,
    Kind::NeighbourOdd,
    Kind::NeighbourTwo,
    Kind::Droop,
    Kind::ClippedCurrent,
    Kind::ClippedVoltage,
    Kind::TooShort,
    Kind::LoadStep,
    Kind::Drift,
    Kind::Saturation,
    Kind::Gain,
    Kind::Lost,
    Kind::Spikes,
    Kind::Swapped,
    Kind::Inverted,
];
const SHORT_SEED: u64 = 101;

#[test]
fn no_wrong_result_is_silent_and_what_can_be_corrected_is() {
    let all: Vec<Row> = SHORT
        .iter()
        .flat_map(|kind| rows(*kind, SHORT_SEED))
        .collect();
    for row in &all {
        println!("{row}");
    }
    for method in score::METHODS {
        let counts = Counts::from_rows(all.iter().filter(|r| r.method == method));
        assert_eq!(counts.silent, 0, "{method}: {counts:?}");
        assert_eq!(counts.refused_right, 0, "{method}: {counts:?}");
        assert_eq!(counts.said, 0, "{method}: {counts:?}");
        assert_eq!(counts.cause, 0, "{method}: {counts:?}");
        // Of a capture too short the gate cannot tell.
        assert_eq!(counts.right, 16, "{method}: {counts:?}");
    }
}

#[test]
fn verdicts_at_length() {
    let number = |name: &str| std::env::var(name).ok();
    let seeds: u64 = number("MADE_SEEDS")
        .and_then(|s| s.parse().ok())
        .unwrap_or(5);
    let first: u64 = number("MADE_FIRST")
        .and_then(|s| s.parse().ok())
        .unwrap_or(1);
    let only = number("MADE_ONLY").unwrap_or_default();
    let kinds = Kind::ALL.iter().filter(|k| k.name().contains(&only));
    let jobs: Vec<(Kind, u64)> = kinds
        .flat_map(|kind| (first..first + seeds).map(|seed| (*kind, seed)))
        .collect();
    let (even, odd): (Vec<_>, Vec<_>) = jobs.iter().enumerate().partition(|(k, _)| k % 2 == 0);
    let run = |jobs: Vec<(usize, &(Kind, u64))>| -> Vec<(usize, Vec<Row>)> {
        let of = |(k, (kind, seed)): (usize, &(Kind, u64))| (k, rows(*kind, *seed));
        jobs.into_iter().map(of).collect()
    };
    let mut done = std::thread::scope(|scope| {
        let other = scope.spawn(|| run(odd));
        let mut done = run(even);
        done.extend(other.join().expect("no row panics"));
        done
    });
    done.sort_by_key(|(k, _)| *k);
    let all: Vec<Row> = done.into_iter().flat_map(|(_, rows)| rows).collect();
    for row in &all {
        println!("{row}");
    }
    let text = section(&all, first, seeds);
    println!("{text}");
    if std::env::var_os("UPDATE_DOCS").is_some() {
        let command = "cargo nextest run -p ihd-made-captures --profile full verdicts_at_length";
        document::hold("identification.md", "made captures", &text, command);
    }
}

fn section(all: &[Row], first: u64, seeds: u64) -> String {
    let mut text = format!(
        "What `ihd identify` says about {} captures ({} kinds, seeds {first} to {}) of tests/made-captures, whose circuit, loads and sensors\n\
         share no code with the simulator. A result is wrong where a half-cycle is off by more than 1 % of R or .7 % of L (mean over its middle\n\
         80 %). A cause is named wrongly where none of its codes stands among the findings, or that of another disturbance does.\n\n\
         Command: `UPDATE_DOCS=1 MADE_FIRST={first} MADE_SEEDS={seeds} cargo nextest run -p ihd-made-captures --profile full verdicts_at_length`\n\n",
        all.len() / score::METHODS.len(),
        Kind::ALL.len(),
        first + seeds - 1,
    );
    let head = "| captures | wrong, silent | wrong, warned or refused | cause named wrongly | refused though right | right and passed |\n\
                |---:|---:|---:|---:|---:|---:|\n";
    text += "### By method\n\n| method ";
    text += &head.replacen("|---:", "|---|---:", 1);
    for method in score::METHODS {
        let counts = Counts::from_rows(all.iter().filter(|r| r.method == method));
        let _ = writeln!(text, "| `{method}` {counts}");
    }
    text += "\n### By kind, least squares\n\n| kind ";
    text += &head.replacen("|---:", "|---|---:", 1);
    for kind in Kind::ALL {
        let of_kind = all
            .iter()
            .filter(|r| r.kind == *kind && r.method == score::METHODS[0]);
        let counts = Counts::from_rows(of_kind);
        let _ = writeln!(text, "| {} {counts}", kind.name());
    }
    text
}
