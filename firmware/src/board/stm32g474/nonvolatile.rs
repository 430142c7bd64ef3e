//! The two pages of the last good lookup: the last two pages of the second flash bank. The program
//! runs from the first bank and is not held up while these are erased.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering, compiler_fence};

use embassy_futures::select::{Either, select};
use embassy_stm32::flash::{Async, Error, Flash};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use ihd_firmware::retained::nonvolatile::{self, RECORD_BYTES, RecordPlace};
use ihd_shared::image::{FLASH_ADDRESS, LOOKUP_ADDRESS, PAGE_BYTES};
use ihd_shared::lookup::RlLookup;

use super::registers;

/// Offset of the first page in the flash: beyond what memory.x gives to the program.
const FIRST: u32 = LOOKUP_ADDRESS - FLASH_ADDRESS;

const _: () = assert!(RECORD_BYTES <= PAGE_BYTES as usize);

/// The pages, and the place of the newest lookup in them.
pub struct LookupPages {
    pages: BankPages,
    newest: Option<RecordPlace>,
}

/// The flash behind the pages; none where it has one bank, as then a page has another size, and the program
/// would stand still while one is erased.
struct BankPages(Option<Flash<'static, Async>>);

/// The lookup that is to be kept; a newer one replaces it.
pub static TO_KEEP: Signal<CriticalSectionRawMutex, RlLookup> = Signal::new();

/// Asks the task whether it runs; it answers by counting.
pub static ASKED: Signal<CriticalSectionRawMutex, ()> = Signal::new();

/// Answers so far.
static ANSWERS: AtomicU32 = AtomicU32::new(0);

/// See [`ASKED`].
pub fn answers() -> u32 {
    ANSWERS.load(Ordering::Relaxed)
}

/// Keeps lookups, beside everything else: an erasure takes 22 ms, in which control and watchdog go on.
#[embassy_executor::task]
pub async fn keep(mut pages: LookupPages) -> ! {
    loop {
        // The question first: however often lookups come, it is answered between two.
        let (version, mut record) = match select(ASKED.wait(), TO_KEEP.wait()).await {
            Either::First(()) => {
                ANSWERS.store(answers().wrapping_add(1), Ordering::Relaxed);
                continue;
            }
            Either::Second(lookup) => (lookup.version, nonvolatile::record_of(&lookup)),
        };
        if nonvolatile::save(&mut pages.pages, &mut pages.newest, &mut record)
            .await
            .is_err()
        {
            // Not tried again: the lookup is still active, and is pushed again.
            defmt::warn!("lookup {=u32} was not kept", version);
        }
    }
}

/// A page is being read.
static READING: AtomicBool = AtomicBool::new(false);
/// A word with two wrong bits was found in it.
static DAMAGED: AtomicBool = AtomicBool::new(false);

/// Returns `true` if an NMI is about a page that is being read, which the reader takes for an empty one from then on:
/// the power went while a word was being written or erased. Nothing else is in the second bank.
pub fn is_damaged_page() -> bool {
    let ours = READING.load(Ordering::Relaxed) && registers::supply::take_error_in_bank_2();
    if ours {
        DAMAGED.store(true, Ordering::Relaxed);
    }
    ours
}

fn offset(page: usize) -> u32 {
    FIRST + PAGE_BYTES * (page as u32 & 1)
}

impl nonvolatile::Flash for BankPages {
    type Error = Error;

    /// A record without a sequence, which is no lookup, if the page is damaged or a switch is closed: a damaged word opens the bridge
    /// (SYSCFG_CFGR2, ECCL), and HRTIM's flag would be taken for another fault's. Interrupts, which close switches, are masked for 5 µs.
    fn read(&mut self, page: usize, out: &mut [u8; RECORD_BYTES]) {
        let is_read = critical_section::with(|_| {
            registers::faults::are_outputs_off() && self.read_masked(page, out)
        });
        if !is_read {
            out[..nonvolatile::WORD].fill(0xFF);
        }
        if DAMAGED.swap(false, Ordering::SeqCst) {
            defmt::warn!("lookup page {=usize} is damaged", page);
        }
    }

    async fn erase(&mut self, page: usize) -> Result<(), Error> {
        let end = offset(page) + PAGE_BYTES;
        self.flash()?.erase(offset(page), end).await
    }

    async fn write(&mut self, page: usize, at: usize, bytes: &[u8]) -> Result<(), Error> {
        let begin = offset(page) + at as u32;
        self.flash()?.write(begin, bytes).await
    }
}

impl BankPages {
    /// Reads a page with both switches open; returns `false` if it is damaged.
    fn read_masked(&mut self, page: usize, out: &mut [u8; RECORD_BYTES]) -> bool {
        registers::supply::forget_corrected_bits();
        READING.store(true, Ordering::SeqCst);
        compiler_fence(Ordering::SeqCst);
        let read = self.flash().map(|f| f.blocking_read(offset(page), out));
        compiler_fence(Ordering::SeqCst);
        // The NMI of the last word comes before the next instruction.
        cortex_m::asm::dsb();
        cortex_m::asm::isb();
        READING.store(false, Ordering::SeqCst);
        matches!(read, Ok(Ok(()))) && !DAMAGED.load(Ordering::SeqCst)
    }

    fn flash(&mut self) -> Result<&mut Flash<'static, Async>, Error> {
        self.0.as_mut().ok_or(Error::Protected)
    }
}

impl LookupPages {
    /// Returns the pages, and the lookup that they hold.
    pub fn load(flash: Option<Flash<'static, Async>>) -> (Self, Option<RlLookup>) {
        let mut pages = BankPages(flash);
        let (newest, lookup) = nonvolatile::load(&mut pages).unzip();
        (Self { pages, newest }, lookup)
    }
}
