//! Faults of a run, and the time until the bridge is open after each.

use ihd_shared::fault::Fault;

use super::record::FaultRecord;

/// Faults in order of time.
#[derive(Default)]
pub struct FaultLog {
    faults: Vec<FaultRecord>,
    active: Fault,
    /// Time of the injection that may cause the next fault, in seconds.
    cause_s: Option<f64>,
    /// Fault whose bridge is not open yet, and the time from which its delay counts.
    opening: Option<(usize, f64)>,
}

impl FaultLog {
    /// The active fault, or [`Fault::NONE`].
    pub fn active(&self) -> Fault {
        self.active
    }

    /// Notes an injection: the next fault's delay counts from `now_s`.
    pub fn injected(&mut self, now_s: f64) {
        self.cause_s = Some(now_s);
    }

    /// Records the fault that is active at `now_s`, if it is another one, and the time since which both switches are open.
    pub fn watch(&mut self, fault: Fault, now_s: f64, open_since_s: Option<f64>) {
        if fault != self.active && fault != Fault::NONE {
            self.opening = Some((self.faults.len(), self.cause_s.take().unwrap_or(now_s)));
            self.faults.push(FaultRecord {
                t_s: now_s,
                name: format!("{fault:?}"),
                off_after_s: None,
            });
        }
        self.active = fault;
        if let (Some((number, since_s)), Some(open_s)) = (self.opening, open_since_s) {
            self.faults[number].off_after_s = Some((open_s - since_s).max(0.0));
            self.opening = None;
        }
    }

    /// Returns all faults.
    pub fn finish(self) -> Vec<FaultRecord> {
        self.faults
    }
}
