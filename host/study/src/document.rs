//! Section of a document written by a study, between two marks.

use std::path::Path;

use anyhow::{Context, Result, bail};

/// Replaces the section between the marks `begin` and `end` of a document; `None` without the marks.
fn replaced(document: &str, (begin, end): (&str, &str), section: &str) -> Option<String> {
    let (before, rest) = document.split_once(begin)?;
    let (_, after) = rest.split_once(end)?;
    Some(format!("{before}{begin}\n{section}{end}{after}"))
}

/// Replaces the section of a file between two marks.
///
/// # Errors
/// A file that cannot be read or written, or has no such section.
pub fn write_into(path: &Path, marks: (&str, &str), section: &str) -> Result<()> {
    let document =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let Some(new) = replaced(&document, marks, section) else {
        let (begin, end) = marks;
        bail!(
            "{} has no section between {begin} and {end}",
            path.display()
        );
    };
    std::fs::write(path, new).with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_section_is_replaced_and_the_rest_kept() {
        let new = replaced("a\n[\nold\n]\nb\n", ("[", "]"), "new\n").unwrap();
        assert_eq!(new, "a\n[\nnew\n]\nb\n");
        assert_eq!(replaced("nothing", ("[", "]"), "new"), None);
    }
}
