//! Documents are few and short.

use std::fs;
use std::path::{Path, PathBuf};

/// Most words that are written by hand.
const MAX_WORDS: usize = 35_000;

/// Most documents.
const MAX_DOCUMENTS: usize = 16;

/// Documents of the repository's readers: the book's pages but the list of changes.
fn documents() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut documents = vec![
        root.join("README.md"),
        root.join("CONTRIBUTING.md"),
        root.join("python/README.md"),
    ];
    let entries = fs::read_dir(root.join("docs")).unwrap();
    documents.extend(entries.map(|entry| entry.unwrap().path()).filter(|path| {
        path.extension().is_some_and(|ending| ending == "md") && !path.ends_with("SUMMARY.md")
    }));
    documents
}

/// Words outside of the sections between marks, which commands write. Bars of tables are no words.
fn words_by_hand(text: &str) -> usize {
    let mut is_by_hand = true;
    let mut words = 0;
    for line in text.lines() {
        if line.starts_with("<!-- ") && line.ends_with(": begin -->") {
            is_by_hand = false;
        } else if line.starts_with("<!-- ") && line.ends_with(": end -->") {
            is_by_hand = true;
        } else if is_by_hand {
            let is_word = |word: &&str| word.contains(char::is_alphanumeric);
            words += line.split_whitespace().filter(is_word).count();
        }
    }
    words
}

#[test]
fn documents_are_few_and_short() {
    let documents = documents();
    let mut words = 0;
    for document in &documents {
        // All of it is written by the table of messages (protocol_doc.rs).
        if !document.ends_with("protocol.md") {
            let of_document = words_by_hand(&fs::read_to_string(document).unwrap());
            println!("{of_document:6} {}", document.display());
            words += of_document;
        }
    }
    println!("{words:6} words in {} documents", documents.len());
    assert!(words <= MAX_WORDS, "{words} words");
    assert!(
        documents.len() <= MAX_DOCUMENTS,
        "{} documents",
        documents.len()
    );
}

#[test]
fn words_between_marks_and_bars_do_not_count() {
    let text =
        "Two words\n<!-- x: begin -->\n| not one |\n<!-- x: end -->\n| a | 1.5 Ω |\n|---|---|\n";
    assert_eq!(words_by_hand(text), 5);
}
