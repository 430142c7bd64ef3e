//! One part of a window, assembled from chunks in any order.

use std::ops::Range;

use super::window::{WindowDefect, WindowPart};

/// Entries of `N` bytes each, with gaps where chunks are missing.
pub struct PartialPayload<const N: usize> {
    of: WindowPart,
    bytes: Vec<u8>,
    /// Ranges of entries received, in order, not touching each other.
    have: Vec<Range<usize>>,
}

impl<const N: usize> PartialPayload<N> {
    /// Creates one without entries.
    pub fn new(of: WindowPart) -> Self {
        Self {
            of,
            bytes: Vec::new(),
            have: Vec::new(),
        }
    }

    /// Inserts a chunk; all chunks have at most `declared` entries. Returns `true` if it contained missing entries.
    ///
    /// # Errors
    /// [`WindowDefect::RaggedChunk`], [`WindowDefect::ChunkBeyondEnd`], and [`WindowDefect::RepeatedChunk`] if it contradicts an
    /// earlier chunk.
    pub fn take(
        &mut self,
        offset: u16,
        data: &[u8],
        declared: usize,
    ) -> Result<bool, WindowDefect> {
        let of = self.of;
        let bytes = data.len();
        if data.is_empty() || !bytes.is_multiple_of(N) {
            return Err(WindowDefect::RaggedChunk { of, bytes });
        }
        let from = usize::from(offset);
        let new = from..from + bytes / N;
        if new.end > declared {
            return Err(WindowDefect::ChunkBeyondEnd { of, offset });
        }
        if self.contradicts(&new, data) {
            return Err(WindowDefect::RepeatedChunk { of, offset });
        }
        if self
            .have
            .iter()
            .any(|r| r.start <= new.start && new.end <= r.end)
        {
            return Ok(false);
        }
        if self.bytes.len() < new.end * N {
            self.bytes.resize(new.end * N, 0);
        }
        self.bytes[new.start * N..new.end * N].copy_from_slice(data);
        self.join(new);
        Ok(true)
    }

    fn contradicts(&self, new: &Range<usize>, data: &[u8]) -> bool {
        self.have.iter().any(|have| {
            let (from, to) = (have.start.max(new.start), have.end.min(new.end));
            from < to
                && self.bytes[from * N..to * N]
                    != data[(from - new.start) * N..(to - new.start) * N]
        })
    }

    fn join(&mut self, mut new: Range<usize>) {
        // Ranges that touch it are merged.
        let first = self.have.partition_point(|r| r.end < new.start);
        let last = self.have.partition_point(|r| r.start <= new.end);
        if let Some(touching) = self.have.get(first..last).filter(|t| !t.is_empty()) {
            new.start = new.start.min(touching[0].start);
            new.end = new.end.max(touching[touching.len() - 1].end);
        }
        self.have.splice(first..last, [new]);
    }

    /// Sets the number of entries.
    ///
    /// # Errors
    /// [`WindowDefect::ChunkBeyondEnd`] when more than that have come.
    pub fn declare(&mut self, declared: usize) -> Result<(), WindowDefect> {
        match self.have.last() {
            Some(last) if last.end > declared => Err(WindowDefect::ChunkBeyondEnd {
                of: self.of,
                offset: last.start as u16,
            }),
            _ => {
                let more = (declared * N).saturating_sub(self.bytes.len());
                self.bytes.reserve_exact(more);
                Ok(())
            }
        }
    }

    /// Number of entries up to the last one received.
    pub fn end(&self) -> usize {
        self.have.last().map_or(0, |last| last.end)
    }

    /// Returns `true` if entry `at` was received.
    pub fn holds(&self, at: usize) -> bool {
        self.have.iter().any(|r| r.contains(&at))
    }

    /// Gaps within the first `declared` entries.
    pub fn gaps(&self, declared: usize) -> impl Iterator<Item = Range<usize>> + '_ {
        let ends = std::iter::once(0).chain(self.have.iter().map(|r| r.end));
        let starts = self.have.iter().map(|r| r.start);
        ends.zip(starts.chain([declared]))
            .map(|(from, to)| from..to)
            .filter(|gap| !gap.is_empty())
    }

    /// The bytes of all entries; zeros in the gaps.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// All entries; zeros in the gaps.
    pub fn entries(&self) -> impl Iterator<Item = [u8; N]> + '_ {
        self.bytes.as_chunks::<N>().0.iter().copied()
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::single_range_in_vec_init, reason = "one gap, one chunk")]

    use super::*;

    /// Entries of a byte whose values are their places.
    fn chunk(range: Range<u8>) -> Vec<u8> {
        range.collect()
    }

    fn taken(chunks: &[Range<u8>]) -> PartialPayload<1> {
        let mut pieces = PartialPayload::new(WindowPart::Pair);
        for range in chunks {
            let data = chunk(range.clone());
            pieces.take(range.start.into(), &data, 100).unwrap();
        }
        pieces
    }

    fn gaps(chunks: &[Range<u8>]) -> Vec<Range<usize>> {
        taken(chunks).gaps(100).collect()
    }

    #[test]
    fn gaps_are_what_has_not_come() {
        assert_eq!(gaps(&[]), [0..100]);
        assert_eq!(gaps(&[0..40, 60..100]), [40..60]);
        assert_eq!(gaps(&[60..100, 0..40, 40..60]), []);
        assert_eq!(gaps(&[10..20, 30..40, 50..60, 15..55]), [0..10, 60..100]);
        assert_eq!(gaps(&[10..20, 20..30, 5..10]), [0..5, 30..100]);
    }

    #[test]
    fn order_and_repetition_make_no_difference() {
        let chunks = [0..30, 30..60, 60..90, 90..100, 20..70, 60..90];
        for turn in 0..chunks.len() {
            let mut turned = chunks.to_vec();
            turned.rotate_left(turn);
            assert_eq!(taken(&turned).bytes(), chunk(0..100));
            turned.reverse();
            assert_eq!(taken(&turned).bytes(), chunk(0..100));
        }
    }

    #[test]
    fn a_repetition_brings_nothing_new_and_a_contradiction_is_one() {
        let mut pieces = taken(&[0..30]);
        assert_eq!(pieces.take(10, &chunk(10..30), 100), Ok(false));
        assert_eq!(pieces.take(10, &chunk(10..31), 100), Ok(true));
        let offset = 9;
        let contradiction = WindowDefect::RepeatedChunk {
            of: WindowPart::Pair,
            offset,
        };
        assert_eq!(pieces.take(offset, &chunk(10..40), 100), Err(contradiction));
    }
}
