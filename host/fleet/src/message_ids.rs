//! Message ids of windows and events, by which the server detects duplicates. Ids are unique in a stream, not in a subject: with a guessed id one edge
//! could make another edge's message pass for a duplicate. So each id carries an authentication code of the edge.

use ring::hmac::{HMAC_SHA256, Key, sign};

/// Bytes of the code: 64 bits cannot be guessed within the server's duplicate window.
const CODE_BYTES: usize = 8;

/// Generator of one edge's message ids.
pub struct MessageIds {
    key: Key,
}

impl MessageIds {
    /// Creates it from the secret of the edge's store, so that the ids are the same after a restart.
    pub fn new(secret: [u8; 16]) -> Self {
        Self {
            key: Key::new(HMAC_SHA256, &secret),
        }
    }

    /// Returns the id of a window: `HOB-BOOT-SEQ-CODE`.
    pub fn window_id(&self, hob: &str, boot: u32, seq: u32) -> String {
        let name = format!("{hob}-{boot}-{seq}");
        let code = self.code(&name);
        format!("{name}-{code}")
    }

    /// Returns the id of an event: `EDGE-event-NUMBER-TIME-CODE`. A new store, which counts from the beginning, has other codes; one from a
    /// backup counts on from it, at other times.
    pub fn event_id(&self, edge: &str, number: i64, at_ms: i64) -> String {
        let name = format!("{edge}-event-{number}-{at_ms}");
        let code = self.code(&name);
        format!("{name}-{code}")
    }

    /// Returns the public identity of the edge's store, which does not reveal its secret.
    pub fn public(&self) -> String {
        // No window has this name: names of hobs have no spaces.
        self.code("the store itself")
    }

    fn code(&self, of: &str) -> String {
        let code = sign(&self.key, of.as_bytes());
        let code = code.as_ref()[..CODE_BYTES].iter();
        code.map(|byte| format!("{byte:02x}")).collect()
    }
}

/// Returns boot and number of the window with an id of [`MessageIds::window_id`]; `None` if it is not of this hob.
pub fn parse_window_id(number: &str, hob: &str) -> Option<(u32, u32)> {
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
        let (a, b) = (MessageIds::new([1; 16]), MessageIds::new([2; 16]));
        let number = a.window_id("bench", 7, 11);
        assert_eq!(number, MessageIds::new([1; 16]).window_id("bench", 7, 11));
        assert!(number.starts_with("bench-7-11-"), "{number}");
        let others = [
            a.window_id("bench", 7, 12),
            a.window_id("bench", 71, 1),
            b.window_id("bench", 7, 11),
        ];
        assert!(!others.contains(&number));
        assert_eq!(parse_window_id(&number, "bench"), Some((7, 11)));
        for (number, hob) in [
            (&*number, "ben"),
            ("bench-7-11", "bench"),
            ("bench-7-11-a-b", "bench"),
        ] {
            assert_eq!(parse_window_id(number, hob), None, "{number} of {hob}");
        }
    }

    #[test]
    fn an_event_of_a_new_store_is_no_duplicate_of_the_former_stores() {
        let (a, b) = (MessageIds::new([1; 16]), MessageIds::new([2; 16]));
        let number = a.event_id("lab-2", 1, 5);
        assert!(number.starts_with("lab-2-event-1-"), "{number}");
        assert_ne!(number, b.event_id("lab-2", 1, 5));
        assert_ne!(number, a.event_id("lab-2", 2, 5));
        assert_ne!(
            number,
            a.event_id("lab-2", 1, 6),
            "counted again, from a backup"
        );
    }

    #[test]
    fn a_store_is_known_by_what_is_no_window_of_it() {
        let (a, b) = (MessageIds::new([1; 16]), MessageIds::new([2; 16]));
        assert_eq!(a.public(), MessageIds::new([1; 16]).public());
        assert_ne!(a.public(), b.public());
        assert_eq!(a.public().len(), 2 * CODE_BYTES);
    }
}
