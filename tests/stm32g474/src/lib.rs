//! An emulated STM32G474 that runs the flash image, with the simulated power stage on its pins.

pub mod registers;
pub mod usb;
