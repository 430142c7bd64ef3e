//! How busy the processor is, by its cycle counter (Armv7-M, C1.8.8: DWT_CYCCNT). QEMU's stands still: all is 0.

#![cfg_attr(
    any(feature = "mps2-an386", feature = "instruction-counts"),
    expect(dead_code, reason = "without a cycle counter there is nothing to tell")
)]

use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::DWT;

/// Blocks, the cycles they took, and what the longest took. Written in the sampling interrupt alone; the
/// thread takes them by exchange, which that interrupt makes it repeat.
static BLOCKS: AtomicU32 = AtomicU32::new(0);
static BUSY: AtomicU32 = AtomicU32::new(0);
static WORST: AtomicU32 = AtomicU32::new(0);
/// Longest time between two feedings of the watchdog, in cycles.
static LONGEST_GAP: AtomicU32 = AtomicU32::new(0);

/// What [`load`] tells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Load {
    /// Blocks since it was asked last.
    pub blocks: u32,
    /// Cycles that these took together; wraps after 25 s at 170 MHz.
    pub busy_cycles: u32,
    /// Cycles of the one that took longest.
    pub worst_cycles: u32,
    /// Cycles between the two feedings of the watchdog that were furthest apart.
    pub longest_feed_gap_cycles: u32,
}

/// Starts the counter.
pub fn start(mut core: cortex_m::Peripherals) {
    core.DCB.enable_trace();
    core.DWT.enable_cycle_counter();
}

/// The counter.
#[inline(always)]
pub fn now() -> u32 {
    DWT::cycle_count()
}

/// Counts a block that was begun then; returns when it ended. Without the interrupt's entry and exit, some
/// 30 cycles.
#[inline(always)]
pub fn block_done(begun: u32) -> u32 {
    let now = now();
    let took = now.wrapping_sub(begun);
    add(&BLOCKS, 1);
    add(&BUSY, took);
    raise(&WORST, took);
    now
}

/// Counts a feeding of the watchdog after the last one then; returns when.
pub fn fed(last: u32) -> u32 {
    let now = now();
    raise(&LONGEST_GAP, now.wrapping_sub(last));
    now
}

/// Since it was asked last, which it is at least every 20 s.
pub fn load() -> Load {
    Load {
        blocks: BLOCKS.swap(0, Ordering::Relaxed),
        busy_cycles: BUSY.swap(0, Ordering::Relaxed),
        worst_cycles: WORST.swap(0, Ordering::Relaxed),
        longest_feed_gap_cycles: LONGEST_GAP.swap(0, Ordering::Relaxed),
    }
}

/// For the one writer that nobody interrupts who writes it too: no exclusive access is needed.
#[inline(always)]
fn add(to: &AtomicU32, what: u32) {
    to.store(
        to.load(Ordering::Relaxed).wrapping_add(what),
        Ordering::Relaxed,
    );
}

#[inline(always)]
fn raise(highest: &AtomicU32, to: u32) {
    if to > highest.load(Ordering::Relaxed) {
        highest.store(to, Ordering::Relaxed);
    }
}
