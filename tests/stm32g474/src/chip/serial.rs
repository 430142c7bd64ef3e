//! LPUART1 at the baud rate of BRR (RM0440, 38).

use std::collections::VecDeque;

use crate::registers::{lpuart1, rcc};
use crate::time::{TICKS_PER_S, Ticks};
use crate::violation::Log;

use super::ports::carries;
use super::register_file::RegisterFile;

/// Interrupt number (RM0440, 14.3, vector table).
pub const INTERRUPT: usize = 91;

/// Lines of port A that are wired, PA2 and PA3, and the alternate function that leads LPUART1 to them (DS12288, table 13).
const TRANSMIT_LINE: u8 = 2;
const RECEIVE_LINE: u8 = 3;
const FUNCTION: u32 = 12;

/// Bits on the line for a byte: start, 8, stop.
const FRAME_BITS: u64 = 10;

/// Serial port with both ends of its line.
#[derive(Clone, Debug)]
pub struct Serial {
    /// Bytes that the chip has sent.
    pub sent: VecDeque<u8>,
    /// Bytes on their way to the chip.
    pub inbound: VecDeque<u8>,
    shifting: Option<(u8, Ticks)>,
    holding: VecDeque<u8>,
    received: VecDeque<u8>,
    next_receive: Ticks,
    overrun: bool,
    complete: bool,
    /// Time at which the line has been idle for one byte; `idle` is the flag.
    idle_at: Option<Ticks>,
    idle: bool,
}

impl Default for Serial {
    fn default() -> Self {
        Self {
            sent: VecDeque::new(),
            inbound: VecDeque::new(),
            shifting: None,
            holding: VecDeque::new(),
            received: VecDeque::new(),
            next_receive: 0,
            overrun: false,
            // ISR after reset: transmission complete.
            complete: true,
            idle_at: None,
            idle: false,
        }
    }
}

impl Serial {
    /// Duration of a byte.
    fn byte_ticks(file: &RegisterFile, hclk_hz: u64) -> Ticks {
        // RCC_CCIPR (RM0440, 7.4.27): 0 is PCLK, 2 is HSI16; the image has no LSE, and SYSCLK is PCLK.
        let hz = if file.get(rcc::rcc_ccipr::LPUART1SEL) == 2 {
            16_000_000
        } else {
            hclk_hz
        };
        // BRR = 256 · clock / baud (RM0440, 38.4.7); PRESC is not used here.
        let brr = u64::from(file.get(lpuart1::brr::BRR)).max(0x300);
        FRAME_BITS * brr * TICKS_PER_S / (256 * hz.max(1))
    }

    fn is_on(file: &RegisterFile) -> bool {
        file.is(lpuart1::cr1::UE)
    }

    /// Capacity of each direction in bytes: the data register alone, or the FIFO (RM0440, 38.4.3: 8 bytes).
    fn depth(file: &RegisterFile) -> usize {
        if file.is(lpuart1::cr1::FIFOEN) { 8 } else { 1 }
    }

    /// Time of the next event.
    pub fn next(&self, file: &RegisterFile) -> Option<Ticks> {
        let sending = self.shifting.map(|(_, until)| until);
        let receiving =
            (Self::is_on(file) && file.is(lpuart1::cr1::RE) && !self.inbound.is_empty())
                .then_some(self.next_receive);
        sending
            .into_iter()
            .chain(receiving)
            .chain(self.idle_at)
            .min()
    }

    /// Processes the events that are due.
    pub fn advance(&mut self, now: Ticks, hclk_hz: u64, file: &RegisterFile) {
        if let Some((byte, until)) = self.shifting
            && now >= until
        {
            // Otherwise nobody sees it.
            if carries(TRANSMIT_LINE, FUNCTION, file) {
                self.sent.push_back(byte);
            }
            self.shifting = None;
            self.complete = self.holding.is_empty();
            if let Some(next) = self.holding.pop_front() {
                self.shifting = Some((next, until + Self::byte_ticks(file, hclk_hz)));
            }
        }
        let listening = Self::is_on(file) && file.is(lpuart1::cr1::RE);
        if listening
            && now >= self.next_receive
            && let Some(byte) = self.inbound.pop_front()
        {
            // Without room the byte is lost (ORE).
            if self.received.len() >= Self::depth(file) {
                self.overrun = true;
            } else if carries(RECEIVE_LINE, FUNCTION, file) {
                self.received.push_back(byte);
            }
            self.next_receive = now + Self::byte_ticks(file, hclk_hz);
            self.idle_at = Some(self.next_receive);
        } else if self.idle_at.is_some_and(|at| now >= at) {
            self.idle_at = None;
            self.idle = listening;
        }
    }

    /// Level of the interrupt line.
    pub fn line(&self, file: &RegisterFile) -> bool {
        use lpuart1::{cr1, cr3};
        (file.is(cr1::TXEIE) && self.holding.len() < Self::depth(file) && Self::is_on(file))
            || (file.is(cr1::TCIE) && self.complete)
            || (file.is(cr1::RXNEIE) && (!self.received.is_empty() || self.overrun))
            || (file.is(cr1::IDLEIE) && self.idle)
            || (file.is(cr3::EIE) && self.overrun)
    }

    /// Reads a register; a read of RDR removes the byte.
    pub fn read(&mut self, address: u32, file: &RegisterFile) -> u32 {
        use lpuart1::isr;
        match address {
            isr::ADDRESS => {
                let mut word = 0;
                for (field, set) in [
                    (isr::TXE, self.holding.len() < Self::depth(file)),
                    (isr::TC, self.shifting.is_none() && self.complete),
                    (isr::RXNE, !self.received.is_empty()),
                    (isr::ORE, self.overrun),
                    (isr::IDLE, self.idle),
                    (isr::TEACK, file.is(lpuart1::cr1::TE)),
                    (isr::REACK, file.is(lpuart1::cr1::RE)),
                    (isr::BUSY, self.shifting.is_some()),
                ] {
                    word = field.put(word, u32::from(set));
                }
                word
            }
            lpuart1::rdr::ADDRESS => self.received.pop_front().map_or(0, u32::from),
            _ => file.word(address),
        }
    }

    /// Handles a write.
    pub fn write(
        &mut self,
        address: u32,
        value: u32,
        hclk_hz: u64,
        file: &RegisterFile,
        log: &mut Log,
    ) {
        match address {
            lpuart1::tdr::ADDRESS => {
                if !Self::is_on(file) || !file.is(lpuart1::cr1::TE) {
                    log.broken("LPUART1 TDR written while the transmitter is off (RM0440 38.4.5)");
                } else if self.holding.len() >= Self::depth(file) {
                    log.broken(
                        "LPUART1 TDR written while TXE is 0: a byte is lost (RM0440 38.4.5)",
                    );
                }
                let byte = value as u8;
                if self.shifting.is_none() {
                    self.shifting = Some((byte, log.now + Self::byte_ticks(file, hclk_hz)));
                } else {
                    self.holding.push_back(byte);
                }
                self.complete = false;
            }
            lpuart1::icr::ADDRESS => {
                self.overrun &= lpuart1::icr::ORECF.extract(value) == 0;
                self.complete &= lpuart1::icr::TCCF.extract(value) == 0;
                self.idle &= lpuart1::icr::IDLECF.extract(value) == 0;
            }
            lpuart1::brr::ADDRESS if Self::is_on(file) => {
                log.broken("LPUART1 BRR written while UE is 1 (RM0440 38.7.5)");
            }
            _ => {}
        }
    }
}
