//! The bytes of a test of the link, and the count of what came of them.

use super::messages::{LinkData, LinkTested};

/// Byte `k` of the frame of number `seq`.
pub const fn byte(seq: u32, k: usize) -> u8 {
    (seq as u8).wrapping_add(k as u8)
}

/// Fills the data of the frame of number `seq`.
pub fn fill(seq: u32, data: &mut [u8]) {
    for (k, place) in data.iter_mut().enumerate() {
        *place = byte(seq, k);
    }
}

/// Counts of the frames of a test of the link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkTestCounts {
    frames: u32,
    bytes: u32,
    bad: u32,
    lost: u32,
    next: u32,
}

impl LinkTestCounts {
    /// Nothing yet.
    pub const NONE: Self = Self {
        frames: 0,
        bytes: 0,
        bad: 0,
        lost: 0,
        next: 0,
    };

    /// Takes a frame. One of a number that is past was late or came twice: it is counted, and nothing is missing before it.
    pub fn take(&mut self, frame: &LinkData<'_>) {
        let (seq, data) = (frame.seq, frame.data.0);
        self.frames = self.frames.wrapping_add(1);
        self.bytes = self.bytes.wrapping_add(data.len() as u32);
        let is_right = data.iter().enumerate().all(|(k, &b)| b == byte(seq, k));
        self.bad = self.bad.wrapping_add(u32::from(!is_right));
        if let Some(gap) = seq.checked_sub(self.next) {
            self.lost = self.lost.wrapping_add(gap);
            self.next = seq.wrapping_add(1);
        }
    }

    /// Counts so far.
    pub fn counts(&self) -> LinkTested {
        LinkTested {
            frames: self.frames,
            bytes: self.bytes,
            bad: self.bad,
            lost: self.lost,
        }
    }

    /// Frames up to the last number seen, those that are missing included.
    pub fn seen(&self) -> u32 {
        self.next
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::messages::Raw;

    fn take(received: &mut LinkTestCounts, seq: u32, data: &[u8]) {
        let data = Raw(data);
        received.take(&LinkData { seq, data });
    }

    #[test]
    fn what_is_missing_late_or_wrong_is_counted() {
        let mut received = LinkTestCounts::default();
        let mut data = [0; 300];
        for seq in [0, 1, 5, 6, 4] {
            fill(seq, &mut data);
            take(&mut received, seq, &data);
        }
        fill(7, &mut data);
        data[299] ^= 1;
        take(&mut received, 7, &data);
        take(&mut received, 8, &[]);
        let counts = received.counts();
        assert_eq!((counts.frames, counts.bytes), (7, 6 * 300));
        assert_eq!((counts.bad, counts.lost), (1, 3));
        assert_eq!(received.seen(), 9);
    }

    #[test]
    fn the_bytes_are_those_of_the_document() {
        let mut data = [0; 3];
        fill(0x1FF, &mut data);
        assert_eq!(data, [0xFF, 0, 1]);
    }
}
