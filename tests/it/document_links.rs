//! Links of documents lead to files and headings that there are; sources and documents name files that there are.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Folders that hold nothing of ours.
const FOREIGN: [&str; 5] = ["target", ".git", "node_modules", "vendor", ".library"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Files below a folder with one of these endings.
fn files(folder: &Path, endings: &[&str], found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if path.is_symlink() || FOREIGN.contains(&name.as_ref()) {
            continue;
        }
        if path.is_dir() {
            files(&path, endings, found);
        } else if endings.iter().any(|ending| name.ends_with(ending)) {
            found.push(path);
        }
    }
}

/// Anchor that GitHub and mdbook make of a heading.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().to_lowercase();
    let kept = kept
        .chars()
        .filter(|c| c.is_alphanumeric() || "-_ ".contains(*c));
    kept.collect::<String>().replace(' ', "-")
}

/// Anchors of a document, its blocks of code left out.
fn anchors(path: &Path) -> BTreeSet<String> {
    let text = fs::read_to_string(path).unwrap();
    let outside = text.split("\n```").step_by(2);
    let headings = outside.flat_map(|part| part.lines().filter(|line| line.starts_with('#')));
    headings
        .map(|line| anchor(line.trim_start_matches('#')))
        .collect()
}

/// Targets of the links of a text.
fn targets(text: &str) -> impl Iterator<Item = &str> {
    let after = text.split("](").skip(1);
    after.filter_map(|rest| rest.split_once(')').map(|(target, _)| target))
}

/// The fault of a link in a document, if it has one.
fn fault(document: &Path, target: &str) -> Option<&'static str> {
    let (file, heading) = target.split_once('#').unwrap_or((target, ""));
    let path = match file {
        "" => document.to_path_buf(),
        _ => document.parent().unwrap().join(file),
    };
    if !path.exists() {
        return Some("no such file");
    }
    let is_document = path.extension().is_some_and(|ending| ending == "md");
    let is_missing = is_document && !heading.is_empty() && !anchors(&path).contains(heading);
    is_missing.then_some("no such heading")
}

/// Faults of the links of all documents below a folder, and the number of these documents.
pub fn faults(folder: &Path) -> (Vec<String>, usize) {
    let mut documents = Vec::new();
    files(folder, &[".md"], &mut documents);
    let mut faults = Vec::new();
    for document in &documents {
        let text = fs::read_to_string(document).unwrap();
        let text: String = text.split("\n```").step_by(2).collect();
        for target in targets(&text) {
            let is_outside = target.contains("://") || target.contains(' ');
            if let Some(fault) = (!is_outside).then(|| fault(document, target)).flatten() {
                faults.push(format!("{}: {target}: {fault}", document.display()));
            }
        }
    }
    (faults, documents.len())
}

#[test]
fn links_of_documents_lead_somewhere() {
    let (faults, documents) = faults(&root());
    assert!(documents > 30, "{documents} documents");
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn documents_that_sources_name_are_there() {
    let mut sources = Vec::new();
    let endings = [
        ".rs", ".py", ".mjs", ".js", ".toml", ".service", ".plist", ".ipynb",
    ];
    files(&root(), &endings, &mut sources);
    let mut missing = Vec::new();
    for source in sources {
        let text = fs::read_to_string(&source).unwrap();
        for part in text.split("docs/").skip(1) {
            let end = part.find(|c: char| !(c.is_ascii_alphanumeric() || "-/.".contains(c)));
            let name = part[..end.unwrap_or(part.len())].trim_end_matches('.');
            if name.ends_with(".md") && !root().join("docs").join(name).exists() {
                missing.push(format!("{}: docs/{name}", source.display()));
            }
        }
    }
    assert!(missing.is_empty(), "{}", missing.join("\n"));
}

/// Folders of the repository, as documents name what is in them.
const FOLDERS: [&str; 8] = [
    "host/",
    "firmware/",
    "shared/",
    "tests/",
    "boards/",
    "xtask/",
    "packaging/",
    "fuzz/",
];

#[test]
fn sources_that_documents_name_are_there() {
    let mut documents = vec![root().join("README.md"), root().join("CONTRIBUTING.md")];
    files(&root().join("docs"), &[".md"], &mut documents);
    let mut missing = Vec::new();
    for document in documents {
        let text = fs::read_to_string(&document).unwrap();
        let is_of_path = |c: char| c.is_ascii_alphanumeric() || "_-/.".contains(c);
        for word in text.split(|c| !is_of_path(c)) {
            let path = word.trim_end_matches('.');
            let is_file = [".rs", ".toml", ".py", ".csv", ".mjs"]
                .iter()
                .any(|e| path.ends_with(e));
            let is_ours = FOLDERS.iter().any(|folder| path.starts_with(folder));
            // NAME and FAMILY stand for any.
            let is_open = path.contains("NAME") || path.contains("FAMILY");
            if is_file && is_ours && !is_open && !root().join(path).exists() {
                missing.push(format!("{}: {path}", document.display()));
            }
        }
    }
    assert!(missing.is_empty(), "{}", missing.join("\n"));
}
