//! A recorded window on its way to the host: start, pairs, trajectory, end; then kept for a while, for pieces once more.

use ihd_shared::sampling::{I_FULL_SCALE_MA, V_FULL_SCALE_MV};
use ihd_shared::window::{CHUNK_BYTES, PAIR_BYTES, TRAJECTORY_ENTRY_BYTES};
use ihd_shared::wire::frame::{CRC32, Digest, MAX_ENCODED};
use ihd_shared::wire::messages::{
    Piece, Raw, ResendWindow, TrajectoryChunk, WindowChunk, WindowEnd, WindowGone, WindowStart,
};
use ihd_shared::wire::timing::WINDOW_KEPT_HALF_CYCLES;

use crate::link::frame_writer::FrameWriter;
use crate::sampling::path::SamplingLock;
use crate::sampling::recorder::{Recorder, WindowHeader};

/// Progress of a window that is being sent.
struct Cursor {
    header: WindowHeader,
    stage: Stage,
    digest: Digest,
}

#[derive(Clone, Copy)]
enum Stage {
    Start,
    Pairs(u16),
    Trajectory(u16),
    End,
    /// All of it is sent; the host may request pieces again.
    Sent,
}

/// The window that is being sent, or was.
#[derive(Default)]
pub struct WindowSender {
    cursor: Option<Cursor>,
    /// Half-cycles for which a window that was sent is still kept.
    kept_half_cycles: u8,
}

impl WindowSender {
    /// Forgets the window, of a host that is gone.
    pub fn forget(&mut self, lock: &mut impl SamplingLock) {
        self.cursor = None;
        lock.with(|path| path.recorder().abandon());
    }

    /// Keeps the window as long as after it was sent: the host has requested a piece.
    pub fn keep(&mut self) {
        self.kept_half_cycles = WINDOW_KEPT_HALF_CYCLES;
    }

    /// Releases the window of this number.
    pub fn release(&mut self, seq: u32, lock: &mut impl SamplingLock) {
        if self.cursor.as_ref().is_some_and(|c| c.header.seq == seq) {
            self.free(lock);
        }
    }

    /// Counts a half-cycle: a window that was sent, and that the host is silent about, is not kept for ever.
    pub fn on_half_cycle(&mut self, lock: &mut impl SamplingLock) {
        if !matches!(&self.cursor, Some(cursor) if matches!(cursor.stage, Stage::Sent)) {
            return;
        }
        self.kept_half_cycles = self.kept_half_cycles.saturating_sub(1);
        if self.kept_half_cycles == 0 {
            self.free(lock);
        }
    }

    fn free(&mut self, lock: &mut impl SamplingLock) {
        self.cursor = None;
        lock.with(|path| path.recorder().release());
    }

    /// Writes the next frame of a recorded window; returns its length, 0 if there is none.
    pub fn write(
        &mut self,
        lock: &mut impl SamplingLock,
        frames: &mut FrameWriter,
        out: &mut [u8; MAX_ENCODED],
    ) -> usize {
        if self.cursor.is_none() {
            let header = lock.with(|path| path.recorder().ready().copied());
            self.cursor = header.map(|header| Cursor {
                header,
                stage: Stage::Start,
                digest: CRC32.digest(),
            });
        }
        match self.cursor.take() {
            Some(cursor) => self.write_next(cursor, lock, frames, out),
            None => 0,
        }
    }

    /// Writes the next frame of a window.
    fn write_next(
        &mut self,
        mut cursor: Cursor,
        lock: &mut impl SamplingLock,
        frames: &mut FrameWriter,
        out: &mut [u8; MAX_ENCODED],
    ) -> usize {
        let h = cursor.header;
        cursor.stage = match cursor.stage {
            Stage::Pairs(offset) if offset >= h.pairs => Stage::Trajectory(0),
            stage => stage,
        };
        cursor.stage = match cursor.stage {
            Stage::Trajectory(offset) if offset >= h.trajectory => Stage::End,
            stage => stage,
        };
        let digest = &mut cursor.digest;
        let (length, next) = match cursor.stage {
            Stage::Start => (start(&h, lock, frames, out), Stage::Pairs(0)),
            Stage::Pairs(offset) => {
                let (n, length) = pairs(h.seq, offset, digest, lock, frames, out);
                (length, Stage::Pairs(offset + n.max(1)))
            }
            Stage::Trajectory(offset) => {
                let (n, length) = trajectory(h.seq, offset, digest, lock, frames, out);
                (length, Stage::Trajectory(offset + n.max(1)))
            }
            Stage::End => {
                self.kept_half_cycles = WINDOW_KEPT_HALF_CYCLES;
                (end(&cursor, frames, out), Stage::Sent)
            }
            Stage::Sent => (0, Stage::Sent),
        };
        cursor.stage = next;
        self.cursor = Some(cursor);
        length
    }

    /// Writes a piece once more, or that there is none.
    #[inline(never)]
    pub fn write_piece(
        &mut self,
        m: &ResendWindow,
        lock: &mut impl SamplingLock,
        frames: &mut FrameWriter,
        out: &mut [u8; MAX_ENCODED],
    ) -> usize {
        if let Some(cursor) = self.cursor.take_if(|c| c.header.seq == m.seq) {
            let h = cursor.header;
            let mut digest = CRC32.digest();
            let length = match m.piece {
                Piece::Start => start(&h, lock, frames, out),
                Piece::Pairs if m.offset < h.pairs => {
                    pairs(h.seq, m.offset, &mut digest, lock, frames, out).1
                }
                Piece::Trajectory if m.offset < h.trajectory => {
                    trajectory(h.seq, m.offset, &mut digest, lock, frames, out).1
                }
                Piece::End if matches!(cursor.stage, Stage::Sent) => end(&cursor, frames, out),
                // It comes by itself.
                _ => 0,
            };
            self.cursor = Some(cursor);
            if length > 0 || m.piece == Piece::End {
                return length;
            }
        }
        frames.write(&WindowGone { seq: m.seq }, out)
    }
}

fn start(
    h: &WindowHeader,
    lock: &mut impl SamplingLock,
    frames: &mut FrameWriter,
    out: &mut [u8; MAX_ENCODED],
) -> usize {
    let start = WindowStart {
        seq: h.seq,
        dropped: lock.with(|path| path.recorder().counters().dropped),
        half_cycle: h.half_cycle,
        f_sw_hz: h.f_sw_hz,
        half_cycle_ns: h.half_cycle_ns,
        first_pair_ns: h.first_pair_ns,
        first_trajectory_ns: h.first_trajectory_ns,
        pairs: h.pairs,
        trajectory: h.trajectory,
        saturated: h.saturated,
        lookup_version: h.lookup_version,
        v_full_scale_mv: V_FULL_SCALE_MV,
        i_full_scale_ma: I_FULL_SCALE_MA,
    };
    frames.write(&start, out)
}

/// Writes the pairs from `offset` on, as many as a chunk takes; returns how many, and the frame's length.
#[inline(never)]
fn pairs(
    seq: u32,
    offset: u16,
    digest: &mut Digest,
    lock: &mut impl SamplingLock,
    frames: &mut FrameWriter,
    out: &mut [u8; MAX_ENCODED],
) -> (u16, usize) {
    chunk(
        offset,
        Recorder::read_pairs,
        PAIR_BYTES,
        digest,
        lock,
        |data| frames.write(&WindowChunk { seq, offset, data }, out),
    )
}

/// Writes a chunk of the trajectory, as `pairs` does of the pairs.
#[inline(never)]
fn trajectory(
    seq: u32,
    offset: u16,
    digest: &mut Digest,
    lock: &mut impl SamplingLock,
    frames: &mut FrameWriter,
    out: &mut [u8; MAX_ENCODED],
) -> (u16, usize) {
    let read = Recorder::read_trajectory;
    chunk(offset, read, TRAJECTORY_ENTRY_BYTES, digest, lock, |data| {
        frames.write(&TrajectoryChunk { seq, offset, data }, out)
    })
}

/// Reads a chunk of entries of so many bytes and writes its frame; returns the number of entries and the frame's length.
#[inline(always)]
fn chunk(
    offset: u16,
    read: impl Fn(&Recorder, u16, &mut [u8]) -> u16,
    entry_bytes: usize,
    digest: &mut Digest,
    lock: &mut impl SamplingLock,
    write: impl FnOnce(Raw<'_>) -> usize,
) -> (u16, usize) {
    let mut raw = [0; CHUNK_BYTES];
    let n = read_in_parts(&mut raw, offset, lock, read);
    let data = &raw[..usize::from(n) * entry_bytes];
    digest.update(data);
    (n, write(Raw(data)))
}

/// Bytes that are read under one lock.
pub(super) const READ_BYTES: usize = CHUNK_BYTES / 8;
const _: () = assert!(
    CHUNK_BYTES.is_multiple_of(READ_BYTES)
        && READ_BYTES.is_multiple_of(PAIR_BYTES)
        && READ_BYTES.is_multiple_of(TRAJECTORY_ENTRY_BYTES)
);

/// Reads a chunk in eight parts, each under the lock by itself, so that a block waits for one part at most. The window stays as it
/// is meanwhile: only its sender releases it.
#[inline(always)]
fn read_in_parts(
    raw: &mut [u8; CHUNK_BYTES],
    offset: u16,
    lock: &mut impl SamplingLock,
    read: impl Fn(&Recorder, u16, &mut [u8]) -> u16,
) -> u16 {
    let parts = raw.chunks_exact_mut(READ_BYTES);
    parts.fold(0, |n, part| {
        n + lock.with(|path| read(path.recorder(), offset + n, part))
    })
}

fn end(cursor: &Cursor, frames: &mut FrameWriter, out: &mut [u8; MAX_ENCODED]) -> usize {
    let end = WindowEnd {
        seq: cursor.header.seq,
        crc32: cursor.digest.clone().finalize(),
    };
    frames.write(&end, out)
}
