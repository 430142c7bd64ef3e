//! The processor: Unicorn executes the instructions; exceptions, sleep and time are here.

pub mod exceptions;
pub mod flash_accelerator;
pub mod instructions;
pub mod nvic;
pub mod trace;

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};
use std::rc::Rc;

use unicorn_engine::RegisterARM;

use self::flash_accelerator::{Access, FlashAccelerator};
use self::instructions::{Block, REFILL};
use self::trace::Trace;
use crate::chip::Chip;
use crate::chip::register_file::RegisterFile;
use crate::image::{FLASH, PROGRAM_BYTES};
use crate::registers::flash::flash_acr;
use crate::time::Ticks;

/// Where code has been counted: how many instructions and cycles.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cost {
    /// Instructions.
    pub instructions: u64,
    /// Cycles, wait states included.
    pub cycles: u64,
}

/// How the time of the instructions is counted.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum CycleModel {
    /// Published timings of the Cortex-M4, wait states and caches of the flash.
    #[default]
    Published,
    /// This many cycles an instruction, whatever it is: a pessimist's bound.
    PerInstruction(u32),
}

/// A hash of an address, for the lookup before each block of code: the standard library's, which nobody can foresee, takes longer than
/// the block.
#[derive(Default)]
struct AddressHasher(u64);

impl Hasher for AddressHasher {
    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.write_u32((*byte).into());
        }
    }

    fn write_u32(&mut self, word: u32) {
        // The golden ratio of 2^64 spreads neighbours over all bits; the table wants good ones at both ends.
        let spread = (self.0 ^ u64::from(word)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        self.0 = spread ^ (spread >> 32);
    }

    fn finish(&self) -> u64 {
        self.0
    }
}

/// Time-keeping of the instructions.
pub struct Timing {
    /// How they are counted.
    pub model: CycleModel,
    /// The flash behind its accelerator.
    pub flash: FlashAccelerator,
    blocks: HashMap<u32, Rc<Block>, BuildHasherDefault<AddressHasher>>,
    /// Where the last block ended: a block that begins elsewhere was branched to.
    last_end: u32,
    /// Everything since power-on.
    pub total: Cost,
    /// What each exception's handler has taken, by its number.
    pub handlers: HashMap<usize, HandlerTime>,
    /// The runs of one exception's handler, where somebody wants them.
    pub trace: Option<Trace>,
}

/// The time of an exception's handler, from its entry to the return, in cycles.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HandlerTime {
    /// Runs.
    pub runs: u64,
    /// Cycles of all of them.
    pub cycles: u64,
    /// Cycles of the longest.
    pub worst: u64,
}

impl Default for Timing {
    fn default() -> Self {
        Self {
            model: CycleModel::Published,
            flash: FlashAccelerator::default(),
            blocks: HashMap::default(),
            last_end: 0,
            total: Cost::default(),
            handlers: HashMap::new(),
            trace: None,
        }
    }
}

impl Timing {
    /// A block that was seen before.
    pub fn known(&self, address: u32, bytes: u32) -> Option<Rc<Block>> {
        self.blocks
            .get(&address)
            .filter(|block| block.end - block.start == bytes)
            .cloned()
    }

    /// Decodes a block that is seen for the first time.
    pub fn learn(&mut self, address: u32, code: &[u8]) -> Rc<Block> {
        let block = Rc::new(instructions::decode(address, code));
        self.blocks.insert(address, Rc::clone(&block));
        block
    }

    /// What was code may be other code now.
    pub fn forget(&mut self) {
        self.blocks.clear();
    }

    /// Takes FLASH_ACR over.
    pub fn set_access(&mut self, file: &RegisterFile) {
        self.flash.access = Access {
            wait_states: file.get(flash_acr::LATENCY),
            prefetch: file.is(flash_acr::PRFTEN),
            instruction_cache: file.is(flash_acr::ICEN),
            data_cache: file.is(flash_acr::DCEN),
        };
    }

    /// Cycles that a block takes now.
    pub fn run(&mut self, block: &Block) -> u32 {
        let mut cycles = block.cycles;
        if block.start != self.last_end {
            cycles += REFILL;
        }
        self.last_end = block.end;
        let in_flash =
            |address: u32| (FLASH as u32..FLASH as u32 + PROGRAM_BYTES as u32).contains(&address);
        if in_flash(block.start) {
            cycles += self.flash.fetch(block.start, block.end, block.cycles);
        }
        for &literal in block.literals.iter().filter(|&&literal| in_flash(literal)) {
            cycles += self.flash.read(literal);
        }
        if let CycleModel::PerInstruction(each) = self.model {
            cycles = block.instructions * each;
        }
        self.total.instructions += u64::from(block.instructions);
        self.total.cycles += u64::from(cycles);
        cycles
    }
}

/// What Unicorn's callbacks reach.
pub struct State {
    /// The chip around the processor.
    pub chip: Chip,
    /// Time-keeping.
    pub timing: Timing,
    /// The event register (Armv7-M, B1.5.18).
    pub event: bool,
    /// The program waits for an event.
    pub sleeping: bool,
    /// When the run is to end.
    pub run_until: Ticks,
    /// The block before which Unicorn was stopped.
    pub stopped_at: Option<u32>,
    /// Bits of the RAM that are stuck at 1, as an address and a mask: a test's interference.
    pub stuck: Vec<(u32, u8)>,
    /// Bits of a register of the processor that are stuck at 1: a test's interference.
    pub stuck_register: Option<(RegisterARM, u32)>,
    /// Which bytes of the RAM were written, if that is watched.
    pub written: Vec<bool>,
    /// What was read before that, and by which block of code.
    pub read_unwritten: Vec<(u32, u32)>,
}

impl State {
    /// Notes a block of code for whoever traces its handler.
    pub fn note(&mut self, address: u32, cycles: u32) {
        if let Some(trace) = &mut self.timing.trace
            && self.chip.nvic.runs(trace.exception())
        {
            trace.note(address, cycles);
        }
    }

    /// Lets time pass by cycles of the processor.
    pub fn pass(&mut self, cycles: u64) {
        self.chip.cycles += cycles;
        self.chip.log.now += cycles * self.chip.ticks_per_cycle();
    }
}
