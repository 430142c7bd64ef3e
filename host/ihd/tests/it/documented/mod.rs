//! Every call of `ihd` in the documents, run. The calls of a document run in its order, in one folder: what one writes the next reads.

mod desk;
mod files;
mod special;

use std::collections::BTreeSet;
use std::path::Path;

use self::desk::{Desk, ROOT};
use self::special::SPECIAL;
use super::documents;

/// Documents with calls; each has a test of its own below, so that they run side by side.
const DOCUMENTS: [&str; 9] = [
    "CONTRIBUTING.md",
    "README.md",
    "docs/board.md",
    "docs/bring-up.md",
    "docs/captures.md",
    "docs/daemon.md",
    "docs/fleet.md",
    "docs/map.md",
    "docs/simulator.md",
];

/// Calls, each with its document and its line.
fn calls() -> Vec<(String, String, Vec<String>)> {
    let all = documents::calls(Path::new(ROOT), "ihd").into_iter();
    all.map(|(place, call)| {
        let place = place.trim_start_matches(ROOT).trim_start_matches('/');
        let (document, line) = place.rsplit_once(':').expect("a line");
        (document.to_owned(), line.to_owned(), call)
    })
    .collect()
}

fn run(document: &str) {
    assert!(DOCUMENTS.contains(&document));
    let mut desk = Desk::new();
    let mut failed = String::new();
    let calls: Vec<_> = calls().into_iter().filter(|c| c.0 == document).collect();
    for (k, (_, line, call)) in calls.iter().enumerate() {
        if let Err(why) = desk.run(call) {
            failed += &format!("{document}:{line}: {}\n{why}\n\n", call.join(" "));
        }
        desk.end_unused(calls[k + 1..].iter().map(|later| &later.2[..]));
    }
    assert!(failed.is_empty(), "{failed}");
    desk.close();
}

#[test]
fn every_call_has_its_test_and_nothing_else_is_special() {
    let calls = calls();
    assert!(calls.len() > 60, "{} calls only", calls.len());
    let found: BTreeSet<_> = calls
        .iter()
        .map(|(document, ..)| document.as_str())
        .collect();
    assert_eq!(found, BTreeSet::from(DOCUMENTS));
    for special in SPECIAL {
        let is_there = calls.iter().any(|call| call.2.join(" ") == special.call);
        assert!(is_there, "no document has {:?}", special.call);
    }
}

#[test]
fn contributing() {
    run("CONTRIBUTING.md");
}

#[test]
fn readme() {
    run("README.md");
}

#[test]
fn board() {
    run("docs/board.md");
}

#[test]
fn bring_up() {
    run("docs/bring-up.md");
}

#[test]
fn captures() {
    run("docs/captures.md");
}

#[test]
fn daemon() {
    run("docs/daemon.md");
}

#[test]
fn fleet() {
    run("docs/fleet.md");
}

#[test]
fn map() {
    run("docs/map.md");
}

#[test]
fn simulator() {
    run("docs/simulator.md");
}

/// Its parts have tests of their own, in `ihd-field` and `ihd-sim`: together they take twelve seconds of processor time.
#[test]
fn the_costs_of_the_approximations_at_length() {
    Desk::new().must(&["simulate", "--approximations"]);
}
