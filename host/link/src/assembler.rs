//! Windows put together from their messages, or rejected with the reason.

use ihd_shared::sampling::Pair;
use ihd_shared::window::{CHUNK_BYTES, PAIR_BYTES, TRAJECTORY_ENTRY_BYTES, TrajectoryEntry};
use ihd_shared::window::{MAX_PAIRS, MAX_TRAJECTORY};
use ihd_shared::wire::frame::CRC32;
use ihd_shared::wire::messages::{AnyMessage, Piece, ResendWindow, WindowEnd, WindowStart};

use super::pieces::Pieces;
use super::window::{MAX_SATURATED_FRACTION, Part, Window, WindowDefect};

/// A window rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rejected {
    /// Its number.
    pub seq: u32,
    /// Why.
    pub reason: WindowDefect,
}

/// Windows under way at once: one that ends and one that begins, where a link changes the order of frames.
const UNDER_WAY: usize = 2;

/// Windows whose late messages are known as such.
const CLOSED: usize = 8;

/// Puts windows together. Their messages come in any order, and more than once: a piece that was
/// lost is asked for again. A window that misses something is given up when a later one has ended, when there
/// is nothing to be had any more ([`Assembler::give_up`]), or when the stream is over; one that contradicts
/// itself at once.
#[derive(Default)]
pub struct Assembler {
    /// Oldest first.
    under_way: Vec<Building>,
    /// Windows that were last given out or rejected: the rest of their messages mean nothing.
    closed: [Option<u32>; CLOSED],
    next_closed: usize,
    stray: u32,
}

/// The window that began last, while it is not complete.
pub struct Unfinished<'a>(&'a Building);

impl Unfinished<'_> {
    /// Its number.
    pub fn seq(&self) -> u32 {
        self.0.seq
    }

    /// Whether its end has come: what is missing will not come by itself.
    pub fn has_ended(&self) -> bool {
        self.0.end_crc32.is_some()
    }

    /// Counts the messages that have brought something new.
    pub fn progress(&self) -> u32 {
        self.0.progress
    }

    /// Counts all messages of it.
    pub fn heard(&self) -> u32 {
        self.0.heard
    }

    /// What is missing, in requests of a chunk each; at most `limit`, first things first.
    pub fn missing(&self, limit: usize) -> Vec<ResendWindow> {
        let building = self.0;
        let ask = |piece, offset: usize| ResendWindow {
            seq: building.seq,
            piece,
            // Within a window's size, which 16 bits hold.
            offset: offset as u16,
        };
        let start = building.start.is_none().then(|| ask(Piece::Start, 0));
        let [pairs, entries] = building.declared();
        let pairs = building.pairs.gaps(pairs);
        let pairs = pairs.flat_map(|gap| gap.step_by(CHUNK_BYTES / PAIR_BYTES));
        let entries = building.trajectory.gaps(entries);
        let entries = entries.flat_map(|gap| gap.step_by(CHUNK_BYTES / TRAJECTORY_ENTRY_BYTES));
        let end = building.end_crc32.is_none().then(|| ask(Piece::End, 0));
        start
            .into_iter()
            .chain(pairs.map(|at| ask(Piece::Pairs, at)))
            .chain(entries.map(|at| ask(Piece::Trajectory, at)))
            .chain(end)
            .take(limit)
            .collect()
    }

    /// Whether what `request` asks for is still missing.
    pub fn misses(&self, request: &ResendWindow) -> bool {
        let building = self.0;
        let at = usize::from(request.offset);
        match request.piece {
            Piece::Start => building.start.is_none(),
            Piece::Pairs => !building.pairs.holds(at),
            Piece::Trajectory => !building.trajectory.holds(at),
            Piece::End => building.end_crc32.is_none(),
            Piece::Nothing => false,
        }
    }
}

impl Assembler {
    /// Messages of windows that had already been given out or rejected.
    pub fn stray(&self) -> u32 {
        self.stray
    }

    /// The window that began last, while it is not complete.
    pub fn unfinished(&self) -> Option<Unfinished<'_>> {
        self.under_way.last().map(Unfinished)
    }

    /// Takes a message; other than window messages are ignored. Hands windows and rejections to `out`: those of the windows
    /// under way that are given up, at most two, then its own. Returns the number of a window of which it was the
    /// first message.
    pub fn take(
        &mut self,
        message: &AnyMessage<'_>,
        mut out: impl FnMut(Result<Box<Window>, Rejected>),
    ) -> Option<u32> {
        let seq = match message {
            AnyMessage::WindowStart(m) => m.seq,
            AnyMessage::WindowChunk(m) => m.seq,
            AnyMessage::TrajectoryChunk(m) => m.seq,
            AnyMessage::WindowEnd(m) => m.seq,
            _ => return None,
        };
        if self.closed.contains(&Some(seq)) {
            self.stray = self.stray.wrapping_add(1);
            return None;
        }
        let known = self.under_way.iter().any(|b| b.seq == seq);
        if !known {
            if self.under_way.len() == UNDER_WAY {
                self.give_up_oldest(&mut out);
            }
            self.under_way.push(Building::new(seq));
        }
        let first = (!known).then_some(seq);
        let building = self.under_way.iter_mut().find(|b| b.seq == seq)?;
        let result = building.take(message);
        let ended = building.end_crc32.is_some();
        if matches!(result, Ok(None)) && !ended {
            return first;
        }
        // What began before this one and is not complete will hardly be.
        while self.under_way.first().is_some_and(|b| b.seq != seq) {
            self.give_up_oldest(&mut out);
        }
        match result {
            Ok(None) => {}
            Ok(Some(window)) => {
                self.close(seq);
                out(Ok(window));
            }
            Err(reason) => {
                self.close(seq);
                out(Err(Rejected { seq, reason }));
            }
        }
        first
    }

    /// Gives a window up that is under way.
    pub fn give_up(&mut self, seq: u32) -> Option<Rejected> {
        let building = self.under_way.iter().find(|b| b.seq == seq)?;
        let reason = building.what_is_missing();
        self.close(seq);
        Some(Rejected { seq, reason })
    }

    /// The stream is over: a window that is not complete never will be. To be called until it gives none.
    pub fn finish(&mut self) -> Option<Rejected> {
        let seq = self.under_way.first()?.seq;
        self.give_up(seq)
    }

    fn give_up_oldest(&mut self, out: &mut impl FnMut(Result<Box<Window>, Rejected>)) {
        if let Some(rejected) = self.finish() {
            out(Err(rejected));
        }
    }

    fn close(&mut self, seq: u32) {
        self.under_way.retain(|b| b.seq != seq);
        self.closed[self.next_closed] = Some(seq);
        self.next_closed = (self.next_closed + 1) % CLOSED;
    }
}

struct Building {
    seq: u32,
    start: Option<WindowStart>,
    pairs: Pieces<PAIR_BYTES>,
    trajectory: Pieces<TRAJECTORY_ENTRY_BYTES>,
    end_crc32: Option<u32>,
    progress: u32,
    heard: u32,
}

impl Building {
    fn new(seq: u32) -> Self {
        Self {
            seq,
            start: None,
            pairs: Pieces::new(Part::Pair),
            trajectory: Pieces::new(Part::Trajectory),
            end_crc32: None,
            progress: 0,
            heard: 0,
        }
    }

    /// Pairs and entries that the window has; as many as are known of while its start is missing.
    fn declared(&self) -> [usize; 2] {
        match &self.start {
            Some(start) => [start.pairs.into(), start.trajectory.into()],
            None => [self.pairs.end(), self.trajectory.end()],
        }
    }

    /// Takes one of the window's messages; gives the window when it was the last.
    fn take(&mut self, message: &AnyMessage<'_>) -> Result<Option<Box<Window>>, WindowDefect> {
        let declared = self
            .start
            .as_ref()
            .map_or([MAX_PAIRS, MAX_TRAJECTORY], |s| {
                [s.pairs.into(), s.trajectory.into()]
            });
        let is_new = match message {
            AnyMessage::WindowStart(m) => self.take_start(m)?,
            AnyMessage::WindowChunk(m) => self.pairs.take(m.offset, m.data.0, declared[0])?,
            AnyMessage::TrajectoryChunk(m) => {
                self.trajectory.take(m.offset, m.data.0, declared[1])?
            }
            AnyMessage::WindowEnd(m) => self.take_end(m)?,
            _ => false,
        };
        self.heard = self.heard.wrapping_add(1);
        self.progress = self.progress.wrapping_add(is_new.into());
        self.complete()
    }

    fn take_start(&mut self, start: &WindowStart) -> Result<bool, WindowDefect> {
        if let Some(first) = &self.start {
            // Sent again it tells of what has been dropped by then.
            let same = WindowStart {
                dropped: first.dropped,
                ..start.clone()
            };
            return if same == *first {
                Ok(false)
            } else {
                Err(WindowDefect::RepeatedStart)
            };
        }
        let [pairs, trajectory] = [start.pairs, start.trajectory].map(usize::from);
        if pairs > MAX_PAIRS || trajectory > MAX_TRAJECTORY {
            return Err(WindowDefect::TooLarge {
                pairs: start.pairs,
                trajectory: start.trajectory,
            });
        }
        let scale = start.v_full_scale_mv.min(start.i_full_scale_ma);
        if start.pairs == 0 || start.f_sw_hz == 0 || start.half_cycle_ns == 0 || scale == 0 {
            return Err(WindowDefect::Empty);
        }
        self.pairs.declare(pairs)?;
        self.trajectory.declare(trajectory)?;
        self.start = Some(start.clone());
        Ok(true)
    }

    fn take_end(&mut self, end: &WindowEnd) -> Result<bool, WindowDefect> {
        match self.end_crc32.replace(end.crc32) {
            None => Ok(true),
            Some(first) if first == end.crc32 => Ok(false),
            Some(_) => Err(WindowDefect::Crc),
        }
    }

    /// Why the window is not complete.
    fn what_is_missing(&self) -> WindowDefect {
        let Some(start) = &self.start else {
            return WindowDefect::NoStart;
        };
        // The gap's end, unless nothing has come behind it and no end either.
        let inner = |end: usize, declared: u16| {
            let cut = end == usize::from(declared) && self.end_crc32.is_none();
            (!cut).then_some(end as u16)
        };
        if let Some(gap) = self.pairs.gaps(start.pairs.into()).next() {
            let cut = self.trajectory.end() == 0;
            return match inner(gap.end, start.pairs) {
                None if cut => WindowDefect::NoEnd,
                _ => WindowDefect::MissingChunk {
                    of: Part::Pair,
                    offset: gap.end as u16,
                },
            };
        }
        let gap = self.trajectory.gaps(start.trajectory.into()).next();
        match gap.and_then(|gap| inner(gap.end, start.trajectory)) {
            Some(offset) => WindowDefect::MissingChunk {
                of: Part::Trajectory,
                offset,
            },
            None => WindowDefect::NoEnd,
        }
    }

    fn complete(&mut self) -> Result<Option<Box<Window>>, WindowDefect> {
        let (Some(start), Some(crc32)) = (&self.start, self.end_crc32) else {
            return Ok(None);
        };
        let (pairs, trajectory) = (usize::from(start.pairs), usize::from(start.trajectory));
        if self.pairs.gaps(pairs).next().is_some()
            || self.trajectory.gaps(trajectory).next().is_some()
        {
            return Ok(None);
        }
        let mut digest = CRC32.digest();
        digest.update(self.pairs.bytes());
        digest.update(self.trajectory.bytes());
        if digest.finalize() != crc32 {
            return Err(WindowDefect::Crc);
        }
        let pairs: Vec<Pair> = self.pairs.entries().map(Pair::from_le_bytes).collect();
        let counted = pairs.iter().filter(|p| p.is_saturated()).count() as u16;
        let saturated = counted.max(start.saturated);
        if f64::from(saturated) > MAX_SATURATED_FRACTION * f64::from(start.pairs) {
            return Err(WindowDefect::Saturated {
                pairs: saturated,
                of: start.pairs,
            });
        }
        let trajectory = self.trajectory.entries();
        Ok(Some(Box::new(Window {
            seq: start.seq,
            half_cycle: start.half_cycle,
            f_sw_hz: start.f_sw_hz,
            half_cycle_ns: start.half_cycle_ns,
            first_pair_ns: start.first_pair_ns,
            pairs,
            first_trajectory_ns: start.first_trajectory_ns,
            trajectory: trajectory.map(TrajectoryEntry::from_le_bytes).collect(),
            saturated,
            lookup_version: start.lookup_version,
            scales: start.scales(),
        })))
    }
}
