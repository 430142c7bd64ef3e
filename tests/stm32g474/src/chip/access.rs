//! Read and write accesses of the processor: dispatch to the peripherals, and the effects of a write on the chip.

use super::ports::PORT_BYTES;
use super::{Chip, Reset, clocks};
use crate::cpu::nvic::NMI;
use crate::registers as reg;
use crate::violation::Log;

use super::register_file::RegisterFile;

const PMA: u32 = 0x4000_6000;
const PMA_BYTES: u32 = 0x400;

/// First address of the processor's own registers and of DBGMCU.
const SYSTEM: u32 = 0xE000_0000;

impl Chip {
    /// Reads `bytes` at an address of a peripheral.
    pub fn read(&mut self, address: u32, bytes: usize) -> u32 {
        if (PMA..PMA + PMA_BYTES).contains(&address) {
            return self.usb.pma_read(address - PMA, bytes);
        }
        let aligned = address & !3;
        if in_block(aligned, reg::usb_fs_device::BASE, 0x100) {
            // The USB peripheral checks its registers itself: the SVD lacks some.
            self.before_usb_access();
            let word = self.usb.read(aligned - reg::usb_fs_device::BASE);
            self.update_lines();
            return word >> (8 * (address & 3));
        }
        if !self.file.check_access(aligned, None, &mut self.log) {
            return 0;
        }
        let now = self.log.now;
        if in_block(aligned, reg::rcc::BASE, 0x400) {
            self.oscillators.settle(&mut self.file, now);
        }
        let word = match aligned {
            a if in_block(a, reg::hrtim_master::BASE, 0x400) => self.hrtim.read(a, &self.file, now),
            a if in_block(a, reg::lpuart1::BASE, 0x400) => self.serial.read(a, &self.file),
            a if in_block(a, reg::flash::BASE, 0x400) => self.flash.read(a, &self.file),
            a if in_block(a, reg::rng::BASE, 0x400) => {
                self.random.read(a, &self.file, &mut self.log)
            }
            reg::gpioa::idr::ADDRESS => self.levels(0),
            reg::gpiob::idr::ADDRESS => self.levels(1),
            reg::gpioc::idr::ADDRESS => self.levels(2),
            reg::crc::dr::ADDRESS => self.checksum.read(&self.file),
            a if in_block(a, reg::tim16::BASE, 0x400) => self.read_timer(a),
            a if in_block(a, reg::iwdg::BASE, 0x400) => self.watchdog.read(a, &self.file, now),
            a if in_block(a, reg::tim2::BASE, 0x400) => {
                self.timer_2.read(a, self.ticks_per_cycle, &self.file, now)
            }
            a => match converter(a) {
                Some(k) => self.adcs[k].read(a, &mut self.file, &mut self.log),
                None => self.file.word(a),
            },
        };
        self.update_lines();
        word >> (8 * (address & 3))
    }

    /// Writes `bytes` at an address of a peripheral.
    pub fn write(&mut self, address: u32, bytes: usize, value: u32) {
        if (PMA..PMA + PMA_BYTES).contains(&address) {
            self.usb.pma_write(address - PMA, bytes, value);
            return;
        }
        let aligned = address & !3;
        if in_block(aligned, reg::usb_fs_device::BASE, 0x100) {
            self.before_usb_access();
            self.usb.write(aligned - reg::usb_fs_device::BASE, value);
            self.update_lines();
            return;
        }
        if in_block(aligned, reg::rcc::BASE, 0x400) {
            self.oscillators.settle(&mut self.file, self.log.now);
        }
        let before = self.file.word(aligned);
        let shift = 8 * (address & 3);
        let mask = if bytes >= 4 {
            u32::MAX
        } else {
            ((1 << (8 * bytes)) - 1) << shift
        };
        let value = (before & !mask) | (value << shift & mask);
        if !self.file.check_access(aligned, Some(value), &mut self.log) {
            return;
        }
        self.write_word(aligned, bytes, before, value);
        self.update_lines();
    }

    fn before_usb_access(&mut self) {
        self.usb.set_time(crate::time::seconds(self.log.now) * 1e6);
        if !self.file.is(reg::rcc::rcc_apb1enr1::USBEN) {
            self.log.broken(
                "USB registers accessed while the peripheral's clock is off (RM0440 7.2.16)",
            );
        }
        self.oscillators.settle(&mut self.file, self.log.now);
        clocks::check_48_mhz("USB", &self.file, &mut self.log);
    }

    /// Reads a register of TIM16, captures up to now included. Reading CCR1 clears CC1IF (RM0440 29.6.5).
    fn read_timer(&mut self, address: u32) -> u32 {
        let (lsi, file, now) = (&self.lsi, &mut self.file, self.log.now);
        self.capture.advance(lsi, self.ticks_per_cycle, file, now);
        if address == reg::tim16::tim16_ccr1::ADDRESS {
            file.set(reg::tim16::tim16_sr::CC1IF, 0);
        }
        file.word(address)
    }

    fn write_word(&mut self, address: u32, bytes: usize, before: u32, value: u32) {
        let active_faults = self.active_faults();
        let (file, log) = (&mut self.file, &mut self.log);
        let hclk_hz = clocks::hclk_hz(file);
        let stored = match address {
            a if in_block(a, reg::hrtim_master::BASE, 0x400) => {
                self.hrtim.active_faults = active_faults;
                self.hrtim.write(a, value, file, log)
            }
            a if in_block(a, reg::dma1::BASE, 0x400) => self.dma.write(a, value, file, log),
            a if in_block(a, reg::flash::BASE, 0x400) => self.flash.write(a, value, file, log),
            a if in_block(a, reg::lpuart1::BASE, 0x400) => {
                self.serial.write(a, value, hclk_hz, file, log);
                value
            }
            a if in_block(a, reg::iwdg::BASE, 0x400) => {
                if !self.watchdog.write(a, value, self.lsi.hz(), log) {
                    return;
                }
                value
            }
            a if in_block(a, reg::crc::BASE, 0x400) => {
                self.checksum.write(a, bytes, value, file, log)
            }
            a if in_block(a, reg::tim16::BASE, 0x400) => {
                self.capture
                    .advance(&self.lsi, self.ticks_per_cycle, file, log.now);
                self.capture.write(a, value, &self.lsi, file, log)
            }
            a if in_block(a, reg::tim2::BASE, 0x400) => {
                self.timer_2
                    .write(a, value, self.ticks_per_cycle, file, log)
            }
            a => match converter(a) {
                Some(k) => self.adcs[k].write(a, value, hclk_hz, file, log),
                None => plain_write(a, before, value, file, log),
            },
        };
        self.file.set_word(address, stored);
        self.after_write(address, before);
    }

    fn after_write(&mut self, address: u32, before: u32) {
        let (file, log) = (&mut self.file, &mut self.log);
        match address {
            a if in_block(a, reg::rcc::BASE, 0x400) => {
                clocks::after_rcc_write(a, before, &mut self.oscillators, file, log)
            }
            a if in_block(a, reg::pwr::BASE, 0x400) => clocks::after_pwr_write(file, log),
            reg::rng::cr::ADDRESS => self.random.enable(file, log),
            reg::flash::flash_acr::ADDRESS => clocks::after_wait_states_write(file, log),
            _ => {}
        }
        if in_block(address, reg::pwr::BASE, 0x400) {
            self.update_supply_detector();
        }
        if in_block(address, reg::gpioa::BASE, 3 * PORT_BYTES) {
            self.check_share_wire();
        }
        let starts = |word: u32| reg::adc1::cr::ADSTART.extract(word) == 1;
        if address == reg::adc4::cr::ADDRESS
            && starts(self.file.word(address))
            && !starts(before)
            && reg::adc1::cfgr::EXTEN.extract(self.file.word(reg::adc4::cfgr::ADDRESS)) == 0
        {
            self.start_adc4();
        }
        self.ticks_per_cycle = clocks::ticks_per_cycle(&self.file);
        if in_block(address, reg::hrtim_master::BASE, 0x400)
            || in_block(address, reg::gpioa::BASE, 0x400)
        {
            self.hrtim.after_write(address, &self.file);
            self.next_trigger = self.hrtim.next_trigger(&self.file, self.log.now);
            // A flag that is cleared while its input is active is set again.
            self.check_event_2();
            self.drive_pins();
        }
    }

    /// Reads from the pages that the program may write. A double error pends NMI and returns `None` (RM0440, 3.3.2); the load
    /// succeeds, without another error, when it is repeated after the handler.
    pub fn read_page(&mut self, offset: u32, bytes: usize) -> Option<u32> {
        if self.reported_page_word.take() == Some(offset) {
            return Some(self.flash.peek(offset, bytes));
        }
        let (word, damaged) = self.flash.read_page(offset, bytes, &mut self.file);
        if damaged {
            self.reported_page_word = Some(offset);
            self.nvic.pend(NMI);
            self.system_fault(reg::syscfg::cfgr2::ECCL);
            return None;
        }
        Some(word)
    }

    /// Writes to the pages that the program may write.
    pub fn write_page(&mut self, offset: u32, bytes: usize, value: u32) {
        self.flash
            .write_page(offset, value, bytes, &mut self.file, &mut self.log);
    }

    /// Reads a register of the processor at an offset from 0xE000_0000.
    pub fn read_system(&mut self, offset: u32) -> u32 {
        if let Some(word) = self.cycle_counter.read(offset) {
            return word;
        }
        match offset {
            // DBGMCU_IDCODE of a category 3 device, revision X (RM0440 47.6.1).
            0x42000 => 0x2003_6469,
            0x4_2004..0x4_3000 => self.file.word(SYSTEM + offset),
            0xE000..0xF000 => {
                let inside = offset - 0xE000;
                let own = self.nvic.read(inside).or_else(|| self.mpu.read(inside));
                own.unwrap_or_else(|| self.system.get(&offset).copied().unwrap_or(0))
            }
            _ => self.system.get(&offset).copied().unwrap_or(0),
        }
    }

    /// Writes a register of the processor at an offset from 0xE000_0000.
    pub fn write_system(&mut self, offset: u32, bytes: usize, value: u32) {
        const AIRCR: u32 = 0xED0C;
        if self.cycle_counter.write(offset, value) {
            return;
        }
        match offset {
            0x4_2004..0x4_3000 => {
                let address = SYSTEM + offset;
                if self.file.check_access(address, Some(value), &mut self.log) {
                    self.file.set_word(address, value);
                }
            }
            // VECTKEY and SYSRESETREQ.
            AIRCR if value >> 16 == 0x05FA && value & 4 != 0 => self.reset = Some(Reset::Software),
            0xE000..0xF000 if self.nvic.write(offset - 0xE000, bytes, value) => {}
            0xE000..0xF000 if self.mpu.write(offset - 0xE000, value, &mut self.log) => {}
            _ => {
                self.system.insert(offset, value);
            }
        }
    }
}

fn in_block(address: u32, base: u32, bytes: u32) -> bool {
    (base..base + bytes).contains(&address)
}

fn converter(address: u32) -> Option<usize> {
    [
        reg::adc1::BASE,
        reg::adc2::BASE,
        reg::adc3::BASE,
        reg::adc4::BASE,
    ]
    .iter()
    .position(|&base| in_block(address, base, 0x100))
}

/// Handles a write to a register without a model of its own: locks, and bits that act when written. Returns the word to store.
fn plain_write(
    address: u32,
    before: u32,
    value: u32,
    file: &mut RegisterFile,
    log: &mut Log,
) -> u32 {
    match address {
        // GPIOx_BSRR acts on ODR.
        a if [
            reg::gpioa::bsrr::ADDRESS,
            reg::gpiob::bsrr::ADDRESS,
            reg::gpioc::bsrr::ADDRESS,
        ]
        .contains(&a) =>
        {
            let odr = a - reg::gpioa::bsrr::ADDRESS + reg::gpioa::odr::ADDRESS;
            file.set_word(odr, file.word(odr) & !(value >> 16) | value & 0xFFFF);
            0
        }
        a if in_block(a, reg::comp::BASE, 8) => {
            if reg::comp::comp_c1csr::LOCK.extract(before) == 1 {
                if value != before {
                    log.broken("COMP CSR written after LOCK (RM0440 24.3.7)");
                }
                return before;
            }
            value
        }
        reg::exti::pr1::ADDRESS => before & !value,
        // PVDL locks PVDE and PLS until reset (RM0440, 10.2.8).
        reg::pwr::pwr_cr2::ADDRESS if file.is(reg::syscfg::cfgr2::PVDL) => {
            if value != before {
                log.broken("PWR_CR2 written after SYSCFG PVDL (RM0440 10.2.8)");
            }
            before
        }
        reg::syscfg::cfgr2::ADDRESS => {
            if reg::syscfg::cfgr2::PVDL.extract(value) == 1 && !file.is(reg::pwr::pwr_cr2::PVDE) {
                log.broken("PVDL locks a supply detector that is off: PVDE (RM0440 10.2.8)");
            }
            if reg::syscfg::cfgr2::SPL.extract(value) == 1
                && file.is(reg::flash::flash_optr::SRAM_PE)
            {
                log.broken("SPL without RAM parity: option bit SRAM_PE is 1, off (RM0440 3.4.1)");
            }
            // SPF is cleared by writing 1; the locks stay.
            let flag = reg::syscfg::cfgr2::SPF.mask();
            (before & !(value & flag)) | (value & !flag) | (before & 0xF)
        }
        _ => value,
    }
}
