//! The transmit queue, the link's outgoing side: what waits, in which order it leaves, and what is
//! counted.
//!
//! Nothing waits for the link. Answers go first, then faults, telemetry, the log, windows and the bytes of a test of the
//! link. The log before windows: its frames are rare and short, and on a slow link a stream of windows would never let it
//! pass; a flood of it is dropped where it is kept ([`LogSource`]), not here. Telemetry and
//! windows take their sequence number before they look for room, so that what is dropped shows as
//! a gap at the host. A window that was sent stays for a while, for a host that asks for pieces again.

use heapless::Deque;
use ihd_shared::lookup::RlLookup;
use ihd_shared::sampling::{CODE_BITS, I_FULL_SCALE_MA, V_FULL_SCALE_MV};
use ihd_shared::window::{CHUNK_BYTES, PAIR_BYTES, TRAJECTORY_ENTRY_BYTES};
use ihd_shared::wire::frame::{CRC32, Digest, MAX_ENCODED, encode_numbered};
use ihd_shared::wire::link_test::fill;
use ihd_shared::wire::messages::{
    Board, Channels, Clocks, Comparators, FaultEvent, FrontEnd, Hello, LinkData, LinkTested, Log,
    LookupBlob, Message, Piece, Raw, ReplayMode, Reply, ResendWindow, Status, Telemetry,
    TrajectoryChunk, Utilisation, WindowChunk, WindowEnd, WindowGone, WindowStart,
};
use ihd_shared::wire::number::Number;
use ihd_shared::wire::timing::WINDOW_KEPT_HALF_CYCLES;

use crate::log_ring::LogSource;
use crate::mains::{BUS_DV_FULL_SCALE, MAINS_FULL_SCALE_MV};
use crate::realtime::Access;
use crate::recorder::Header;
use crate::replay::Estimates;
use crate::service::Identity;

/// Answers that may wait for the link. When they are all taken, no more bytes are accepted.
const ANSWERS: usize = 8;

/// Telemetry messages that may wait.
const TELEMETRY: usize = 4;

/// Bytes of log in one message: all that is kept, as a frame of it is sent whole.
pub const LOG_BYTES: usize = 512;

/// An answer that waits, or what is as urgent.
#[derive(Clone)]
pub enum Answer {
    /// The device's hello.
    Hello,
    /// Scales of the channels' codes.
    FrontEnd,
    /// Outcome of a command.
    Reply(Reply),
    /// The status of the moment it was asked for.
    Status(Status),
    /// Load of the controller.
    Utilisation(Utilisation),
    /// The lookup that is active when the answer leaves.
    Lookup,
    /// A fault tripped or was cleared.
    Fault(FaultEvent),
    /// Replay mode was entered, left, or is missing.
    ReplayMode(ReplayMode),
    /// Estimates from replayed blocks.
    ReplayEstimates(Estimates),
    /// A piece of a window once more.
    Piece(ResendWindow),
    /// Identity of the device.
    Board,
    /// Means and deviations of the measuring channels.
    Channels(Channels),
    /// Outcome of a test of the trip in hardware.
    Comparators(Comparators),
    /// The clocks against each other.
    Clocks(Clocks),
    /// Outcome of a test of the link.
    LinkTested(LinkTested),
}

/// Bytes of a test of the link that are still to be sent.
#[derive(Clone, Copy, Default)]
struct TestData {
    seq: u32,
    frames: u16,
    bytes: u16,
}

/// Scales of the codes of this firmware's channels.
pub fn front_end() -> FrontEnd {
    FrontEnd {
        v_full_scale_mv: V_FULL_SCALE_MV,
        i_full_scale_ma: I_FULL_SCALE_MA,
        bus_full_scale_mv: BUS_DV_FULL_SCALE * 100,
        mains_full_scale_mv: MAINS_FULL_SCALE_MV,
        bits: CODE_BITS,
    }
}

/// Progress of a window that is being sent.
struct Cursor {
    header: Header,
    stage: Stage,
    digest: Digest,
}

#[derive(Clone, Copy)]
enum Stage {
    Start,
    Pairs(u16),
    Trajectory(u16),
    End,
    /// All of it is sent; the host may ask for pieces again.
    Sent,
}

/// Queues and counters of the outgoing side.
pub struct TransmitQueue {
    hello: Hello,
    frame_seq: u16,
    answers: Deque<(Number, Answer), ANSWERS>,
    telemetry: Deque<Telemetry, TELEMETRY>,
    telemetry_due: u32,
    telemetry_dropped: u32,
    cursor: Option<Cursor>,
    /// Half-cycles for which a window that was sent is still kept.
    kept_half_cycles: u8,
    identity: Identity,
    log: Option<&'static dyn LogSource>,
    log_on: bool,
    /// Bytes of log that were sent.
    log_sent: u32,
    test_data: TestData,
}

impl TransmitQueue {
    /// Nothing queued.
    pub fn new(hello: Hello) -> Self {
        Self {
            hello,
            frame_seq: 0,
            answers: Deque::new(),
            telemetry: Deque::new(),
            telemetry_due: 0,
            telemetry_dropped: 0,
            cursor: None,
            kept_half_cycles: 0,
            identity: Identity::default(),
            log: None,
            log_on: false,
            log_sent: 0,
            test_data: TestData::default(),
        }
    }

    /// Our hello.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// Sets the identity of the device.
    pub fn set_identity(&mut self, identity: Identity) {
        self.identity = identity;
    }

    /// Sets the place where the log is kept until it is sent.
    pub fn set_log(&mut self, log: &'static dyn LogSource) {
        self.log = Some(log);
    }

    /// Sends the log from now on, or no more; false where there is none.
    pub fn stream_log(&mut self, on: bool) -> bool {
        self.log_on = on && self.log.is_some();
        self.log.is_some()
    }

    /// Sends so many frames of a test of the link, in place of those that were left of another.
    pub fn send_link_data(&mut self, frames: u16, bytes: u16) {
        self.test_data = TestData {
            seq: 0,
            frames,
            bytes,
        };
    }

    /// Sets or clears one of the hello's capabilities.
    pub fn set_capability(&mut self, bit: u32, on: bool) {
        if on {
            self.hello.capabilities |= bit;
        } else {
            self.hello.capabilities &= !bit;
        }
    }

    /// Returns `true` if another answer would find no room.
    pub fn is_full(&self) -> bool {
        self.answers.is_full()
    }

    /// Queues an answer to the request of this number; callers keep [`TransmitQueue::is_full`] false first.
    pub fn answer(&mut self, number: Number, answer: Answer) {
        let _ = self.answers.push_back((number, answer));
    }

    /// Queues a message that answers no request.
    pub fn tell(&mut self, answer: Answer) {
        self.answer(Number::NONE, answer);
    }

    /// Telemetry is due: takes a number, then looks for room. `fill` gets number and drop count.
    pub fn telemetry(&mut self, fill: impl FnOnce(u32, u32) -> Telemetry) {
        let seq = self.telemetry_due;
        self.telemetry_due = seq.wrapping_add(1);
        if self.telemetry.is_full() {
            self.telemetry_dropped = self.telemetry_dropped.wrapping_add(1);
            return;
        }
        let _ = self.telemetry.push_back(fill(seq, self.telemetry_dropped));
    }

    /// Telemetry messages that found their queue full.
    pub fn telemetry_dropped(&self) -> u32 {
        self.telemetry_dropped
    }

    /// Forgets everything queued for a host that is gone.
    pub fn restart(&mut self, access: &mut impl Access) {
        self.answers.clear();
        self.telemetry.clear();
        self.cursor = None;
        self.log_on = false;
        self.test_data = TestData::default();
        access.with(|rt| rt.recorder().abandon());
    }

    /// The host asks for a piece of a window, or lets go of it.
    pub fn resend(&mut self, access: &mut impl Access, m: ResendWindow) {
        if m.piece != Piece::Nothing {
            self.kept_half_cycles = WINDOW_KEPT_HALF_CYCLES;
            self.tell(Answer::Piece(m));
        } else if self.cursor.as_ref().is_some_and(|c| c.header.seq == m.seq) {
            self.let_go(access);
        }
    }

    /// A half-cycle is over: a window that was sent, and that the host says nothing of, is not kept for ever.
    pub fn half_cycle(&mut self, access: &mut impl Access) {
        if !matches!(&self.cursor, Some(cursor) if matches!(cursor.stage, Stage::Sent)) {
            return;
        }
        self.kept_half_cycles = self.kept_half_cycles.saturating_sub(1);
        if self.kept_half_cycles == 0 {
            self.let_go(access);
        }
    }

    fn let_go(&mut self, access: &mut impl Access) {
        self.cursor = None;
        access.with(|rt| rt.recorder().release());
    }

    /// Writes the next frame, if there is one; returns its length, 0 for none.
    pub fn transmit(
        &mut self,
        access: &mut impl Access,
        lookup: &RlLookup,
        out: &mut [u8; MAX_ENCODED],
    ) -> usize {
        if let Some((number, answer)) = self.answers.pop_front() {
            return match answer {
                Answer::Hello => {
                    let hello = self.hello.clone();
                    self.frame(&hello, out)
                }
                Answer::FrontEnd => self.numbered(&front_end(), number, out),
                Answer::Reply(m) => self.numbered(&m, number, out),
                Answer::Status(m) => self.numbered(&m, number, out),
                Answer::Utilisation(m) => self.numbered(&m, number, out),
                Answer::Lookup => {
                    let blob = lookup.to_bytes();
                    self.numbered(&LookupBlob { blob: Raw(&blob) }, number, out)
                }
                Answer::Fault(m) => self.frame(&m, out),
                Answer::ReplayMode(m) => self.numbered(&m, number, out),
                Answer::ReplayEstimates(estimates) => {
                    let mut raw = [0; Estimates::BYTES];
                    self.numbered(&estimates.message(&mut raw), number, out)
                }
                Answer::Piece(m) => self.piece(&m, access, out),
                Answer::Board => self.board(number, out),
                Answer::Channels(m) => self.numbered(&m, number, out),
                Answer::Comparators(m) => self.numbered(&m, number, out),
                Answer::Clocks(m) => self.numbered(&m, number, out),
                Answer::LinkTested(m) => self.numbered(&m, number, out),
            };
        }
        if let Some(telemetry) = self.telemetry.pop_front() {
            return self.frame(&telemetry, out);
        }
        if let Some(length) = self.logged(out) {
            return length;
        }
        if self.cursor.is_none() {
            let header = access.with(|rt| rt.recorder().ready().copied());
            self.cursor = header.map(|header| Cursor {
                header,
                stage: Stage::Start,
                digest: CRC32.digest(),
            });
        }
        let length = match self.cursor.take() {
            Some(cursor) => self.window_frame(cursor, access, out),
            None => 0,
        };
        match length {
            0 => self.link_data(out),
            length => length,
        }
    }

    fn board(&mut self, number: Number, out: &mut [u8; MAX_ENCODED]) -> usize {
        let id = self.identity;
        let message = Board {
            id_code: id.id_code,
            flash_kib: id.flash_kib,
            option_bytes: id.option_bytes,
            reset_flags: id.reset_flags,
            starts: id.starts,
            image_bytes: id.image_bytes,
            image_crc: id.image_crc,
            sealed_crc: id.sealed_crc,
            build_id: Raw(id.build_id.as_ref().map_or(&[], |id| id.as_slice())),
            chip: Raw(id.chip.as_ref().map_or(&[], |id| id.as_slice())),
        };
        self.numbered(&message, number, out)
    }

    /// The oldest of the log that was not sent, if the host wants it and there is any.
    #[inline(never)]
    fn logged(&mut self, out: &mut [u8; MAX_ENCODED]) -> Option<usize> {
        let log = self.log.filter(|_| self.log_on)?;
        let mut raw = [0; LOG_BYTES];
        let length = log.take(&mut raw);
        let data = raw.get(..length).filter(|data| !data.is_empty())?;
        let seq = self.log_sent;
        self.log_sent = seq.wrapping_add(length as u32);
        let (dropped, data) = (log.dropped(), Raw(data));
        Some(self.frame(&Log { seq, dropped, data }, out))
    }

    /// The next frame of a test of the link.
    #[inline(never)]
    fn link_data(&mut self, out: &mut [u8; MAX_ENCODED]) -> usize {
        if self.test_data.frames == 0 {
            return 0;
        }
        self.test_data.frames -= 1;
        let seq = self.test_data.seq;
        self.test_data.seq = seq.wrapping_add(1);
        let mut raw = [0; CHUNK_BYTES];
        let length = usize::from(self.test_data.bytes).min(CHUNK_BYTES);
        let data = &mut raw[..length];
        fill(seq, data);
        let data = Raw(data);
        self.frame(&LinkData { seq, data }, out)
    }

    fn window_frame(
        &mut self,
        mut cursor: Cursor,
        access: &mut impl Access,
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
            Stage::Start => (self.start(&h, access, out), Stage::Pairs(0)),
            Stage::Pairs(offset) => {
                let (n, length) = self.pairs(h.seq, offset, digest, access, out);
                (length, Stage::Pairs(offset + n.max(1)))
            }
            Stage::Trajectory(offset) => {
                let (n, length) = self.trajectory(h.seq, offset, digest, access, out);
                (length, Stage::Trajectory(offset + n.max(1)))
            }
            Stage::End => {
                self.kept_half_cycles = WINDOW_KEPT_HALF_CYCLES;
                (self.end(&cursor, out), Stage::Sent)
            }
            Stage::Sent => (0, Stage::Sent),
        };
        cursor.stage = next;
        self.cursor = Some(cursor);
        length
    }

    /// A piece once more, or the news that there is none.
    #[inline(never)]
    fn piece(
        &mut self,
        m: &ResendWindow,
        access: &mut impl Access,
        out: &mut [u8; MAX_ENCODED],
    ) -> usize {
        if let Some(cursor) = self.cursor.take_if(|c| c.header.seq == m.seq) {
            let h = cursor.header;
            let mut digest = CRC32.digest();
            let length = match m.piece {
                Piece::Start => self.start(&h, access, out),
                Piece::Pairs if m.offset < h.pairs => {
                    self.pairs(h.seq, m.offset, &mut digest, access, out).1
                }
                Piece::Trajectory if m.offset < h.trajectory => {
                    self.trajectory(h.seq, m.offset, &mut digest, access, out).1
                }
                Piece::End if matches!(cursor.stage, Stage::Sent) => self.end(&cursor, out),
                // It comes by itself.
                _ => 0,
            };
            self.cursor = Some(cursor);
            if length > 0 || m.piece == Piece::End {
                return length;
            }
        }
        self.frame(&WindowGone { seq: m.seq }, out)
    }

    fn start(
        &mut self,
        h: &Header,
        access: &mut impl Access,
        out: &mut [u8; MAX_ENCODED],
    ) -> usize {
        let start = WindowStart {
            seq: h.seq,
            dropped: access.with(|rt| rt.recorder().counters().dropped),
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
        self.frame(&start, out)
    }

    /// The pairs from `offset` on, as many as a chunk takes; how many, and the frame's length.
    #[inline(never)]
    fn pairs(
        &mut self,
        seq: u32,
        offset: u16,
        digest: &mut Digest,
        access: &mut impl Access,
        out: &mut [u8; MAX_ENCODED],
    ) -> (u16, usize) {
        let mut raw = [0; CHUNK_BYTES];
        let n = access.with(|rt| rt.recorder().read_pairs(offset, &mut raw));
        let data = &raw[..usize::from(n) * PAIR_BYTES];
        digest.update(data);
        let data = Raw(data);
        let chunk = WindowChunk { seq, offset, data };
        (n, self.frame(&chunk, out))
    }

    /// Does for the trajectory the same as [`TransmitQueue::pairs`].
    #[inline(never)]
    fn trajectory(
        &mut self,
        seq: u32,
        offset: u16,
        digest: &mut Digest,
        access: &mut impl Access,
        out: &mut [u8; MAX_ENCODED],
    ) -> (u16, usize) {
        let mut raw = [0; CHUNK_BYTES];
        let n = access.with(|rt| rt.recorder().read_trajectory(offset, &mut raw));
        let data = &raw[..usize::from(n) * TRAJECTORY_ENTRY_BYTES];
        digest.update(data);
        let data = Raw(data);
        let chunk = TrajectoryChunk { seq, offset, data };
        (n, self.frame(&chunk, out))
    }

    fn end(&mut self, cursor: &Cursor, out: &mut [u8; MAX_ENCODED]) -> usize {
        let end = WindowEnd {
            seq: cursor.header.seq,
            crc32: cursor.digest.clone().finalize(),
        };
        self.frame(&end, out)
    }

    /// A frame of a message that has no number.
    fn frame<M: Message>(&mut self, message: &M, out: &mut [u8; MAX_ENCODED]) -> usize {
        self.numbered(message, Number::NONE, out)
    }

    fn numbered<M: Message>(
        &mut self,
        message: &M,
        number: Number,
        out: &mut [u8; MAX_ENCODED],
    ) -> usize {
        let seq = self.frame_seq;
        self.frame_seq = seq.wrapping_add(1);
        // Every message of the table fits; a test in `tests/` encodes the longest of each.
        encode_numbered(message, number, seq, out).unwrap_or(0)
    }
}
