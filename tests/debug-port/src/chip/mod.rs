//! An STM32G474 without a processor: memory, the flash's controller, the few registers a probe looks at, and ST's flash
//! algorithm done natively.

mod algorithm;
pub mod flash;

use std::ops::Range;

use ihd_shared::image::{DEVICE_ID, FLASH_ADDRESS, FLASH_BYTES};

use self::algorithm::{Algorithm, Routine};
use self::flash::{CONTROLLER, Flash};
use crate::target::{BusFault, Contact, Stop, Target};

const RAM: Range<u32> = 0x2000_0000..0x2001_8000;
const CCM: Range<u32> = 0x1000_0000..0x1000_8000;
/// The CCM SRAM's second place.
const CCM_ALIAS: u32 = 0x2001_8000;
const SYSTEM_MEMORY: Range<u32> = 0x1FFF_0000..0x1FFF_8000;
const PERIPHERALS: Range<u32> = 0x4000_0000..0x6000_0000;

const IDCODE: u32 = 0xE004_2000;
const DBGMCU_CR: u32 = 0xE004_2004;
const DEMCR: u32 = 0xE000_EDFC;
const APB2ENR: u32 = 0x4002_1060;
const OENR: u32 = 0x4001_6B94;
const ODISR: u32 = 0x4001_6B98;
const UNIQUE_ID: u32 = 0x1FFF_7590;
const FLASH_SIZE: u32 = 0x1FFF_75E0;

/// Fault that occurs once, before a flash operation (an erasure of a page, the programming of a double word).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mishap {
    /// The probe is pulled out; the chip goes on as far as it can by itself.
    ProbePulled,
    /// The supply goes, in the middle of the operation.
    PowerLost,
    /// The controller does not finish.
    Stuck,
    /// A bit of what is programmed does not change.
    BitStays,
}

/// The chip.
#[derive(Debug)]
pub struct Chip {
    /// `DBGMCU_IDCODE`.
    pub id_code: u32,
    /// Flash and its controller.
    pub flash: Flash,
    /// The outputs of HRTIM that are on.
    pub outputs: u32,
    /// `true` if HRTIM has its clock.
    pub timer_clocked: bool,
    /// Its unique number.
    pub unique_id: [u8; 12],
    /// A mishap, and how many flash operations come before it.
    pub mishap: Option<(u64, Mishap)>,
    /// Number of resets.
    pub resets: u32,
    /// Number of halts of the running core.
    pub halts: u32,
    /// `true` if outputs were on at one of them.
    pub halted_switching: bool,
    ram: Vec<u8>,
    ccm: Vec<u8>,
    debug_control: u32,
    demcr: u32,
    registers: [u32; 32],
    stop: Option<Stop>,
    contact: Contact,
    algorithm: Algorithm,
    /// The routine at whose beginning the core was stepped off.
    entered: Option<Routine>,
}

impl Default for Chip {
    /// Creates a chip as delivered, running, with empty flash and the option bytes that the firmware requires.
    fn default() -> Self {
        Self {
            id_code: 0x2003_6000 | DEVICE_ID,
            flash: Flash::default(),
            outputs: 0,
            timer_clocked: false,
            unique_id: *b"model chip 1",
            mishap: None,
            resets: 0,
            halts: 0,
            halted_switching: false,
            ram: vec![0; RAM.len()],
            ccm: vec![0; CCM.len()],
            debug_control: 0,
            demcr: 0,
            registers: [0; 32],
            stop: None,
            contact: Contact::Good,
            algorithm: Algorithm::of_st(),
            entered: None,
        }
    }
}

impl Chip {
    /// Plugs the probe in again, or switches the supply on again: with it the chip begins anew, its RAM holds nothing known.
    pub fn restore(&mut self) {
        if self.contact == Contact::NoPower {
            self.ram.fill(0xA5);
            self.ccm.fill(0xA5);
            self.reset();
        }
        self.contact = Contact::Good;
    }

    /// Pulls the probe or the supply.
    pub fn cut(&mut self, contact: Contact) {
        self.contact = contact;
    }

    /// Bytes of RAM.
    ///
    /// # Panics
    /// Outside of it.
    pub fn ram(&mut self, address: u32, bytes: usize) -> &mut [u8] {
        let at = (address - RAM.start) as usize;
        &mut self.ram[at..at + bytes]
    }

    fn little(bytes: &[u8], at: u32, count: u32) -> u32 {
        let bytes = bytes.iter().skip(at as usize).take(count as usize);
        bytes
            .rev()
            .fold(0, |value, &byte| value << 8 | u32::from(byte))
    }

    fn memory(&mut self, address: u32) -> Option<&mut [u8]> {
        let (bytes, at) = match address {
            ram if RAM.contains(&ram) => (&mut self.ram, ram - RAM.start),
            ccm if CCM.contains(&ccm) => (&mut self.ccm, ccm - CCM.start),
            alias if (CCM_ALIAS..CCM_ALIAS + CCM.len() as u32).contains(&alias) => {
                (&mut self.ccm, alias - CCM_ALIAS)
            }
            _ => return None,
        };
        bytes.get_mut(at as usize..)
    }

    fn system_memory(&self, address: u32, bytes: u32) -> u32 {
        let size = FLASH_BYTES / 1_024;
        match address {
            FLASH_SIZE => size | 0xFFFF_0000,
            id if (UNIQUE_ID..UNIQUE_ID + 12).contains(&id) => {
                Self::little(&self.unique_id, id - UNIQUE_ID, bytes)
            }
            _ => u32::MAX,
        }
    }

    /// Takes the fault of the next flash operation; `None` if it succeeds.
    fn next_mishap(&mut self) -> Option<Mishap> {
        let (after, mishap) = self.mishap?;
        if after > 0 {
            self.mishap = Some((after - 1, mishap));
            return None;
        }
        self.mishap = None;
        Some(mishap)
    }

    /// Does what ST's routine does; the core then stands at the breakpoint behind its return address, or runs for ever.
    fn run_routine(&mut self, routine: Routine) {
        self.stop = None;
        let finished = match self
            .algorithm
            .is_in(self.ram.get(0x20..).unwrap_or_default())
        {
            true => self.perform(routine),
            false => {
                self.stop = Some(Stop::LockedUp);
                return;
            }
        };
        if let Some(result) = finished {
            self.registers[0] = result;
            self.registers[15] = self.registers[14] & !1;
            self.stop = Some(Stop::Breakpoint);
        }
    }
}

impl Target for Chip {
    fn read(&mut self, address: u32, bytes: u32) -> Result<u32, BusFault> {
        if let Some(memory) = self.memory(address) {
            return Ok(Self::little(memory, 0, bytes));
        }
        match address {
            IDCODE => Ok(self.id_code),
            DBGMCU_CR => Ok(self.debug_control),
            DEMCR => Ok(self.demcr),
            APB2ENR => Ok(u32::from(self.timer_clocked) << 26),
            OENR => Ok(if self.timer_clocked { self.outputs } else { 0 }),
            at if (FLASH_ADDRESS..FLASH_ADDRESS + FLASH_BYTES).contains(&at) => {
                self.flash.read(at, bytes)
            }
            at if CONTROLLER.contains(&at) => Ok(self.flash.register(at)),
            at if SYSTEM_MEMORY.contains(&at) => Ok(self.system_memory(at, bytes)),
            at if PERIPHERALS.contains(&at) => Ok(0),
            _ => Err(BusFault),
        }
    }

    fn write(&mut self, address: u32, bytes: u32, value: u32) -> Result<(), BusFault> {
        if let Some(memory) = self.memory(address) {
            let value = value.to_le_bytes();
            for (to, from) in memory.iter_mut().zip(value.iter().take(bytes as usize)) {
                *to = *from;
            }
            return Ok(());
        }
        match address {
            DBGMCU_CR => self.debug_control = value,
            DEMCR => self.demcr = value,
            ODISR => self.outputs &= !value,
            at if CONTROLLER.contains(&at) => {
                self.flash.set_register(at, value)?;
                if self.flash.wants_reset() {
                    // Loading the option bytes resets the chip as power-on does.
                    self.reset();
                    self.resets += 1;
                }
            }
            at if PERIPHERALS.contains(&at) => {}
            _ => return Err(BusFault),
        }
        Ok(())
    }

    fn register(&mut self, number: u32) -> u32 {
        self.registers.get(number as usize).copied().unwrap_or(0)
    }

    fn set_register(&mut self, number: u32, value: u32) {
        // The stack pointer in use is the main one.
        let number = if number == 17 { 13 } else { number };
        if let Some(register) = self.registers.get_mut(number as usize) {
            *register = value;
        }
        if number == 15 {
            self.entered = None;
        }
    }

    fn halt(&mut self) {
        if self.stop.is_none() {
            self.halts += 1;
            self.halted_switching |= self.outputs != 0;
        }
        if self.stop.is_none() || self.stop == Some(Stop::LockedUp) {
            self.stop = Some(Stop::Asked);
        }
    }

    fn run(&mut self) {
        let pc = self.registers[15];
        match self.entered.take().or_else(|| self.algorithm.at(pc)) {
            Some(routine) => self.run_routine(routine),
            // The firmware, or whatever else: nobody looks.
            None => self.stop = None,
        }
    }

    /// One instruction, 2 bytes long; of the algorithm the first, which changes nothing that could be seen.
    fn step(&mut self) {
        self.entered = self.algorithm.at(self.registers[15]);
        self.registers[15] = self.registers[15].wrapping_add(2);
        self.stop = Some(Stop::Asked);
    }

    fn reset(&mut self) {
        self.flash.reset();
        self.registers = [0; 32];
        // Stack and entry as the core reads them.
        self.registers[13] = self.flash.read(FLASH_ADDRESS, 4).unwrap_or(u32::MAX);
        self.registers[15] = self.flash.read(FLASH_ADDRESS + 4, 4).unwrap_or(u32::MAX) & !1;
        self.registers[16] = 1 << 24;
        self.outputs = 0;
        self.timer_clocked = false;
        self.entered = None;
        self.stop = None;
        self.resets += 1;
    }

    fn stopped(&mut self) -> Option<Stop> {
        self.stop
    }

    fn contact(&self) -> Contact {
        self.contact
    }
}
