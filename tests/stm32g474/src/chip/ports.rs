//! Ports A to C: what the program makes of their lines (RM0440, 9).

use ihd_shared::board::{Pin, SHARE_WIRE_PIN};

use super::Chip;
use super::register_file::RegisterFile;
use crate::registers as reg;

/// Address distance between the registers of two neighbouring ports.
pub(super) const PORT_BYTES: u32 = 0x400;

/// Values of MODER.
const OUTPUT: u32 = 1;
const ALTERNATE: u32 = 2;

/// Address of a port's register, by that of port A.
fn of_port(of_port_a: u32, port: u8) -> u32 {
    of_port_a + PORT_BYTES * u32::from(port)
}

/// Mode of a line.
fn mode(pin: Pin, file: &RegisterFile) -> u32 {
    file.word(of_port(reg::gpioa::moder::ADDRESS, pin.port)) >> (2 * pin.line) & 3
}

/// Returns `true` if a line of port A carries a peripheral by this alternate function.
pub fn carries(line: u8, function: u32, file: &RegisterFile) -> bool {
    let (register, place) = match line {
        0..8 => (reg::gpioa::afrl::ADDRESS, line),
        _ => (reg::gpioa::afrh::ADDRESS, line - 8),
    };
    let selected = file.word(register) >> (4 * place) & 0xF;
    mode(Pin { port: 0, line }, file) == ALTERNATE && selected == function
}

impl Chip {
    /// Input levels of a port, 0 for A.
    pub(super) fn levels(&self, port: u8) -> u32 {
        // GPIOx_PUPDR: 1 is a pull-up.
        let pulls = self.file.word(of_port(reg::gpioa::pupdr::ADDRESS, port));
        let pulled_up = (0..16).filter(|line| pulls >> (2 * line) & 3 == 1);
        let pulled_up = pulled_up.map(|line| 1 << line).sum();
        let outputs = (0..16).filter(|&line| mode(Pin { port, line }, &self.file) == OUTPUT);
        let outputs: u32 = outputs.map(|line| 1 << line).sum();
        let levels = self.file.word(of_port(reg::gpioa::odr::ADDRESS, port));
        self.pins.levels(port, pulled_up, levels | !outputs)
    }

    /// Output level that the program drives at a pin; low if it is no output.
    pub fn driven(&self, pin: Pin) -> bool {
        let levels = self.file.word(of_port(reg::gpioa::odr::ADDRESS, pin.port));
        mode(pin, &self.file) == OUTPUT && levels >> pin.line & 1 == 1
    }

    /// Checks the wire to a second zone, which either board may pull low and neither drives high.
    pub(super) fn check_share_wire(&mut self) {
        let pin = SHARE_WIRE_PIN;
        let types = self
            .file
            .word(of_port(reg::gpioa::otyper::ADDRESS, pin.port));
        if mode(pin, &self.file) == OUTPUT && types >> pin.line & 1 == 0 {
            self.log
                .broken("the wire to a second zone is an output without open drain (RM0440 9.4.2)");
        }
    }
}
