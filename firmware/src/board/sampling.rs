//! The sampling path's owner: one task on the interrupt executor, and the thread's claim on it.

#![cfg_attr(
    feature = "instruction-counts",
    expect(dead_code, reason = "counts what the task does, without the task")
)]

use core::cell::UnsafeCell;
use core::future::Future;
use core::pin::Pin;
use core::sync::atomic::{AtomicBool, Ordering};
use core::task::{Context, Poll};

use embassy_executor::raw::{task_from_waker, wake_task_no_pend};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use ihd_firmware::drive::bridge::Drive;
use ihd_firmware::sampling::path::{AdcBlock, SamplingLock, SamplingPath};
use ihd_shared::units::{MicroOhm, PicoHenry};

use super::cycles;
use super::dsp::DspArithmetic;

/// The one sampling path. Its window alone is 50 KiB, so it is never moved.
struct PathCell(UnsafeCell<SamplingPath<DspArithmetic>>);

// SAFETY: reached only through `InterruptSide` and `ThreadSide`, of which `split` makes one each.
// The former runs at an interrupt's priority and is never preempted by the latter; the latter masks
// interrupts for as long as it holds its reference.
unsafe impl Sync for PathCell {}

static PLACE: PathCell = PathCell(UnsafeCell::new(SamplingPath::blank()));
static TAKEN: AtomicBool = AtomicBool::new(false);

/// Set after each block, for the link task: faults, summaries and windows may be there.
pub static BLOCK_DONE: Signal<CriticalSectionRawMutex, ()> = Signal::new();

/// The sampling task's hold on the path.
pub struct InterruptSide(());

/// The thread's hold on the path.
pub struct ThreadSide(());

/// Builds the sampling path with the load it expects. `None` the second time.
pub fn split(r: MicroOhm, l: PicoHenry) -> Option<(InterruptSide, ThreadSide)> {
    if TAKEN.swap(true, Ordering::AcqRel) {
        return None;
    }
    // SAFETY: the flag lets one caller through, before either side exists; nothing else has a
    // reference.
    unsafe { (*PLACE.0.get()).begin(r, l) };
    Some((InterruptSide(()), ThreadSide(())))
}

impl InterruptSide {
    /// Takes one block; returns the drive for the bridge.
    #[inline(always)]
    fn on_block(&mut self, block: &AdcBlock<'_>) -> Drive {
        // SAFETY: begun by `split`, which made this side. The thread's side masks interrupts
        // while it holds its reference, and the task that owns this side is no thread.
        let sampling_path = unsafe { &mut *PLACE.0.get() };
        sampling_path.on_block(block)
    }

    /// Counts the cycles that a block took, without the interrupt's entry and exit, some 30.
    #[inline(always)]
    fn note_busy(&mut self, busy_cycles: u32, block_cycles: u32) {
        if block_cycles == 0 {
            return;
        }
        // SAFETY: as in `on_block`.
        let sampling_path = unsafe { &mut *PLACE.0.get() };
        sampling_path.utilisation().add(busy_cycles, block_cycles);
    }
}

impl SamplingLock for ThreadSide {
    type Arithmetic = DspArithmetic;

    fn with<R>(&mut self, f: impl FnOnce(&mut SamplingPath<DspArithmetic>) -> R) -> R {
        critical_section::with(|_| {
            // SAFETY: begun by `split`. Interrupts are masked, so the other side does not
            // run; `&mut self` keeps `f` from coming back here.
            f(unsafe { &mut *PLACE.0.get() })
        })
    }
}

/// Source of blocks, and sink of the drive.
pub trait SampleSource: Unpin {
    /// Hands the oldest block that was not handed out yet to `take`, and its answer to the bridge.
    /// Returns whether there was one.
    fn next(&mut self, take: impl FnOnce(&AdcBlock<'_>) -> Drive) -> bool;

    /// Cycles of the processor from one block to the next; 0 where they are not counted.
    fn block_cycles(&self) -> u32;
}

/// The sampling task: runs each time that its executor's interrupt comes, which is the sample
/// source's own; there is no second entry. Written out, because an `async fn` carries a panic for
/// being polled after its end.
pub struct SamplingTask<S> {
    source: S,
    path: InterruptSide,
}

impl<S: SampleSource> SamplingTask<S> {
    /// A task that moves blocks from `source` into the path.
    pub fn new(source: S, path: InterruptSide) -> Self {
        Self { source, path }
    }
}

impl<S: SampleSource> Future for SamplingTask<S> {
    type Output = ();

    /// Inlined into the executor's part of the task, where the waker's kind is known: the check for
    /// it, and its panic, are left out.
    #[inline(always)]
    fn poll(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<()> {
        let this = self.get_mut();
        // Ready at once for the next interrupt. A waker would ask for that interrupt as well, and as
        // this runs in it, for ever: embassy-executor 0.10 pends the executor's own (NVIC, STIR).
        wake_task_no_pend(task_from_waker(cx.waker()));
        let path = &mut this.path;
        let mut begun = cycles::now();
        loop {
            // Before the answer: the block in which this runs is still of the old frequency.
            let block_cycles = this.source.block_cycles();
            if !this.source.next(|block| path.on_block(block)) {
                break;
            }
            BLOCK_DONE.signal(());
            let ended = cycles::now();
            path.note_busy(ended.wrapping_sub(begun), block_cycles);
            begun = ended;
        }
        Poll::Pending
    }
}
