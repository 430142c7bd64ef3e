//! Accounting of a device's windows: announced, received, dropped, lost.
//!
//! A device numbers its windows from boot and counts those that it drops itself. A skipped number is missing; a missing
//! window that is not among the device's own drops was lost on the link. Numbering continues over connections of one
//! boot and restarts with the next boot.

use std::collections::BTreeSet;

use ihd_model::WindowCounts;

/// Missing windows remembered by number, in case they arrive late; older ones stay missing.
const MAX_MISSING: usize = 1_024;

/// Largest gap in the numbering: a day with a window every half-cycle. Beyond it the device has restarted or its count is
/// wrong, and numbering restarts there.
const MAX_GAP: u32 = 10_000_000;

/// Classification of an arrived window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// First arrival.
    New,
    /// Arrived before.
    Duplicate,
}

/// Counter that a window is added to; a stored one is added to a second one when it has been learned from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WindowCounter {
    /// Stored.
    Stored,
    /// Refused because of a defect.
    Refused,
    /// Dropped because the store could not accept it.
    NotStored,
    /// Passed by the gate and learned from.
    Learned,
    /// Unfit for learning.
    Unfit,
}

/// Window counts of one device.
#[derive(Debug, Default)]
pub struct WindowAccounting {
    boot: Option<Boot>,
    /// Windows of earlier boots lost on the link, and dropped by the device.
    lost_before: u64,
    dropped_before: u64,
    announced: u64,
    jumps: u32,
    outcomes: WindowOutcomes,
}

/// Numbers of windows by outcome.
#[derive(Clone, Copy, Debug, Default)]
struct WindowOutcomes {
    stored: u64,
    refused: u64,
    not_stored: u64,
    learned: u64,
    unfit: u64,
    /// Dropped from the learner's queue.
    unlearned: u64,
}

#[derive(Debug)]
struct Boot {
    id: u32,
    /// Next expected number.
    next: u32,
    /// Count of skipped numbers.
    missing: u64,
    /// Remembered skipped numbers, at most `MAX_MISSING`.
    gaps: BTreeSet<u32>,
    /// The device's own count of drops at the first connection of this boot.
    dropped_at_start: u32,
    /// The device's own count of drops now.
    dropped: u32,
}

impl Boot {
    /// Returns the missing windows that the device dropped itself.
    fn dropped_by_device(&self) -> u64 {
        u64::from(self.dropped.wrapping_sub(self.dropped_at_start)).min(self.missing)
    }
}

impl WindowAccounting {
    /// Starts a connection to boot `id` of the device, which has numbered `due` windows so far and dropped `dropped` of
    /// them.
    pub fn connect(&mut self, id: u32, due: u32, dropped: u32) {
        match &mut self.boot {
            Some(boot) if boot.id == id => {
                boot.dropped = dropped;
                self.announce_up_to(due);
            }
            _ => self.begin(id, due, dropped),
        }
    }

    fn begin(&mut self, id: u32, next: u32, dropped: u32) {
        if let Some(boot) = self.boot.take() {
            let by_device = boot.dropped_by_device();
            self.dropped_before += by_device;
            self.lost_before += boot.missing - by_device;
        }
        self.boot = Some(Boot {
            id,
            next,
            missing: 0,
            gaps: BTreeSet::new(),
            dropped_at_start: dropped,
            dropped,
        });
    }

    /// Counts windows below `due` as announced, those not yet arrived as missing.
    fn announce_up_to(&mut self, due: u32) {
        let Some(boot) = &mut self.boot else { return };
        let gap = due.wrapping_sub(boot.next);
        if gap > MAX_GAP {
            // An old or an invalid number.
            return;
        }
        self.announced += u64::from(gap);
        boot.missing += u64::from(gap);
        let remembered = gap.min(MAX_MISSING as u32);
        boot.gaps
            .extend((0..remembered).map(|k| due.wrapping_sub(1 + k)));
        while boot.gaps.len() > MAX_MISSING {
            boot.gaps.pop_first();
        }
        boot.next = due;
    }

    /// Records the arrival of window `seq`, intact or defective.
    pub fn arrived(&mut self, seq: u32) -> Arrival {
        let Some(boot) = &mut self.boot else {
            return Arrival::Duplicate;
        };
        if boot.gaps.remove(&seq) {
            boot.missing -= 1;
            return Arrival::New;
        }
        let ahead = seq.wrapping_sub(boot.next);
        let behind = boot.next.wrapping_sub(seq);
        if ahead <= MAX_GAP {
            self.announce_up_to(seq);
        } else if behind <= MAX_GAP {
            return Arrival::Duplicate;
        } else {
            self.jumps = self.jumps.saturating_add(1);
            boot.gaps.clear();
        }
        if let Some(boot) = &mut self.boot {
            boot.next = seq.wrapping_add(1);
        }
        self.announced += 1;
        Arrival::New
    }

    /// Adds a window to a counter.
    pub fn count(&mut self, counter: WindowCounter) {
        let outcomes = &mut self.outcomes;
        *match counter {
            WindowCounter::Stored => &mut outcomes.stored,
            WindowCounter::Refused => &mut outcomes.refused,
            WindowCounter::NotStored => &mut outcomes.not_stored,
            WindowCounter::Learned => &mut outcomes.learned,
            WindowCounter::Unfit => &mut outcomes.unfit,
        } += 1;
    }

    /// Updates the number of windows dropped from the learner's queue.
    pub fn set_unlearned(&mut self, count: u64) {
        self.outcomes.unlearned = count;
    }

    /// Updates the device's own count of windows dropped since its boot.
    pub fn dropped_by_device(&mut self, count: u32) {
        if let Some(boot) = &mut self.boot
            // A smaller count is an older one.
            && count.wrapping_sub(boot.dropped) < 1 << 31
        {
            boot.dropped = count;
        }
    }

    /// Returns the number of jumps beyond `MAX_GAP` in the device's numbering.
    pub fn jumps(&self) -> u32 {
        self.jumps
    }

    /// Returns the counts for reports.
    pub fn counts(&self) -> WindowCounts {
        let (missing, by_device) = self
            .boot
            .as_ref()
            .map_or((0, 0), |b| (b.missing, b.dropped_by_device()));
        WindowCounts {
            announced: self.announced,
            stored: self.outcomes.stored,
            refused: self.outcomes.refused,
            dropped_by_device: self.dropped_before + by_device,
            lost: self.lost_before + missing - by_device,
            not_stored: self.outcomes.not_stored,
            learned: self.outcomes.learned,
            unfit: self.outcomes.unfit,
            unlearned: self.outcomes.unlearned,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks that each announced window has one outcome, with none in flight.
    fn balanced(windows: &WindowAccounting) -> WindowCounts {
        let c = windows.counts();
        let gone = c.stored + c.refused + c.not_stored + c.dropped_by_device + c.lost;
        assert_eq!(c.announced, gone, "{c:?}");
        c
    }

    fn store(windows: &mut WindowAccounting, seqs: impl IntoIterator<Item = u32>) {
        for seq in seqs {
            if windows.arrived(seq) == Arrival::New {
                windows.count(WindowCounter::Stored);
            }
        }
    }

    #[test]
    fn what_is_missing_was_dropped_by_the_device_or_lost() {
        let mut windows = WindowAccounting::default();
        windows.connect(7, 100, 40);
        // Before the daemon came there were 100, which are not its business.
        store(&mut windows, [100, 101, 104, 107]);
        windows.dropped_by_device(43);
        let c = balanced(&windows);
        assert_eq!((c.announced, c.stored), (8, 4));
        assert_eq!((c.dropped_by_device, c.lost), (3, 1));
    }

    #[test]
    fn a_connection_to_the_same_boot_goes_on() {
        let mut windows = WindowAccounting::default();
        windows.connect(7, 0, 0);
        store(&mut windows, 0..5);
        // Two more were recorded when the link was cut, one more was dropped.
        windows.connect(7, 8, 1);
        store(&mut windows, 8..10);
        let c = balanced(&windows);
        assert_eq!((c.announced, c.stored), (10, 7));
        assert_eq!((c.dropped_by_device, c.lost), (1, 2));
        // What comes again counts once.
        store(&mut windows, [3, 9]);
        assert_eq!(balanced(&windows), c);
    }

    #[test]
    fn another_boot_begins_anew() {
        let mut windows = WindowAccounting::default();
        windows.connect(7, 0, 0);
        store(&mut windows, [0, 2]);
        windows.connect(8, 0, 0);
        store(&mut windows, [0, 1]);
        let c = balanced(&windows);
        assert_eq!((c.announced, c.stored, c.lost), (5, 4, 1));
    }

    #[test]
    fn a_window_that_was_given_up_and_comes_late_is_not_lost() {
        let mut windows = WindowAccounting::default();
        windows.connect(7, 0, 0);
        store(&mut windows, [0, 2, 1]);
        let c = balanced(&windows);
        assert_eq!((c.announced, c.stored, c.lost), (3, 3, 0));
    }

    #[test]
    fn numbers_wrap() {
        let mut windows = WindowAccounting::default();
        windows.connect(7, u32::MAX - 1, u32::MAX);
        store(&mut windows, [u32::MAX - 1, u32::MAX, 1]);
        windows.dropped_by_device(0);
        let c = balanced(&windows);
        assert_eq!((c.announced, c.stored, c.dropped_by_device), (4, 3, 1));
    }

    #[test]
    fn a_liar_is_counted_and_costs_no_memory() {
        let mut windows = WindowAccounting::default();
        windows.connect(7, 0, 0);
        for k in 0..10_000u32 {
            store(&mut windows, [k.wrapping_mul(2_654_435_761)]);
        }
        assert!(windows.jumps() > 0);
        assert!(windows.boot.as_ref().unwrap().gaps.len() <= MAX_MISSING);
        windows.dropped_by_device(u32::MAX);
        balanced(&windows);
    }
}
