//! Double buffer that a DMA fills: the half to be read, and lost blocks.
//!
//! The flags of a DMA say which half it has filled since they were cleared, not how often. Both at
//! once mean that the reader was late by a block; its own position, read after a block was
//! copied, indicates whether it had begun to overwrite it. Either is a loss and is counted.

use ihd_shared::sampling::ADC_LOCK_P;

/// Halves that the DMA has filled since the last call.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DmaHalves {
    /// The first half.
    pub first: bool,
    /// The second half.
    pub second: bool,
}

/// The reader's side.
#[derive(Clone, Copy, Debug, Default)]
pub struct DmaDoubleBuffer {
    next: usize,
    lost: u32,
}

impl DmaDoubleBuffer {
    /// The half to read now, 0 or 1, if one was filled. The newest, when both were.
    pub fn take(&mut self, filled: DmaHalves) -> Option<usize> {
        let half = match (filled.first, filled.second) {
            (false, false) => return None,
            // The one that is due was overtaken by the other.
            (true, true) => {
                self.lost = self.lost.saturating_add(1);
                1 - self.next
            }
            (true, false) => 0,
            (false, true) => 1,
        };
        if half != self.next && !(filled.first && filled.second) {
            // The other half came and went unseen, or the DMA was started anew.
            self.lost = self.lost.saturating_add(1);
        }
        self.next = 1 - half;
        Some(half)
    }

    /// Returns `true` if the copy of a half is whole, by the index in the double block that the DMA writes next; one that is not
    /// counts as lost.
    pub fn is_whole(&mut self, half: usize, writes_at: usize) -> bool {
        let inside = (half * ADC_LOCK_P..(half + 1) * ADC_LOCK_P).contains(&writes_at);
        if inside {
            self.lost = self.lost.saturating_add(1);
        }
        !inside
    }

    /// Blocks lost since the last call.
    pub fn take_lost(&mut self) -> u32 {
        core::mem::take(&mut self.lost)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FIRST: DmaHalves = DmaHalves {
        first: true,
        second: false,
    };
    const SECOND: DmaHalves = DmaHalves {
        first: false,
        second: true,
    };
    const BOTH: DmaHalves = DmaHalves {
        first: true,
        second: true,
    };

    #[test]
    fn in_time_nothing_is_lost() {
        let mut ring = DmaDoubleBuffer::default();
        for _ in 0..3 {
            assert_eq!(ring.take(FIRST), Some(0));
            assert!(ring.is_whole(0, 61));
            assert_eq!(ring.take(DmaHalves::default()), None);
            assert_eq!(ring.take(SECOND), Some(1));
            assert!(ring.is_whole(1, 5));
        }
        assert_eq!(ring.take_lost(), 0);
    }

    #[test]
    fn a_late_reader_takes_the_newest_and_counts() {
        let mut ring = DmaDoubleBuffer::default();
        assert_eq!(ring.take(BOTH), Some(1), "the second was filled last");
        assert_eq!(ring.take_lost(), 1);
        assert_eq!(ring.take(FIRST), Some(0));
        assert_eq!(ring.take_lost(), 0, "counted once");
    }

    #[test]
    fn a_half_out_of_turn_means_one_was_missed() {
        let mut ring = DmaDoubleBuffer::default();
        assert_eq!(ring.take(FIRST), Some(0));
        assert_eq!(ring.take(FIRST), Some(0));
        assert_eq!(ring.take_lost(), 1);
    }

    #[test]
    fn what_was_overwritten_while_copied_is_lost() {
        let mut ring = DmaDoubleBuffer::default();
        assert_eq!(ring.take(FIRST), Some(0));
        assert!(!ring.is_whole(0, 3));
        assert_eq!(ring.take_lost(), 1);
    }
}
