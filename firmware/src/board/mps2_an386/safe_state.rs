//! Safe state of a board without a power stage, for the crash handler.

/// Does nothing: there are no outputs.
pub fn outputs_off() {}

/// Stays for ever.
pub fn stay(_fault: u16) -> ! {
    loop {
        cortex_m::asm::wfe();
    }
}
