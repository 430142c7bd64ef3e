//! Wire to the other zone of a shared supply: open drain, with the chip's weak pulls; one of the two boards has a resistor to 3.3 V.

use embassy_stm32::gpio::{Flex, Pull, Speed};
use ihd_firmware::control::share_wire::WireDrive;
use ihd_firmware::link::housekeeping::Housekeeping;
use ihd_firmware::sampling::path::SamplingLock;
use ihd_shared::board::SHARE_WIRE_PIN;

use super::pins::of_board;

/// The wire's end.
pub struct ShareWire {
    pin: Flex<'static>,
    drive: WireDrive,
}

impl ShareWire {
    /// Not pulled by this board.
    pub fn new() -> Self {
        let mut wire = Self {
            pin: Flex::new(of_board(SHARE_WIRE_PIN)),
            drive: WireDrive::WeaklyDown,
        };
        wire.set(WireDrive::WeaklyDown);
        wire
    }

    /// Reads the wire, and pulls it or lets go; called every millisecond.
    pub fn exchange(&mut self, housekeeping: &mut Housekeeping, path: &mut impl SamplingLock) {
        let drive = housekeeping.share_supply(path, self.pin.is_high());
        if drive != self.drive {
            self.set(drive);
        }
    }

    fn set(&mut self, drive: WireDrive) {
        self.drive = drive;
        let pull = match drive {
            WireDrive::Low | WireDrive::WeaklyDown => Pull::Down,
            WireDrive::WeaklyUp => Pull::Up,
        };
        self.pin.set_level((drive != WireDrive::Low).into());
        self.pin.set_as_input_output_pull(Speed::Low, pull);
    }
}
