//! Text where only some characters may stand.

/// ASCII letters, digits and the bytes of `plain` as they are, every other byte as `%` and two digits.
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
