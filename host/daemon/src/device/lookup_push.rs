//! Push of lookups, one at a time, as a machine without I/O: events in, steps out.
//!
//! ```text
//!  learned ──► queued (the newest only) ──► sent, if no other is under way ──► under way ──► reported: active
//!  by hand ───────────────────────────────► sent, in place of another ─────►      │
//!                                                                                 └ 3 s, link cut, reset: failed
//! ```

use std::time::Duration;

use ihd_shared::lookup::RlLookup;
use tokio::time::Instant;

use super::request::ReplySender;
use crate::learning::LookupToPush;

/// Time limit from acceptance of a lookup to its use: one half-cycle, and the delay of the link.
const ACTIVATION_TIMEOUT: Duration = Duration::from_secs(3);

/// Lookup that the device has accepted and does not use yet.
pub struct UnderWay {
    /// The lookup, under the version that the device accepted.
    pub lookup: Box<RlLookup>,
    /// `true` if the learner built it under this version.
    pub is_learned: bool,
    /// Sender of the outcome, if it was pushed by hand.
    pub reply: Option<ReplySender>,
}

/// Action that the push requests.
pub enum PushStep {
    /// No action.
    Nothing,
    /// Send this learned lookup to the device.
    Send(Box<LookupToPush>),
    /// The device uses the lookup.
    Active(UnderWay),
    /// The device accepted the lookup and does not use it in time.
    TimedOut(UnderWay),
}

/// State of the pushes to one device.
#[derive(Default)]
pub struct LookupPush {
    /// Push under way with its time limit; `None` without one.
    under_way: Option<(UnderWay, Instant)>,
    /// Learned lookup that waits for the end of the push under way.
    queued: Option<Box<LookupToPush>>,
}

impl LookupPush {
    /// Returns `true` while a lookup is under way.
    pub fn is_under_way(&self) -> bool {
        self.under_way.is_some()
    }

    /// Processes a learned lookup, which takes the place of one that waits.
    pub fn learned(&mut self, lookup: Box<LookupToPush>) -> PushStep {
        self.queued = Some(lookup);
        self.send_queued()
    }

    /// Processes the time. A step other than `Nothing` may be followed by another one.
    pub fn tick(&mut self, now: Instant) -> PushStep {
        match self.under_way.take_if(|(_, deadline)| now >= *deadline) {
            Some((push, _)) => PushStep::TimedOut(push),
            None => self.send_queued(),
        }
    }

    /// Processes the device's acceptance. Returns the push that this one replaces.
    #[must_use]
    pub fn accepted(&mut self, push: UnderWay, now: Instant) -> Option<UnderWay> {
        let replaced = self.under_way.replace((push, now + ACTIVATION_TIMEOUT));
        replaced.map(|(push, _)| push)
    }

    /// Processes the version that the device reports.
    pub fn reported(&mut self, version: u32) -> PushStep {
        let is_used = |push: &mut (UnderWay, Instant)| push.0.lookup.version == version;
        match self.under_way.take_if(is_used) {
            Some((push, _)) => PushStep::Active(push),
            None => PushStep::Nothing,
        }
    }

    /// Ends the push under way, whose outcome is unknown; returns it.
    #[must_use]
    pub fn abandon(&mut self) -> Option<UnderWay> {
        self.under_way.take().map(|(push, _)| push)
    }

    /// Drops the lookup that waits.
    pub fn forget_queued(&mut self) {
        self.queued = None;
    }

    fn send_queued(&mut self) -> PushStep {
        match self.queued.take_if(|_| self.under_way.is_none()) {
            Some(lookup) => PushStep::Send(lookup),
            None => PushStep::Nothing,
        }
    }
}

#[cfg(test)]
mod tests {
    use ihd_shared::lookup::prior::prior;
    use tokio::sync::oneshot;

    use super::*;

    fn lookup(version: u32) -> RlLookup {
        RlLookup { version, ..prior() }
    }

    fn learned(version: u32) -> Box<LookupToPush> {
        Box::new(LookupToPush::without_certainty(lookup(version)))
    }

    fn under_way(version: u32) -> UnderWay {
        UnderWay {
            lookup: Box::new(lookup(version)),
            is_learned: true,
            reply: None,
        }
    }

    /// A step as text, with the version that it concerns.
    fn text(step: PushStep) -> String {
        match step {
            PushStep::Nothing => "nothing".to_owned(),
            PushStep::Send(lookup) => format!("send {}", lookup.lookup.version),
            PushStep::Active(push) => format!("active {}", push.lookup.version),
            PushStep::TimedOut(push) => format!("timed out {}", push.lookup.version),
        }
    }

    #[test]
    fn one_is_under_way_and_the_newest_waits() {
        let (mut push, now) = (LookupPush::default(), Instant::now());
        assert_eq!(text(push.learned(learned(1))), "send 1");
        assert!(push.accepted(under_way(1), now).is_none());
        assert_eq!(text(push.learned(learned(2))), "nothing");
        assert_eq!(text(push.learned(learned(3))), "nothing");
        assert_eq!(text(push.reported(0)), "nothing");
        assert_eq!(text(push.reported(1)), "active 1");
        assert_eq!(text(push.reported(1)), "nothing", "once");
        assert_eq!(text(push.tick(now)), "send 3");
        // Refused by the device: nothing is under way.
        assert_eq!(text(push.tick(now)), "nothing");
        assert!(!push.is_under_way());
    }

    #[test]
    fn what_the_device_does_not_use_in_time_makes_way() {
        let (mut push, now) = (LookupPush::default(), Instant::now());
        assert!(push.accepted(under_way(4), now).is_none());
        assert_eq!(text(push.learned(learned(5))), "nothing");
        let late = now + ACTIVATION_TIMEOUT;
        assert_eq!(text(push.tick(late - Duration::from_millis(1))), "nothing");
        assert_eq!(text(push.tick(late)), "timed out 4");
        assert_eq!(text(push.tick(late)), "send 5");
    }

    #[test]
    fn a_push_by_hand_replaces_another_and_the_end_of_the_link_ends_it() {
        let (mut push, now) = (LookupPush::default(), Instant::now());
        assert!(push.accepted(under_way(1), now).is_none());
        let (reply, _replied) = oneshot::channel();
        let by_hand = UnderWay {
            is_learned: false,
            reply: Some(reply),
            ..under_way(2)
        };
        let replaced = push.accepted(by_hand, now);
        assert_eq!(replaced.map(|push| push.lookup.version), Some(1));
        assert_eq!(text(push.reported(1)), "nothing");
        push.learned(learned(3));
        push.forget_queued();
        let ended = push.abandon().unwrap();
        assert!(ended.reply.is_some() && ended.lookup.version == 2);
        assert!(push.abandon().is_none());
        assert_eq!(
            text(push.tick(now)),
            "nothing",
            "a reset forgets what waits"
        );
    }
}
