//! Safe state of the chip, and what has led to it: for the crash handler, which may rely on nothing else.

use ihd_shared::fault::Fault;

use super::{led, nonvolatile, registers};

/// Opens both switches at once, whatever else goes on.
#[inline(always)]
pub fn outputs_off() {
    registers::bridge::open();
}

/// The system fault of the chip that has left a flag; `None` if none has.
pub fn system_fault() -> Option<Fault> {
    registers::faults::system_fault()
}

/// Returns `true` if an NMI is about a page of the lookup that is being read, and clears it.
pub fn is_damaged_page() -> bool {
    nonvolatile::is_damaged_page()
}

/// Stays for ever; the LED flashes the number of the fault.
pub fn stay(fault: u16) -> ! {
    led::flash_for_ever(fault)
}
