//! Inputs other than the comparator that open the bridge in hardware, and hold it open until the drive has opened it too.

/// Opening of both switches by the sampling watchdog or a system fault.
#[derive(Clone, Copy, Debug)]
pub struct HardwareOpening {
    /// Time at which the sampling watchdog bites if it is not fed, in seconds; infinite without one.
    due_s: f64,
    /// Time since when the bridge is held open, in seconds.
    held_s: Option<f64>,
}

impl Default for HardwareOpening {
    /// Creates one without a watchdog.
    fn default() -> Self {
        Self {
            due_s: f64::INFINITY,
            held_s: None,
        }
    }
}

impl HardwareOpening {
    /// Feeds the sampling watchdog at `now_s`, which next bites at `due_s`; returns `true` if it has bitten. What it opened stays open.
    pub fn feed(&mut self, now_s: f64, due_s: f64) -> bool {
        let has_bitten = self.due_s <= now_s;
        self.held_s = self.since_s(now_s);
        self.due_s = due_s;
        has_bitten
    }

    /// Opens the bridge at `now_s` and holds it open.
    pub fn open(&mut self, now_s: f64) {
        self.held_s = self.since_s(now_s).or(Some(now_s));
    }

    /// Lets the bridge go, as the drive has opened it.
    pub fn release(&mut self) {
        self.held_s = None;
    }

    /// Time in seconds since when the bridge is held open; `None` while it is not.
    pub fn since_s(&self, now_s: f64) -> Option<f64> {
        self.held_s.or((self.due_s <= now_s).then_some(self.due_s))
    }
}
