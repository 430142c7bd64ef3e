//! The LED, on the reference board the NUCLEO's green one (LD2), for who stands beside the board without a host.
//!
//! | LED | meaning |
//! |---|---|
//! | a flash every 2 s | idle, or waiting for a pot, with probes |
//! | lit | probing or heating |
//! | n flashes, a pause | fault n |
//! | n flashes, or a flicker, and the host gets no answer | the program ended too often in a row and stays so (`crash.rs`); fault n was active before, or none |

use embassy_stm32::gpio::{Level, Output};
use embassy_stm32::pac;
use embassy_stm32::pac::gpio::vals::Moder;
use embassy_stm32::pac::iwdg::vals::Key;
use embassy_stm32::pac::rcc::vals::Sw;
use ihd_firmware::control::panel::is_flash;
use ihd_shared::board::LED_PIN;
use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::State;

use super::pins::low_output;
use super::registers::clocks::CORE_MHZ;

const PORT: pac::gpio::Gpio = match LED_PIN.port {
    0 => pac::GPIOA,
    1 => pac::GPIOB,
    _ => pac::GPIOC,
};
const LINE: usize = LED_PIN.line as usize;

/// Half of the time from one flash of a fault to the next, and the pause after the last.
const FLASH_MS: u32 = 200;
const PAUSE_MS: u32 = 1_600;

const CYCLES_PER_MS: u32 = CORE_MHZ * 1_000;

/// The LED and its time.
pub struct Led {
    pin: Output<'static>,
    /// Cycles of the blocks at the last whole millisecond.
    at: u32,
    ms: u32,
}

impl Led {
    /// Creates it, dark.
    pub fn new() -> Self {
        Self {
            pin: low_output(LED_PIN),
            at: 0,
            ms: 0,
        }
    }

    /// Shows it; called at least every 20 s.
    pub fn show(&mut self, state: State, fault: Fault, now: u32) {
        let ms = now.wrapping_sub(self.at) / CYCLES_PER_MS;
        self.at = self.at.wrapping_add(ms * CYCLES_PER_MS);
        self.ms = self.ms.wrapping_add(ms);
        let lit = match (fault, state) {
            (Fault::NONE, State::Probing | State::Heating) => true,
            (Fault::NONE, _) => self.ms % 2_000 < 50,
            (fault, _) => flashes(fault.number(), self.ms),
        };
        self.pin.set_level(Level::from(lit));
    }
}

fn flashes(number: u16, ms: u32) -> bool {
    is_flash(number.into(), FLASH_MS, PAUSE_MS, ms)
}

/// Flashes a fault's number for ever, or flickers without one, feeding the watchdog should it run. Registers alone: whatever came
/// before cannot be trusted.
pub fn flash_for_ever(number: u16) -> ! {
    // RCC_AHB2ENR: GPIOAEN is bit 0, and so on.
    pac::RCC.ahb2enr().modify(|w| w.0 |= 1 << LED_PIN.port);
    let _ = pac::RCC.ahb2enr().read();
    PORT.moder().modify(|w| w.set_moder(LINE, Moder::OUTPUT));
    let mhz = match pac::RCC.cfgr().read().sws() {
        Sw::PLL1_R => CORE_MHZ,
        _ => 16,
    };
    let mut ms = 0;
    loop {
        let lit = match number {
            0 => ms % 200 < 100,
            _ => flashes(number, ms),
        };
        PORT.bsrr().write(|w| match lit {
            true => w.set_bs(LINE, true),
            false => w.set_br(LINE, true),
        });
        pac::IWDG.kr().write(|w| w.set_key(Key::RESET));
        cortex_m::asm::delay(mhz * 1_000);
        ms += 1;
    }
}
