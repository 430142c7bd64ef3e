//! Text from outside, made fit for terminals, logs and JSON, and no longer than a person reads.

/// Longest text of a device that is passed on, in characters.
const LONGEST: usize = 300;

/// `text` with its control characters escaped, and cut where it is very long.
pub fn printable(text: &str) -> String {
    match text.char_indices().nth(LONGEST) {
        None => ihd_link::printable(text),
        Some((end, _)) => ihd_link::printable(&text[..end]) + " …",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_terminal_is_not_commanded_and_not_flooded() {
        let text = printable("a\u{1b}[2Jb\n\u{9b}");
        assert!(!text.chars().any(char::is_control), "{text}");
        assert!(text.starts_with("a\\u{1b}[2Jb"), "{text}");
        let long = printable(&"ü".repeat(10_000));
        assert_eq!(long.chars().count(), LONGEST + 2);
    }
}
