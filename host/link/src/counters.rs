//! What a link has seen, the bad included.

use std::collections::BTreeMap;

/// Counts since the link was made or the recording opened. Nothing that was lost is missing here.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Bytes received.
    pub bytes: u64,
    /// Frames with a correct CRC.
    pub frames_good: u32,
    /// Runs of bytes that were no frame.
    pub frames_bad: u32,
    /// Frames missing from the device's sequence.
    pub frames_lost: u32,
    /// Frames whose payload is not a message of their id.
    pub messages_malformed: u32,
    /// Frames of an id that this host does not know: a device of a newer minor version.
    pub messages_unknown: u32,
    /// Answers that no command waited for: late ones, or repeated ones.
    pub answers_stray: u32,
    /// Events dropped because nobody took them for too long.
    pub events_dropped: u32,
    /// Telemetry.
    pub telemetry: SequenceCounters,
    /// Windows accepted.
    pub windows: SequenceCounters,
    /// Windows of which anything has come: each is accepted or rejected in the end, or under way.
    pub windows_begun: u32,
    /// Windows rejected, by [`super::WindowDefect::label`].
    pub windows_rejected: BTreeMap<&'static str, u32>,
    /// Pieces of windows that were asked for again.
    pub pieces_asked: u32,
    /// Messages of windows that had already been given out or rejected.
    pub window_messages_stray: u32,
}

impl Counters {
    /// Windows rejected, for whatever reason.
    pub fn windows_rejected_total(&self) -> u32 {
        self.windows_rejected.values().sum()
    }
}

/// Counts of one numbered stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SequenceCounters {
    /// Received whole.
    pub received: u32,
    /// Sequence numbers never seen, whether the device dropped them or the link lost them.
    pub missing: u32,
    /// Dropped since boot, as the device last reported.
    pub dropped_by_device: u32,
    next: Option<u32>,
    /// Which of the last 64 numbers count as missing; the lowest bit is the last.
    late: u64,
}

impl SequenceCounters {
    /// Takes the sequence number of something that arrived, whole or not.
    pub(super) fn see(&mut self, seq: u32) {
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
            // A repetition, or one that another has overtaken.
            let bit = 1u64 << (back - 1);
            if self.late & bit != 0 {
                self.late &= !bit;
                self.missing = self.missing.wrapping_sub(1);
            }
            return;
        } else {
            // The device began anew.
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
            s.see(seq);
        }
        assert_eq!(s.missing, 2);
        for seq in [100_000, 100_001] {
            s.see(seq);
        }
        assert_eq!(s.missing, 2 + 99_989);
        for seq in [0, 1] {
            s.see(seq);
        }
        assert_eq!(
            s.missing,
            2 + 99_989,
            "a device that began anew misses nothing"
        );
        for seq in [u32::MAX - 1, u32::MAX] {
            s.see(seq);
        }
        assert_eq!(s.missing, 2 + 99_989);
    }

    #[test]
    fn what_was_overtaken_is_not_missing() {
        let mut s = SequenceCounters::default();
        for seq in [5, 7, 6, 6, 10, 8, 11] {
            s.see(seq);
        }
        assert_eq!(s.missing, 1, "9 alone");
        for seq in [12 + 63, 12 + 62, 12] {
            s.see(seq);
        }
        assert_eq!(s.missing, 1 + 61);
    }
}
