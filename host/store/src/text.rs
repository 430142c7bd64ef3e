//! Text from outside, before it is stored: whoever reads the database prints it.

/// Longest text of a row, in characters.
const MAX_CHARS: usize = 4_000;

/// The text fit to be shown, and cut where it is far too long.
pub fn printable(text: &str) -> String {
    ihd_signal::printable::cut(text, MAX_CHARS)
}
