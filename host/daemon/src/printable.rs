//! Text from a device, made fit for terminals, logs and JSON.

/// Longest text of a device that is passed on, in characters.
const LONGEST: usize = 200;

/// `text` with its control characters escaped, and cut where it is very long.
pub fn printable(text: &str) -> String {
    let mut out = String::with_capacity(text.len().min(LONGEST));
    for c in text.chars().take(LONGEST) {
        if c.is_control() {
            out.extend(c.escape_unicode());
        } else {
            out.push(c);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_terminal_is_not_commanded() {
        assert_eq!(
            printable("a\u{1b}[2Jb\n\u{9b}"),
            "a\\u{1b}[2Jb\\u{a}\\u{9b}"
        );
        assert_eq!(printable(&"x".repeat(1_000)).len(), LONGEST);
    }
}
