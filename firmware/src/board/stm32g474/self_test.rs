//! The self-tests that run in the thread: at start all at once, afterwards a slice every few blocks. What is tested before
//! `main`, RAM and watchdog, is in `start_up.rs`; the trip in `registers/comparators.rs`.

use core::arch::asm;
use core::{ptr, slice};

use embassy_stm32::Peri;
use embassy_stm32::crc::{Config, Crc, InputReverseConfig, PolySize};
use embassy_stm32::peripherals::CRC;
use ihd_firmware::link::housekeeping::Housekeeping;
use ihd_firmware::self_test::clock::{ClockCapture, ClockCheck};
use ihd_firmware::self_test::flow::{Flow, ProgramFlow, Task, TaskCounts};
use ihd_firmware::self_test::image::{CopyCheck, Crc32, ImageCheck};
use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::Clocks;

use super::adc::{sampled_cycles, written_by_dma};
use super::clock_count::ClockCount;
use super::nonvolatile::{ASKED, answers};
use super::registers::clocks::CORE_MHZ;
use super::registers::low_speed;
use crate::board::cycles;

/// Words of the image, and of a copy, that are looked at every [`SLICE_PERIOD_BLOCKS`] blocks: 131 KiB in 3 s at 34 kHz, the CCM SRAM in 1 s.
const SLICE_WORDS: usize = 64;
const SLICE_PERIOD_BLOCKS: u32 = 64;

/// Words of the RAM that are tested every [`SLICE_PERIOD_BLOCKS`] blocks: all 96 KiB in 4 s at 80 kHz, 9 s at 34 kHz. Interrupts are masked
/// for some 600 cycles, as long as for a copy of a chunk.
const RAM_SLICE_WORDS: usize = 16;

/// From one look at clock and lookup to the next: 1 s.
const SECOND_CYCLES: u32 = CORE_MHZ * 1_000_000;

/// Polls of a capture, which comes every 250 µs: in a loop of some 20 cycles at start, once a block later.
const PATIENCE_AT_START: u32 = 40_000;
const PATIENCE: u32 = 400;

/// Words at the end of the stack that nothing may have written to.
const CANARY_WORDS: usize = 32;

unsafe extern "C" {
    static __vector_table: u32;
    static __image_crc: u32;
    static __sccm: u32;
    static __eccm: u32;
    static __siccm: u32;
    static __stables: u32;
    static __etables: u32;
    static __sitables: u32;
    static _stack_end: u32;
    static __crash_record: u32;
}

/// Words from one symbol of the linker to another.
fn section_words(begin: *const u32, end: *const u32) -> &'static [u32] {
    let length = (end as usize).saturating_sub(begin as usize) / size_of::<u32>();
    // SAFETY: both are symbols of the same section in flash, CCM SRAM or RAM, which holds code and constants that are
    // not written after start-up has copied them.
    unsafe { slice::from_raw_parts(begin, length) }
}

/// The chip's CRC unit (RM0440, CRC): with both reversals and a complement it is the CRC-32 of zlib.
struct Unit(Crc<'static>);

impl Unit {
    const POLYNOMIAL: u32 = 0x04C1_1DB7;

    fn new(unit: Peri<'static, CRC>) -> Option<Self> {
        let (reversed, width) = (InputReverseConfig::Word, PolySize::Width32);
        let config = Config::new(reversed, true, width, u32::MAX, Self::POLYNOMIAL).ok()?;
        Some(Self(Crc::new(unit, config)))
    }
}

impl Crc32 for Unit {
    fn restart(&mut self) {
        self.0.reset();
    }
    fn feed(&mut self, words: &[u32]) {
        self.0.feed_words(words);
    }
    fn value(&self) -> u32 {
        !self.0.read()
    }
}

/// The program's length and its CRC, as it should be and as it was found at start.
#[derive(Clone, Copy, Default)]
pub struct ImageSeal {
    /// Bytes before the CRC.
    pub bytes: u32,
    /// CRC-32 as written there.
    pub sealed_crc: u32,
    /// CRC-32 as calculated.
    pub crc: u32,
}

/// Tests under way and their progress.
pub struct SelfTest {
    sealed: ImageSeal,
    counting: Option<ClockCount>,
    unit: Option<Unit>,
    image: ImageCheck,
    copies: [CopyCheck; 2],
    clock: ClockCheck,
    flow: ProgramFlow,
    turns: u32,
    sliced_at: u32,
    second_at: u32,
    checks_clock: bool,
    ram_at: usize,
}

impl SelfTest {
    /// Tests flash and clock; returns the faults.
    pub fn at_start(unit: Peri<'static, CRC>) -> (Self, [Option<Fault>; 2]) {
        // SAFETY: the linker's symbols; the CRC is read once, and is no variable.
        let (image, crc, copies) = unsafe {
            let image = section_words(&raw const __vector_table, &raw const __image_crc);
            let ccm = section_words(&raw const __sccm, &raw const __eccm);
            let tables = section_words(&raw const __stables, &raw const __etables);
            let end_of = |begin: *const u32, copy: &[u32]| {
                section_words(begin, begin.wrapping_add(copy.len()))
            };
            let copies = [
                CopyCheck::new(ccm, end_of(&raw const __siccm, ccm)),
                CopyCheck::new(tables, end_of(&raw const __sitables, tables)),
            ];
            (image, ptr::read_volatile(&raw const __image_crc), copies)
        };
        let mut this = Self {
            sealed: ImageSeal {
                bytes: size_of_val(image) as u32,
                sealed_crc: crc,
                crc: 0,
            },
            counting: None,
            unit: Unit::new(unit),
            image: ImageCheck::new(image, crc),
            copies,
            clock: ClockCheck::default(),
            flow: ProgramFlow::new(0, TaskCounts::default()),
            turns: 0,
            sliced_at: 0,
            second_at: 0,
            checks_clock: false,
            ram_at: &raw const _stack_end as usize,
        };
        let whole = this.unit.as_mut().is_some_and(|unit| this.image.run(unit));
        this.sealed.crc = this.unit.as_ref().map_or(0, Unit::value);
        low_speed::start();
        let agree = loop {
            let captured = low_speed::captured();
            if let Some(agree) = this.clock.take(captured, PATIENCE_AT_START) {
                break agree;
            }
        };
        let faults = [
            (!whole).then_some(Fault::FLASH_CRC),
            (!agree).then_some(Fault::CLOCK),
        ];
        (this, faults)
    }

    /// The program's length and CRC.
    pub fn sealed(&self) -> ImageSeal {
        self.sealed
    }

    /// Begins to count the clocks, beside the tests.
    pub fn begin_clocks(&mut self) {
        self.counting = Some(ClockCount::begin(cycles::now()));
    }

    /// Counts of the clocks, once they are long enough.
    pub fn clocks(&mut self) -> Option<Clocks> {
        let clocks = self.counting.as_ref()?.result(cycles::now());
        if clocks.is_some() {
            self.counting = None;
        }
        clocks
    }

    /// Blocks come from here on.
    pub fn begin(&mut self) {
        let now = cycles::now();
        self.second_at = sampled_cycles();
        self.flow = ProgramFlow::new(now, self.counts(0));
        ASKED.signal(());
    }

    /// Returns `true` if each task ran at its rate in the last window.
    pub fn is_flow_right(&self) -> bool {
        self.flow.is_right()
    }

    /// A turn of housekeeping, after `blocks` blocks since boot; what is wrong.
    pub fn after_block(&mut self, housekeeping: &Housekeeping, blocks: u32) -> Option<Fault> {
        self.turns = self.turns.wrapping_add(1);
        let now = cycles::now();
        let rate = match self.flow.check(now, self.counts(blocks)) {
            Flow::Pending => None,
            Flow::Passed => {
                ASKED.signal(());
                None
            }
            Flow::Failed(task) => {
                defmt::error!("program flow: task {=u8}", task as u8);
                // Where it has not answered it is not asked again.
                if task != Task::Keep {
                    ASKED.signal(());
                }
                Some(Fault::PROGRAM_FLOW)
            }
        };
        rate.or_else(|| self.each_second(housekeeping, now))
            .or_else(|| self.slice(blocks))
    }

    fn counts(&self, blocks: u32) -> TaskCounts {
        TaskCounts {
            sampled_cycles: sampled_cycles(),
            blocks,
            turns: self.turns,
            answers: answers(),
        }
    }

    fn each_second(&mut self, housekeeping: &Housekeeping, now: u32) -> Option<Fault> {
        // A capture can be read once.
        let in_use = self.checks_clock || self.counting.is_some();
        let captured = match in_use {
            true => low_speed::captured(),
            false => ClockCapture::Nothing,
        };
        if let Some(counting) = &mut self.counting {
            counting.take(captured, now);
        }
        if self.checks_clock {
            let agree = self.clock.take(captured, PATIENCE)?;
            self.checks_clock = false;
            return (!agree).then_some(Fault::CLOCK);
        }
        let sampled = sampled_cycles();
        if sampled.wrapping_sub(self.second_at) < SECOND_CYCLES {
            return None;
        }
        self.second_at = sampled;
        self.checks_clock = true;
        (!housekeeping.is_lookup_intact()).then_some(Fault::DATA_CRC)
    }

    fn slice(&mut self, blocks: u32) -> Option<Fault> {
        if blocks.wrapping_sub(self.sliced_at) < SLICE_PERIOD_BLOCKS {
            return None;
        }
        self.sliced_at = blocks;
        if !is_canary_alive() {
            return Some(Fault::STACK_CANARY);
        }
        if !self.is_next_ram_whole() {
            return Some(Fault::RAM_TEST);
        }
        let mut copies = self.copies.iter_mut();
        if copies.any(|copy| copy.step(SLICE_WORDS).is_break()) {
            return Some(Fault::DATA_CRC);
        }
        let whole = self.image.step(self.unit.as_mut()?, SLICE_WORDS);
        (whole == Some(false)).then_some(Fault::FLASH_CRC)
    }
}

impl SelfTest {
    /// Tests the next words of the RAM, from the end of the stack to the crash record, which a reset may need at any moment.
    /// What a DMA writes is left out: it would be lost.
    fn is_next_ram_whole(&mut self) -> bool {
        let (begin, last) = (
            &raw const _stack_end as usize,
            &raw const __crash_record as usize,
        );
        let end = (self.ram_at + RAM_SLICE_WORDS * size_of::<u32>()).min(last);
        let slice = self.ram_at..end;
        self.ram_at = if end == last { begin } else { end };
        let overlaps =
            |dma: core::ops::Range<usize>| dma.start < slice.end && slice.start < dma.end;
        written_by_dma().into_iter().any(overlaps) || keeps_both_values(slice)
    }
}

/// Returns `true` if every bit of a piece of RAM takes both values; its contents are restored. They are held in registers only, as the
/// stack may be under test. DSB and ISB make each read come from the RAM.
fn keeps_both_values(words: core::ops::Range<usize>) -> bool {
    let mut wrong = 0usize;
    critical_section::with(|_| {
        // SAFETY: RAM from end to end, on word boundaries; with interrupts masked only a DMA may access it, whose
        // memory the caller leaves out. Each word is put back before the next.
        unsafe {
            asm!(
                "2: ldr {kept}, [{at}]",
                "mvn {other}, {kept}",
                "str {other}, [{at}]",
                "dsb",
                "isb",
                "ldr {found}, [{at}]",
                "str {kept}, [{at}]",
                "eor {found}, {found}, {other}",
                "orr {wrong}, {wrong}, {found}",
                "dsb",
                "isb",
                "ldr {found}, [{at}], #4",
                "eor {found}, {found}, {kept}",
                "orr {wrong}, {wrong}, {found}",
                "cmp {at}, {end}",
                "blo 2b",
                at = inout(reg) words.start => _,
                end = in(reg) words.end,
                kept = out(reg) _,
                other = out(reg) _,
                found = out(reg) _,
                wrong = inout(reg) wrong,
            );
        }
    });
    wrong == 0
}

/// Returns `true` if the end of the stack is as start-up painted it (cortex-m-rt, `paint-stack`).
fn is_canary_alive() -> bool {
    let end = &raw const _stack_end;
    (0..CANARY_WORDS).all(|k| {
        // SAFETY: inside the stack's memory, which is larger; volatile, as the compiler knows no writer.
        let word = unsafe { ptr::read_volatile(end.wrapping_add(k)) };
        word == cortex_m_rt::STACK_PAINT_VALUE
    })
}
