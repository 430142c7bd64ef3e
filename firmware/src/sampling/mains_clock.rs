//! Time of the sampling path: since boot, and since the last zero crossing of the mains.

use ihd_shared::sampling::{ADC_LOCK_P, block_ns};

use crate::limits::SHORTEST_HALF_CYCLE_NS;

/// A half-cycle that ended within a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FinishedHalfCycle {
    /// Number since boot.
    pub half_cycle: u32,
    /// Duration, in nanoseconds.
    pub duration_ns: u32,
    /// Time of the block's first pair after the zero crossing that ended it, in nanoseconds; mostly below 0.
    pub block_start_ns: i32,
}

/// Clock that counts blocks, whose duration follows the switching frequency.
#[derive(Clone, Debug)]
pub struct MainsClock {
    /// Duration of a block.
    block_ns: u32,
    /// Blocks from the ADC since boot.
    blocks: u32,
    /// Time since boot: whole milliseconds, and the rest.
    now_ms: u32,
    now_rest_ns: u32,
    /// Time of the current block's first pair since the last zero crossing.
    since_crossing_ns: i64,
    half_cycle: u32,
}

impl MainsClock {
    /// All bits zero; [`MainsClock::set_frequency`] comes before anything else.
    pub const fn blank() -> Self {
        Self {
            block_ns: 0,
            blocks: 0,
            now_ms: 0,
            now_rest_ns: 0,
            since_crossing_ns: 0,
            half_cycle: 0,
        }
    }

    /// Sets the duration of a block by the switching frequency in hertz.
    pub fn set_frequency(&mut self, f_sw_hz: u32) {
        self.block_ns = block_ns(f_sw_hz);
    }

    /// Duration of a block, in nanoseconds.
    pub fn block_ns(&self) -> u32 {
        self.block_ns
    }

    /// Blocks from the ADC since boot.
    pub fn blocks(&self) -> u32 {
        self.blocks
    }

    /// Time since boot, in milliseconds; wraps after 49 days.
    pub fn now_ms(&self) -> u32 {
        self.now_ms
    }

    /// Half-cycles since boot.
    pub fn half_cycle(&self) -> u32 {
        self.half_cycle
    }

    /// Time of the current block's first pair since the last zero crossing, in nanoseconds.
    pub fn since_crossing_ns(&self) -> i64 {
        self.since_crossing_ns
    }

    /// Counts a block of the ADC, which lasted `block_ns`: not as long as a recording's.
    #[inline]
    pub fn count_block(&mut self, block_ns: u32) {
        self.blocks = self.blocks.wrapping_add(1);
        self.now_rest_ns += block_ns;
        // Not a division: a block is 37 to 88 µs.
        if self.now_rest_ns >= 1_000_000 {
            self.now_rest_ns -= 1_000_000;
            self.now_ms = self.now_ms.wrapping_add(1);
        }
    }

    /// Passes the time of lost blocks since boot, a second at most.
    pub fn pass(&mut self, lost_ns: u32) {
        self.now_rest_ns += lost_ns;
        self.now_ms = self.now_ms.wrapping_add(self.now_rest_ns / 1_000_000);
        self.now_rest_ns %= 1_000_000;
    }

    /// Passes the time of lost blocks since the last zero crossing.
    pub fn pass_in_half_cycle(&mut self, lost_ns: u32) {
        self.since_crossing_ns = self.since_crossing_ns.wrapping_add(lost_ns.into());
    }

    /// Returns `true` if the half-cycle has lasted long enough for a zero crossing to be one.
    #[inline]
    pub fn may_cross(&self) -> bool {
        self.since_crossing_ns >= SHORTEST_HALF_CYCLE_NS
    }

    /// Permits a zero crossing at once: blocks of another source follow.
    pub fn restart_half_cycle(&mut self) {
        self.since_crossing_ns = SHORTEST_HALF_CYCLE_NS;
    }

    /// Ends the half-cycle before pair `at` of the current block, `since_ns` after the zero crossing.
    #[inline]
    pub fn cross_zero(&mut self, at: usize, since_ns: i32) -> FinishedHalfCycle {
        // 61 times 88 µs at most: 32 bit, as one of 64 is divided by a library.
        let offset_ns = (at as u32 * self.block_ns / ADC_LOCK_P as u32) as i32;
        let block_start_ns = since_ns.wrapping_sub(offset_ns);
        let duration_ns = self.since_crossing_ns.wrapping_sub(block_start_ns.into());
        let half_cycle = self.half_cycle;
        self.since_crossing_ns = block_start_ns.into();
        self.half_cycle = half_cycle.wrapping_add(1);
        FinishedHalfCycle {
            half_cycle,
            duration_ns: u32::try_from(duration_ns).unwrap_or(u32::MAX),
            block_start_ns,
        }
    }

    /// Moves on to the next block.
    #[inline]
    pub fn advance(&mut self) {
        // 292 years.
        self.since_crossing_ns = self
            .since_crossing_ns
            .wrapping_add(i64::from(self.block_ns));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 35 kHz: a block of three periods lasts 85.7 µs.
    #[test]
    fn a_half_cycle_lasts_from_crossing_to_crossing() {
        let mut clock = MainsClock::blank();
        clock.set_frequency(35_000);
        clock.restart_half_cycle();
        let first = clock.cross_zero(0, 0);
        assert_eq!((first.half_cycle, first.block_start_ns), (0, 0));
        assert!(!clock.may_cross());
        for _ in 0..116 {
            clock.advance();
        }
        assert!(clock.may_cross());
        // 116 blocks and 40 of 61 pairs less 11 µs: 116.656 · 85.714 µs = 9.9991 ms.
        let second = clock.cross_zero(40, 11_000);
        assert!((9_988_000..=9_989_000).contains(&second.duration_ns));
        assert!((-45_300..=-45_100).contains(&second.block_start_ns));
        assert_eq!((second.half_cycle, clock.half_cycle()), (1, 2));
    }

    #[test]
    fn milliseconds_are_counted_from_blocks() {
        let mut clock = MainsClock::blank();
        // 25 blocks of 40 µs are a millisecond.
        for _ in 0..1_000 {
            clock.count_block(40_000);
        }
        assert_eq!((clock.now_ms(), clock.blocks()), (40, 1_000));
    }
}
