//! Emulated STM32G474 that runs the flash image, with the simulated power stage at its pins.

pub use unicorn_engine::RegisterARM;

pub mod bench;
pub mod chip;
pub mod cpu;
pub mod debugged;
pub mod image;
pub mod machine;
pub mod pins;
pub mod processor;
pub mod registers;
pub mod server;
pub mod time;
pub mod usb;
pub mod violation;
