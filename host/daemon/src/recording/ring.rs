//! What came over a link in the last minute, in case somebody wants to know what was before.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// What is kept of a link: the longest pre-trigger.
const KEPT: Duration = Duration::from_secs(60);

/// Most bytes of one link: a minute of a hob that heats is 11 MB.
const MOST_BYTES: usize = 16 << 20;

/// Most bytes of all links of this process together; each has an equal share.
const MOST_BYTES_OF_ALL: usize = 128 << 20;

/// What a piece costs beside its bytes.
const OVERHEAD: usize = size_of::<Piece>() + 16;

/// Rings of this process.
static RINGS: AtomicUsize = AtomicUsize::new(0);

/// Bytes that came or went at once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Piece {
    /// When, on the transport's clock.
    pub at: Duration,
    /// From the device; to it where false.
    pub from_device: bool,
    /// The first byte lies within a frame.
    pub mid_frame: bool,
    /// The bytes.
    pub bytes: Box<[u8]>,
}

/// The last pieces of a link, within time and memory.
#[derive(Debug)]
pub struct Ring {
    pieces: VecDeque<Piece>,
    bytes: usize,
}

impl Default for Ring {
    fn default() -> Self {
        RINGS.fetch_add(1, Ordering::Relaxed);
        Self {
            pieces: VecDeque::new(),
            bytes: 0,
        }
    }
}

impl Drop for Ring {
    fn drop(&mut self) {
        RINGS.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Ring {
    /// Takes a piece, and lets go of what is too old or too much.
    pub fn push(&mut self, piece: Piece) {
        let share = MOST_BYTES_OF_ALL / RINGS.load(Ordering::Relaxed).max(1);
        let (most, oldest) = (MOST_BYTES.min(share), piece.at.saturating_sub(KEPT));
        self.bytes += piece.bytes.len() + OVERHEAD;
        self.pieces.push_back(piece);
        while let Some(first) = self.pieces.front()
            && (self.bytes > most || first.at < oldest)
        {
            self.bytes -= first.bytes.len() + OVERHEAD;
            self.pieces.pop_front();
        }
    }

    /// A copy of what came since `from`.
    pub fn since(&self, from: Duration) -> Vec<Piece> {
        let after = self.pieces.iter().skip_while(|piece| piece.at < from);
        after.cloned().collect()
    }

    /// Forgets everything: a connection is over.
    pub fn clear(&mut self) {
        self.pieces = VecDeque::new();
        self.bytes = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn piece(at_ms: u64, bytes: usize) -> Piece {
        Piece {
            at: Duration::from_millis(at_ms),
            from_device: true,
            mid_frame: false,
            bytes: vec![1; bytes].into(),
        }
    }

    #[test]
    fn a_minute_is_kept_and_no_more() {
        let mut ring = Ring::default();
        (0..7_000).for_each(|k| ring.push(piece(10 * k, 80)));
        // From 9.99 s to 69.99 s.
        assert_eq!(ring.since(Duration::ZERO).len(), 6_001);
        assert_eq!(ring.since(Duration::from_millis(69_000)).len(), 100);
    }

    #[test]
    fn whatever_a_device_sends_it_keeps_to_its_bytes() {
        let mut ring = Ring::default();
        // 200 MB in a second, and then in single bytes.
        (0..20_000).for_each(|k| ring.push(piece(k / 20, 10_000)));
        let held = |ring: &Ring| {
            let pieces = ring.since(Duration::ZERO);
            pieces
                .iter()
                .map(|p| p.bytes.len() + OVERHEAD)
                .sum::<usize>()
        };
        assert!(
            (15 << 20..=MOST_BYTES).contains(&held(&ring)) || RINGS.load(Ordering::Relaxed) > 8
        );
        (0..1_000_000).for_each(|k| ring.push(piece(1_000 + k / 1_000, 1)));
        assert!(held(&ring) <= MOST_BYTES);
        assert_eq!(ring.bytes, held(&ring));
        ring.clear();
        assert_eq!((ring.bytes, ring.since(Duration::ZERO).len()), (0, 0));
    }
}
