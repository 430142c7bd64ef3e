//! Condition for feeding the watchdog: blocks arrive, housekeeping runs, and both keep pace.

/// Blocks between two feedings: 2.4 ms at 80 kHz, 5.7 ms at 34 kHz.
const PERIOD_BLOCKS: u32 = 64;

/// Most blocks from one feeding to the next: 60 ms at 80 kHz. The longest time on the emulated chip is 4.3 ms, at two cycles an
/// instruction (docs/board.md). Housekeeping that is later is not in control.
const MAX_BLOCKS_BEHIND: u32 = 1_600;

/// Feeds the watchdog of a control loop that is whole.
#[derive(Clone, Copy, Debug, Default)]
pub struct Heartbeat {
    fed_at: u32,
}

impl Heartbeat {
    /// Takes the number of blocks since boot, each time housekeeping has run; returns `true` if the watchdog is to be fed: never
    /// without new blocks, nor after housekeeping has stood still for too long.
    pub fn beat(&mut self, blocks: u32) -> bool {
        let since = blocks.wrapping_sub(self.fed_at);
        if since > MAX_BLOCKS_BEHIND {
            return false;
        }
        let feed = since >= PERIOD_BLOCKS;
        if feed {
            self.fed_at = blocks;
        }
        feed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fed_as_long_as_blocks_come_and_housekeeping_keeps_pace() {
        let mut h = Heartbeat::default();
        let fed = (1..=640).filter(|&blocks| h.beat(blocks)).count();
        assert_eq!(fed, 10);
    }

    #[test]
    fn not_fed_when_no_blocks_come() {
        let mut h = Heartbeat::default();
        assert!(h.beat(64));
        for _ in 0..1_000 {
            assert!(!h.beat(64));
        }
    }

    #[test]
    fn not_fed_again_once_housekeeping_stood_still() {
        let mut h = Heartbeat::default();
        assert!(h.beat(64));
        assert!(h.beat(64 + 900), "a lookup was kept");
        let late = 64 + 900 + MAX_BLOCKS_BEHIND;
        for blocks in late + 1..late + 500 {
            assert!(!h.beat(blocks), "the reset is due");
        }
    }
}
