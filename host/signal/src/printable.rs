//! Text from a device or a file, made fit for a terminal or a log.

use std::fmt::{self, Display, Formatter, Write};

/// Shows text with its control characters as `\u{1b}`, so that nothing that a device or a file holds
/// moves a cursor, names a window or breaks a line.
#[derive(Clone, Copy, Debug)]
pub struct Printable<'a>(&'a str);

/// Text from a device or a file, fit to be shown.
pub fn printable(text: &str) -> Printable<'_> {
    Printable(text)
}

impl Display for Printable<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        for c in self.0.chars() {
            if c.is_control() {
                write!(f, "{}", c.escape_unicode())?;
            } else {
                f.write_char(c)?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_are_escaped_and_nothing_else() {
        let text = printable("a\x1b]0;owned\x07\r\n\u{9b}b µΩ").to_string();
        assert_eq!(text, r"a\u{1b}]0;owned\u{7}\u{d}\u{a}\u{9b}b µΩ");
    }
}
