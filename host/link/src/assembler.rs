//! Assembly of windows from their messages, and the checks that they must pass.

use ihd_shared::sampling::Pair;
use ihd_shared::window::{CHUNK_BYTES, PAIR_BYTES, TRAJECTORY_ENTRY_BYTES, TrajectoryEntry};
use ihd_shared::window::{MAX_PAIRS, MAX_TRAJECTORY};
use ihd_shared::wire::frame::CRC32;
use ihd_shared::wire::messages::{AnyMessage, Piece, ResendWindow, WindowEnd, WindowStart};

use super::partial_payload::PartialPayload;
use super::window::{MAX_SATURATED_FRACTION, Window, WindowDefect, WindowPart};

/// A rejected window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RejectedWindow {
    /// Number of the window.
    pub seq: u32,
    /// Reason.
    pub reason: WindowDefect,
}

/// Windows under way at once: one that ends and one that begins, if the link reorders frames.
const MAX_WINDOWS: usize = 2;

/// Closed windows that are remembered, so that their late messages are recognised.
const CLOSED: usize = 8;

/// Assembles windows. Their messages may come in any order and more than once, since lost pieces are requested again. A window with
/// missing pieces is rejected when a later one has ended, when its pieces are not available any more ([`Assembler::give_up`]), or
/// when the stream ends. One that contradicts itself is rejected at once.
#[derive(Default)]
pub struct Assembler {
    /// Oldest first.
    under_way: Vec<PartialWindow>,
    /// Windows completed or rejected last; their remaining messages are ignored.
    closed: [Option<u32>; CLOSED],
    next_closed: usize,
    stray: u32,
}

/// The window that began last and is not complete.
pub struct UnfinishedWindow<'a>(&'a PartialWindow);

impl UnfinishedWindow<'_> {
    /// Number of the window.
    pub fn seq(&self) -> u32 {
        self.0.seq
    }

    /// Returns `true` if the window's end has come: missing pieces will not come without a request.
    pub fn has_ended(&self) -> bool {
        self.0.end_crc32.is_some()
    }

    /// Number of its messages that contained new data.
    pub fn progress(&self) -> u32 {
        self.0.progress
    }

    /// Number of its messages.
    pub fn heard(&self) -> u32 {
        self.0.heard
    }

    /// Requests for its missing pieces, one chunk each, in order; at most `limit`.
    pub fn missing(&self, limit: usize) -> Vec<ResendWindow> {
        let partial = self.0;
        let ask = |piece, offset: usize| ResendWindow {
            seq: partial.seq,
            piece,
            // A window's size fits 16 bits.
            offset: offset as u16,
        };
        let start = partial.start.is_none().then(|| ask(Piece::Start, 0));
        let [pairs, entries] = partial.declared();
        let pairs = partial.pairs.gaps(pairs);
        let pairs = pairs.flat_map(|gap| gap.step_by(CHUNK_BYTES / PAIR_BYTES));
        let entries = partial.trajectory.gaps(entries);
        let entries = entries.flat_map(|gap| gap.step_by(CHUNK_BYTES / TRAJECTORY_ENTRY_BYTES));
        let end = partial.end_crc32.is_none().then(|| ask(Piece::End, 0));
        start
            .into_iter()
            .chain(pairs.map(|at| ask(Piece::Pairs, at)))
            .chain(entries.map(|at| ask(Piece::Trajectory, at)))
            .chain(end)
            .take(limit)
            .collect()
    }

    /// Returns `true` if the piece of `request` is still missing.
    pub fn misses(&self, request: &ResendWindow) -> bool {
        let partial = self.0;
        let at = usize::from(request.offset);
        match request.piece {
            Piece::Start => partial.start.is_none(),
            Piece::Pairs => !partial.pairs.holds(at),
            Piece::Trajectory => !partial.trajectory.holds(at),
            Piece::End => partial.end_crc32.is_none(),
            Piece::Nothing => false,
        }
    }
}

impl Assembler {
    /// Messages of windows that were complete or rejected already.
    pub fn stray(&self) -> u32 {
        self.stray
    }

    /// The window that began last; `None` if it is complete.
    pub fn unfinished(&self) -> Option<UnfinishedWindow<'_>> {
        self.under_way.last().map(UnfinishedWindow)
    }

    /// Processes a message; messages other than a window's are ignored. Passes completed and rejected windows to `out`: first those
    /// given up, at most two, then the message's own. Returns the window's number if this was its first message.
    pub fn take(
        &mut self,
        message: &AnyMessage<'_>,
        mut out: impl FnMut(Result<Box<Window>, RejectedWindow>),
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
            if self.under_way.len() == MAX_WINDOWS {
                self.give_up_oldest(&mut out);
            }
            self.under_way.push(PartialWindow::new(seq));
        }
        let first = (!known).then_some(seq);
        let partial = self.under_way.iter_mut().find(|b| b.seq == seq)?;
        let result = partial.take(message);
        let ended = partial.end_crc32.is_some();
        if matches!(result, Ok(None)) && !ended {
            return first;
        }
        // An earlier window that is not complete yet will hardly be completed.
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
                out(Err(RejectedWindow { seq, reason }));
            }
        }
        first
    }

    /// Rejects a window under way; `None` if there is none of this number.
    pub fn give_up(&mut self, seq: u32) -> Option<RejectedWindow> {
        let partial = self.under_way.iter().find(|b| b.seq == seq)?;
        let reason = partial.defect();
        self.close(seq);
        Some(RejectedWindow { seq, reason })
    }

    /// Rejects the oldest window under way at the end of the stream. Call it until it returns `None`.
    pub fn finish(&mut self) -> Option<RejectedWindow> {
        let seq = self.under_way.first()?.seq;
        self.give_up(seq)
    }

    fn give_up_oldest(&mut self, out: &mut impl FnMut(Result<Box<Window>, RejectedWindow>)) {
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

struct PartialWindow {
    seq: u32,
    start: Option<WindowStart>,
    pairs: PartialPayload<PAIR_BYTES>,
    trajectory: PartialPayload<TRAJECTORY_ENTRY_BYTES>,
    end_crc32: Option<u32>,
    progress: u32,
    heard: u32,
}

impl PartialWindow {
    fn new(seq: u32) -> Self {
        Self {
            seq,
            start: None,
            pairs: PartialPayload::new(WindowPart::Pair),
            trajectory: PartialPayload::new(WindowPart::Trajectory),
            end_crc32: None,
            progress: 0,
            heard: 0,
        }
    }

    /// Numbers of pairs and of trajectory entries; those received so far if the start is missing.
    fn declared(&self) -> [usize; 2] {
        match &self.start {
            Some(start) => [start.pairs.into(), start.trajectory.into()],
            None => [self.pairs.end(), self.trajectory.end()],
        }
    }

    /// Adds one of the window's messages; returns the window if it is complete.
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
            // A repeated start carries a newer drop count.
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

    /// Reason why the window is not complete.
    fn defect(&self) -> WindowDefect {
        let Some(start) = &self.start else {
            return WindowDefect::NoStart;
        };
        // End of the gap; `None` if neither later chunks nor the end have come.
        let inner = |end: usize, declared: u16| {
            let cut = end == usize::from(declared) && self.end_crc32.is_none();
            (!cut).then_some(end as u16)
        };
        if let Some(gap) = self.pairs.gaps(start.pairs.into()).next() {
            let cut = self.trajectory.end() == 0;
            return match inner(gap.end, start.pairs) {
                None if cut => WindowDefect::NoEnd,
                _ => WindowDefect::MissingChunk {
                    of: WindowPart::Pair,
                    offset: gap.end as u16,
                },
            };
        }
        let gap = self.trajectory.gaps(start.trajectory.into()).next();
        match gap.and_then(|gap| inner(gap.end, start.trajectory)) {
            Some(offset) => WindowDefect::MissingChunk {
                of: WindowPart::Trajectory,
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
