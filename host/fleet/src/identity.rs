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
        let code = self.code(&name);
        format!("{name}-{code}")
    }

    /// By which others know the edge's store and learn nothing of its secret.
    pub fn public(&self) -> String {
        // No window is called so: hobs have no spaces in their names.
        self.code("the store itself")
    }

    fn code(&self, of: &str) -> String {
        let code = sign(&self.key, of.as_bytes());
        let code = code.as_ref()[..CODE_BYTES].iter();
        code.map(|byte| format!("{byte:02x}")).collect()
    }
}

/// Boot and number of a window by the number that [`Identity::of_window`] has given it; none where it is none of this hob.
pub fn window_of(number: &str, hob: &str) -> Option<(u32, u32)> {
    let mut parts = number.strip_prefix(hob)?.strip_prefix('-')?.split('-');
    let key = (parts.next()?.parse().ok()?, parts.next()?.parse().ok()?);
    parts.next()?;
    parts.next().is_none().then_some(key)
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
        assert_eq!(window_of(&number, "bench"), Some((7, 11)));
        for (number, hob) in [
            (&*number, "ben"),
            ("bench-7-11", "bench"),
            ("bench-7-11-a-b", "bench"),
        ] {
            assert_eq!(window_of(number, hob), None, "{number} of {hob}");
        }
    }

    #[test]
    fn a_store_is_known_by_what_is_no_window_of_it() {
        let (a, b) = (Identity::new([1; 16]), Identity::new([2; 16]));
        assert_eq!(a.public(), Identity::new([1; 16]).public());
        assert_ne!(a.public(), b.public());
        assert_eq!(a.public().len(), 2 * CODE_BYTES);
    }
}
