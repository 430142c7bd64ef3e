//! TIM16, which captures the edges of LSI, the watchdog's oscillator, with the main clock.

use embassy_stm32::pac;
use embassy_stm32::pac::timer::vals::{CcmrInputCcs, FilterValue};
use embassy_stm32::{peripherals, rcc};
use ihd_firmware::self_test::clock::{COUNTS_PER_S, ClockCapture, PERIODS};

use super::clocks::CORE_MHZ;

/// TIM, TIM16_TISEL: LSI (ST's `TIM_TIM16_TI1_LSI`).
const TI1_LSI: u8 = 6;

const DIVIDER: u32 = CORE_MHZ * 1_000_000 / COUNTS_PER_S;

/// TIM, "Input capture mode": channel 1 on TI1, every eighth edge. Its clock is that of APB2, which is not divided. LSI is not waited for:
/// one that does not start is a capture that does not come.
pub fn start() {
    const { assert!(PERIODS == 8, "IC1PSC = 3") };
    rcc::enable_and_reset::<peripherals::TIM16>();
    pac::RCC.csr().modify(|w| w.set_lsion(true));
    let timer = pac::TIM16;
    timer.tisel().write(|w| w.set_tisel(0, TI1_LSI));
    timer.ccmr_input(0).write(|w| {
        w.set_ccs(0, CcmrInputCcs::TI4);
        w.set_icpsc(0, 3);
        w.set_icf(0, FilterValue::NO_FILTER);
    });
    timer.psc().write_value(DIVIDER as u16 - 1);
    timer.egr().write(|w| w.set_ug(true));
    timer.ccer().write(|w| w.set_cce(0, true));
    timer.cr1().write(|w| w.set_cen(true));
}

/// Takes the captures since the last call: TIM16_SR, whose flags are cleared by writing 0, and TIM16_CCR1, whose
/// reading clears CC1IF.
pub fn captured() -> ClockCapture {
    let timer = pac::TIM16;
    let flags = timer.sr().read();
    if !flags.ccif(0) {
        return ClockCapture::Nothing;
    }
    let at = timer.ccr(0).read().ccr();
    if flags.ccof(0) {
        timer.sr().modify(|w| w.set_ccof(0, false));
        return ClockCapture::Overtaken;
    }
    ClockCapture::At(at)
}
