//! Preemption of a waiting command by a request to switch off.
//!
//! A command that waits for its answer polls for such a request. If there is one, the device receives `SetPower(0)` at once, and
//! the command fails unless its answer comes within a short grace time. The device is then switched off again by a command with an
//! answer.

use std::time::Duration;

/// Period at which a waiting command polls for a request to switch off, on the transport's clock.
const POLL_PERIOD: Duration = Duration::from_millis(10);

/// State of the preemption of commands by a request to switch off.
#[derive(Default)]
pub(super) struct OffPreemption {
    /// Returns `true` while a request to switch off is waiting; `None` if commands are never preempted.
    pub(super) off_waits: Option<Box<dyn Fn() -> bool + Send>>,
    /// Set while the command under way is the one that switches off.
    pub(super) runs_off: bool,
    /// Set once the device was sent `SetPower(0)` during the command under way.
    pub(super) off_sent: bool,
}

impl OffPreemption {
    /// Returns `true` if a request to switch off is waiting while another command is under way.
    pub(super) fn is_requested(&self) -> bool {
        !self.runs_off && self.off_waits.as_ref().is_some_and(|off_waits| off_waits())
    }

    /// Longest time that a command may wait between two polls.
    pub(super) fn poll_period(&self) -> Duration {
        match self.off_waits {
            Some(_) => POLL_PERIOD,
            None => Duration::MAX,
        }
    }
}
