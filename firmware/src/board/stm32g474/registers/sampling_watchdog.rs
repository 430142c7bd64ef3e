//! The sampling watchdog: hardware opens the bridge 0.5 ms after the last block, whatever has stopped.
//!
//! ```text
//! block taken ─► feed: TIM2 from 0     TIM2 ≥ 0.5 ms ─► OC1REF ─► TRGO ─► HRTIM external event 2 ─► fault input 2 ─► outputs off
//! ```
//!
//! No pin, interrupt or DMA lies in between. TIM2 counts on while a debugger halts the processor (DBGMCU, DBG_TIM2_STOP = 0),
//! so that the halt, which opens the bridge ([`faults::start`]), is reported.
//! The independent watchdog needs 58 ms for the same, as it waits for the thread.

use embassy_stm32::pac;
use embassy_stm32::pac::timer::vals::{Mms, Ocm};
use embassy_stm32::{peripherals, rcc};
use ihd_firmware::limits::SAMPLING_WATCHDOG_US;

use super::clocks::CORE_MHZ;
use super::faults;

const LIMIT_CYCLES: u32 = SAMPLING_WATCHDOG_US * CORE_MHZ;

/// HRTIM_EECR1, EE2SRC: TIM2_TRGO (HRTIM, table "External events mapping"; ST's `HRTIM1_EEV2SRC_TIM2_TRGO`).
const EVENT_2: usize = 1;
const TIM2_TRGO: u8 = 2;

/// TIM, "PWM mode": in PWM mode 2 OC1REF is active from CCR1 on; TIM2_CR2, MMS: it is the trigger output. TIM2's clock is that
/// of APB1, which is not divided. HRTIM's side is in [`faults`].
pub fn start() {
    rcc::enable_and_reset::<peripherals::TIM2>();
    // DBGMCU outlasts every reset but power-on, with what a debugger left in it.
    pac::DBGMCU.apb1lfzr().modify(|w| w.set_tim2(false));
    let timer = pac::TIM2;
    timer.ccmr_output(0).write(|w| w.set_ocm(0, Ocm::PWM_MODE2));
    timer.ccr(0).write_value(LIMIT_CYCLES);
    timer.cr2().write(|w| w.set_mms(Mms::COMPARE_OC1));
    timer.cr1().write(|w| w.set_cen(true));
    // Level, active high: both 0.
    pac::HRTIM1
        .eecr1()
        .modify(|w| w.set_eesrc(EVENT_2, TIM2_TRGO));
}

/// TIM2_EGR, UG: the counter begins anew. After each block that was taken, and nowhere else.
#[inline(always)]
pub fn feed() {
    pac::TIM2.egr().write(|w| w.set_ug(true));
}

/// Returns `true` if it bites when it is not fed, and lets go when it is. The bridge is open and stays so. Interrupts are
/// masked for 5 µs, as each block feeds.
pub fn is_sound() -> bool {
    critical_section::with(|_| {
        feed();
        faults::clear();
        cortex_m::asm::delay(CORE_MHZ);
        let quiet = !faults::is_sampling_stopped();
        pac::TIM2.cnt().write_value(LIMIT_CYCLES - CORE_MHZ);
        cortex_m::asm::delay(2 * CORE_MHZ);
        let bites = faults::is_sampling_stopped();
        feed();
        cortex_m::asm::delay(CORE_MHZ);
        faults::clear();
        let lets_go = !faults::is_sampling_stopped();
        quiet && bites && lets_go
    })
}
