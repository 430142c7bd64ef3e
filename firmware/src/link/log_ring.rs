//! Log frames that wait for a reader: whole ones only. One that finds no room is dropped and counted, so that the oldest,
//! those of the start, stay until they are read.
//!
//! One writer and one reader, which may interrupt each other; neither waits. The indices may belong to another
//! memory layout, as those of RTT do, whose reader is a debug probe.

use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};

/// A ring of bytes, one of which stays free.
#[derive(Clone, Copy)]
pub struct LogRing<'a> {
    /// Bytes of the log.
    pub bytes: &'a [AtomicU8],
    /// Index behind the last byte of the last whole frame.
    pub write: &'a AtomicU32,
    /// Index of the oldest byte that was not read; a reader may write nonsense there.
    pub read: &'a AtomicU32,
}

/// The log for the link.
#[derive(Clone, Copy)]
pub struct LinkLog {
    /// Its frames until they are sent.
    pub ring: LogRing<'static>,
    /// Frames since boot that found no room in it, or that met another one.
    pub dropped: &'static AtomicU32,
}

/// A frame that is being written, and is not seen before it is whole.
#[derive(Clone, Copy, Debug, Default)]
pub struct RingFrame {
    at: u32,
    fits: bool,
}

impl RingFrame {
    /// None, which finds no room.
    pub const NONE: Self = Self { at: 0, fits: false };
}

impl LogRing<'_> {
    fn size(&self) -> u32 {
        self.bytes.len() as u32
    }

    fn after(&self, at: u32) -> u32 {
        match at + 1 {
            next if next < self.size() => next,
            _ => 0,
        }
    }

    /// Begins a frame.
    pub fn begin(&self) -> RingFrame {
        RingFrame {
            at: self.write.load(Ordering::Relaxed),
            fits: true,
        }
    }

    /// Adds bytes to it, as far as there is room.
    pub fn add(&self, frame: &mut RingFrame, bytes: &[u8]) {
        for &byte in bytes {
            let next = self.after(frame.at);
            frame.fits &= next != self.read.load(Ordering::Acquire);
            let Some(place) = self.bytes.get(frame.at as usize).filter(|_| frame.fits) else {
                frame.fits = false;
                return;
            };
            place.store(byte, Ordering::Relaxed);
            frame.at = next;
        }
    }

    /// Ends it; returns `true` if it found room.
    pub fn end(&self, frame: RingFrame) -> bool {
        if frame.fits {
            self.write.store(frame.at, Ordering::Release);
        }
        frame.fits
    }

    /// Moves the oldest frames that fit to the front of `out`; returns how many bytes. Each frame ends with a 0. One
    /// that is longer than `out` is thrown away.
    pub fn take(&self, out: &mut [u8]) -> usize {
        let write = self.write.load(Ordering::Acquire);
        let mut at = self.read.load(Ordering::Relaxed);
        let (mut length, mut whole, mut whole_at) = (0, 0, at);
        while at != write {
            let Some(byte) = self.bytes.get(at as usize) else {
                break;
            };
            let byte = byte.load(Ordering::Relaxed);
            at = self.after(at);
            let Some(place) = out.get_mut(length) else {
                if whole == 0 {
                    whole_at = write;
                }
                break;
            };
            *place = byte;
            length += 1;
            if byte == 0 {
                (whole, whole_at) = (length, at);
            }
        }
        self.read.store(whole_at, Ordering::Release);
        whole
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;

    struct Memory<const N: usize> {
        bytes: [AtomicU8; N],
        write: AtomicU32,
        read: AtomicU32,
    }

    impl<const N: usize> Memory<N> {
        fn new() -> Self {
            Self {
                bytes: [const { AtomicU8::new(0x55) }; N],
                write: AtomicU32::new(0),
                read: AtomicU32::new(0),
            }
        }

        fn ring(&self) -> LogRing<'_> {
            LogRing {
                bytes: &self.bytes,
                write: &self.write,
                read: &self.read,
            }
        }
    }

    fn put(ring: &LogRing<'_>, bytes: &[u8]) -> bool {
        let mut frame = ring.begin();
        for piece in bytes.chunks(2) {
            ring.add(&mut frame, piece);
        }
        ring.end(frame)
    }

    fn taken(ring: &LogRing<'_>, room: usize) -> Vec<u8> {
        let mut out = std::vec![0xEE; room];
        let length = ring.take(&mut out);
        out.truncate(length);
        out
    }

    #[test]
    fn frames_come_out_whole_and_in_order_round_and_round() {
        let memory = Memory::<32>::new();
        let ring = memory.ring();
        for k in 0..100u8 {
            let frame = [k | 1, 2, 3, 4, 5, 6, 0];
            assert!(put(&ring, &frame) && put(&ring, &[9, 0]));
            assert_eq!(taken(&ring, 8), frame, "the second does not fit");
            assert_eq!(taken(&ring, 8), [9, 0]);
            assert!(taken(&ring, 8).is_empty());
        }
    }

    #[test]
    fn what_finds_no_room_is_dropped_whole_and_the_oldest_stays() {
        let memory = Memory::<16>::new();
        let ring = memory.ring();
        assert!(put(&ring, &[1; 9]) && !put(&ring, &[2; 7]) && put(&ring, &[3, 3, 0]));
        assert!(!put(&ring, &[4; 200]), "longer than the ring");
        // 12 of the 15 that it holds.
        assert_eq!(taken(&ring, 15), [1, 1, 1, 1, 1, 1, 1, 1, 1, 3, 3, 0]);
        assert!(put(&ring, &[5; 15]) && !put(&ring, &[6]));
    }

    #[test]
    fn a_frame_under_way_is_not_seen() {
        let memory = Memory::<16>::new();
        let ring = memory.ring();
        let mut frame = ring.begin();
        ring.add(&mut frame, &[1, 2, 0]);
        assert!(taken(&ring, 16).is_empty());
        assert!(ring.end(frame));
        assert_eq!(taken(&ring, 16), [1, 2, 0]);
    }

    #[test]
    fn a_reader_that_writes_nonsense_stops_the_log_and_nothing_else() {
        let memory = Memory::<16>::new();
        let ring = memory.ring();
        for read in [16, 17, u32::MAX] {
            memory.read.store(read, Ordering::Relaxed);
            put(&ring, &[1, 2, 3, 0]);
            assert!(taken(&ring, 16).is_empty());
        }
        memory.write.store(u32::MAX - 1, Ordering::Relaxed);
        memory.read.store(3, Ordering::Relaxed);
        assert!(!put(&ring, &[1, 0]));
        assert!(taken(&ring, 16).is_empty() || memory.read.load(Ordering::Relaxed) < 16);
    }

    #[test]
    fn a_frame_that_no_message_takes_is_thrown_away() {
        let memory = Memory::<32>::new();
        let ring = memory.ring();
        assert!(put(&ring, &[1; 20]) && put(&ring, &[2, 0]));
        assert!(taken(&ring, 8).is_empty());
        assert!(put(&ring, &[3, 0]));
        assert_eq!(taken(&ring, 8), [3, 0]);
    }
}
