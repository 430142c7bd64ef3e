//! All registers as plain words, with the rules for each of them: it exists, its peripheral is clocked, its reserved bits
//! stay unchanged.

use std::sync::LazyLock;

use crate::registers::{Field, REGISTERS, rcc};
use crate::violation::Log;

/// Words of address space in the ranges that have registers.
const PLACES: usize = 0xB500;

/// Number of the register plus 1 for each word of address space, or 0. Registers are looked up some ten times in each block of
/// code; hashing their addresses took half of the emulator's time.
static INDEX: LazyLock<[u16; PLACES]> = LazyLock::new(|| {
    let mut index = [0; PLACES];
    for (number, register) in (1..).zip(REGISTERS) {
        index[place(register.address).expect("in one of the ranges")] = number;
    }
    index
});

/// Place of an address in [`INDEX`]. Inlined, as are its callers, since most addresses are constants.
#[inline]
fn place(address: u32) -> Option<usize> {
    let (first, base, bytes) = match address >> 24 {
        0x40 => (0, 0x4000_0000, 0x2_8000),
        0x48 => (0xA000, 0x4800_0000, 0x2000),
        0x50 if address >> 16 == 0x5006 => (0xB400, 0x5006_0800, 0x400),
        0x50 => (0xA800, 0x5000_0000, 0x2000),
        0xE0 => (0xB000, 0xE004_2000, 0x1000),
        _ => return None,
    };
    let offset = address.wrapping_sub(base);
    (offset < bytes && offset.is_multiple_of(4)).then_some(first + offset as usize / 4)
}

/// Values of all registers.
#[derive(Clone, Debug)]
pub struct RegisterFile {
    index: &'static [u16; PLACES],
    values: Vec<u32>,
}

/// RCC bit that clocks a peripheral (RM0440, 7.2.16 and the RCC_xxxENR registers); `None` if it is always clocked.
pub fn clock_of(peripheral: &str) -> Option<Field> {
    Some(match peripheral {
        "DMA1" => rcc::rcc_ahb1enr::DMA1EN,
        "DMAMUX" => rcc::rcc_ahb1enr::DMAMUX1EN,
        "FLASH" => rcc::rcc_ahb1enr::FLASHEN,
        "CRC" => rcc::rcc_ahb1enr::CRCEN,
        "GPIOA" => rcc::rcc_ahb2enr::GPIOAEN,
        "GPIOB" => rcc::rcc_ahb2enr::GPIOBEN,
        "GPIOC" => rcc::rcc_ahb2enr::GPIOCEN,
        "ADC1" | "ADC2" | "ADC12_Common" => rcc::rcc_ahb2enr::ADC12EN,
        "ADC3" | "ADC4" | "ADC345_Common" => rcc::rcc_ahb2enr::ADC345EN,
        "DAC1" => rcc::rcc_ahb2enr::DAC1EN,
        "CRS" => rcc::rcc_apb1enr1::CRSEN,
        "PWR" => rcc::rcc_apb1enr1::PWREN,
        "USB_FS_device" => rcc::rcc_apb1enr1::USBEN,
        "LPUART1" => rcc::rcc_apb1enr2::LPUART1EN,
        "TIM2" => rcc::rcc_apb1enr1::TIM2EN,
        "RNG" => rcc::rcc_ahb2enr::RNGEN,
        "TIM16" => rcc::rcc_apb2enr::TIM16EN,
        "SYSCFG" | "COMP" => rcc::rcc_apb2enr::SYSCFGEN,
        "HRTIM_Master" | "HRTIM_TIMA" | "HRTIM_TIMB" | "HRTIM_Common" => rcc::rcc_apb2enr::HRTIM1EN,
        _ => return None,
    })
}

impl Default for RegisterFile {
    fn default() -> Self {
        Self {
            index: &INDEX,
            values: REGISTERS.iter().map(|register| register.reset).collect(),
        }
    }
}

impl RegisterFile {
    #[inline]
    fn number(&self, address: u32) -> Option<usize> {
        usize::from(self.index[place(address)?]).checked_sub(1)
    }

    /// Word of a register; 0 if there is none at the address.
    #[inline]
    pub fn word(&self, address: u32) -> u32 {
        self.number(address).map_or(0, |k| self.values[k])
    }

    /// Sets a register's word.
    pub fn set_word(&mut self, address: u32, value: u32) {
        if let Some(k) = self.number(address) {
            self.values[k] = value;
        }
    }

    /// Value of a field.
    #[inline]
    pub fn get(&self, field: Field) -> u32 {
        field.extract(self.word(field.address))
    }

    /// Returns `true` if a field is not 0.
    #[inline]
    pub fn is(&self, field: Field) -> bool {
        self.get(field) != 0
    }

    /// Sets a field.
    pub fn set(&mut self, field: Field, value: u32) {
        self.set_word(field.address, field.put(self.word(field.address), value));
    }

    /// Resets every register of a peripheral.
    pub fn reset(&mut self, peripheral: &str) {
        for (value, register) in self.values.iter_mut().zip(REGISTERS) {
            if register.peripheral == peripheral {
                *value = register.reset;
            }
        }
    }

    /// Checks an access and logs violations; returns `false` if the chip ignores it.
    pub fn check_access(&self, address: u32, written: Option<u32>, log: &mut Log) -> bool {
        let Some(k) = self.number(address) else {
            log.broken(format!(
                "{address:#010x} is no register of what the image uses (SVD)"
            ));
            return false;
        };
        let register = &REGISTERS[k];
        let name = register.name;
        let of = register.peripheral;
        if clock_of(of).is_some_and(|clock| !self.is(clock)) {
            let kind = if written.is_some() { "written" } else { "read" };
            log.broken(format!(
                "{of} {name} {kind} while the peripheral's clock is off (RM0440 7.2.16)"
            ));
            return false;
        }
        if let Some(value) = written {
            // Drivers clear flags by writing back the word that they read; no manual requires its other bits to stay at reset.
            let clears_flags = matches!((of, name), ("LPUART1", "ICR"));
            let reserved = if clears_flags { 0 } else { !register.bits };
            if (value ^ self.values[k]) & reserved != 0 && value & reserved != 0 {
                log.broken(format!(
                    "{of} {name}: reserved bits written, {value:#010x} (RM0440 1.2)"
                ));
            }
        }
        true
    }
}
