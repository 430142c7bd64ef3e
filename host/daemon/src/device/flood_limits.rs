//! Limits of what a device may send, and what came beyond them.

use crate::clocks::RateLimit;

/// Largest number of windows accepted per second; a device sends six as configured.
const MAX_WINDOWS_PER_S: u32 = 30;

/// Largest number of faults, rejected windows and pot changes published per second.
const MAX_EVENTS_PER_S: u32 = 10;

/// Limits of one session.
pub(super) struct FloodLimits {
    pub(super) windows: RateLimit,
    pub(super) events: RateLimit,
    /// Frames of this link already counted as beyond what a hob sends.
    frames: u64,
}

impl Default for FloodLimits {
    fn default() -> Self {
        Self {
            windows: RateLimit::new(MAX_WINDOWS_PER_S),
            events: RateLimit::new(MAX_EVENTS_PER_S),
            frames: 0,
        }
    }
}

impl FloodLimits {
    /// Returns how many windows and events were rejected since the last call.
    pub(super) fn take_rejected(&mut self) -> u64 {
        self.events.take_rejected() + self.windows.take_rejected()
    }

    /// Takes the number of frames of this link beyond what a hob sends; returns how many of them are new.
    pub(super) fn new_frames(&mut self, beyond: u64) -> u64 {
        beyond - std::mem::replace(&mut self.frames, beyond)
    }
}
