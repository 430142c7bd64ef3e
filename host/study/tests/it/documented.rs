//! The studies of the documents, as short as they can be: fewer pots, seeds, methods and epochs.

use std::fs;
use std::path::Path;

use assert_cmd::Command;
use clap::CommandFactory;
use ihd_study::cli::Cli;

use super::documents;

/// Documented calls, and what is run: `…` is the call itself.
const SHORT: [(&str, &str); 9] = [
    (
        "ihd-study paper --quick",
        "… --seeds 1 --epochs 1 --khz 45 --load behavioural --snr none --out a",
    ),
    (
        "ihd-study paper --preset hybrid,hybrid-waveform --seeds 3",
        "paper --preset hybrid,hybrid-waveform --seeds 1 --epochs 1 --khz 45 --load behavioural --snr none --out b",
    ),
    (
        "ihd-study estimators --seeds 10 --docs docs/accuracy.md",
        "estimators --quick --method least-squares --docs docs/accuracy.md",
    ),
    (
        "ihd-study hostile --docs docs/identification.md",
        "… --only inverted --method least-squares --seeds 1",
    ),
    ("ihd-study map", "… --pot ferritic-18 --seeds 1"),
    (
        "ihd-study map --load field --docs docs/map.md",
        "… --pot foil-14 --seeds 1",
    ),
    (
        "ihd-study map --pot ferritic-18 --perturb tail,sharp-knee,ferrite,wall,coil-gap",
        "map --pot ferritic-18 --perturb tail --seeds 1",
    ),
    (
        "ihd-study map --closed-loop --pot ferritic-12",
        "… --seeds 1",
    ),
    (
        "ihd-study temperature --docs docs/map.md --plot docs/pot-temperature.svg",
        "… --runs 1",
    ),
];

/// Only parsed: another call without its document; and one that with one pot still teaches another hob twenty, 24 s of processor time.
const ONLY_PARSED: [&str; 2] = [
    "ihd-study estimators",
    "ihd-study pots --pot ferritic-21,ferritic-18,ferritic-12,cast-iron-21,ferritic-18+120C \
     --perturb sharp-knee --seeds 1 --docs docs/map.md",
];

/// Calls in the documents, as one text each.
fn calls() -> Vec<(String, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let calls = documents::calls(&root, "ihd-study").into_iter();
    calls
        .map(|(place, words)| (place, words.join(" ")))
        .collect()
}

#[test]
fn every_study_can_be_called_as_documented_and_has_a_short_form() {
    let calls = calls();
    for (place, call) in &calls {
        if let Err(error) = Cli::command().try_get_matches_from(call.split(' ')) {
            panic!("{place}: {call}\n{error}");
        }
        let is_known = ONLY_PARSED.contains(&&call[..])
            || SHORT.iter().any(|(documented, _)| documented == call);
        assert!(is_known, "{place}: {call} has no short form");
    }
    for documented in SHORT.iter().map(|(call, _)| *call).chain(ONLY_PARSED) {
        let is_there = calls.iter().any(|(_, call)| call == documented);
        assert!(is_there, "no document has {documented}");
    }
}

#[test]
fn short_forms_work() {
    let folder = tempfile::tempdir().unwrap();
    let docs = folder.path().join("docs");
    fs::create_dir(&docs).unwrap();
    for document in ["accuracy.md", "identification.md", "map.md"] {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs");
        fs::copy(root.join(document), docs.join(document)).unwrap();
    }
    for (documented, short) in SHORT {
        let call = short.replace('…', documented.trim_start_matches("ihd-study "));
        let mut command = Command::cargo_bin("ihd-study").expect("it is built with its tests");
        command.current_dir(folder.path()).args(call.split(' '));
        let output = command.output().expect("it runs");
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{call}: {stderr}");
        assert!(!output.stdout.is_empty(), "{call}");
    }
}
