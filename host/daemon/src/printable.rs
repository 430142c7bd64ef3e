//! Sanitising of external text for terminals, logs and JSON.

/// Longest text passed on, in characters.
const MAX_CHARS: usize = 300;

/// Returns `text` with control characters escaped, cut to 300 characters.
pub fn printable(text: &str) -> String {
    ihd_signal::printable::cut(text, MAX_CHARS)
}
