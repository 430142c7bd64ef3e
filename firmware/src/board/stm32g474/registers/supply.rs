//! Resets, option bytes, and the memories' own guards.

use cortex_m::peripheral::MPU;
use embassy_stm32::pac;
use ihd_firmware::retained::reset::ResetFlags;

/// RCC, RCC_CSR: why the controller started, also as it was read, cleared for the next time; and whether the watchdog is sound. After power-on
/// start-up lets it run out once (`start_up.rs`), which is no end of the program: both flags are set then.
pub fn reset_flags() -> (ResetFlags, u32, bool) {
    let csr = pac::RCC.csr().read();
    let bit_by_watchdog = csr.iwdgrstf() || csr.wwdgrstf();
    let is_sound = bit_by_watchdog || !csr.borrstf();
    let flags = ResetFlags {
        watchdog: bit_by_watchdog && !csr.borrstf(),
        software: csr.sftrstf(),
        brown_out: csr.borrstf(),
        pin: csr.pinrstf(),
    };
    pac::RCC.csr().modify(|w| w.set_rmvf(true));
    (flags, csr.0, is_sound)
}

/// FLASH, FLASH_OPTR: the option bytes in force.
pub fn option_bytes() -> u32 {
    pac::FLASH.optr().read().0
}

/// DBGMCU, DBGMCU_IDCODE: which chip, and its revision.
pub fn id_code() -> u32 {
    pac::DBGMCU.idcode().read().0
}

/// Flash, in KiB (RM0440, "Device electronic signature": FLASHSIZE).
pub fn flash_kib() -> u16 {
    // SAFETY: read-only memory of every STM32G4.
    unsafe { core::ptr::read_volatile(0x1FFF_75E0 as *const u16) }
}

/// Code of the reference voltage at 3.0 V and 30 °C, as ST found it (DS12288, "Embedded voltage reference": VREFINT_CAL).
pub fn reference_calibration() -> u16 {
    // SAFETY: read-only memory of every STM32G4.
    unsafe { core::ptr::read_volatile(0x1FFF_75AA as *const u16) }
}

/// FLASH, FLASH_OPTR: returns `true` if there are two banks, of which one can be written while the program runs
/// from the other (DBANK = 1, as delivered).
pub fn has_two_banks() -> bool {
    pac::FLASH.optr().read().dbank()
}

/// Returns `true` if parity of SRAM1 and CCM SRAM is checked (FLASH_OPTR: SRAM_PE = 0; delivered as 1).
pub fn has_parity() -> bool {
    !pac::FLASH.optr().read().sram_pe()
}

/// Clears the flags of bits in the flash that a read corrected, by writing 1: until then FLASH_ECCR does not report another error
/// (RM0440, 3.3.2).
pub fn forget_corrected_bits() {
    pac::FLASH.eccr().write(|w| w.set_eccc(true));
}

/// Returns `true` if an NMI is about wrong bits in the second bank, and clears FLASH_ECCR's flags. A word with one wrong bit that was
/// read before the one with two is what FLASH_ECCR reports. The other cause of an NMI is the RAM's parity (SYSCFG_CFGR2, SPF).
pub fn take_error_in_bank_2() -> bool {
    let ecc = pac::FLASH.eccr().read();
    let is_wrong = ecc.eccd() || ecc.eccc() && !pac::SYSCFG.cfgr2().read().spf();
    let in_bank_2 = is_wrong && ecc.bk_ecc() && !ecc.sysf_ecc();
    if in_bank_2 {
        pac::FLASH.eccr().write(|w| {
            w.set_eccd(true);
            w.set_eccc(true);
        });
    }
    in_bank_2
}

/// MPU (Armv7-M, B3.5): no access to the 32 KiB below the RAM, where the stack ends (memory.x). The chip has option bytes and reserved
/// addresses there, and no manual says that writing to them is a bus error. All else stays as without MPU (PRIVDEFENA), which the
/// handlers of hard fault and NMI do not have (HFNMIENA = 0). The unit's own fault is not enabled, so it becomes a hard fault.
pub fn guard_stack(mpu: &mut MPU) {
    const BELOW_RAM: u32 = 0x1FFF_8000;
    // RBAR: VALID, region 0. RASR: XN, AP = 0, SIZE (2^15 bytes), ENABLE. CTRL: PRIVDEFENA, ENABLE.
    // SAFETY: no code and no variable lies in the region, so no access that Rust knows of is forbidden.
    unsafe {
        mpu.rbar.write(BELOW_RAM | 1 << 4);
        mpu.rasr.write(1 << 28 | 14 << 1 | 1);
        mpu.ctrl.write(1 << 2 | 1);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// SYSCFG, SYSCFG_SWPR: the CCM SRAM, all of whose 32 pages hold code or constants by now, is written no
/// more until reset.
pub fn protect_code() {
    pac::SYSCFG.swpr().write(|w| {
        for page in 0..32 {
            w.set_page_wp(page, true);
        }
    });
}
