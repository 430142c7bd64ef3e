//! Agreement of docs/identification.md, the table of codes and the sources.

#[path = "../../../tests/it/document.rs"]
mod document;

use std::path::{Path, PathBuf};

use ihd_gate::codes::{CODES, find, markdown};
use ihd_survey::mains::RANGE_HZ;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

#[test]
fn the_document_holds_the_table() {
    let command = "cargo test -p ihd-gate --test codes";
    let table = format!("{}\n", markdown());
    document::hold("identification.md", "codes", &table, command);
}

/// The table and a document name the range of the mains by number.
#[test]
fn the_range_of_the_mains_is_the_one_that_is_searched() {
    let (from_hz, to_hz) = RANGE_HZ;
    let time_base = find("time_base").expect("a code");
    let limits = format!("error below {from_hz} and above {to_hz} Hz");
    assert!(time_base.severity.contains(&limits), "{limits}");
    let document = std::fs::read_to_string(root().join("docs/captures.md")).unwrap();
    let range = format!("the voltage's envelope: {from_hz} to {to_hz} Hz from");
    assert!(document.contains(&range), "{range}");
}

#[test]
fn no_code_stands_twice() {
    let mut names: Vec<_> = CODES
        .iter()
        .flat_map(|(_, codes)| *codes)
        .map(|c| c.name)
        .collect();
    names.sort_unstable();
    let all = names.len();
    names.dedup();
    assert_eq!(names.len(), all);
}

/// Sources of a room, and of its folders.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

/// The first string in `snake_case` of each text that follows `mark`.
fn codes_after<'a>(source: &'a str, mark: &str) -> Vec<&'a str> {
    let named = |rest: &'a str| {
        let word = rest.trim_start().strip_prefix('"')?.split('"').next()?;
        let snake = |c: char| c.is_ascii_lowercase() || c == '_' || c.is_ascii_digit();
        (!word.is_empty() && word.chars().all(snake)).then_some(word)
    };
    source.split(mark).skip(1).filter_map(named).collect()
}

#[test]
fn every_code_of_the_sources_is_in_the_table() {
    let mut paths = Vec::new();
    for room in ["survey", "identify", "gate", "train"] {
        sources(&root().join("host").join(room).join("src"), &mut paths);
    }
    let mut seen = 0;
    for path in paths {
        let source = std::fs::read_to_string(&path).unwrap();
        let mut codes = codes_after(&source, "Remark::new(");
        if path.ends_with("survey/src/finding/mod.rs") {
            let (_, rest) = source
                .split_once("pub fn code(")
                .expect("the codes of findings");
            let (body, _) = rest.split_once("\n    }\n").expect("their end");
            codes.extend(codes_after(body, "=>"));
        }
        for code in codes {
            assert!(
                find(code).is_some(),
                "{code} of {} is not in codes.rs",
                path.display()
            );
            seen += 1;
        }
    }
    assert!(
        seen > 25,
        "{seen} codes only: the search finds nothing any more"
    );
}
