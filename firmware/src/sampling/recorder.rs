//! Window recorder: every pair of one half-cycle, and the estimator's trajectory through it.
//!
//! One slot. While the link drains it, windows that are due are counted and dropped; the sampling
//! path never waits. The trajectory lags the pairs by the demodulator's delay, so a window is ready a
//! few blocks after its half-cycle has ended.

use core::hint::black_box;
use core::ops::Range;

use ihd_shared::sampling::{ADC_LOCK_P, Pair};
use ihd_shared::window::{
    MAX_PAIRS, MAX_TRAJECTORY, PAIR_BYTES, TRAJECTORY_ENTRY_BYTES, TrajectoryEntry,
};

use crate::sampling::packed_blocks::PackedBlocks;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// Empty.
    Free,
    /// Taking pairs and trajectory.
    Recording,
    /// The half-cycle is over; the last trajectory entries are on their way.
    Tail,
    /// Complete; the link may read it.
    Ready,
}

/// Description of a window beside its pairs and trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WindowHeader {
    /// Counts every window that was due, recorded or not.
    pub seq: u32,
    /// Half-cycle since boot.
    pub half_cycle: u32,
    /// Switching frequency, in hertz.
    pub f_sw_hz: u32,
    /// Duration of the half-cycle, in nanoseconds.
    pub half_cycle_ns: u32,
    /// Time of the first pair after the zero crossing, in nanoseconds.
    pub first_pair_ns: i32,
    /// Time of the first trajectory entry after the zero crossing, in nanoseconds.
    pub first_trajectory_ns: i32,
    /// Pairs recorded.
    pub pairs: u16,
    /// Trajectory entries recorded.
    pub trajectory: u16,
    /// Pairs at the end of the ADC's range.
    pub saturated: u16,
    /// Version of the lookup that was active when the half-cycle began.
    pub lookup_version: u32,
}

/// Counters since boot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WindowCounters {
    /// Windows that were due.
    pub due: u32,
    /// Windows recorded completely.
    pub recorded: u32,
    /// Windows that found the slot taken, or that a frequency step or a lost block cut short.
    pub dropped: u32,
}

/// The recorder and its one slot.
pub struct Recorder {
    stage: Stage,
    /// The slot records no half-cycle, but pairs that are read meanwhile.
    raw: bool,
    header: WindowHeader,
    counters: WindowCounters,
    /// Least half-cycles from window to window; 0 for none.
    period: u8,
    /// Half-cycle of the last window that was due.
    last_due: u32,
    /// Version of the active lookup, for the windows' headers.
    lookup_version: u32,
    /// Time of the current block's first pair since the window's zero crossing.
    block_start_ns: i32,
    /// Blocks in the slot, and the first one's pairs that lie before the window.
    blocks: u16,
    skipped: u16,
    packed: PackedBlocks,
    trajectory: [TrajectoryEntry; MAX_TRAJECTORY],
}

impl Default for Recorder {
    fn default() -> Self {
        Self::new()
    }
}

impl Recorder {
    /// An empty recorder.
    pub const fn new() -> Self {
        const NO_ENTRY: TrajectoryEntry = TrajectoryEntry {
            r: ihd_shared::units::MicroOhm(0),
            l: ihd_shared::units::PicoHenry(0),
        };
        Self {
            stage: Stage::Free,
            raw: false,
            header: WindowHeader {
                seq: 0,
                half_cycle: 0,
                f_sw_hz: 0,
                half_cycle_ns: 0,
                first_pair_ns: 0,
                first_trajectory_ns: 0,
                pairs: 0,
                trajectory: 0,
                saturated: 0,
                lookup_version: 0,
            },
            counters: WindowCounters {
                due: 0,
                recorded: 0,
                dropped: 0,
            },
            period: 0,
            last_due: 0,
            lookup_version: 0,
            block_start_ns: 0,
            blocks: 0,
            skipped: 0,
            packed: PackedBlocks::blank(),
            trajectory: [NO_ENTRY; MAX_TRAJECTORY],
        }
    }

    /// Counters since boot.
    pub fn counters(&self) -> WindowCounters {
        self.counters
    }

    /// Sets the least half-cycles from window to window; 0 for none.
    pub fn set_period(&mut self, half_cycles: u8) {
        self.period = half_cycles;
    }

    /// Sets the version of the lookup that is active from the next window on.
    pub fn set_lookup_version(&mut self, version: u32) {
        self.lookup_version = version;
    }

    /// Returns `true` if a window of this half-cycle is due: a period has passed since the last one. It stays due until
    /// [`Recorder::begin`], so that bursts in the period's rhythm show windows too.
    #[inline]
    pub fn is_due(&self, half_cycle: u32) -> bool {
        let period = u32::from(self.period);
        period > 0 && half_cycle.wrapping_sub(self.last_due) >= period
    }

    /// Returns `true` within the half-cycle of a window.
    #[inline]
    pub fn is_recording(&self) -> bool {
        self.stage == Stage::Recording
    }

    /// Begins a window that is due. The sequence number counts before the slot is claimed, so that a drop shows
    /// as a gap. Times after the zero crossing: of the current block's first pair, and of the window's.
    pub fn begin(
        &mut self,
        half_cycle: u32,
        f_sw_hz: u32,
        block_start_ns: i32,
        first_pair_ns: i32,
    ) {
        let seq = self.counters.due;
        self.counters.due = seq.wrapping_add(1);
        self.last_due = half_cycle;
        if self.stage != Stage::Free {
            self.counters.dropped = self.counters.dropped.wrapping_add(1);
            return;
        }
        self.stage = Stage::Recording;
        self.blocks = 0;
        self.block_start_ns = block_start_ns;
        self.header = WindowHeader {
            seq,
            half_cycle,
            f_sw_hz,
            first_pair_ns,
            lookup_version: self.lookup_version,
            ..WindowHeader::default()
        };
    }

    /// Adds the pairs of the half-cycle that a block has, from the first to before the last: in the window's first block the
    /// latter, in its last one the former, in all others all. `saturated` are those of the whole block.
    #[inline(always)]
    pub fn push(&mut self, block: &[Pair; ADC_LOCK_P], pairs: Range<usize>, saturated: u16) {
        if self.stage == Stage::Recording {
            self.take(block, pairs, saturated);
        }
    }

    #[inline(never)]
    fn take(&mut self, block: &[Pair; ADC_LOCK_P], pairs: Range<usize>, saturated: u16) {
        // What is recorded raw takes no notice of crossings.
        let pairs = if self.raw { 0..ADC_LOCK_P } else { pairs };
        let at = usize::from(self.blocks);
        // A saturated code may have more than 12 bits.
        if !self.packed.put(at, block, saturated == 0) {
            return;
        }
        if at == 0 {
            self.skipped = pairs.start as u16;
        }
        self.blocks += 1;
        let room = MAX_PAIRS.saturating_sub(self.header.pairs.into());
        self.header.pairs += pairs.len().min(room) as u16;
        if saturated > 0 {
            let recorded = block.iter().take(pairs.end).skip(pairs.start).take(room);
            self.header.saturated += recorded.filter(|p| p.is_saturated()).count() as u16;
        }
    }

    /// Ends the half-cycle.
    pub fn end(&mut self, half_cycle_ns: u32) {
        if self.stage == Stage::Recording && !self.raw {
            self.stage = Stage::Tail;
            self.header.half_cycle_ns = half_cycle_ns;
        }
    }

    /// Adds the estimate made with the current block; it belongs `delay_blocks` earlier.
    pub fn estimate(&mut self, entry: TrajectoryEntry, block_ns: u32, delay_blocks: u32) {
        if !matches!(self.stage, Stage::Recording | Stage::Tail) {
            return;
        }
        // At most 5 blocks of 88 µs back.
        let since_start = (block_ns / 2).wrapping_sub(delay_blocks.wrapping_mul(block_ns));
        let centre = self.block_start_ns.wrapping_add(since_start as i32);
        if self.stage == Stage::Tail && i64::from(centre) >= i64::from(self.header.half_cycle_ns) {
            self.complete();
            return;
        }
        let at = usize::from(self.header.trajectory);
        if centre >= 0
            && let Some(slot) = self.trajectory.get_mut(at)
        {
            if at == 0 {
                self.header.first_trajectory_ns = centre;
            }
            *slot = entry;
            self.header.trajectory += 1;
        }
    }

    /// Advances by a block.
    pub fn advance(&mut self, block_ns: u32) {
        // 2 s; a mains that is away for 30 ms ends a window.
        self.block_start_ns = self.block_start_ns.wrapping_add(block_ns as i32);
    }

    /// Completes a window in its tail with the trajectory it has, and drops one in the middle: the estimator restarts (frequency
    /// step, inverter off), or blocks are missing.
    pub fn interrupt(&mut self) {
        match self.stage {
            Stage::Tail => self.complete(),
            Stage::Recording if self.raw => self.end_raw(),
            Stage::Recording => {
                self.stage = Stage::Free;
                self.counters.dropped = self.counters.dropped.wrapping_add(1);
            }
            Stage::Free | Stage::Ready => {}
        }
    }

    fn complete(&mut self) {
        self.stage = Stage::Ready;
        self.counters.recorded = self.counters.recorded.wrapping_add(1);
    }

    /// The complete window, if there is one.
    pub fn ready(&self) -> Option<&WindowHeader> {
        (self.stage == Stage::Ready).then_some(&self.header)
    }

    /// Copies pairs from `offset` on as wire bytes; returns how many pairs fitted.
    pub fn read_pairs(&self, offset: u16, out: &mut [u8]) -> u16 {
        let rest = usize::from(self.header.pairs.saturating_sub(offset));
        let room = rest.min(out.len() / PAIR_BYTES);
        let at = usize::from(self.skipped) + usize::from(offset);
        self.packed.read(at, &mut out[..room * PAIR_BYTES]);
        room as u16
    }

    /// Copies trajectory entries from `offset` on as wire bytes; returns how many entries fitted.
    pub fn read_trajectory(&self, offset: u16, out: &mut [u8]) -> u16 {
        let all = &self.trajectory[..usize::from(self.header.trajectory).min(MAX_TRAJECTORY)];
        let rest = all.get(usize::from(offset)..).unwrap_or(&[]);
        let room = rest.len().min(out.len() / TRAJECTORY_ENTRY_BYTES);
        let (rest, out) = (&rest[..room], &mut out[..room * TRAJECTORY_ENTRY_BYTES]);
        if let Some(slots) = TrajectoryEntry::on_bytes(out) {
            copy(rest, slots);
        } else {
            let (slots, _) = out.as_chunks_mut();
            for (entry, slot) in rest.iter().zip(slots) {
                *slot = entry.to_le_bytes();
            }
        }
        room as u16
    }

    /// Frees the slot after the window was sent.
    pub fn release(&mut self) {
        if self.stage == Stage::Ready {
            self.stage = Stage::Free;
        }
    }

    /// Takes pairs from the next block on, whatever the half-cycle, until the slot is full. [`Recorder::read_pairs`]
    /// reads them meanwhile. Only while the bridge is open, as nothing else is recorded then. False where a window has
    /// the slot.
    pub fn begin_raw(&mut self) -> bool {
        let free = self.stage == Stage::Free;
        if free {
            self.raw = true;
            self.stage = Stage::Recording;
            self.blocks = 0;
            self.header = WindowHeader::default();
        }
        free
    }

    /// Returns `true` while pairs are taken by [`Recorder::begin_raw`].
    pub fn is_raw(&self) -> bool {
        self.raw
    }

    /// Frees the slot if pairs are in it and no window.
    pub fn end_raw(&mut self) {
        if self.raw {
            self.raw = false;
            self.stage = Stage::Free;
        }
    }

    /// Frees the slot: the host that requested the window is gone.
    pub fn abandon(&mut self) {
        self.end_raw();
        if matches!(self.stage, Stage::Recording | Stage::Tail) {
            self.counters.dropped = self.counters.dropped.wrapping_add(1);
        }
        self.stage = Stage::Free;
    }
}

/// Copies, twelve at a time, as much as both have. What the compiler sees to be a copy becomes a call of the library's, of
/// seven cycles a word, and the sampling path stands still meanwhile. `black_box` hides it.
fn copy<T: Copy>(from: &[T], to: &mut [T]) {
    let (twelves, rest) = from.as_chunks::<12>();
    let (room_for_twelves, room) = to.as_chunks_mut::<12>();
    for (twelve, room) in twelves.iter().zip(room_for_twelves) {
        *black_box(room) = *twelve;
    }
    for (one, room) in rest.iter().zip(room) {
        *black_box(room) = *one;
    }
}

const _: () = assert!(MAX_PAIRS <= u16::MAX as usize && ADC_LOCK_P <= u8::MAX as usize);

#[cfg(test)]
mod tests;
