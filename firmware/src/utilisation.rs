//! How busy the sampling path keeps the processor, as the board measures it.

/// Cycles that blocks took, of those they had.
#[derive(Clone, Copy, Debug, Default)]
pub struct Utilisation {
    blocks: u32,
    busy: u64,
    all: u64,
    /// Busy and all cycles of the block with the largest share.
    worst: (u32, u32),
}

/// What was measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Shares {
    /// Blocks measured.
    pub blocks: u32,
    /// Share of the time that they took, in permille.
    pub mean_permille: u16,
    /// The same of the one that took most.
    pub worst_permille: u16,
}

impl Utilisation {
    /// As the default.
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

    /// The shares since this was asked last.
    pub fn take(&mut self) -> Shares {
        let taken = core::mem::take(self);
        let (busy, all) = taken.worst;
        Shares {
            blocks: taken.blocks,
            mean_permille: permille(taken.busy, taken.all),
            worst_permille: permille(busy.into(), all.into()),
        }
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
        let shares = Shares {
            blocks: 2,
            mean_permille: 459,
            worst_permille: 600,
        };
        assert_eq!(used.take(), shares);
        assert_eq!(used.take(), Shares::default(), "since it was asked last");
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
