//! 170 MHz from HSI16 and what goes with it: core voltage, wait states, caches.
//!
//! embassy-stm32 0.6 cannot do this alone on this part (firmware/README.md): the metapac has
//! PWR_CR5.R1MODE at bit 0 instead of 8, and `rcc/g4.rs` writes HPRE together with the switch. Its
//! `init` also resets PWR, so nothing that is set there before lasts. So it is asked for the PLL without
//! the switch to it, and that is here. It goes on to calculate with 16 MHz; what it drives with a frequency
//! of its own takes none of the bus clocks: LPUART1 runs from HSI16, USB from HSI48, the watchdog from
//! LSI.

use embassy_stm32::pac;
use embassy_stm32::pac::flash::vals::Latency;
use embassy_stm32::pac::rcc::vals::{Hpre, Sw};
use embassy_stm32::rcc::{self, mux};
use embassy_stm32::{Config, Peripherals};
use ihd_firmware::drive::pwm::CORE_HZ;

/// Frequency of SYSCLK, AHB and APB, in MHz.
pub const CORE_MHZ: u32 = CORE_HZ / 1_000_000;

/// RM0440, PWR: bit 8 of PWR_CR5 (also ST's SVD, and `PWR_CR5_R1MODE` of stm32g474xx.h). 0 is boost.
const R1MODE: u32 = 1 << 8;

/// Range 1 boost mode is for above 150 MHz. RM0440, PWR, "Dynamic voltage scaling management", from
/// normal to boost mode: AHB by 2, R1MODE to 0, wait states, switch, 1 µs, AHB by 1; the PLL's output R, too fast for normal mode,
/// is enabled in boost mode only, beside a running PLL (RCC, "PLL"). The same order in ST's `HAL_PWREx_ControlVoltageScaling`, then
/// `HAL_RCC_ClockConfig`.
pub fn start() -> Peripherals {
    let peripherals = embassy_stm32::init(pll_beside());
    let rcc = pac::RCC;
    rcc.cfgr().modify(|w| w.set_hpre(Hpre::DIV2));
    pac::PWR.cr5().modify(|w| w.0 &= !R1MODE);
    set_wait_states();
    // PLLR is 0: by 2.
    rcc.pllcfgr().modify(|w| w.set_pllren(true));
    rcc.cfgr().modify(|w| w.set_sw(Sw::PLL1_R));
    while rcc.cfgr().read().sws() != Sw::PLL1_R {}
    // At least 1 µs; a cycle is 12 ns until the AHB is undivided.
    cortex_m::asm::delay(CORE_MHZ / 2);
    rcc.cfgr().modify(|w| w.set_hpre(Hpre::DIV1));
    // 16 cycles later the new prescaler is in force (RCC, RCC_CFGR, HPRE).
    let _ = rcc.cfgr().read();
    cortex_m::asm::delay(16);
    peripherals
}

/// HSI16 with the PLL running at 16 MHz / 4 · 85 beside it, its outputs off. USB runs from HSI48, trimmed by the start
/// of each USB frame.
fn pll_beside() -> Config {
    let mut config = Config::default();
    config.rcc.hsi = true;
    config.rcc.pll = Some(rcc::Pll {
        source: rcc::PllSource::HSI,
        prediv: rcc::PllPreDiv::DIV4,
        mul: rcc::PllMul::MUL85,
        divp: None,
        divq: None,
        divr: None,
    });
    config.rcc.sys = rcc::Sysclk::HSI;
    // Errata, "Unstable LSI when it clocks RTC": after a brown-out it may run at three halves of its frequency.
    config.rcc.ls.rtc = rcc::RtcClockSource::DISABLE;
    // embassy-stm32 would wait for it without end; `low_speed` starts it.
    config.rcc.ls.lsi = false;
    // It would write another bit than R1MODE.
    config.rcc.boost = false;
    config.rcc.hsi48 = Some(rcc::Hsi48Config {
        sync_from_usb: true,
    });
    config.rcc.mux.clk48sel = mux::Clk48sel::HSI48;
    config.rcc.mux.lpuart1sel = mux::Uartsel::HSI;
    config.rcc.mux.adc12sel = mux::Adcsel::SYS;
    config.rcc.mux.adc345sel = mux::Adcsel::SYS;
    config
}

/// FLASH, FLASH_ACR: 4 wait states for up to 170 MHz in boost mode (table "Number of wait states
/// according to CPU clock frequency"), prefetch and both caches.
///
/// Errata: on other parts with this flash a prefetch may fail when a branch leads into the other
/// bank (ES0548 2.2.10, of the STM32G0B1); whatever this part does, the image lies in the first bank
/// and nothing is executed from the second. The data cache is off while the other bank is written,
/// and emptied afterwards: embassy-stm32 does that (flash/g.rs, `save_data_cache_state`).
fn set_wait_states() {
    let acr = pac::FLASH.acr();
    acr.modify(|w| {
        w.set_latency(Latency::WS4);
        w.set_prften(true);
        w.set_icen(true);
        w.set_dcen(true);
    });
    // The new latency is in force when it reads back.
    while acr.read().latency() != Latency::WS4 {}
}

/// CRS, CRS_ISR (FECAP, FEDIR) and CRS_CR (TRIM): how many periods too many HSI48 had in the USB host's last frame, and its
/// trim.
pub fn hsi48() -> (i16, u8) {
    let isr = pac::CRS.isr().read();
    let off = isr.fecap() as i16;
    // FEDIR: counting down when the frame came, it was too slow.
    let off = if isr.fedir() { -off } else { off };
    (off, pac::CRS.cr().read().trim())
}
