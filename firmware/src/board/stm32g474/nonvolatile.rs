//! The two pages of the last good lookup: the last two pages of the second flash bank. The program
//! runs from the first bank and is not held up while these are erased.

use embassy_stm32::flash::{Blocking, Error, Flash};
use ihd_firmware::nonvolatile::{self, RECORD_BYTES};

const PAGE: u32 = 2 * 1024;

/// Beyond what memory.x gives to the program.
const FIRST: u32 = 508 * 1024;

const _: () = assert!(RECORD_BYTES <= PAGE as usize);

/// The flash behind the pages.
pub struct LookupPages(pub Flash<'static, Blocking>);

fn offset(page: usize) -> u32 {
    FIRST + PAGE * (page as u32 & 1)
}

impl nonvolatile::Flash for LookupPages {
    type Error = Error;

    fn read(&mut self, page: usize, out: &mut [u8; RECORD_BYTES]) {
        if self.0.blocking_read(offset(page), out).is_err() {
            // An erased page, which is no lookup.
            out.fill(0xFF);
        }
    }

    fn erase(&mut self, page: usize) -> Result<(), Error> {
        self.0.blocking_erase(offset(page), offset(page) + PAGE)
    }

    fn write(&mut self, page: usize, at: usize, bytes: &[u8]) -> Result<(), Error> {
        self.0.blocking_write(offset(page) + at as u32, bytes)
    }
}
