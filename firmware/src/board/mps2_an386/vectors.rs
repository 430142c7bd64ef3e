//! The interrupts in use and their vectors. QEMU's an386 wires UART 0 to lines 0 and 1 and timer 0
//! to line 8 (hw/arm/mps2.c).

use cortex_m::interrupt::InterruptNumber;

/// An interrupt line.
#[derive(Clone, Copy)]
#[repr(u16)]
pub enum Interrupt {
    /// A byte came in.
    Uart0Receive = 0,
    /// The tick that stands for the ADC's DMA; the sampling executor runs in it.
    Timer0 = 8,
}

// SAFETY: the numbers are lines of the NVIC, one each.
unsafe impl InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        self as u16
    }
}

/// One entry of the vector table.
#[derive(Clone, Copy)]
pub union Vector {
    handler: unsafe extern "C" fn(),
    reserved: usize,
}

unsafe extern "C" {
    fn DefaultHandler();
    fn UART0_RECEIVE();
    fn TIMER0();
}

const LINES: usize = 32;

/// The table behind the processor's own exceptions; link.x looks for this name.
#[unsafe(link_section = ".vector_table.interrupts")]
#[unsafe(no_mangle)]
pub static __INTERRUPTS: [Vector; LINES] = {
    let mut table = [Vector { reserved: 0 }; LINES];
    let mut line = 0;
    while line < LINES {
        table[line] = Vector {
            handler: DefaultHandler,
        };
        line += 1;
    }
    table[Interrupt::Uart0Receive as usize].handler = UART0_RECEIVE;
    table[Interrupt::Timer0 as usize].handler = TIMER0;
    table
};
