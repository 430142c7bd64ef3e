//! Windows put together from their messages, or rejected with the reason.

use ihd_shared::sampling::Pair;
use ihd_shared::window::{
    MAX_PAIRS, MAX_TRAJECTORY, PAIR_BYTES, TRAJECTORY_ENTRY_BYTES, TrajectoryEntry,
};
use ihd_shared::wire::frame::{CRC32, Digest};
use ihd_shared::wire::messages::{AnyMessage, WindowEnd, WindowStart};

use super::window::{MAX_SATURATED_FRACTION, Part, Window, WindowDefect};

/// A window rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rejected {
    /// Its number.
    pub seq: u32,
    /// Why.
    pub reason: WindowDefect,
}

struct Building {
    start: WindowStart,
    digest: Digest,
    pairs: Vec<Pair>,
    trajectory: Vec<TrajectoryEntry>,
}

/// Puts windows together. A link keeps the order of frames, so that a window's messages come in
/// order or not at all; whatever else comes is a defect, and the window is given up at once.
#[derive(Default)]
pub struct Assembler {
    building: Option<Building>,
    /// The window that was last given out or rejected: the rest of its messages mean nothing.
    closed: Option<u32>,
    stray: u32,
}

impl Assembler {
    /// Messages of windows that had already been given out or rejected.
    pub fn stray(&self) -> u32 {
        self.stray
    }

    /// Takes a message; other than window messages are ignored. Hands windows and rejections, in
    /// this order at most one of an old and one of a new window, to `out`.
    pub fn take(
        &mut self,
        message: &AnyMessage<'_>,
        mut out: impl FnMut(Result<Box<Window>, Rejected>),
    ) {
        let (seq, result) = match message {
            AnyMessage::WindowStart(start) => {
                if let Some(rejected) = self.give_up_before(start.seq) {
                    out(Err(rejected));
                }
                (start.seq, self.start(start).map(|()| None))
            }
            AnyMessage::WindowChunk(m) => {
                let take = |b: &mut Building| b.take_pairs(m.offset, m.data.0).map(|()| None);
                (m.seq, self.with_building(m.seq, take))
            }
            AnyMessage::TrajectoryChunk(m) => {
                let take = |b: &mut Building| b.take_trajectory(m.offset, m.data.0).map(|()| None);
                (m.seq, self.with_building(m.seq, take))
            }
            AnyMessage::WindowEnd(end) => (
                end.seq,
                self.with_building(end.seq, |b| b.end(end).map(Some)),
            ),
            _ => return,
        };
        match result {
            Ok(None) => {}
            Ok(Some(window)) => {
                self.close(seq);
                out(Ok(Box::new(window)));
            }
            Err(reason) => {
                self.close(seq);
                out(Err(Rejected { seq, reason }));
            }
        }
    }

    /// The stream is over: a window that is not complete never will be.
    pub fn finish(&mut self) -> Option<Rejected> {
        let seq = self.building.as_ref()?.start.seq;
        self.close(seq);
        let reason = WindowDefect::NoEnd;
        Some(Rejected { seq, reason })
    }

    fn close(&mut self, seq: u32) {
        if self.building.as_ref().is_some_and(|b| b.start.seq == seq) {
            self.building = None;
        }
        self.closed = Some(seq);
    }

    /// A window begins, so the one under way has ended without its end.
    fn give_up_before(&mut self, seq: u32) -> Option<Rejected> {
        if self.building.as_ref()?.start.seq == seq {
            return None;
        }
        self.finish()
    }

    fn start(&mut self, start: &WindowStart) -> Result<(), WindowDefect> {
        if self.building.is_some() {
            return Err(WindowDefect::RepeatedStart);
        }
        if usize::from(start.pairs) > MAX_PAIRS || usize::from(start.trajectory) > MAX_TRAJECTORY {
            return Err(WindowDefect::TooLarge {
                pairs: start.pairs,
                trajectory: start.trajectory,
            });
        }
        let scale = start.v_full_scale_mv.min(start.i_full_scale_ma);
        if start.pairs == 0 || start.f_sw_hz == 0 || start.half_cycle_ns == 0 || scale == 0 {
            return Err(WindowDefect::Empty);
        }
        self.building = Some(Building {
            start: start.clone(),
            digest: CRC32.digest(),
            pairs: Vec::with_capacity(start.pairs.into()),
            trajectory: Vec::with_capacity(start.trajectory.into()),
        });
        Ok(())
    }

    fn with_building(
        &mut self,
        seq: u32,
        f: impl FnOnce(&mut Building) -> Result<Option<Window>, WindowDefect>,
    ) -> Result<Option<Window>, WindowDefect> {
        match &mut self.building {
            Some(building) if building.start.seq == seq => f(building),
            _ if self.closed == Some(seq) => {
                self.stray = self.stray.wrapping_add(1);
                Ok(None)
            }
            _ => Err(WindowDefect::NoStart),
        }
    }
}

impl Building {
    fn take_pairs(&mut self, offset: u16, data: &[u8]) -> Result<(), WindowDefect> {
        let (entries, rest) = data.as_chunks::<PAIR_BYTES>();
        let sizes = [self.pairs.len(), entries.len(), self.start.pairs.into()];
        check_chunk(Part::Pair, offset, data.len(), rest.len(), sizes)?;
        self.digest.update(data);
        self.pairs
            .extend(entries.iter().map(|&b| Pair::from_le_bytes(b)));
        Ok(())
    }

    fn take_trajectory(&mut self, offset: u16, data: &[u8]) -> Result<(), WindowDefect> {
        self.expect_all_pairs()?;
        let (entries, rest) = data.as_chunks::<TRAJECTORY_ENTRY_BYTES>();
        let sizes = [
            self.trajectory.len(),
            entries.len(),
            self.start.trajectory.into(),
        ];
        check_chunk(Part::Trajectory, offset, data.len(), rest.len(), sizes)?;
        self.digest.update(data);
        self.trajectory
            .extend(entries.iter().map(|&b| TrajectoryEntry::from_le_bytes(b)));
        Ok(())
    }

    /// Pairs come before the trajectory: the CRC takes them in this order.
    fn expect_all_pairs(&self) -> Result<(), WindowDefect> {
        if self.pairs.len() < usize::from(self.start.pairs) {
            return Err(WindowDefect::MissingChunk {
                of: Part::Pair,
                offset: self.start.pairs,
            });
        }
        Ok(())
    }

    fn end(&mut self, end: &WindowEnd) -> Result<Window, WindowDefect> {
        self.expect_all_pairs()?;
        if self.trajectory.len() < usize::from(self.start.trajectory) {
            return Err(WindowDefect::MissingChunk {
                of: Part::Trajectory,
                offset: self.start.trajectory,
            });
        }
        if self.digest.clone().finalize() != end.crc32 {
            return Err(WindowDefect::Crc);
        }
        let counted = self.pairs.iter().filter(|p| p.is_saturated()).count() as u16;
        let saturated = counted.max(self.start.saturated);
        if f64::from(saturated) > MAX_SATURATED_FRACTION * f64::from(self.start.pairs) {
            return Err(WindowDefect::Saturated {
                pairs: saturated,
                of: self.start.pairs,
            });
        }
        let start = &self.start;
        Ok(Window {
            seq: start.seq,
            half_cycle: start.half_cycle,
            f_sw_hz: start.f_sw_hz,
            half_cycle_ns: start.half_cycle_ns,
            first_pair_ns: start.first_pair_ns,
            pairs: std::mem::take(&mut self.pairs),
            first_trajectory_ns: start.first_trajectory_ns,
            trajectory: std::mem::take(&mut self.trajectory),
            saturated,
            lookup_version: start.lookup_version,
            scales: start.scales(),
        })
    }
}

/// Whether a chunk continues exactly where the last one ended; `sizes` are the entries so far, in
/// the chunk, and declared.
fn check_chunk(
    of: Part,
    offset: u16,
    bytes: usize,
    rest: usize,
    [have, new, declared]: [usize; 3],
) -> Result<(), WindowDefect> {
    let at = usize::from(offset);
    if rest > 0 || new == 0 {
        Err(WindowDefect::RaggedChunk { of, bytes })
    } else if at > have {
        Err(WindowDefect::MissingChunk { of, offset })
    } else if at < have {
        Err(WindowDefect::RepeatedChunk { of, offset })
    } else if at + new > declared {
        Err(WindowDefect::ChunkBeyondEnd { of, offset })
    } else {
        Ok(())
    }
}
