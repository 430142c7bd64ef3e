//! The processor's cycle counter (Armv7-M, C1.8.8: DWT_CYCCNT). QEMU's stands still.

use cortex_m::peripheral::DWT;

/// Starts it.
#[cfg(feature = "stm32g474")]
pub fn start(mut core: cortex_m::Peripherals) {
    core.DCB.enable_trace();
    core.DWT.enable_cycle_counter();
}

/// Reads the counter.
#[inline(always)]
pub fn now() -> u32 {
    DWT::cycle_count()
}
