//! Contact with a device: when it was heard and asked last, and when it counts as silent or lost.

use std::time::Duration;

use ihd_link::KEEPALIVE_PERIOD;
use tokio::time::Instant;

use crate::clocks::SuspendDetector;
use crate::machine::Machine;

/// Time without events after which the device is queried.
const SILENCE_LIMIT: Duration = Duration::from_secs(2);

/// Period of reading the counters of link and learner.
const POLL_PERIOD: Duration = Duration::from_secs(1);

/// Largest number of consecutive checks without an answer or without telemetry; one more ends the session.
const MAX_UNANSWERED: u32 = 2;

/// Contact with a device during a session.
pub struct Contact {
    clocks: SuspendDetector,
    last_event: Instant,
    last_request: Instant,
    last_check: Instant,
    last_poll: Instant,
    /// Consecutive checks without an answer, or without an event since the previous one.
    unanswered: u32,
}

/// Check of the device that is due.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DueCheck {
    /// Keep-alive of a device that heats for the daemon.
    KeepAlive,
    /// Query of a device that has sent nothing for this long.
    Silence,
}

impl Contact {
    /// Begins with the handshake.
    pub fn new(machine: &Machine) -> Self {
        let now = Instant::now();
        Self {
            clocks: SuspendDetector::new(machine),
            last_event: now,
            last_request: now,
            last_check: now,
            last_poll: now,
            unanswered: 0,
        }
    }

    /// Processes the begin of a wait of the device's task, of 0.1 s at most.
    pub fn begin_wait(&mut self, machine: &Machine) {
        self.clocks.leave_out_work(machine);
    }

    /// Processes its end. Returns the time without running of this machine or process if it exceeds 5 s.
    pub fn end_wait(&mut self, machine: &Machine) -> Option<Duration> {
        self.clocks.poll(machine)
    }

    /// Processes an event of the device.
    pub fn on_event(&mut self) {
        self.on_queued_event();
        self.unanswered = 0;
    }

    /// Processes events that wait in the queue: the device is not silent.
    pub fn on_queued_event(&mut self) {
        self.last_event = Instant::now();
    }

    /// Processes a request to the device.
    pub fn on_request(&mut self) {
        self.last_request = Instant::now();
    }

    /// Processes the begin of a check.
    pub fn on_check(&mut self) {
        self.last_check = Instant::now();
    }

    /// Returns `true` if the device has sent nothing for `SILENCE_LIMIT`.
    pub fn is_silent(&self) -> bool {
        self.last_event.elapsed() >= SILENCE_LIMIT
    }

    /// Returns the check that is due; `heats` is `true` if the device heats for the daemon.
    pub fn due_check(&self, heats: bool) -> Option<DueCheck> {
        if self.is_silent() && self.last_request.elapsed() >= SILENCE_LIMIT {
            return Some(DueCheck::Silence);
        }
        let is_due = heats && self.last_check.elapsed() >= KEEPALIVE_PERIOD;
        is_due.then_some(DueCheck::KeepAlive)
    }

    /// Processes an answer to a check.
    pub fn answered(&mut self, check: DueCheck) {
        match check {
            DueCheck::KeepAlive => self.unanswered = 0,
            // It answers and sends no half-cycles.
            DueCheck::Silence => self.unanswered += 1,
        }
    }

    /// Processes a check that was preempted by `off`, which the device has answered.
    pub fn preempted(&mut self) {
        self.unanswered = 0;
    }

    /// Processes a check without an answer. Returns `false` if it was one too many.
    pub fn unanswered(&mut self) -> bool {
        self.unanswered += 1;
        self.unanswered <= MAX_UNANSWERED
    }

    /// Returns `true` if the device has sent nothing for too many checks.
    pub fn is_lost(&self) -> bool {
        self.unanswered > MAX_UNANSWERED
    }

    /// Returns `true` once per `POLL_PERIOD`.
    pub fn is_poll_due(&mut self) -> bool {
        let is_due = self.last_poll.elapsed() >= POLL_PERIOD;
        if is_due {
            self.last_poll = Instant::now();
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use tokio::time::advance;

    use super::*;

    const S: Duration = Duration::from_secs(1);

    #[tokio::test(start_paused = true)]
    async fn a_silent_device_is_asked_and_one_that_heats_is_kept_alive() {
        let mut contact = Contact::new(&Machine::default());
        advance(2 * S - Duration::from_millis(1)).await;
        assert_eq!(contact.due_check(false), None);
        advance(Duration::from_millis(1)).await;
        assert_eq!(contact.due_check(false), Some(DueCheck::Silence));
        // A request under way asks already.
        contact.on_request();
        assert_eq!(contact.due_check(false), None);
        contact.on_event();
        assert!(!contact.is_silent());
        // The keep-alive counts from the last check, whatever is heard meanwhile.
        contact.on_check();
        advance(KEEPALIVE_PERIOD).await;
        contact.on_event();
        assert_eq!(contact.due_check(true), Some(DueCheck::KeepAlive));
        assert_eq!(contact.due_check(false), None);
        contact.on_check();
        assert_eq!(contact.due_check(true), None);
    }

    #[tokio::test(start_paused = true)]
    async fn two_checks_may_go_unanswered() {
        let mut contact = Contact::new(&Machine::default());
        assert!(contact.unanswered() && contact.unanswered() && !contact.unanswered());
        contact.on_event();
        // It answers each time, and sends no half-cycles.
        let silent = DueCheck::Silence;
        contact.answered(silent);
        contact.answered(silent);
        assert!(!contact.is_lost());
        contact.answered(silent);
        assert!(contact.is_lost());
        contact.answered(DueCheck::KeepAlive);
        assert!(!contact.is_lost());
    }

    #[tokio::test(start_paused = true)]
    async fn counters_are_read_once_a_second() {
        let mut contact = Contact::new(&Machine::default());
        assert!(!contact.is_poll_due());
        advance(S).await;
        assert!(contact.is_poll_due() && !contact.is_poll_due());
    }
}
