//! Text from outside, made printable before it is stored: readers of the database print it as it is.

/// Longest text of a row, in characters.
const MAX_CHARS: usize = 4_000;

/// Replaces unprintable characters and cuts a text that is far too long.
pub fn printable(text: &str) -> String {
    ihd_signal::printable::cut(text, MAX_CHARS)
}
