//! The processor's cycle counter (Armv7-M, C1.8.8: DWT_CYCCNT). QEMU's stands still.
//!
//! It belongs to the debug unit, so nothing takes its time from it: load and gaps are measured with it, and program flow
//! compares it with the time of the blocks.

use cortex_m::peripheral::DWT;

/// Starts it, and goes on with it where a debug probe has switched it off on leaving: DEMCR, TRCENA (CMSIS, DebugCoreStop), and
/// DBGMCU_CR, DBG_SLEEP, without which it stands still in WFE (RM0440, "Debug support for low-power modes").
#[cfg(feature = "stm32g474")]
pub fn keep_running() {
    use cortex_m::peripheral::DCB;
    use embassy_stm32::pac::DBGMCU;
    const TRCENA: u32 = 1 << 24;
    const CYCCNTENA: u32 = 1;
    // SAFETY: registers of every Cortex-M4, which nothing else in the program writes; the bits only let it count.
    unsafe {
        let (dcb, dwt) = (&*DCB::PTR, &*DWT::PTR);
        if dcb.demcr.read() & TRCENA == 0 {
            dcb.demcr.modify(|word| word | TRCENA);
        }
        if dwt.ctrl.read() & CYCCNTENA == 0 {
            dwt.ctrl.modify(|word| word | CYCCNTENA);
        }
    }
    if !DBGMCU.cr().read().dbg_sleep() {
        DBGMCU.cr().modify(|w| w.set_dbg_sleep(true));
    }
}

/// Reads the counter.
#[inline(always)]
pub fn now() -> u32 {
    DWT::cycle_count()
}
