//! Text from outside, before it is stored.

/// Longest text of a row, in characters.
const MAX_CHARS: usize = 4_000;

/// The text with its control characters escaped, and cut where it is far too long: whoever reads the
/// database prints it.
pub fn printable(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars().take(MAX_CHARS) {
        if c.is_control() {
            out.extend(c.escape_unicode());
        } else {
            out.push(c);
        }
    }
    if text.chars().nth(MAX_CHARS).is_some() {
        out.push('…');
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_are_escaped_and_nothing_else() {
        assert_eq!(
            printable("\u{1b}[2J ü\n\u{9b}"),
            "\\u{1b}[2J ü\\u{a}\\u{9b}"
        );
        assert_eq!(printable(&"ü".repeat(5_000)).chars().count(), MAX_CHARS + 1);
    }
}
