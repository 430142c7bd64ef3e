//! Share of the processor's time that the sampling path takes, as the board measures it.

/// Cycles that blocks took, of those they had.
#[derive(Clone, Copy, Debug, Default)]
pub struct Utilisation {
    blocks: u32,
    busy: u64,
    all: u64,
    /// Busy and all cycles of the block with the largest share.
    worst: (u32, u32),
}

/// Measured shares.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ProcessorShares {
    /// Blocks measured.
    pub blocks: u32,
    /// Share of the time that they took, in permille.
    pub mean_permille: u16,
    /// The same of the one that took most.
    pub worst_permille: u16,
}

impl Utilisation {
    /// All bits zero, as the default.
    pub(crate) const fn blank() -> Self {
        Self {
            blocks: 0,
            busy: 0,
            all: 0,
            worst: (0, 0),
        }
    }

    /// Adds a block that kept the processor busy for so many of the cycles it lasted. No division:
    /// this runs in the sampling interrupt.
    pub fn add(&mut self, busy_cycles: u32, block_cycles: u32) {
        let block_cycles = block_cycles.max(1);
        self.blocks = self.blocks.wrapping_add(1);
        self.busy += u64::from(busy_cycles);
        self.all += u64::from(block_cycles);
        let (busy, all) = self.worst;
        if u64::from(busy_cycles) * u64::from(all) >= u64::from(busy) * u64::from(block_cycles) {
            self.worst = (busy_cycles, block_cycles);
        }
    }

    /// The shares since the last call.
    pub fn take(&mut self) -> ProcessorShares {
        let taken = core::mem::take(self);
        let (busy, all) = taken.worst;
        ProcessorShares {
            blocks: taken.blocks,
            mean_permille: permille(taken.busy, taken.all),
            worst_permille: permille(busy.into(), all.into()),
        }
    }
}

/// Time between two turns of housekeeping, which runs below the sampling path.
#[derive(Clone, Debug, Default)]
pub struct HousekeepingGap {
    /// Time since the last turn, and the longest so far.
    gap_ns: u32,
    longest_ns: u32,
}

impl HousekeepingGap {
    /// All bits zero, as the default.
    pub(crate) const fn blank() -> Self {
        Self {
            gap_ns: 0,
            longest_ns: 0,
        }
    }

    /// Adds the duration of a block, in nanoseconds.
    #[inline]
    pub fn add(&mut self, block_ns: u32) {
        self.gap_ns = self.gap_ns.saturating_add(block_ns);
    }

    /// Ends the gap: housekeeping has its turn.
    pub fn end(&mut self) {
        self.longest_ns = self.longest_ns.max(self.gap_ns);
        self.gap_ns = 0;
    }

    /// Longest gap since the last call, in microseconds, to a block.
    pub fn take_longest_us(&mut self) -> u32 {
        core::mem::take(&mut self.longest_ns) / 1_000
    }
}

fn permille(busy: u64, all: u64) -> u16 {
    let permille = busy.saturating_mul(1_000).checked_div(all).unwrap_or(0);
    u16::try_from(permille).unwrap_or(u16::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_and_worst_are_shares_of_the_time() {
        let mut used = Utilisation::default();
        // At 80 kHz a block has 6 375 cycles, at 34 kHz 15 000.
        used.add(3_825, 6_375);
        used.add(6_000, 15_000);
        let shares = ProcessorShares {
            blocks: 2,
            mean_permille: 459,
            worst_permille: 600,
        };
        assert_eq!(used.take(), shares);
        assert_eq!(
            used.take(),
            ProcessorShares::default(),
            "since it was asked last"
        );
    }

    #[test]
    fn a_block_that_takes_longer_than_it_lasts_is_shown_as_that() {
        let mut used = Utilisation::default();
        used.add(6_631, 6_375);
        assert_eq!(used.take().worst_permille, 1_040);
        used.add(u32::MAX, 1);
        used.add(1, u32::MAX);
        used.add(5, 0);
        assert_eq!(used.take().worst_permille, u16::MAX);
    }
}
