//! RCC, PWR and the wait states of the flash: frequencies of the clocks, and the order in which they may be changed.

use crate::registers::{Field, REGISTERS, flash, pwr, rcc};
use crate::time::{TICKS_PER_S, Ticks, us};
use crate::violation::Log;

use super::register_file::{RegisterFile, clock_of};

const HSI_HZ: u64 = 16_000_000;

/// SYSCLK in hertz, from the registers (RM0440, 7.2).
fn sysclk_hz(file: &RegisterFile) -> u64 {
    if file.get(rcc::rcc_cfgr::SWS) != 3 {
        return HSI_HZ;
    }
    pll_hz(file)
}

fn pll_hz(file: &RegisterFile) -> u64 {
    use rcc::rcc_pllcfgr::{PLLM, PLLN, PLLR};
    let vco_in = HSI_HZ / (u64::from(file.get(PLLM)) + 1);
    vco_in * u64::from(file.get(PLLN)) / (2 * (u64::from(file.get(PLLR)) + 1))
}

/// Returns `true` if the PLL is on and its output R, too.
fn is_pll_out(file: &RegisterFile) -> bool {
    file.is(rcc::rcc_cr::PLLON) && file.is(rcc::rcc_pllcfgr::PLLREN)
}

fn divided(hz: u64, hpre: u32) -> u64 {
    match hpre {
        0..8 => hz,
        // 2, 4, 8, 16, 64, 128, 256, 512
        n @ 8..12 => hz >> (n - 7),
        n => hz >> (n - 6),
    }
}

/// Frequency of the AHB and of both APBs, which the image does not divide.
pub fn hclk_hz(file: &RegisterFile) -> u64 {
    divided(sysclk_hz(file), file.get(rcc::rcc_cfgr::HPRE))
}

/// Length of a cycle of HCLK in ticks.
pub fn ticks_per_cycle(file: &RegisterFile) -> Ticks {
    TICKS_PER_S / hclk_hz(file).max(1)
}

/// Minimum of wait states at a frequency (RM0440, table 29: range 1 boost 34 MHz a step, range 1 normal 30, range 2 12).
fn least_wait_states(file: &RegisterFile, hz: u64) -> u64 {
    let step = match (file.get(pwr::pwr_cr1::VOS), boosted(file)) {
        (1, true) => 34_000_000,
        (1, false) => 30_000_000,
        _ => 12_000_000,
    };
    hz.div_ceil(step).saturating_sub(1)
}

/// Returns `true` in boost mode: PWR_CR5.R1MODE is 0 (RM0440, 6.4.26).
pub fn boosted(file: &RegisterFile) -> bool {
    !file.is(pwr::pwr_cr5::R1MODE)
}

fn check_speed(file: &RegisterFile, log: &mut Log) {
    // The voltage range also limits SYSCLK, before the AHB's prescaler, and the PLL's output before it is SYSCLK.
    let hz = match is_pll_out(file) {
        true => pll_hz(file).max(sysclk_hz(file)),
        false => sysclk_hz(file),
    };
    let limit = match (file.get(pwr::pwr_cr1::VOS), boosted(file)) {
        (1, true) => 170_000_000,
        (1, false) => 150_000_000,
        _ => 26_000_000,
    };
    if hz > limit {
        log.broken(format!(
            "SYSCLK or PLL's output R {hz} Hz in a voltage range for {limit} Hz: PWR_CR5.R1MODE (RM0440 6.1.5)"
        ));
    }
    let hz = hclk_hz(file);
    let least = least_wait_states(file, hz);
    if u64::from(file.get(flash::flash_acr::LATENCY)) < least {
        log.broken(format!(
            "HCLK {hz} Hz needs {least} wait states (RM0440 3.3.3)"
        ));
    }
}

/// Address of the RCC register with a peripheral's reset bit: 0x20 below the register of its clock bit, at the same position.
fn reset_of(clock: Field) -> u32 {
    clock.address - 0x20
}

/// Enable bit, ready bit and longest start-up of HSI16, PLL, HSI48 and LSI (DS12288: t_su(HSI16), t_LOCK, t_su(HSI48),
/// t_su(LSI)). HSE is never ready: the boards have no crystal.
const STARTS: [(Field, Field, Ticks); 4] = [
    (rcc::rcc_cr::HSION, rcc::rcc_cr::HSIRDY, us(12) / 10),
    (rcc::rcc_cr::PLLON, rcc::rcc_cr::PLLRDY, us(40)),
    (rcc::rcc_crrcr::HSI48ON, rcc::rcc_crrcr::HSI48RDY, us(6)),
    (rcc::rcc_csr::LSION, rcc::rcc_csr::LSIRDY, us(130)),
];

/// Times from which the clocks of [`STARTS`] are ready.
#[derive(Clone, Debug, Default)]
pub struct Oscillators {
    ready_at: [Ticks; STARTS.len()],
}

impl Oscillators {
    /// Brings the ready bits up to date; called before each access to RCC.
    pub fn settle(&self, file: &mut RegisterFile, now: Ticks) {
        for ((on, ready, _), &at) in STARTS.into_iter().zip(&self.ready_at) {
            file.set(ready, u32::from(file.is(on) && now >= at));
        }
        file.set(rcc::rcc_cr::HSERDY, 0);
    }

    fn after_write(&mut self, address: u32, before: u32, file: &mut RegisterFile, now: Ticks) {
        for ((on, _, start), at) in STARTS.into_iter().zip(&mut self.ready_at) {
            if on.address == address && file.is(on) && on.extract(before) == 0 {
                *at = now + start;
            }
        }
        self.settle(file, now);
    }
}

/// Checks the 48 MHz of USB and RNG, HSI48 alone in this image (RM0440, RCC_CCIPR: CLK48SEL); returns `true` if they are there.
pub fn check_48_mhz(of: &str, file: &RegisterFile, log: &mut Log) -> bool {
    let is_there = file.is(rcc::rcc_crrcr::HSI48RDY) && !file.is(rcc::rcc_ccipr::CLK48SEL);
    if !is_there {
        log.broken(format!(
            "{of} without 48 MHz: HSI48RDY, CLK48SEL (RM0440 7.4.27)"
        ));
    }
    is_there
}

/// Applies the effects of a stored write to RCC.
pub fn after_rcc_write(
    address: u32,
    before: u32,
    oscillators: &mut Oscillators,
    file: &mut RegisterFile,
    log: &mut Log,
) {
    use rcc::{rcc_bdcr, rcc_cfgr, rcc_cr, rcc_crrcr, rcc_csr};
    oscillators.after_write(address, before, file, log.now);
    match address {
        rcc_cfgr::ADDRESS => switch(before, file, log),
        rcc::rcc_pllcfgr::ADDRESS => {
            use rcc::rcc_pllcfgr::{PLLPEN, PLLQEN, PLLREN};
            // The outputs are enabled at any time.
            let outputs = PLLPEN.mask() | PLLQEN.mask() | PLLREN.mask();
            if file.is(rcc_cr::PLLON) && (file.word(address) ^ before) & !outputs != 0 {
                log.broken("PLLCFGR written while the PLL is on (RM0440 7.4.4)");
            }
            check_speed(file, log);
        }
        rcc_cr::ADDRESS => check_speed(file, log),
        rcc_crrcr::ADDRESS | rcc_bdcr::ADDRESS => {}
        rcc_csr::ADDRESS => {
            if file.is(rcc_csr::RMVF) {
                let flags = 0xFE00_0000;
                file.set_word(address, file.word(address) & !flags & !rcc_csr::RMVF.mask());
            }
        }
        _ => reset_peripherals(address, file),
    }
}

/// Resets the registers of all peripherals whose reset bit is set.
fn reset_peripherals(address: u32, file: &mut RegisterFile) {
    let word = file.word(address);
    let mut names: Vec<_> = REGISTERS
        .iter()
        .map(|register| register.peripheral)
        .collect();
    names.dedup();
    for name in names {
        let in_reset = clock_of(name)
            .is_some_and(|clock| reset_of(clock) == address && clock.extract(word) != 0);
        // The registers of FLASH are reset only with the whole chip.
        if in_reset && !matches!(name, "FLASH") {
            file.reset(name);
        }
    }
}

fn switch(before: u32, file: &mut RegisterFile, log: &mut Log) {
    use rcc::rcc_cfgr::{HPRE, SW, SWS};
    let wanted = file.get(SW);
    let old_hz = divided(
        if SWS.extract(before) == 3 {
            pll_hz(file)
        } else {
            HSI_HZ
        },
        HPRE.extract(before),
    );
    if wanted == 3 && !(file.is(rcc::rcc_cr::PLLRDY) && is_pll_out(file)) {
        log.broken("switch to a PLL that is not ready, or whose output R is off (RM0440 7.2.8)");
        return;
    }
    file.set(SWS, wanted);
    let new_hz = hclk_hz(file);
    if old_hz <= 80_000_000 && new_hz > 85_000_000 && SWS.extract(before) != 3 {
        log.broken(format!(
            "HCLK from {old_hz} to {new_hz} Hz in one step: HPRE must divide by two across it (RM0440 6.1.5, 7.2.7)"
        ));
    }
    check_speed(file, log);
}

/// Checks clocks and wait states after a write to PWR.
pub fn after_pwr_write(file: &RegisterFile, log: &mut Log) {
    check_speed(file, log);
}

/// Checks clocks and wait states after a write to FLASH_ACR.
pub fn after_wait_states_write(file: &RegisterFile, log: &mut Log) {
    check_speed(file, log);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Violations in the sequence of RM0440 6.1.5 for 170 MHz, with or without the division of HCLK; boost mode begins before the
    /// write of that number, and `wait` is the time after each write.
    fn started(boost_at: usize, divide: bool, wait: Ticks) -> Vec<String> {
        use rcc::{rcc_cfgr, rcc_cr, rcc_pllcfgr};
        let (mut file, mut log) = (RegisterFile::default(), Log::default());
        let mut oscillators = Oscillators::default();
        file.set(pwr::pwr_cr5::R1MODE, 1);
        file.set(flash::flash_acr::LATENCY, 4);
        let writes = [
            (rcc_pllcfgr::PLLM, 3),
            (rcc_pllcfgr::PLLN, 85),
            (rcc_cr::PLLON, 1),
            (rcc_cfgr::HPRE, if divide { 8 } else { 0 }),
            (rcc_pllcfgr::PLLREN, 1),
            (rcc_cfgr::SW, 3),
            (rcc_cfgr::HPRE, 0),
        ];
        for (number, (field, value)) in writes.into_iter().enumerate() {
            if number == boost_at {
                file.set(pwr::pwr_cr5::R1MODE, 0);
            }
            let before = file.word(field.address);
            file.set(field, value);
            after_rcc_write(field.address, before, &mut oscillators, &mut file, &mut log);
            log.now += wait;
            oscillators.settle(&mut file, log.now);
        }
        assert_eq!(hclk_hz(&file) == 170_000_000, wait >= us(40));
        log.violations
            .into_iter()
            .map(|violation| violation.rule)
            .collect()
    }

    #[test]
    fn the_manuals_order_is_taken_and_each_omission_is_found() {
        assert_eq!(started(4, true, us(40)), Vec::<String>::new());
        // The output R before boost mode, and no boost mode at all.
        assert!(started(5, true, us(40))[0].contains("R1MODE"));
        assert!(started(9, true, us(40))[0].contains("R1MODE"));
        assert!(started(4, false, us(40))[0].contains("HPRE"));
        assert!(started(4, true, us(5))[0].contains("not ready"));
    }
}
