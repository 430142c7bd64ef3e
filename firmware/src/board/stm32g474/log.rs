//! defmt's logger: each frame goes into two rings of whole frames, one for a debug probe (RTT), one for the link.
//!
//! Never waits: a frame that finds a ring full, or another one being written, is dropped and counted. The sampling
//! path does not log, and nothing here masks an interrupt.
//!
//! The control block is laid out as SEGGER's RTT describes it, and as defmt-rtt had it: one channel up, called "defmt". A
//! probe that sets it to block is not obeyed.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};

use ihd_firmware::link::log_ring::{LinkLog, LogRing, RingFrame};
use ihd_firmware::link::log_sender::LOG_BYTES;

/// Bytes for the probe: half of what defmt-rtt takes, the other half is the link's.
const RTT_BYTES: usize = 512;

/// Layout of a channel in memory, by which RTT's readers find it.
#[repr(C)]
struct Channel {
    name: *const u8,
    bytes: *const AtomicU8,
    size: u32,
    write: AtomicU32,
    read: AtomicU32,
    mode: AtomicU32,
}

#[repr(C)]
struct ControlBlock {
    id: [u8; 16],
    channels_up: u32,
    channels_down: u32,
    up: Channel,
}

// SAFETY: the pointers are to statics, and are read by a debug probe alone; all else is atomic.
unsafe impl Sync for ControlBlock {}

/// Mode "skip": a frame that does not fit is left out whole.
const MODE_SKIP: u32 = 0;

/// In RAM, where a probe reads it while the flash is busy.
#[unsafe(link_section = ".data.rtt_name")]
static NAME: [u8; 6] = *b"defmt\0";

static RTT: [AtomicU8; RTT_BYTES] = [const { AtomicU8::new(0) }; RTT_BYTES];

#[unsafe(no_mangle)]
#[unsafe(link_section = ".data.rtt")]
static _SEGGER_RTT: ControlBlock = ControlBlock {
    id: *b"SEGGER RTT\0\0\0\0\0\0",
    channels_up: 1,
    channels_down: 0,
    up: Channel {
        name: NAME.as_ptr(),
        bytes: RTT.as_ptr(),
        size: RTT_BYTES as u32,
        write: AtomicU32::new(0),
        read: AtomicU32::new(0),
        mode: AtomicU32::new(MODE_SKIP),
    },
};

/// Ring of the log for the link; one byte stays free.
static LINK: [AtomicU8; LOG_BYTES] = [const { AtomicU8::new(0) }; LOG_BYTES];
static LINK_WRITE: AtomicU32 = AtomicU32::new(0);
static LINK_READ: AtomicU32 = AtomicU32::new(0);
static LINK_DROPPED: AtomicU32 = AtomicU32::new(0);

fn rtt() -> LogRing<'static> {
    LogRing {
        bytes: &RTT,
        write: &_SEGGER_RTT.up.write,
        read: &_SEGGER_RTT.up.read,
    }
}

/// The link's end of the log.
pub static LINK_LOG: LinkLog = LinkLog {
    ring: LogRing {
        bytes: &LINK,
        write: &LINK_WRITE,
        read: &LINK_READ,
    },
    dropped: &LINK_DROPPED,
};

/// A frame on its way into both.
struct FrameInProgress {
    encoder: defmt::Encoder,
    rtt: RingFrame,
    link: RingFrame,
}

/// Reached only while [`TAKEN`] is held.
struct FrameCell(UnsafeCell<FrameInProgress>);

// SAFETY: one processor; `TAKEN` lets one context in at a time, and another that finds it taken stays out.
unsafe impl Sync for FrameCell {}

static TAKEN: AtomicBool = AtomicBool::new(false);
static WRITING: FrameCell = FrameCell(UnsafeCell::new(FrameInProgress {
    encoder: defmt::Encoder::new(),
    rtt: RingFrame::NONE,
    link: RingFrame::NONE,
}));
/// Contexts that found it taken and whose frame is being thrown away: an interrupt within an interrupt at most.
static STRANGERS: AtomicU32 = AtomicU32::new(0);

fn drop_one() {
    LINK_DROPPED.store(
        LINK_DROPPED.load(Ordering::Relaxed).wrapping_add(1),
        Ordering::Relaxed,
    );
}

impl FrameInProgress {
    fn start(&mut self) {
        (self.rtt, self.link) = (rtt().begin(), LINK_LOG.ring.begin());
        let Self { encoder, rtt, link } = self;
        encoder.start_frame(|bytes| add(rtt, link, bytes));
    }

    fn write(&mut self, bytes: &[u8]) {
        let Self { encoder, rtt, link } = self;
        encoder.write(bytes, |bytes| add(rtt, link, bytes));
    }

    fn end(&mut self) {
        let Self {
            encoder,
            rtt: probe,
            link: host,
        } = self;
        encoder.end_frame(|bytes| add(probe, host, bytes));
        rtt().end(*probe);
        if !LINK_LOG.ring.end(*host) {
            drop_one();
        }
    }
}

fn add(probe: &mut RingFrame, host: &mut RingFrame, bytes: &[u8]) {
    rtt().add(probe, bytes);
    LINK_LOG.ring.add(host, bytes);
}

/// Runs `f` on the frame that this context writes; not where it met another's.
fn writing(f: impl FnOnce(&mut FrameInProgress)) {
    if STRANGERS.load(Ordering::Relaxed) == 0 {
        // SAFETY: this context took `TAKEN` in `acquire`. One that interrupts it finds that taken, counts itself a
        // stranger until it is done, and comes by here without entering.
        f(unsafe { &mut *WRITING.0.get() });
    }
}

#[defmt::global_logger]
struct Logger;

// SAFETY: `acquire` lets one context in; defmt calls `write` and `release` between it and the next `acquire` of the same
// context.
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        if TAKEN.swap(true, Ordering::Acquire) {
            // Before the context that holds it goes on, this one is done.
            STRANGERS.store(STRANGERS.load(Ordering::Relaxed) + 1, Ordering::Relaxed);
            drop_one();
        } else {
            writing(FrameInProgress::start);
        }
    }

    unsafe fn flush() {}

    unsafe fn release() {
        let strangers = STRANGERS.load(Ordering::Relaxed);
        if strangers > 0 {
            STRANGERS.store(strangers - 1, Ordering::Relaxed);
        } else {
            writing(FrameInProgress::end);
            TAKEN.store(false, Ordering::Release);
        }
    }

    unsafe fn write(bytes: &[u8]) {
        writing(|frame| frame.write(bytes));
    }
}
