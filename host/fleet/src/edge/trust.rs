//! Time until which windows are delegated to the fleet: an edge that receives no results identifies windows itself.
//!
//! The delegation is a lease of [`DELEGATION_TIME`] (docs/fleet.md). It counts from the oldest of three times, so that each of them alone lets
//! it expire: the outbox has sent all due windows, the inbox was answered, the oldest unanswered window was sent.

use std::collections::BTreeMap;
use std::time::Duration;

use ihd_daemon::fleet::DELEGATION_TIME;
use tokio::time::Instant;

/// Time after which a missing result is ignored: by then later windows show that the fleet answers.
pub const FORGOTTEN_AFTER: Duration = Duration::from_secs(300);

/// Most unanswered windows; with more the fleet is behind in any case.
const MAX_UNANSWERED: usize = 8_192;

/// Hob, boot and number of a window.
pub type WindowKey = (String, u32, u32);

/// Windows that the fleet has received and not answered.
#[derive(Debug, Default)]
pub struct Answers {
    waited_for: BTreeMap<WindowKey, Instant>,
}

impl Answers {
    /// Adds a window that the fleet has received.
    pub fn insert(&mut self, key: WindowKey, now: Instant) {
        if self.waited_for.len() < MAX_UNANSWERED {
            self.waited_for.insert(key, now);
        }
    }

    /// Removes a window whose result came, or will not come.
    pub fn remove(&mut self, key: &WindowKey) {
        self.waited_for.remove(key);
    }

    /// Removes all windows, because no result of them will come.
    pub fn clear(&mut self) {
        self.waited_for.clear();
    }

    /// Returns the time at which the oldest unanswered window was sent, `now` without any; `None` if they are too many.
    fn oldest(&mut self, now: Instant) -> Option<Instant> {
        self.waited_for
            .retain(|_, since| now.duration_since(*since) < FORGOTTEN_AFTER);
        let oldest = self.waited_for.values().min();
        (self.waited_for.len() < MAX_UNANSWERED).then(|| oldest.copied().unwrap_or(now))
    }
}

/// Times at which outbox and inbox last succeeded; `None` while they fail.
#[derive(Debug, Default)]
pub struct Signs {
    sent: Option<Instant>,
    answered: Option<Instant>,
}

impl Signs {
    /// Records the outbox: it has sent all windows of a batch (or none was due), or it has failed.
    pub fn sent(&mut self, works: bool, now: Instant) {
        self.sent = works.then_some(now);
    }

    /// Records the inbox: it was answered, or not.
    pub fn answered(&mut self, works: bool, now: Instant) {
        self.answered = works.then_some(now);
    }

    /// Returns the end of the delegation; `None` if there is none.
    pub fn delegated_until(&self, answers: &mut Answers, now: Instant) -> Option<Instant> {
        let since = answers.oldest(now)?.min(self.sent?).min(self.answered?);
        Some(since + DELEGATION_TIME)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(seq: u32) -> WindowKey {
        ("hob".into(), 1, seq)
    }

    const S: Duration = Duration::from_secs(1);

    /// Records a server that answers everything at once.
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
            signs.delegated_until(answers, begin + after * S)
        };
        assert_eq!(until(&mut answers, 0), Some(begin + DELEGATION_TIME));
        answers.insert(key(1), begin);
        answers.insert(key(2), begin + 15 * S);
        assert_eq!(until(&mut answers, 19), Some(begin + DELEGATION_TIME));
        answers.remove(&key(2));
        assert_eq!(
            until(&mut answers, 22),
            Some(begin + DELEGATION_TIME),
            "the older one is missing"
        );
        answers.remove(&key(1));
        assert_eq!(
            until(&mut answers, 22),
            Some(begin + 22 * S + DELEGATION_TIME)
        );
    }

    #[test]
    fn each_sign_alone_lets_trust_run_out() {
        let begin = Instant::now();
        let mut answers = Answers::default();
        let mut signs = Signs::default();
        assert_eq!(signs.delegated_until(&mut answers, begin), None);
        signs.sent(true, begin);
        assert_eq!(
            signs.delegated_until(&mut answers, begin),
            None,
            "nothing was heard"
        );
        works(&mut signs, begin);
        // The outbox hangs; then the inbox.
        signs.answered(true, begin + 15 * S);
        let until = signs.delegated_until(&mut answers, begin + 15 * S);
        assert_eq!(until, Some(begin + DELEGATION_TIME));
        signs.sent(true, begin + 17 * S);
        let until = signs.delegated_until(&mut answers, begin + 17 * S);
        assert_eq!(until, Some(begin + 15 * S + DELEGATION_TIME));
        signs.sent(false, begin + 17 * S);
        assert_eq!(signs.delegated_until(&mut answers, begin + 17 * S), None);
    }

    #[test]
    fn a_window_is_not_waited_for_for_ever() {
        let begin = Instant::now();
        let (mut signs, mut answers) = (Signs::default(), Answers::default());
        answers.insert(key(1), begin);
        let late = begin + FORGOTTEN_AFTER;
        works(&mut signs, late);
        assert_eq!(
            signs.delegated_until(&mut answers, late),
            Some(late + DELEGATION_TIME)
        );
        assert!(answers.waited_for.is_empty());
    }
}
