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
    /// Windows rejected, by [`super::WindowDefect::label`].
    pub windows_rejected: BTreeMap<&'static str, u32>,
    /// Window messages that belong to no window under way, beyond the first of each window.
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
}

impl SequenceCounters {
    /// Takes the sequence number of something that arrived, whole or not, and the device's own count
    /// of what it dropped.
    pub(super) fn see(&mut self, seq: u32, dropped_by_device: u32) {
        self.dropped_by_device = dropped_by_device;
        if let Some(next) = self.next {
            let gap = seq.wrapping_sub(next);
            // More than half the range is a repetition, or a device that began anew.
            if gap < 1 << 31 {
                self.missing = self.missing.wrapping_add(gap);
            }
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
        for seq in [5, 6, 9, 9, u32::MAX, 0] {
            s.see(seq, 3);
        }
        assert_eq!((s.missing, s.dropped_by_device), (2, 3));
    }
}
