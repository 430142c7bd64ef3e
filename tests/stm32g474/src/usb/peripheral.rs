//! USB full-speed device of the chip (RM0440, chapter 45): registers, packet memory, interrupt.
//!
//! The program's side is [`Usb::read`], [`Usb::write`], [`Usb::pma_read`], [`Usb::pma_write`] and
//! [`Usb::interrupt`]; the bus's side is the trait [`Device`]. Violations of the manual are logged in
//! [`Usb::violations`].

use crate::registers::Field;
use crate::registers::usb_fs_device::{BASE, cntr, daddr, ep0r, ep7r, fnr, istr};

use super::bus::{Answer, Device, Handshake, Toggle};
use super::endpoint::{self, Endpoint, STALL, VALID};
use super::packet_memory::{self, Buffer, PacketMemory};

mod bus_side;
#[cfg(test)]
mod tests;

/// Number of endpoint registers.
const ENDPOINTS: usize = 8;

const LAST_EPNR: u32 = ep7r::ADDRESS - BASE;
const CNTR: u32 = cntr::ADDRESS - BASE;
const ISTR: u32 = istr::ADDRESS - BASE;
const FNR: u32 = fnr::ADDRESS - BASE;
const DADDR: u32 = daddr::ADDRESS - BASE;
const BTABLE: u32 = 0x50;
/// Offset of LPMCSR; ST's SVD lacks this register and BCDR.
const LPMCSR: u32 = 0x54;
const BCDR: u32 = 0x58;

/// BCDR.DPPU: the pull-up on D+.
const PULL_UP: u32 = 1 << 15;
/// BCDR's bits that a program may write: DPPU, SDEN, PDEN, DCDEN, BCDEN.
const BCDR_WRITTEN: u32 = PULL_UP | 0xF;
/// LPMCSR.LPMEN.
const LPM_ENABLED: u32 = 1;

/// tSTARTUP: minimum time between leaving power-down and lifting the reset (RM0440, 45.5.2).
const STARTUP_US: f64 = 1.0;

/// Flags of USB_ISTR that a written 0 clears; CTR, DIR and EP_ID follow the endpoint registers.
const CLEARED: u32 = istr::PMAOVR.mask()
    | istr::ERR.mask()
    | istr::WKUP.mask()
    | istr::SUSP.mask()
    | istr::RESET.mask()
    | istr::SOF.mask()
    | istr::ESOF.mask()
    | istr::L1REQ.mask();

/// USB peripheral of the chip.
pub struct Usb {
    /// Violations of the manual by the program, each once.
    pub violations: Vec<String>,
    endpoints: [Endpoint; ENDPOINTS],
    memory: PacketMemory,
    control: u32,
    flags: u32,
    frame: u32,
    address: u32,
    power_management: u32,
    charging: u32,
    /// Milliseconds without a frame.
    silent: u32,
    /// Number of frames since the last silence, up to three.
    frames: u32,
    now_us: Option<f64>,
    powered_us: Option<f64>,
}

impl Default for Usb {
    fn default() -> Self {
        Self::new()
    }
}

impl Usb {
    /// Peripheral after a reset of the chip: powered down, with its logic held in reset.
    pub fn new() -> Self {
        Self {
            violations: Vec::new(),
            endpoints: [Endpoint::default(); ENDPOINTS],
            memory: PacketMemory::default(),
            control: cntr::FRES.mask() | cntr::PDWN.mask(),
            flags: 0,
            frame: 0,
            address: 0,
            power_management: 0,
            charging: 0,
            silent: 0,
            frames: 0,
            now_us: None,
            powered_us: None,
        }
    }

    /// Sets the time of the next access; without it, start-up times are not checked.
    pub fn set_time(&mut self, now_us: f64) {
        self.now_us = Some(now_us);
    }

    /// Reads the register at `offset`.
    pub fn read(&mut self, offset: u32) -> u32 {
        match offset {
            0..=LAST_EPNR if offset.is_multiple_of(4) => {
                let index = (offset / 4) as usize;
                self.endpoints[index].read()
            }
            CNTR => self.control,
            ISTR => self.status(),
            FNR => self.frame_register(),
            DADDR => self.address,
            BTABLE => self.memory.table as u32,
            LPMCSR => self.power_management,
            BCDR => self.charging,
            _ => {
                self.report(format!(
                    "reads offset {offset:#x}, where there is no register"
                ));
                0
            }
        }
    }

    /// Writes the register at `offset`.
    pub fn write(&mut self, offset: u32, value: u32) {
        match offset {
            0..=LAST_EPNR if offset.is_multiple_of(4) => {
                self.write_endpoint((offset / 4) as usize, value);
            }
            CNTR => self.write_control(value),
            ISTR => self.flags &= value | !CLEARED,
            DADDR => self.address = value & (daddr::ADD.mask() | daddr::EF.mask()),
            BTABLE if value.is_multiple_of(8) && value < packet_memory::SIZE as u32 => {
                self.memory.table = value as usize;
            }
            LPMCSR => {
                if value & LPM_ENABLED != 0 {
                    self.report("link power management is not modelled");
                }
                self.power_management = value & 0xB;
            }
            BCDR => self.write_charging(value),
            _ => self.report(format!("writes {value:#x} to offset {offset:#x}")),
        }
    }

    /// Reads `size` bytes of packet memory.
    pub fn pma_read(&mut self, offset: u32, size: usize) -> u32 {
        self.check_access("reads", offset, size);
        self.memory.read(offset as usize, size)
    }

    /// Writes `size` bytes of packet memory.
    pub fn pma_write(&mut self, offset: u32, size: usize, value: u32) {
        self.check_access("writes", offset, size);
        self.memory.write(offset as usize, size, value);
    }

    /// Returns `true` if the interrupt USB_LP is requested.
    pub fn interrupt(&self) -> bool {
        // The masks have the positions of the flags.
        let masks = CLEARED | istr::CTR.mask();
        self.status() & self.control & masks != 0
    }

    fn report(&mut self, text: impl Into<String>) {
        let text = format!("USB: {}", text.into());
        if !self.violations.contains(&text) {
            self.violations.push(text);
        }
    }

    fn on(&self, field: Field) -> bool {
        field.extract(self.control) != 0
    }

    fn status(&self) -> u32 {
        // The lowest number has priority: without isochronous or double-buffered endpoints there is one class only.
        let Some(index) = self.endpoints.iter().position(Endpoint::complete) else {
            return self.flags;
        };
        let received = self.endpoints[index].get(ep0r::CTR_RX);
        let status = istr::EP_ID.put(self.flags, index as u32);
        istr::CTR.put(istr::DIR.put(status, received), 1)
    }

    fn frame_register(&self) -> u32 {
        let lost = fnr::LSOF.put(0, self.silent.min(3));
        let locked = fnr::LCK.put(0, u32::from(self.frames >= 2));
        // The pull-up holds D+ high at rest.
        let line = fnr::RXDP.put(0, u32::from(self.attached()));
        fnr::FN.put(0, self.frame) | lost | locked | line
    }

    fn write_control(&mut self, value: u32) {
        let old = self.control;
        self.control = value & 0xFFBF;
        if cntr::PDWN.extract(old & !value) != 0 {
            self.powered_us = self.now_us;
        }
        let lifted = cntr::FRES.extract(old & !value) != 0;
        if lifted && self.on(cntr::PDWN) {
            self.report("the reset is lifted in power-down");
        }
        if let (true, Some(now), Some(since)) = (lifted, self.now_us, self.powered_us) {
            let passed = now - since;
            if passed < STARTUP_US {
                let late = "after power-down: tSTARTUP is 1 µs";
                self.report(format!("the reset is lifted {passed:.2} µs {late}"));
            }
        }
        if self.on(cntr::RESUME) || self.on(cntr::L1RESUME) {
            self.report("remote wake-up is not modelled");
        }
        // The reset holds for as long as FRES is set.
        if self.on(cntr::FRES) {
            self.reset();
        }
    }

    fn write_charging(&mut self, value: u32) {
        if value & PULL_UP != 0 && self.on(cntr::PDWN) {
            self.report("the pull-up is switched on in power-down");
        }
        if value & PULL_UP != 0 && self.on(cntr::FRES) {
            self.report("the pull-up is switched on while FRES is set");
        }
        if value & BCDR_WRITTEN & !PULL_UP != 0 {
            self.report("charger detection is not modelled");
        }
        self.charging = value & BCDR_WRITTEN;
    }

    fn write_endpoint(&mut self, index: usize, value: u32) {
        if self.on(cntr::FRES) {
            self.report(format!(
                "EP{index}R is written while FRES holds it in reset"
            ));
            return;
        }
        let before = self.endpoints[index];
        if let Some(wrong) = self.endpoints[index].write(value) {
            self.report(format!("EP{index}R = {value:#06x} {wrong}"));
        }
        let after = self.endpoints[index];
        let starts = |field| after.get(field) == VALID && before.get(field) != VALID;
        let (sent, received) = (self.memory.sent(index), self.memory.received(index));
        if starts(ep0r::STAT_TX) {
            self.check_buffer(index, "sends", sent);
        }
        if starts(ep0r::STAT_RX) {
            self.check_buffer(index, "receives", received);
            if received.length == 0 {
                self.report(format!("EP{index}R receives into a buffer without blocks"));
            }
        }
    }

    fn check_buffer(&mut self, index: usize, doing: &str, buffer: Buffer) {
        if let Some(defect) = self.memory.defect(index, buffer) {
            self.report(format!(
                "EP{index}R {doing} with a buffer {defect}: {buffer:?}"
            ));
        }
    }

    /// Checks an access of the program to packet memory: by half-words only, and not to a buffer that the hardware is about to use.
    fn check_access(&mut self, doing: &str, offset: u32, size: usize) {
        let start = offset as usize;
        if size != 2 || !start.is_multiple_of(2) {
            let access = format!("{doing} {size} bytes of packet memory at {offset:#x}");
            self.report(access + ": half-words only");
        }
        if start + size > packet_memory::SIZE {
            self.report(format!(
                "{doing} packet memory at {offset:#x}, beyond its end"
            ));
        }
        for index in 0..ENDPOINTS {
            let busy = |field| self.endpoints[index].get(field) == VALID;
            let sending = busy(ep0r::STAT_TX) && doing == "writes";
            let touched = (sending && self.memory.sent(index).touches(start, size))
                || (busy(ep0r::STAT_RX) && self.memory.received(index).touches(start, size));
            if touched {
                self.report(format!(
                    "{doing} the buffer of EP{index}R while it is VALID"
                ));
            }
        }
    }
}
