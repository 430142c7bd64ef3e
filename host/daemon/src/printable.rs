//! Text from outside, made fit for terminals, logs and JSON, and no longer than a person reads.

/// Longest text of a device that is passed on, in characters.
const LONGEST: usize = 300;

/// `text` fit to be shown, and cut where it is very long.
pub fn printable(text: &str) -> String {
    ihd_signal::printable::cut(text, LONGEST)
}
