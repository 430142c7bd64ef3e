//! The two pages of the last good lookup: the last two pages of the second flash bank. The program
//! runs from the first bank and is not held up while these are erased.

use core::sync::atomic::{AtomicBool, Ordering, compiler_fence};

use embassy_stm32::flash::{Blocking, Error, Flash};
use ihd_firmware::nonvolatile::{self, RECORD_BYTES};

use super::registers;

const PAGE: u32 = 2 * 1024;

/// Beyond what memory.x gives to the program.
const FIRST: u32 = 508 * 1024;

const _: () = assert!(RECORD_BYTES <= PAGE as usize);

/// The flash behind the pages; none where it has one bank, as then a page has another size, and the program
/// would stand still while one is erased.
pub struct LookupPages(pub Option<Flash<'static, Blocking>>);

/// A page is being read.
static READING: AtomicBool = AtomicBool::new(false);
/// A word with two wrong bits was found in it.
static DAMAGED: AtomicBool = AtomicBool::new(false);

/// Whether an NMI is about a page that is being read, which the reader takes for an empty one from then on:
/// the power went while a word was being written or erased. Nothing else is in the second bank.
pub fn is_damaged_page() -> bool {
    let ours = READING.load(Ordering::Relaxed) && registers::supply::take_error_in_bank_2();
    if ours {
        DAMAGED.store(true, Ordering::Relaxed);
    }
    ours
}

fn offset(page: usize) -> u32 {
    FIRST + PAGE * (page as u32 & 1)
}

impl nonvolatile::Flash for LookupPages {
    type Error = Error;

    fn read(&mut self, page: usize, out: &mut [u8; RECORD_BYTES]) {
        DAMAGED.store(false, Ordering::Relaxed);
        READING.store(true, Ordering::SeqCst);
        compiler_fence(Ordering::SeqCst);
        let read = self.flash().map(|f| f.blocking_read(offset(page), out));
        compiler_fence(Ordering::SeqCst);
        // The NMI of the last word comes before the next instruction.
        cortex_m::asm::dsb();
        cortex_m::asm::isb();
        READING.store(false, Ordering::SeqCst);
        if !matches!(read, Ok(Ok(()))) || DAMAGED.load(Ordering::SeqCst) {
            // An erased page, which is no lookup.
            out.fill(0xFF);
        }
    }

    fn erase(&mut self, page: usize) -> Result<(), Error> {
        self.flash()?
            .blocking_erase(offset(page), offset(page) + PAGE)
    }

    fn write(&mut self, page: usize, at: usize, bytes: &[u8]) -> Result<(), Error> {
        self.flash()?
            .blocking_write(offset(page) + at as u32, bytes)
    }
}

impl LookupPages {
    fn flash(&mut self) -> Result<&mut Flash<'static, Blocking>, Error> {
        self.0.as_mut().ok_or(Error::Protected)
    }
}
