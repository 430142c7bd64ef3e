//! Percent encoding.

/// Encodes every byte but ASCII letters, digits and those of `plain` as `%` and two hexadecimal digits.
pub(crate) fn encoded(text: &str, plain: &[u8]) -> String {
    let mut written = String::new();
    for byte in text.bytes() {
        if byte.is_ascii_alphanumeric() || plain.contains(&byte) {
            written.push(char::from(byte));
        } else {
            written += &format!("%{byte:02X}");
        }
    }
    written
}
