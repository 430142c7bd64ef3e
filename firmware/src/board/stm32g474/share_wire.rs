//! Wire to the other zone of a shared supply: open drain, with the chip's pull-down; one of the two boards has a resistor to 3.3 V.

use embassy_stm32::gpio::{Level, OutputOpenDrain, Pull, Speed};
use ihd_firmware::link::housekeeping::Housekeeping;
use ihd_firmware::sampling::path::SamplingLock;
use ihd_shared::board::SHARE_WIRE_PIN;

use super::pins::of_board;

/// The wire's end.
pub struct ShareWire(OutputOpenDrain<'static>);

impl ShareWire {
    /// Not pulled by this board.
    pub fn new() -> Self {
        let pin = of_board(SHARE_WIRE_PIN);
        Self(OutputOpenDrain::new_pull(
            pin,
            Level::High,
            Speed::Low,
            Pull::Down,
        ))
    }

    /// Reads the wire, and pulls it or lets go; called every millisecond.
    pub fn exchange(&mut self, housekeeping: &mut Housekeeping, path: &mut impl SamplingLock) {
        let pulls = housekeeping.share_supply(path, self.0.is_high());
        self.0.set_level((!pulls).into());
    }
}
