//! Sections of documents that tests generate, between two lines of marks. Tests of other packages include this file by its path.

use std::fs::File;
use std::io::{Read, Seek, Write};
use std::path::Path;

/// Compares a section of a document of docs/ with what was generated; `UPDATE_DOCS=1` rewrites it.
///
/// # Panics
/// Where they differ, with the command that rewrites it.
pub fn hold(document: &str, mark: &str, generated: &str, command: &str) {
    let above = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors();
    let path = above
        .map(|folder| folder.join("docs").join(document))
        .find(|path| path.exists());
    let path = path.unwrap_or_else(|| panic!("no docs/{document} in the checkout"));
    let mut file = File::options().read(true).write(true).open(path).unwrap();
    // Tests of other sections of this document run at the same time, in this process or another.
    file.lock().unwrap();
    let mut text = String::new();
    file.read_to_string(&mut text).unwrap();
    let (begin, end) = (
        format!("<!-- {mark}: begin -->\n"),
        format!("<!-- {mark}: end -->\n"),
    );
    let lacks = || panic!("docs/{document} lacks {begin}{end}");
    let (before, rest) = text.split_once(&begin).unwrap_or_else(lacks);
    let (section, after) = rest.split_once(&end).unwrap_or_else(lacks);
    if std::env::var_os("UPDATE_DOCS").is_some() {
        let text = [before, &begin, generated, &end, after].concat();
        file.rewind().unwrap();
        file.write_all(text.as_bytes()).unwrap();
        file.set_len(text.len() as u64).unwrap();
    } else {
        assert_eq!(
            section, generated,
            "docs/{document}: UPDATE_DOCS=1 {command}"
        );
    }
}
