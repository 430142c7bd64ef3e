//! Whether the fleet does what it is there for: whoever sends windows and hears nothing learns by himself.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// How long a result may take. Then the next windows are learned from here, until those that are waited for have come.
const PATIENCE: Duration = Duration::from_secs(20);

/// How long a result is waited for at all: a window may have been given up.
const FORGOTTEN_AFTER: Duration = Duration::from_secs(300);

/// Windows that are waited for at most; beyond them the fleet is behind in any case.
const MOST: usize = 8_192;

/// Hob, boot and number of a window.
pub type Key = (String, u32, u32);

/// Windows that the fleet has got and not answered.
#[derive(Debug, Default)]
pub struct Answers {
    waited_for: BTreeMap<Key, Instant>,
}

impl Answers {
    /// The fleet has got a window.
    pub fn sent(&mut self, key: Key, now: Instant) {
        if self.waited_for.len() < MOST {
            self.waited_for.insert(key, now);
        }
    }

    /// A result came.
    pub fn came(&mut self, key: &Key) {
        self.waited_for.remove(key);
    }

    /// Whether the fleet answers in time.
    pub fn are_in_time(&mut self, now: Instant) -> bool {
        self.waited_for
            .retain(|_, since| now.duration_since(*since) < FORGOTTEN_AFTER);
        let oldest = self.waited_for.values().min();
        let in_time = oldest.is_none_or(|since| now.duration_since(*since) < PATIENCE);
        in_time && self.waited_for.len() < MOST
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(seq: u32) -> Key {
        ("hob".into(), 1, seq)
    }

    #[test]
    fn a_fleet_that_does_not_answer_is_not_trusted_until_it_has() {
        let begin = Instant::now();
        let after = |s: u64| begin + Duration::from_secs(s);
        let mut answers = Answers::default();
        assert!(answers.are_in_time(begin));
        answers.sent(key(1), begin);
        answers.sent(key(2), after(15));
        assert!(answers.are_in_time(after(19)));
        assert!(!answers.are_in_time(after(21)));
        answers.came(&key(2));
        assert!(!answers.are_in_time(after(22)), "the older one is missing");
        answers.came(&key(1));
        assert!(answers.are_in_time(after(22)));
    }

    #[test]
    fn a_window_that_was_given_up_is_not_waited_for_for_ever() {
        let begin = Instant::now();
        let mut answers = Answers::default();
        answers.sent(key(1), begin);
        assert!(!answers.are_in_time(begin + PATIENCE));
        assert!(answers.are_in_time(begin + FORGOTTEN_AFTER));
        assert!(answers.waited_for.is_empty());
    }
}
