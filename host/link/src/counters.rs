//! Counters of a link: traffic, damage and losses.

use std::collections::BTreeMap;

/// Counts since the link was opened or the recording began. Every loss is counted.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ClientCounters {
    /// Bytes received.
    pub bytes: u64,
    /// Frames with a correct CRC.
    pub frames_good: u32,
    /// Runs of bytes that were no frame.
    pub frames_bad: u32,
    /// Frames missing from the device's sequence.
    pub frames_lost: u32,
    /// Frames beyond what a hob sends of its own accord, which nobody looked at ([`super::Client::limit_floods`]).
    pub frames_beyond: u64,
    /// Frames whose payload is not a message of their id.
    pub messages_malformed: u32,
    /// Frames with an id that this host does not know; the device has a newer minor version.
    pub messages_unknown: u32,
    /// Answers that no command waited for: late or repeated ones.
    pub answers_stray: u32,
    /// Events dropped because the queue was full.
    pub events_dropped: u32,
    /// Telemetry.
    pub telemetry: SequenceCounters,
    /// Windows accepted.
    pub windows: SequenceCounters,
    /// Windows of which a message has come; each is accepted, rejected or still under way.
    pub windows_begun: u32,
    /// Windows rejected, by [`super::WindowDefect::label`].
    pub windows_rejected: BTreeMap<&'static str, u32>,
    /// Pieces of windows requested again.
    pub pieces_asked: u32,
    /// Messages of windows that were complete or rejected already.
    pub window_messages_stray: u32,
}

impl ClientCounters {
    /// Windows rejected, for whatever reason.
    pub fn windows_rejected_total(&self) -> u32 {
        self.windows_rejected.values().sum()
    }
}

/// Counts of one numbered stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SequenceCounters {
    /// Items received complete.
    pub received: u32,
    /// Sequence numbers never received, dropped by the device or lost on the link.
    pub missing: u32,
    /// Items dropped since boot, as last reported by the device.
    pub dropped_by_device: u32,
    next: Option<u32>,
    /// Bit mask of the last 64 numbers: set bits count as missing; bit 0 is the latest number.
    late: u64,
}

impl SequenceCounters {
    /// Counts the sequence number of an item that arrived, complete or not.
    pub(super) fn count_seq(&mut self, seq: u32) {
        let Some(next) = self.next else {
            self.next = Some(seq.wrapping_add(1));
            return;
        };
        let (gap, back) = (seq.wrapping_sub(next), next.wrapping_sub(seq));
        if gap < 1 << 31 {
            self.missing = self.missing.wrapping_add(gap);
            let skipped = 1u64.checked_shl(gap).map_or(u64::MAX, |bit| bit - 1);
            let shifted = self.late.checked_shl(gap).unwrap_or(0);
            self.late = (shifted | skipped) << 1;
        } else if back <= 64 {
            // Repeated or overtaken.
            let bit = 1u64 << (back - 1);
            if self.late & bit != 0 {
                self.late &= !bit;
                self.missing = self.missing.wrapping_sub(1);
            }
            return;
        } else {
            // The device restarted its numbering.
            self.late = 0;
        }
        self.next = Some(seq.wrapping_add(1));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_count_and_repetitions_do_not() {
        let mut s = SequenceCounters::default();
        for seq in [5, 6, 9, 9, 6, 10] {
            s.count_seq(seq);
        }
        assert_eq!(s.missing, 2);
        for seq in [100_000, 100_001] {
            s.count_seq(seq);
        }
        assert_eq!(s.missing, 2 + 99_989);
        for seq in [0, 1] {
            s.count_seq(seq);
        }
        assert_eq!(
            s.missing,
            2 + 99_989,
            "a device that began anew misses nothing"
        );
        for seq in [u32::MAX - 1, u32::MAX] {
            s.count_seq(seq);
        }
        assert_eq!(s.missing, 2 + 99_989);
    }

    #[test]
    fn what_was_overtaken_is_not_missing() {
        let mut s = SequenceCounters::default();
        for seq in [5, 7, 6, 6, 10, 8, 11] {
            s.count_seq(seq);
        }
        assert_eq!(s.missing, 1, "9 alone");
        for seq in [12 + 63, 12 + 62, 12] {
            s.count_seq(seq);
        }
        assert_eq!(s.missing, 1 + 61);
    }
}
