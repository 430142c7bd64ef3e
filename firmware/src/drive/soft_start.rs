//! Soft start: the upper switch's share of the period grows from block to block, until both switches share it evenly.
//!
//! A DC link that stands at the mains' crest before the first period would drive twice the steady current through a load of
//! little impedance: aluminium takes 107 A at 230 V, and 64 A this way. Board and simulated hob both take the share from here.

use crate::drive::bridge::Drive;

/// Blocks that half the period counts.
pub const WHOLE_SHARE: u32 = 32;

/// Share of the first block: the upper switch is on for a little longer than the dead time.
const FIRST_SHARE: u32 = 8;

/// Blocks until the whole share.
pub const BLOCKS: u8 = (WHOLE_SHARE - FIRST_SHARE) as u8;

/// Soft start of a bridge.
#[derive(Clone, Debug, Default)]
pub struct SoftStart {
    share: u32,
}

impl SoftStart {
    /// Bridge that does not switch.
    pub const fn new() -> Self {
        Self { share: 0 }
    }

    /// Takes the drive from the next block on; returns the upper switch's part of half the period in it, in 1/[`WHOLE_SHARE`]; all of
    /// it while the bridge does not switch.
    #[inline(always)]
    pub fn on_block(&mut self, drive: Drive) -> u32 {
        self.share = match (drive.is_switching(), self.share) {
            (false, _) => {
                self.share = 0;
                return WHOLE_SHARE;
            }
            (true, 0) => FIRST_SHARE,
            (true, share) => (share + 1).min(WHOLE_SHARE),
        };
        self.share
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive::pwm::{DEAD_TIME_NS, MAX_HZ};

    #[test]
    fn the_share_grows_to_the_whole_and_begins_anew_after_off() {
        let mut soft = SoftStart::new();
        let drive = Drive::switching(MAX_HZ);
        for share in FIRST_SHARE..WHOLE_SHARE {
            assert_eq!(soft.on_block(drive), share);
        }
        assert_eq!(
            [soft.on_block(drive), soft.on_block(drive)],
            [WHOLE_SHARE; 2]
        );
        assert_eq!(soft.on_block(Drive::OFF), WHOLE_SHARE);
        assert_eq!(soft.on_block(drive), FIRST_SHARE);
    }

    /// A pulse shorter than the dead time is none.
    #[test]
    fn the_first_pulse_is_longer_than_the_dead_time() {
        let half_ns = 500_000_000 / MAX_HZ;
        assert!(
            half_ns * FIRST_SHARE / WHOLE_SHARE > DEAD_TIME_NS,
            "{half_ns}"
        );
    }
}
