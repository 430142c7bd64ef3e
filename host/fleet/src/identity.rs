//! By which the server knows a window that comes twice. The server asks for it in a whole stream, not in a subject: whoever could guess the
//! number of another edge's window could make it pass for a duplicate. So it carries a code that only the edge itself can make.

use ring::hmac::{HMAC_SHA256, Key, sign};

/// Bytes of the code: nobody guesses 64 bits within the time for which the server remembers.
const CODE_BYTES: usize = 8;

/// What makes the numbers of one edge's windows.
pub struct Identity {
    key: Key,
}

impl Identity {
    /// With a secret of the edge's store, so that the numbers are the same after a restart.
    pub fn new(secret: [u8; 16]) -> Self {
        Self {
            key: Key::new(HMAC_SHA256, &secret),
        }
    }

    /// The number of a window: `HOB-BOOT-SEQ-CODE`.
    pub fn of_window(&self, hob: &str, boot: u32, seq: u32) -> String {
        let name = format!("{hob}-{boot}-{seq}");
        let code = sign(&self.key, name.as_bytes());
        let code = code.as_ref()[..CODE_BYTES].iter();
        let code: String = code.map(|byte| format!("{byte:02x}")).collect();
        format!("{name}-{code}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_has_one_number_and_no_other_window_or_edge_has_it() {
        let (a, b) = (Identity::new([1; 16]), Identity::new([2; 16]));
        let number = a.of_window("bench", 7, 11);
        assert_eq!(number, Identity::new([1; 16]).of_window("bench", 7, 11));
        assert!(number.starts_with("bench-7-11-"), "{number}");
        let others = [
            a.of_window("bench", 7, 12),
            a.of_window("bench", 71, 1),
            b.of_window("bench", 7, 11),
        ];
        assert!(!others.contains(&number));
    }
}
