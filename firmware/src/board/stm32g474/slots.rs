//! The two slots of the last good lookup: the last two pages of the second flash bank. The program
//! runs from the first bank and is not held up while these are erased.

use embassy_stm32::flash::{Blocking, Error, Flash};
use ihd_firmware::store::{self, SLOT_BYTES};

const PAGE: u32 = 2 * 1024;

/// Beyond what memory.x gives to the program.
const FIRST: u32 = 508 * 1024;

const _: () = assert!(SLOT_BYTES <= PAGE as usize);

/// The flash behind the slots.
pub struct Slots(pub Flash<'static, Blocking>);

fn offset(slot: usize) -> u32 {
    FIRST + PAGE * (slot as u32 & 1)
}

impl store::Flash for Slots {
    type Error = Error;

    fn read(&mut self, slot: usize, out: &mut [u8; SLOT_BYTES]) {
        if self.0.blocking_read(offset(slot), out).is_err() {
            // An erased slot, which is no lookup.
            out.fill(0xFF);
        }
    }

    fn erase(&mut self, slot: usize) -> Result<(), Error> {
        self.0.blocking_erase(offset(slot), offset(slot) + PAGE)
    }

    fn write(&mut self, slot: usize, at: usize, bytes: &[u8]) -> Result<(), Error> {
        self.0.blocking_write(offset(slot) + at as u32, bytes)
    }
}
