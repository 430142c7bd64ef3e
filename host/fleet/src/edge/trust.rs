//! Until when the fleet is trusted to do what it is there for: whoever sends windows and hears nothing learns by himself.
//!
//! Trust is a lease of [`TRUSTED_FOR`] (docs/fleet.md). It counts from the oldest of three signs, so that each of them alone can let it run
//! out: the outbox has sent all that it had to, the inbox was answered, and of the windows that are waited for the oldest was sent.

use std::collections::BTreeMap;
use std::time::Duration;

use ihd_daemon::fleet::TRUSTED_FOR;
use tokio::time::Instant;

/// Longest wait for a result at all: until the windows behind it show that the fleet answers.
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

    /// A result came, or none will.
    pub fn came(&mut self, key: &Key) {
        self.waited_for.remove(key);
    }

    /// None of them will come.
    pub fn lost(&mut self) {
        self.waited_for.clear();
    }

    /// When the oldest was sent of those that are waited for, now where there is none; none where they are too many.
    fn since(&mut self, now: Instant) -> Option<Instant> {
        self.waited_for
            .retain(|_, since| now.duration_since(*since) < FORGOTTEN_AFTER);
        let oldest = self.waited_for.values().min();
        (self.waited_for.len() < MOST).then(|| oldest.copied().unwrap_or(now))
    }
}

/// Times at which outbox and inbox last succeeded; none while they fail.
#[derive(Debug, Default)]
pub struct Signs {
    sent: Option<Instant>,
    answered: Option<Instant>,
}

impl Signs {
    /// The outbox has sent all that was due in a batch, or nothing was; or it has not.
    pub fn sent(&mut self, works: bool, now: Instant) {
        self.sent = works.then_some(now);
    }

    /// The inbox was answered; or not.
    pub fn answered(&mut self, works: bool, now: Instant) {
        self.answered = works.then_some(now);
    }

    /// Until when the fleet is trusted; none where it is not at all.
    pub fn trusted_until(&self, answers: &mut Answers, now: Instant) -> Option<Instant> {
        let since = answers.since(now)?.min(self.sent?).min(self.answered?);
        Some(since + TRUSTED_FOR)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(seq: u32) -> Key {
        ("hob".into(), 1, seq)
    }

    const S: Duration = Duration::from_secs(1);

    /// A fleet whose server answers everything, at once.
    fn works(signs: &mut Signs, now: Instant) {
        signs.sent(true, now);
        signs.answered(true, now);
    }

    #[test]
    fn a_fleet_that_does_not_answer_is_not_trusted_until_it_has() {
        let begin = Instant::now();
        let (mut signs, mut answers) = (Signs::default(), Answers::default());
        let mut until = |answers: &mut Answers, after: u32| {
            works(&mut signs, begin + after * S);
            signs.trusted_until(answers, begin + after * S)
        };
        assert_eq!(until(&mut answers, 0), Some(begin + TRUSTED_FOR));
        answers.sent(key(1), begin);
        answers.sent(key(2), begin + 15 * S);
        assert_eq!(until(&mut answers, 19), Some(begin + TRUSTED_FOR));
        answers.came(&key(2));
        assert_eq!(
            until(&mut answers, 22),
            Some(begin + TRUSTED_FOR),
            "the older one is missing"
        );
        answers.came(&key(1));
        assert_eq!(until(&mut answers, 22), Some(begin + 22 * S + TRUSTED_FOR));
    }

    #[test]
    fn each_sign_alone_lets_trust_run_out() {
        let begin = Instant::now();
        let mut answers = Answers::default();
        let mut signs = Signs::default();
        assert_eq!(signs.trusted_until(&mut answers, begin), None);
        signs.sent(true, begin);
        assert_eq!(
            signs.trusted_until(&mut answers, begin),
            None,
            "nothing was heard"
        );
        works(&mut signs, begin);
        // The outbox hangs; then the inbox.
        signs.answered(true, begin + 15 * S);
        let until = signs.trusted_until(&mut answers, begin + 15 * S);
        assert_eq!(until, Some(begin + TRUSTED_FOR));
        signs.sent(true, begin + 17 * S);
        let until = signs.trusted_until(&mut answers, begin + 17 * S);
        assert_eq!(until, Some(begin + 15 * S + TRUSTED_FOR));
        signs.sent(false, begin + 17 * S);
        assert_eq!(signs.trusted_until(&mut answers, begin + 17 * S), None);
    }

    #[test]
    fn a_window_is_not_waited_for_for_ever() {
        let begin = Instant::now();
        let (mut signs, mut answers) = (Signs::default(), Answers::default());
        answers.sent(key(1), begin);
        let late = begin + FORGOTTEN_AFTER;
        works(&mut signs, late);
        assert_eq!(
            signs.trusted_until(&mut answers, late),
            Some(late + TRUSTED_FOR)
        );
        assert!(answers.waited_for.is_empty());
    }
}
