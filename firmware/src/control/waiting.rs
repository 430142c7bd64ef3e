//! State WaitingForPot: probes at intervals, until a pot is back or the wait is given up.

use crate::control::restart::is_reached;
use crate::limits::{PROBE_MS, QUICK_PROBE_MS, QUICK_PROBES_FOR_MS};

/// A wait for a pot.
#[derive(Clone, Debug)]
pub struct Waiting {
    since_ms: u32,
    next_probe_ms: u32,
    /// A pot was heated before it went away: it may be on its way back.
    may_return: bool,
    /// Start of the time in which the bridge may switch without a judged pot, in milliseconds.
    unjudged_since_ms: u32,
}

impl Waiting {
    /// Begins the wait; `may_return` if a pot was heated until now.
    pub fn new(now_ms: u32, may_return: bool) -> Self {
        Self {
            since_ms: now_ms,
            next_probe_ms: now_ms,
            may_return,
            unjudged_since_ms: now_ms,
        }
    }

    /// Start of the time in which the bridge may switch without a judged pot, in milliseconds.
    pub fn unjudged_since_ms(&mut self) -> &mut u32 {
        &mut self.unjudged_since_ms
    }

    /// Sets the time of the next probe, after one without a pot.
    pub fn schedule_probe(&mut self, now_ms: u32) {
        let waited_ms = now_ms.wrapping_sub(self.since_ms);
        let pause_ms = if self.may_return && waited_ms < QUICK_PROBES_FOR_MS {
            QUICK_PROBE_MS
        } else {
            PROBE_MS
        };
        self.next_probe_ms = now_ms.wrapping_add(pause_ms);
    }

    /// Returns `true` if the next probe is due.
    pub fn is_probe_due(&self, now_ms: u32) -> bool {
        is_reached(now_ms, self.next_probe_ms)
    }

    /// Returns `true` if the wait has lasted so long.
    pub fn is_over(&self, now_ms: u32, give_up_ms: u32) -> bool {
        is_reached(now_ms, self.since_ms.wrapping_add(give_up_ms))
    }
}
