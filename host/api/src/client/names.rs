//! Names of devices, recordings and clients in paths and headers.

use crate::percent;

/// Returns the path of a device.
pub fn device(name: &str, rest: &str) -> String {
    format!("/devices/{}{rest}", encoded(name))
}

/// Encodes a name as one path segment; dots, too: `..` is another path.
pub fn encoded(name: &str) -> String {
    percent::encoded(name, b"-_~")
}

/// Replaces characters that a header cannot hold, and limits the length to 64.
pub fn printable_ascii(name: &str) -> String {
    let printable = name.chars().map(|c| {
        if c == ' ' || c.is_ascii_graphic() {
            c
        } else {
            '?'
        }
    });
    let name: String = printable.take(64).collect();
    match name.trim() {
        "" => "somebody".into(),
        name => name.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_one_segment() {
        assert_eq!(device("bench", ""), "/devices/bench");
        assert_eq!(
            device("serial:/dev/tty ä", "/lease"),
            "/devices/serial%3A%2Fdev%2Ftty%20%C3%A4/lease"
        );
        // A dot alone would be the folder itself to a browser or proxy.
        assert_eq!(device("..", ""), "/devices/%2E%2E");
    }

    #[test]
    fn a_holder_fits_a_header() {
        assert_eq!(printable_ascii("Ada @ bench"), "Ada @ bench");
        assert_eq!(printable_ascii("Zoë\r\nx: y"), "Zo???x: y");
        assert_eq!(printable_ascii("  "), "somebody");
        assert_eq!(printable_ascii(&"x".repeat(99)).len(), 64);
    }
}
