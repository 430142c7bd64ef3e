//! Commands of the documents: each line of a block of code that calls one of the programs.

use std::fs;
use std::path::{Path, PathBuf};

/// Documents, from the root of the repository.
fn documents(root: &Path) -> Vec<PathBuf> {
    let mut found = vec![root.join("README.md"), root.join("CONTRIBUTING.md")];
    let entries = fs::read_dir(root.join("docs")).expect("a folder");
    let paths = entries.map(|entry| entry.expect("an entry").path());
    found.extend(paths.filter(|path| path.extension().is_some_and(|ending| ending == "md")));
    found.sort();
    found
}

/// Words of a line as a shell would split them: quotes hold words together, a comment ends the line.
fn words(line: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut word: Option<String> = None;
    let mut quote = None;
    for c in line.chars() {
        match (quote, c) {
            (Some(q), _) if q == c => quote = None,
            (Some(_), _) => word.get_or_insert_default().push(c),
            (None, '\'' | '"') => {
                quote = Some(c);
                word.get_or_insert_default();
            }
            (None, '#') if word.is_none() => break,
            (None, ' ') => found.extend(word.take()),
            (None, _) => word.get_or_insert_default().push(c),
        }
    }
    found.extend(word);
    found
}

/// Words of the call of `program` in a line, or nothing where the line calls another one or leaves something open.
fn call(line: &str, program: &str) -> Option<Vec<String>> {
    let line = line.strip_prefix("    ")?;
    let command = line
        .split("  #")
        .next()
        .unwrap_or_default()
        .replace("cargo run --release -- ", "ihd ");
    let all = words(&command.replace("cargo run -- ", "ihd "));
    let begin = all.iter().position(|word| word == program)?;
    // What stands before it may only prepare it: `sudo`, a variable, another command that has ended.
    let prepares = |word: &String| word == "sudo" || word.contains('=') || word.ends_with(';');
    let is_prepared = begin == 0 || prepares(&all[begin - 1]);
    let end = |word: &String| ["&&", "|", ">", "&"].contains(&word.as_str());
    let call: Vec<String> = all[begin..]
        .iter()
        .take_while(|word| !end(word))
        .cloned()
        .collect();
    let is_open = call.iter().any(|word| word.contains(['…', '[', '$']));
    (is_prepared && !is_open).then_some(call)
}

/// Calls of `program` in all documents, each with where it stands.
pub fn calls(root: &Path, program: &str) -> Vec<(String, Vec<String>)> {
    let mut found = Vec::new();
    for path in documents(root) {
        let text = fs::read_to_string(&path)
            .expect("a document")
            .replace("\\\n", " ");
        for (number, line) in text.lines().enumerate() {
            if let Some(call) = call(line, program) {
                found.push((format!("{}:{}", path.display(), number + 1), call));
            }
        }
    }
    found
}
