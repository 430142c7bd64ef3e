//! Sanitised text from a device or a file, for a terminal, a log or a database.

use std::fmt::{self, Display, Formatter, Write};

/// Text in which control characters are shown as `\u{1b}`. Text from a device or a file then cannot move a cursor, name a
/// window, break a line, or change the order of letters.
#[derive(Clone, Copy, Debug)]
pub struct Printable<'a>(&'a str);

/// Makes text from a device or a file safe to show.
pub fn printable(text: &str) -> Printable<'_> {
    Printable(text)
}

/// Returns `true` if a character is shown as it is: it is visible, no control character, and does not change the order of
/// letters.
pub fn is_shown(c: char) -> bool {
    matches!(c, '\'' | '"' | '\\') || c.escape_debug().len() == 1
}

/// First characters of a text, safe to show; ends with ` …` if more followed.
pub fn cut(text: &str, longest: usize) -> String {
    match text.char_indices().nth(longest) {
        None => printable(text).to_string(),
        Some((end, _)) => format!("{} …", printable(&text[..end])),
    }
}

impl Display for Printable<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        for c in self.0.chars() {
            if is_shown(c) {
                f.write_char(c)?;
            } else {
                write!(f, "{}", c.escape_unicode())?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_terminal_would_obey_is_shown_instead() {
        let evil = "a\x1b]0;owned\x07\r\n\u{9b}b\u{202e}d\u{200b}\u{7f}";
        let shown = printable(evil).to_string();
        let expected = r"a\u{1b}]0;owned\u{7}\u{d}\u{a}\u{9b}b\u{202e}d\u{200b}\u{7f}";
        assert_eq!(shown, expected);
        assert!(shown.chars().all(is_shown));
    }

    #[test]
    fn ordinary_text_stays() {
        let text = "it's \"ihd\" 1.0 \\ 25 µH, 日本";
        assert_eq!(printable(text).to_string(), text);
    }

    #[test]
    fn long_text_is_cut_by_characters() {
        assert_eq!(cut("µΩ", 2), "µΩ");
        assert_eq!(cut("µΩ\u{7}", 2), "µΩ …");
        assert_eq!(cut(&"\u{7}".repeat(3), 2), r"\u{7}\u{7} …");
    }
}
