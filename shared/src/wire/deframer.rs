//! Finds frames in a byte stream, whatever stands between them.

use super::frame::{Frame, FrameError, MAX_ENCODED, decode};
use super::messages::{Hello, Message};

/// Collects bytes up to a zero and hands out the frame they make. After garbage, a cut frame or an
/// overlong one it is in step again at the next zero; every well-formed frame is found.
pub struct Deframer {
    buffer: [u8; MAX_ENCODED],
    used: usize,
    overlong: bool,
    expected_seq: Option<u16>,
    counters: Counters,
}

/// Counts of a deframer since it was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Frames with a correct CRC.
    pub good: u32,
    /// Runs of bytes between zeros that were no frame.
    pub bad: u32,
    /// Frames missing from the sender's sequence.
    pub lost: u32,
}

impl Default for Deframer {
    fn default() -> Self {
        Self::new()
    }
}

impl Deframer {
    /// An empty deframer.
    pub const fn new() -> Self {
        Self {
            buffer: [0; MAX_ENCODED],
            used: 0,
            overlong: false,
            expected_seq: None,
            counters: Counters {
                good: 0,
                bad: 0,
                lost: 0,
            },
        }
    }

    /// Counts so far.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// Forgets the sender's sequence, for a peer that starts anew.
    pub fn restart_sequence(&mut self) {
        self.expected_seq = None;
    }

    /// Takes one byte; at the end of a frame gives the frame, or the reason that it was none.
    pub fn push(&mut self, byte: u8) -> Option<Result<Frame<'_>, FrameError>> {
        if byte != 0 {
            if self.used < self.buffer.len() {
                self.buffer[self.used] = byte;
                self.used += 1;
            } else {
                self.overlong = true;
            }
            return None;
        }
        self.frame()
    }

    /// Takes bytes up to the end of a frame; returns how many, and whether they end one. Then comes [`Self::frame`] or [`Self::skip`].
    pub fn collect(&mut self, bytes: &[u8]) -> (usize, bool) {
        let end = bytes.iter().position(|&byte| byte == 0);
        let part = &bytes[..end.unwrap_or(bytes.len())];
        let room = self.buffer.len() - self.used;
        let kept = &part[..part.len().min(room)];
        self.buffer[self.used..self.used + kept.len()].copy_from_slice(kept);
        self.used += kept.len();
        self.overlong |= kept.len() < part.len();
        (part.len() + usize::from(end.is_some()), end.is_some())
    }

    /// Id of the frame that has ended, before anything of it is checked.
    pub fn id(&self) -> Option<u8> {
        // The first byte of stuffing says how far it is to the next zero.
        match self.buffer[..self.used] {
            [0 | 1, ..] | [_] | [] => None,
            [_, id, ..] => Some(id),
        }
    }

    /// Forgets the frame that has ended, unchecked. What is missing before the next one is not known then.
    pub fn skip(&mut self) {
        self.used = 0;
        self.overlong = false;
        self.expected_seq = None;
    }

    /// The frame that has ended, or why it was none.
    pub fn frame(&mut self) -> Option<Result<Frame<'_>, FrameError>> {
        let (used, overlong) = (self.used, self.overlong);
        self.used = 0;
        self.overlong = false;
        if used == 0 {
            return None;
        }
        if overlong {
            self.counters.bad = self.counters.bad.wrapping_add(1);
            return Some(Err(FrameError::TooLong));
        }
        let frame = match decode(&mut self.buffer[..used]) {
            Ok(frame) => frame,
            Err(e) => {
                self.counters.bad = self.counters.bad.wrapping_add(1);
                return Some(Err(e));
            }
        };
        self.counters.good = self.counters.good.wrapping_add(1);
        // A hello begins a conversation, and a sequence: the sender before it is gone.
        if let Some(expected) = self.expected_seq.filter(|_| frame.id != Hello::ID) {
            let gap = frame.seq.wrapping_sub(expected);
            // A gap of more than half the range is a repeated or reordered frame, not a loss.
            if gap < 0x8000 {
                self.counters.lost = self.counters.lost.wrapping_add(u32::from(gap));
            }
        }
        self.expected_seq = Some(frame.seq.wrapping_add(1));
        Some(Ok(frame))
    }
}

#[cfg(test)]
mod tests {
    use super::super::frame::{encode_numbered, encode_raw};
    use super::super::messages::{GetStatus, Message, SetPower};
    use super::super::number::Number;
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn framed(power_w: u16, seq: u16) -> Vec<u8> {
        let mut out = [0; MAX_ENCODED];
        let n = encode_numbered(&SetPower { power_w }, Number::FIRST, seq, &mut out).unwrap();
        out[..n].to_vec()
    }

    /// Returns what [`good`] does, of a stream that comes in runs of these lengths.
    fn good_of_runs(stream: &[u8], runs: &[usize]) -> Vec<(u8, u16, Vec<u8>)> {
        let mut deframer = Deframer::new();
        let mut found = Vec::new();
        let mut rest = stream;
        for run in runs.iter().copied().chain([usize::MAX]) {
            let (mut bytes, later) = rest.split_at(run.min(rest.len()));
            rest = later;
            while !bytes.is_empty() {
                let (taken, is_end) = deframer.collect(bytes);
                bytes = &bytes[taken..];
                let id = deframer.id();
                if is_end && let Some(Ok(f)) = deframer.frame() {
                    assert_eq!(id.unwrap_or(0), f.id);
                    found.push((f.id, f.seq, f.payload.to_vec()));
                }
            }
        }
        found
    }

    /// Every good frame's (id, seq, payload) that a stream holds.
    fn good(stream: &[u8]) -> Vec<(u8, u16, Vec<u8>)> {
        let mut deframer = Deframer::new();
        let mut found = Vec::new();
        for &b in stream {
            if let Some(Ok(f)) = deframer.push(b) {
                found.push((f.id, f.seq, f.payload.to_vec()));
            }
        }
        found
    }

    #[test]
    fn a_frame_cut_short_does_not_swallow_the_next() {
        let mut stream = framed(1000, 0);
        stream.truncate(stream.len() - 3);
        stream.extend(framed(2000, 1));
        assert_eq!(good(&stream).len(), 1);
        assert_eq!(good(&stream)[0].1, 1);
    }

    #[test]
    fn gaps_are_counted_and_repeats_are_not() {
        let mut deframer = Deframer::new();
        for seq in [10, 11, 14, 14, 65_535, 0] {
            for b in framed(1, seq) {
                deframer.push(b);
            }
        }
        let c = deframer.counters();
        // 12, 13 are missing; the repeated 14 is "one behind"; 15..=65534 is a gap of more than
        // half the range, so it is read as going back.
        assert_eq!((c.good, c.bad, c.lost), (6, 0, 2));
    }

    #[test]
    fn a_frame_is_known_by_its_id_and_may_be_skipped() {
        let mut deframer = Deframer::new();
        let stream = [framed(1, 7), framed(2, 8), framed(3, 9)].concat();
        let (mut at, mut seen) = (0, Vec::new());
        while at < stream.len() {
            let (taken, is_end) = deframer.collect(&stream[at..]);
            at += taken;
            if !is_end || deframer.id().is_none() {
                continue;
            }
            assert_eq!(deframer.id(), Some(SetPower::ID));
            if at > stream.len() / 3 && at <= 2 * stream.len() / 3 {
                deframer.skip();
            } else {
                seen.push(deframer.frame().unwrap().unwrap().seq);
            }
        }
        assert_eq!(seen, [7, 9]);
        let counters = deframer.counters();
        assert_eq!((counters.good, counters.bad, counters.lost), (2, 0, 0));
    }

    #[test]
    fn an_overlong_run_is_one_bad_frame() {
        let mut deframer = Deframer::new();
        for _ in 0..3 * MAX_ENCODED {
            assert_eq!(deframer.push(1), None);
        }
        assert_eq!(deframer.push(0), Some(Err(FrameError::TooLong)));
        for b in framed(5, 0) {
            deframer.push(b);
        }
        assert_eq!(deframer.counters().good, 1);
    }

    #[test]
    fn an_empty_message_and_the_longest_one_fit() {
        let mut out = [0; MAX_ENCODED];
        let n = encode_numbered(&GetStatus {}, Number::FIRST, 3, &mut out).unwrap();
        let number = Number::FIRST.to_le_bytes().to_vec();
        assert_eq!(good(&out[..n]), [(GetStatus::ID, 3, number)]);
        let n = encode_raw(GetStatus::ID, 4, &[], &mut out).unwrap();
        assert_eq!(good(&out[..n]), [(GetStatus::ID, 4, Vec::new())]);
        let longest = [0xA5; super::super::frame::MAX_PAYLOAD];
        let n = encode_raw(0x7f, 4, &longest, &mut out).unwrap();
        assert_eq!(good(&out[..n]), [(0x7f, 4, longest.to_vec())]);
        assert!(encode_raw(0x7f, 4, &[0; 1018], &mut out).is_err());
    }

    #[derive(Clone, Debug)]
    enum Piece {
        Frame(u8, u16, Vec<u8>),
        Cut(u8, Vec<u8>, prop::sample::Index),
        Garbage(Vec<u8>),
    }

    fn piece() -> impl Strategy<Value = Piece> {
        let payload = || prop::collection::vec(any::<u8>(), 0..300);
        prop_oneof![
            3 => (any::<u8>(), any::<u16>(), payload()).prop_map(|(i, s, p)| Piece::Frame(i, s, p)),
            1 => (any::<u8>(), payload(), any::<prop::sample::Index>())
                .prop_map(|(i, p, at)| Piece::Cut(i, p, at)),
            1 => prop::collection::vec(any::<u8>(), 0..2500).prop_map(Piece::Garbage),
        ]
    }

    proptest! {
        /// Every well-formed frame is found, in order, unchanged, with anything between them.
        #[test]
        fn every_well_formed_frame_is_found(
            pieces in prop::collection::vec(piece(), 0..12),
            runs in prop::collection::vec(1..900usize, 0..30),
        ) {
            let mut stream = Vec::new();
            let mut sent = Vec::new();
            for p in pieces {
                let mut out = [0; MAX_ENCODED];
                match p {
                    Piece::Frame(id, seq, payload) => {
                        let n = encode_raw(id, seq, &payload, &mut out).unwrap();
                        stream.extend_from_slice(&out[..n]);
                        sent.push((id, seq, payload));
                    }
                    Piece::Cut(id, payload, at) => {
                        let n = encode_raw(id, 0, &payload, &mut out).unwrap();
                        // At most up to its last byte before the closing zero's neighbour.
                        stream.extend_from_slice(&out[..at.index(n - 1)]);
                    }
                    Piece::Garbage(bytes) => stream.extend(bytes),
                }
            }
            let found = good(&stream);
            prop_assert_eq!(&found, &good_of_runs(&stream, &runs));
            let mut rest = found.as_slice();
            for frame in &sent {
                let at = rest.iter().position(|f| f == frame);
                prop_assert!(at.is_some(), "lost {frame:?}");
                rest = &rest[at.unwrap() + 1..];
            }
            // A garbage frame would need a matching CRC: one in 2^32.
            prop_assert_eq!(found.len(), sent.len());
        }
    }
}
