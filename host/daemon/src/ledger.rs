//! Where each window of a device has gone.
//!
//! A device numbers its windows from its boot on and counts those that it dropped itself. A number that is
//! passed over is missing; what is missing and not among the device's own drops was lost on the link. Numbers
//! go on over connections of the same boot and begin anew with another.

use std::collections::BTreeSet;

use crate::model::WindowCounts;

/// Missing windows that are remembered by number, in case they still come; older ones stay missing.
const REMEMBERED: usize = 1_024;

/// Numbers that a device may pass over at once: a day of a window every half-cycle. More is a device that
/// began anew, or lies; its numbering begins there.
const LARGEST_GAP: u32 = 10_000_000;

/// What a window that has come is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// Not seen before.
    New,
    /// It has come before.
    Again,
}

/// The windows of one device.
#[derive(Debug, Default)]
pub struct Ledger {
    boot: Option<Boot>,
    /// Of boots that are over.
    missing_before: u64,
    dropped_before: u64,
    announced: u64,
    numbering_began_anew: u32,
    /// Windows whose fate is known.
    pub fates: Fates,
}

/// What became of the windows that came.
#[derive(Clone, Copy, Debug, Default)]
pub struct Fates {
    /// In the store.
    pub stored: u64,
    /// With a defect.
    pub refused: u64,
    /// Dropped, because the store could not take them.
    pub not_stored: u64,
    /// Learned from.
    pub learned: u64,
    /// Unfit to learn from.
    pub unfit: u64,
    /// Dropped before anybody could learn from them.
    pub unlearned: u64,
}

#[derive(Debug)]
struct Boot {
    id: u32,
    /// The number that comes next.
    next: u32,
    /// Numbers passed over.
    missing: u64,
    /// Those of them that are remembered.
    gaps: BTreeSet<u32>,
    /// The device's own count of drops at the beginning, and now.
    dropped_from: u32,
    dropped: u32,
}

impl Boot {
    /// Drops of the device among what is missing.
    fn dropped_by_device(&self) -> u64 {
        u64::from(self.dropped.wrapping_sub(self.dropped_from)).min(self.missing)
    }
}

impl Ledger {
    /// A connection to the device in its boot `id`, that has numbered `due` windows so far and dropped
    /// `dropped` of them.
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
            self.missing_before += boot.missing - by_device;
        }
        self.boot = Some(Boot {
            id,
            next,
            missing: 0,
            gaps: BTreeSet::new(),
            dropped_from: dropped,
            dropped,
        });
    }

    /// Windows below `due` have been numbered.
    fn announce_up_to(&mut self, due: u32) {
        let Some(boot) = &mut self.boot else { return };
        let gap = due.wrapping_sub(boot.next);
        if gap > LARGEST_GAP {
            // Numbered before, or nonsense.
            return;
        }
        self.announced += u64::from(gap);
        boot.missing += u64::from(gap);
        let remembered = gap.min(REMEMBERED as u32);
        boot.gaps
            .extend((0..remembered).map(|k| due.wrapping_sub(1 + k)));
        while boot.gaps.len() > REMEMBERED {
            boot.gaps.pop_first();
        }
        boot.next = due;
    }

    /// Window `seq` has come, whole or not.
    pub fn arrived(&mut self, seq: u32) -> Arrival {
        let Some(boot) = &mut self.boot else {
            return Arrival::Again;
        };
        if boot.gaps.remove(&seq) {
            boot.missing -= 1;
            return Arrival::New;
        }
        let ahead = seq.wrapping_sub(boot.next);
        let behind = boot.next.wrapping_sub(seq);
        if ahead <= LARGEST_GAP {
            self.announce_up_to(seq);
        } else if behind <= LARGEST_GAP {
            return Arrival::Again;
        } else {
            self.numbering_began_anew = self.numbering_began_anew.saturating_add(1);
            boot.gaps.clear();
        }
        if let Some(boot) = &mut self.boot {
            boot.next = seq.wrapping_add(1);
        }
        self.announced += 1;
        Arrival::New
    }

    /// The device's own count of windows that it dropped since its boot.
    pub fn dropped_by_device(&mut self, count: u32) {
        if let Some(boot) = &mut self.boot
            // A count that falls is one that was told before.
            && count.wrapping_sub(boot.dropped) < 1 << 31
        {
            boot.dropped = count;
        }
    }

    /// How often the device's numbers made a jump that no loss explains.
    pub fn jumps(&self) -> u32 {
        self.numbering_began_anew
    }

    /// The counts.
    pub fn counts(&self) -> WindowCounts {
        let (missing, by_device) = self
            .boot
            .as_ref()
            .map_or((0, 0), |b| (b.missing, b.dropped_by_device()));
        WindowCounts {
            announced: self.announced,
            stored: self.fates.stored,
            refused: self.fates.refused,
            dropped_by_device: self.dropped_before + by_device,
            lost: self.missing_before + missing - by_device,
            not_stored: self.fates.not_stored,
            learned: self.fates.learned,
            unfit: self.fates.unfit,
            unlearned: self.fates.unlearned,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What must hold once nothing is on its way.
    fn balanced(ledger: &Ledger) -> WindowCounts {
        let c = ledger.counts();
        let gone = c.stored + c.refused + c.not_stored + c.dropped_by_device + c.lost;
        assert_eq!(c.announced, gone, "{c:?}");
        c
    }

    fn store(ledger: &mut Ledger, seqs: impl IntoIterator<Item = u32>) {
        for seq in seqs {
            if ledger.arrived(seq) == Arrival::New {
                ledger.fates.stored += 1;
            }
        }
    }

    #[test]
    fn what_is_missing_was_dropped_by_the_device_or_lost() {
        let mut ledger = Ledger::default();
        ledger.connect(7, 100, 40);
        // Before the daemon came there were 100, which are not its business.
        store(&mut ledger, [100, 101, 104, 107]);
        ledger.dropped_by_device(43);
        let c = balanced(&ledger);
        assert_eq!((c.announced, c.stored), (8, 4));
        assert_eq!((c.dropped_by_device, c.lost), (3, 1));
    }

    #[test]
    fn a_connection_to_the_same_boot_goes_on() {
        let mut ledger = Ledger::default();
        ledger.connect(7, 0, 0);
        store(&mut ledger, 0..5);
        // Two more were recorded when the link was cut, one more was dropped.
        ledger.connect(7, 8, 1);
        store(&mut ledger, 8..10);
        let c = balanced(&ledger);
        assert_eq!((c.announced, c.stored), (10, 7));
        assert_eq!((c.dropped_by_device, c.lost), (1, 2));
        // What comes again counts once.
        store(&mut ledger, [3, 9]);
        assert_eq!(balanced(&ledger), c);
    }

    #[test]
    fn another_boot_begins_anew() {
        let mut ledger = Ledger::default();
        ledger.connect(7, 0, 0);
        store(&mut ledger, [0, 2]);
        ledger.connect(8, 0, 0);
        store(&mut ledger, [0, 1]);
        let c = balanced(&ledger);
        assert_eq!((c.announced, c.stored, c.lost), (5, 4, 1));
    }

    #[test]
    fn a_window_that_was_given_up_and_comes_late_is_not_lost() {
        let mut ledger = Ledger::default();
        ledger.connect(7, 0, 0);
        store(&mut ledger, [0, 2, 1]);
        let c = balanced(&ledger);
        assert_eq!((c.announced, c.stored, c.lost), (3, 3, 0));
    }

    #[test]
    fn numbers_wrap() {
        let mut ledger = Ledger::default();
        ledger.connect(7, u32::MAX - 1, u32::MAX);
        store(&mut ledger, [u32::MAX - 1, u32::MAX, 1]);
        ledger.dropped_by_device(0);
        let c = balanced(&ledger);
        assert_eq!((c.announced, c.stored, c.dropped_by_device), (4, 3, 1));
    }

    #[test]
    fn a_liar_is_counted_and_costs_no_memory() {
        let mut ledger = Ledger::default();
        ledger.connect(7, 0, 0);
        for k in 0..10_000u32 {
            store(&mut ledger, [k.wrapping_mul(2_654_435_761)]);
        }
        assert!(ledger.jumps() > 0);
        assert!(ledger.boot.as_ref().unwrap().gaps.len() <= REMEMBERED);
        ledger.dropped_by_device(u32::MAX);
        balanced(&ledger);
    }
}
