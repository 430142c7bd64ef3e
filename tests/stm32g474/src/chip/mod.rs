//! Chip around the processor: every register that the image uses, and the events of the peripherals over time.

mod access;
pub mod adc;
pub mod checksum;
pub mod clocks;
mod conversions;
pub mod cycle_counter;
pub mod dma;
mod fault_levels;
pub mod flash;
pub mod hrtim;
pub mod low_speed;
pub mod ports;
pub mod random;
pub mod register_file;
pub mod serial;
pub mod timer_2;
pub mod watchdog;

use ihd_sim::front_end::NOMINAL_SUPPLY_V;

use crate::cpu::mpu::Mpu;
use crate::cpu::nvic::Nvic;
use crate::pins::Pins;
use crate::registers::{self as reg, Field};
use crate::time::{Ticks, us};
use crate::usb::peripheral::Usb;
use crate::violation::Log;

use self::adc::Converter;
use self::checksum::Checksum;
use self::clocks::Oscillators;
use self::cycle_counter::CycleCounter;
use self::dma::{Dma, Transfer};
use self::flash::FlashController;
use self::hrtim::{Bridge, Hrtim};
use self::low_speed::{Capture, Lsi};
use self::random::Random;
use self::register_file::RegisterFile;
use self::serial::Serial;
use self::timer_2::Timer2;
use self::watchdog::Watchdog;

/// Interrupt numbers of USB_LP and FLASH (RM0440, 14.3, vector table).
const USB_LP: usize = 20;
const FLASH: usize = 4;

/// Polling period of the other end of the USB cable: a full-speed packet of 64 bytes takes 50 µs.
const USB_POLL: Ticks = us(25);

/// FLASH_OPTR as ST delivers it, 0xFFEF_F8AA, but with RAM parity on: SRAM_PE = 0 (RM0440, 3.4.1), without which nothing heats. Its
/// BOR_LEV stays 0, which `ihd flash` reports, and raises to 4 on request.
const OPTIONS_OF_A_NEW_CHIP: u32 = 0xFEEF_F8AA;

/// Registers of DBGMCU, which only power-on resets (RM0440, 47.16).
const KEPT_BY_DEBUG: [u32; 4] = {
    use reg::dbgmcu::{apb1h_fz, apb1l_fz, apb2_fz, cr};
    [
        cr::ADDRESS,
        apb1l_fz::ADDRESS,
        apb1h_fz::ADDRESS,
        apb2_fz::ADDRESS,
    ]
};

/// Cause of a reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reset {
    /// Request by the program.
    Software,
    /// Timeout of the watchdog.
    Watchdog,
    /// Power-on, or a supply that fell below the brown-out level for a moment.
    Power,
}

/// Index of ADC4 among the converters: software starts it, and no DMA moves its result.
const ADC4: usize = 3;

/// Conversion in progress, with its result.
#[derive(Clone, Copy, Debug)]
struct Conversion {
    at: Ticks,
    /// DMA request; `None` for ADC4, whose result stays in its data register.
    request: Option<u32>,
    value: u32,
}

/// Whole chip without the processor and its memory.
pub struct Chip {
    /// All registers.
    pub file: RegisterFile,
    /// Violations, time, program counter.
    pub log: Log,
    /// Interrupt controller.
    pub nvic: Nvic,
    /// Memory protection unit.
    pub mpu: Mpu,
    /// HRTIM.
    pub hrtim: Hrtim,
    /// Serial port and its line.
    pub serial: Serial,
    /// USB device.
    pub usb: Usb,
    /// Flash controller.
    pub flash: FlashController,
    /// Independent watchdog.
    pub watchdog: Watchdog,
    /// Random number generator.
    pub random: Random,
    /// Circuits at the pins.
    pub pins: Pins,
    /// Low-speed oscillator.
    pub lsi: Lsi,
    supply_v: f64,
    /// Fault injection: conversions of ADC3 whose DMA request is not served in time.
    pub late_transfers: u32,
    /// Fault injection: every second trigger of the ADCs is lost.
    pub loses_triggers: bool,
    trigger_is_lost: bool,
    /// Converters ADC1, 2, 3 and 4.
    adcs: [Converter; 4],
    oscillators: Oscillators,
    checksum: Checksum,
    capture: Capture,
    timer_2: Timer2,
    dma: Dma,
    conversions: Vec<Conversion>,
    next_trigger: Option<Ticks>,
    /// Offset of the load for which NMI was pended; the load is repeated after the handler.
    reported_page_word: Option<u32>,
    /// Time of the last event.
    happened_at: Ticks,
    next_usb_poll: Ticks,
    /// Pending reset.
    pub reset: Option<Reset>,
    /// System registers of the processor, by offset: VTOR, CCR, SHCSR.
    pub system: std::collections::HashMap<u32, u32>,
    /// Cycles since power-on.
    pub cycles: u64,
    /// Cycle counter of the processor.
    pub cycle_counter: CycleCounter,
    ticks_per_cycle: Ticks,
    /// Writes of the DMA to memory, which the machine carries out.
    pub transfers: Vec<Transfer>,
}

impl Chip {
    /// Chip at power-on.
    pub fn new(pins: Pins, pages: flash::Pages) -> Self {
        let mut chip = Self {
            file: RegisterFile::default(),
            log: Log::default(),
            nvic: Nvic::default(),
            mpu: Mpu::default(),
            hrtim: Hrtim::default(),
            serial: Serial::default(),
            usb: Usb::new(),
            flash: FlashController::with(pages),
            watchdog: Watchdog::default(),
            random: Random::new(1),
            pins,
            lsi: Lsi::default(),
            supply_v: NOMINAL_SUPPLY_V,
            late_transfers: 0,
            loses_triggers: false,
            trigger_is_lost: false,
            adcs: [0, 1, 2, ADC4].map(Converter::new),
            oscillators: Oscillators::default(),
            checksum: Checksum::default(),
            capture: Capture::default(),
            timer_2: Timer2::default(),
            dma: Dma::default(),
            conversions: Vec::new(),
            next_trigger: None,
            happened_at: 0,
            reported_page_word: None,
            next_usb_poll: 0,
            reset: None,
            system: std::collections::HashMap::new(),
            cycles: 0,
            cycle_counter: CycleCounter::default(),
            ticks_per_cycle: 85,
            transfers: Vec::new(),
        };
        chip.after_reset(Reset::Power);
        chip
    }

    /// Sets a field of the option bytes, for tests.
    pub fn set_option(&mut self, option: Field, value: u32) {
        self.file.set(option, value);
    }

    /// Resets everything but memory, time and the circuits outside.
    pub fn after_reset(&mut self, why: Reset) {
        let options = self.file.word(reg::flash::flash_optr::ADDRESS);
        let flags = self.file.word(reg::rcc::rcc_csr::ADDRESS) & 0xFE00_0000;
        let was_on = self.hrtim.bridge(&self.file) != Bridge::Open;
        let kept_by_debug = KEPT_BY_DEBUG.map(|address| (address, self.file.word(address)));
        self.file = RegisterFile::default();
        if why != Reset::Power {
            for (address, value) in kept_by_debug {
                self.file.set_word(address, value);
            }
        }
        let (cause, options) = match why {
            Reset::Software => (reg::rcc::rcc_csr::SFTRSTF, options),
            Reset::Watchdog => (reg::rcc::rcc_csr::IWDGRSTF, options),
            Reset::Power => (
                reg::rcc::rcc_csr::BORRSTF,
                if options == 0 {
                    OPTIONS_OF_A_NEW_CHIP
                } else {
                    options
                },
            ),
        };
        let kept = if why == Reset::Power { 0 } else { flags };
        let pin = reg::rcc::rcc_csr::PINRSTF.mask();
        self.file
            .set_word(reg::rcc::rcc_csr::ADDRESS, kept | cause.mask() | pin);
        self.file.set_word(reg::flash::flash_optr::ADDRESS, options);
        // State as delivered: no page is write-protected, as each area's start lies after its end.
        for protection in [
            reg::flash::flash_wrp1ar::ADDRESS,
            reg::flash::flash_wrp1br::ADDRESS,
            reg::flash::flash_wrp2ar::ADDRESS,
            reg::flash::flash_wrp2br::ADDRESS,
        ] {
            self.file.set_word(protection, 0x7F);
        }
        let off_at = if was_on {
            Some(self.log.now)
        } else {
            self.hrtim.off_at
        };
        self.hrtim = Hrtim::default();
        self.hrtim.off_at = off_at;
        // Bytes on the line, already sent or not yet received, are outside the chip and stay.
        let line = std::mem::take(&mut self.serial);
        (self.serial.sent, self.serial.inbound) = (line.sent, line.inbound);
        self.usb = Usb::new();
        self.nvic = Nvic::default();
        self.mpu = Mpu::default();
        self.watchdog = self.watchdog.after_reset();
        self.random = self.random.after_reset();
        self.adcs = [0, 1, 2, ADC4].map(Converter::new);
        self.oscillators = Oscillators::default();
        self.checksum = Checksum::default();
        self.capture = Capture::default();
        self.timer_2 = Timer2::default();
        self.dma = Dma::default();
        self.conversions.clear();
        self.system.clear();
        if why == Reset::Power {
            self.cycle_counter = CycleCounter::default();
        }
        self.reset = None;
        self.ticks_per_cycle = clocks::ticks_per_cycle(&self.file);
        self.drive_pins();
    }

    /// Counts cycles in which the processor sleeps: its clock stops then, unless DBG_SLEEP is set (RM0440, 47.16.1).
    pub fn sleep(&mut self, cycles: u64) {
        if self.file.is(reg::dbgmcu::cr::DBG_SLEEP) {
            self.cycle_counter.run(cycles);
        }
    }

    /// Length of a cycle of the processor in ticks.
    pub fn ticks_per_cycle(&self) -> Ticks {
        self.ticks_per_cycle
    }

    /// Time of the next event.
    pub fn next_event(&self) -> Ticks {
        [
            self.next_trigger,
            self.hrtim.next_repetition(&self.file),
            self.conversions
                .iter()
                .map(|conversion| conversion.at)
                .min(),
            self.serial.next(&self.file),
            self.flash.next(),
            self.watchdog.bites_at,
            self.next_event_2(),
            Some(self.next_usb_poll),
        ]
        .into_iter()
        .flatten()
        .min()
        .unwrap_or(Ticks::MAX)
    }

    /// Processes all events that are due by now, each at its own time.
    pub fn advance(&mut self) {
        let now = self.log.now;
        while self.reset.is_none() {
            let at = self.next_event();
            if at > now {
                break;
            }
            // No event is earlier than the last one: bytes put on an idle line start now, not when it became idle.
            self.happened_at = self.happened_at.max(at);
            self.log.now = self.happened_at;
            self.happen();
        }
        self.happened_at = now;
        self.log.now = now;
        self.update_lines();
    }

    /// Processes the events that are due at this time.
    fn happen(&mut self) {
        let now = self.log.now;
        if self.watchdog.bites_at.is_some_and(|at| now >= at) {
            self.reset = Some(Reset::Watchdog);
            return;
        }
        while let Some(k) = self
            .conversions
            .iter()
            .position(|conversion| now >= conversion.at)
        {
            let done = self.conversions.swap_remove(k);
            match done.request {
                Some(request) => self.move_result(request, done.value),
                None => {
                    if self.adcs[ADC4].finish(done.value, &mut self.file) {
                        self.start_adc4();
                    }
                }
            }
        }
        if self
            .hrtim
            .next_repetition(&self.file)
            .is_some_and(|at| now >= at)
        {
            self.hrtim.repeat(&self.file, now);
            self.drive_pins();
        }
        if self.next_trigger.is_some_and(|at| now >= at) {
            self.trigger();
        }
        self.check_event_2();
        let hclk_hz = clocks::hclk_hz(&self.file);
        self.serial.advance(now, hclk_hz, &self.file);
        self.flash.advance(now, &mut self.file);
        if now >= self.next_usb_poll {
            let now_us = crate::time::seconds(now) * 1e6;
            self.usb.set_time(now_us);
            self.pins.usb.poll(&mut self.usb, now_us);
            self.next_usb_poll = now + USB_POLL;
        }
    }

    fn update_lines(&mut self) {
        for channel in 0..2 {
            let high = self.dma.line(channel, &self.file);
            self.nvic
                .set_line(dma::FIRST_INTERRUPT + channel as usize, high);
        }
        self.nvic
            .set_line(serial::INTERRUPT, self.serial.line(&self.file));
        self.nvic.set_line(USB_LP, self.usb.interrupt());
        self.nvic.set_line(FLASH, FlashController::line(&self.file));
    }

    /// Handles a halt of the core by a debugger, or its end: DBGMCU_APB2FZR decides whether HRTIM stops. ST's SVD calls the bit
    /// DBG_HRTIM0_STOP, its HAL DBG_HRTIM1_STOP.
    pub fn set_core_halted(&mut self, halted: bool) {
        let now = self.log.now;
        if !halted {
            self.hrtim.thaw(now);
            // Triggers that a debugger holds up are no fault of the program.
            self.adcs.iter_mut().for_each(|adc| adc.begin_idle(now));
        } else if self.file.is(reg::dbgmcu::apb2_fz::DBG_HRTIM0_STOP) {
            self.hrtim.freeze(now);
        }
        self.next_trigger = self.hrtim.next_trigger(&self.file, now);
        self.drive_pins();
    }

    /// Drives the bridge's pins, which carry HRTIM's outputs only in alternate function 13 (DS12288, table 13).
    fn drive_pins(&mut self) {
        let moder = self.file.word(reg::gpioa::moder::ADDRESS);
        let afrh = self.file.word(reg::gpioa::afrh::ADDRESS);
        let wired = moder >> 16 & 0xF == 0b1010 && afrh & 0xFF == 0xDD;
        let bridge = if wired {
            self.hrtim.bridge(&self.file)
        } else {
            Bridge::Open
        };
        self.pins.drive(bridge, self.hrtim.f_sw_hz());
    }
}
