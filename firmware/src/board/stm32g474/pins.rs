//! Pins that the board's file chooses.

use embassy_stm32::Peri;
use embassy_stm32::gpio::{AnyPin, Level, Output, Speed};
use ihd_shared::board::Pin;

/// Pin of the file.
pub fn of_board(pin: Pin) -> Peri<'static, AnyPin> {
    // SAFETY: the file's pins differ from one another and from those that start.rs takes by name (boards/src/pins.rs), and each
    // is asked for once.
    unsafe { AnyPin::steal(pin.port * 16 + pin.line) }
}

/// Output at a pin of the file, low at first: a light or a fan that is off.
pub fn low_output(pin: Pin) -> Output<'static> {
    Output::new(of_board(pin), Level::Low, Speed::Low)
}
