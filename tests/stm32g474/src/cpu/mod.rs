//! Processor: Unicorn executes the instructions; exceptions, sleep and time are modelled here.

pub mod exceptions;
pub mod flash_accelerator;
pub mod instructions;
pub mod mpu;
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

/// Cost of executed code.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cost {
    /// Number of instructions.
    pub instructions: u64,
    /// Cycles, wait states included.
    pub cycles: u64,
}

/// Model of the instructions' time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum CycleModel {
    /// Published timings of the Cortex-M4, wait states and caches of the flash.
    #[default]
    Published,
    /// Fixed number of cycles for each instruction: a pessimistic bound.
    PerInstruction(u32),
}

/// Hash of an address, for the lookup before each block of code: the standard library's hash, which is keyed at random, takes
/// longer than the block.
#[derive(Default)]
struct AddressHasher(u64);

impl Hasher for AddressHasher {
    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.write_u32((*byte).into());
        }
    }

    fn write_u32(&mut self, word: u32) {
        // The golden ratio of 2^64 spreads neighbours over all bits; the table needs well-spread bits at both ends.
        let spread = (self.0 ^ u64::from(word)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        self.0 = spread ^ (spread >> 32);
    }

    fn finish(&self) -> u64 {
        self.0
    }
}

/// Timing of the instructions.
pub struct Timing {
    /// Model in use.
    pub model: CycleModel,
    /// Flash accelerator.
    pub flash: FlashAccelerator,
    blocks: HashMap<u32, Rc<Block>, BuildHasherDefault<AddressHasher>>,
    /// End of the last block: a block that begins elsewhere was branched to.
    last_end: u32,
    /// Cost of all code since power-on.
    pub total: Cost,
    /// Time of each exception's handler, by the exception's number.
    pub handlers: HashMap<usize, HandlerTime>,
    /// Trace of one exception's handler, if requested.
    pub trace: Option<Trace>,
}

/// Time of an exception's handler, from its entry to the return, in cycles.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HandlerTime {
    /// Number of runs.
    pub runs: u64,
    /// Cycles of all runs.
    pub cycles: u64,
    /// Cycles of the longest run.
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
    /// Block of code that was decoded before.
    pub fn known(&self, address: u32, bytes: u32) -> Option<Rc<Block>> {
        self.blocks
            .get(&address)
            .filter(|block| block.end - block.start == bytes)
            .cloned()
    }

    /// Decodes a block of code and stores it.
    pub fn learn(&mut self, address: u32, code: &[u8]) -> Rc<Block> {
        let block = Rc::new(instructions::decode(address, code));
        self.blocks.insert(address, Rc::clone(&block));
        block
    }

    /// Drops all decoded blocks, as the memory may hold other code now.
    pub fn forget(&mut self) {
        self.blocks.clear();
    }

    /// Applies the fields of FLASH_ACR.
    pub fn set_access(&mut self, file: &RegisterFile) {
        self.flash.access = Access {
            wait_states: file.get(flash_acr::LATENCY),
            prefetch: file.is(flash_acr::PRFTEN),
            instruction_cache: file.is(flash_acr::ICEN),
            data_cache: file.is(flash_acr::DCEN),
        };
    }

    /// Counts one run of a block; returns its cycles.
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

/// State that Unicorn's callbacks access.
pub struct State {
    /// The chip around the processor.
    pub chip: Chip,
    /// Timing of the instructions.
    pub timing: Timing,
    /// The event register (Armv7-M, B1.5.18).
    pub event: bool,
    /// Set while the program waits for an event.
    pub sleeping: bool,
    /// Set while the MPU denies access to the addresses below the RAM.
    pub below_ram_denied: bool,
    /// Time at which the run ends.
    pub run_until: Ticks,
    /// The block before which Unicorn was stopped.
    pub stopped_at: Option<u32>,
    /// Fault injection: bits of the RAM that are stuck at 1, as an address and a mask.
    pub stuck: Vec<(u32, u8)>,
    /// Fault injection: bits of a register of the processor that are stuck at 1.
    pub stuck_register: Option<(RegisterARM, u32)>,
    /// Bytes of the RAM that have been written, if that is watched.
    pub written: Vec<bool>,
    /// Addresses read before they were written, with the address of the block of code.
    pub read_unwritten: Vec<(u32, u32)>,
}

impl State {
    /// Adds a block of code to the trace if the traced handler runs.
    pub fn note(&mut self, address: u32, cycles: u32) {
        if let Some(trace) = &mut self.timing.trace
            && self.chip.nvic.runs(trace.exception())
        {
            trace.note(address, cycles);
        }
    }

    /// Advances time by cycles in which the processor executes.
    pub fn pass(&mut self, cycles: u64) {
        self.chip.cycle_counter.run(cycles);
        self.wait(cycles);
    }

    /// Advances time by cycles in which the processor does not execute.
    pub fn wait(&mut self, cycles: u64) {
        self.chip.cycles += cycles;
        self.chip.log.now += cycles * self.chip.ticks_per_cycle();
    }
}
