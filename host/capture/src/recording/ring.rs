//! Ring of the last minute of a link's data, for pre-triggers.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// Longest retention: the longest pre-trigger.
const RETENTION: Duration = Duration::from_secs(60);

/// Largest size for one link; a minute of a heating hob is 11 MB.
const MAX_BYTES: usize = 16 << 20;

/// Largest size for all links of this process together; each has an equal share.
const MAX_TOTAL_BYTES: usize = 128 << 20;

/// Memory of a chunk beside its data, in bytes.
const OVERHEAD: usize = size_of::<ByteChunk>() + 16;

/// Number of rings in this process.
static RINGS: AtomicUsize = AtomicUsize::new(0);

/// Bytes received or sent at once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ByteChunk {
    /// Time on the transport's clock.
    pub at: Duration,
    /// `true` if received from the device, `false` if sent to it.
    pub from_device: bool,
    /// `true` if the first byte lies within a frame.
    pub mid_frame: bool,
    /// Received or sent bytes.
    pub bytes: Box<[u8]>,
}

/// Last chunks of a link, limited by time and memory.
#[derive(Debug)]
pub struct Ring {
    chunks: VecDeque<ByteChunk>,
    bytes: usize,
}

impl Default for Ring {
    fn default() -> Self {
        RINGS.fetch_add(1, Ordering::Relaxed);
        Self {
            chunks: VecDeque::new(),
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
    /// Adds a chunk and drops the oldest ones beyond the limits.
    pub fn push(&mut self, chunk: ByteChunk) {
        let share = MAX_TOTAL_BYTES / RINGS.load(Ordering::Relaxed).max(1);
        let (limit, oldest) = (MAX_BYTES.min(share), chunk.at.saturating_sub(RETENTION));
        self.bytes += chunk.bytes.len() + OVERHEAD;
        self.chunks.push_back(chunk);
        while let Some(first) = self.chunks.front()
            && (self.bytes > limit || first.at < oldest)
        {
            self.bytes -= first.bytes.len() + OVERHEAD;
            self.chunks.pop_front();
        }
    }

    /// Returns a copy of the chunks since `from`.
    pub fn since(&self, from: Duration) -> Vec<ByteChunk> {
        let after = self.chunks.iter().skip_while(|chunk| chunk.at < from);
        after.cloned().collect()
    }

    /// Clears the ring at the end of a connection.
    pub fn clear(&mut self) {
        self.chunks = VecDeque::new();
        self.bytes = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chunk(at_ms: u64, bytes: usize) -> ByteChunk {
        ByteChunk {
            at: Duration::from_millis(at_ms),
            from_device: true,
            mid_frame: false,
            bytes: vec![1; bytes].into(),
        }
    }

    #[test]
    fn a_minute_is_kept_and_no_more() {
        let mut ring = Ring::default();
        (0..7_000).for_each(|k| ring.push(chunk(10 * k, 80)));
        // From 9.99 s to 69.99 s.
        assert_eq!(ring.since(Duration::ZERO).len(), 6_001);
        assert_eq!(ring.since(Duration::from_millis(69_000)).len(), 100);
    }

    #[test]
    fn whatever_a_device_sends_it_keeps_to_its_bytes() {
        let mut ring = Ring::default();
        // 200 MB in a second, and then in single bytes.
        (0..20_000).for_each(|k| ring.push(chunk(k / 20, 10_000)));
        let held = |ring: &Ring| {
            let chunks = ring.since(Duration::ZERO);
            chunks
                .iter()
                .map(|p| p.bytes.len() + OVERHEAD)
                .sum::<usize>()
        };
        assert!((15 << 20..=MAX_BYTES).contains(&held(&ring)) || RINGS.load(Ordering::Relaxed) > 8);
        (0..1_000_000).for_each(|k| ring.push(chunk(1_000 + k / 1_000, 1)));
        assert!(held(&ring) <= MAX_BYTES);
        assert_eq!(ring.bytes, held(&ring));
        ring.clear();
        assert_eq!((ring.bytes, ring.since(Duration::ZERO).len()), (0, 0));
    }
}
