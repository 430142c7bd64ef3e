//! Debugger access to the processor: halt, step and breakpoints, and memory accesses past the processor.

use unicorn_engine::{HookType, MemType, Prot, RegisterARM, Unicorn, uc_error};

use super::{Machine, MachineError};
use crate::chip::Reset;
use crate::chip::flash::{PAGES, PAGES_BYTES};
use crate::cpu::State;
use crate::image::{FLASH, PROGRAM_BYTES};
use crate::time::Ticks;

/// Registers of the processor by their numbers in `DCRSR`.
const NUMBERED: [RegisterARM; 19] = [
    RegisterARM::R0,
    RegisterARM::R1,
    RegisterARM::R2,
    RegisterARM::R3,
    RegisterARM::R4,
    RegisterARM::R5,
    RegisterARM::R6,
    RegisterARM::R7,
    RegisterARM::R8,
    RegisterARM::R9,
    RegisterARM::R10,
    RegisterARM::R11,
    RegisterARM::R12,
    RegisterARM::SP,
    RegisterARM::LR,
    RegisterARM::PC,
    RegisterARM::XPSR,
    RegisterARM::MSP,
    RegisterARM::PSP,
];

/// Addresses of the peripherals and of the processor's own registers.
const PERIPHERALS: std::ops::Range<u32> = 0x4000_0000..0x6000_0000;
const SYSTEM: std::ops::Range<u32> = 0xE000_0000..0xE010_0000;

/// Cause of a halt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stands {
    /// Request of the debugger.
    Halted,
    /// BKPT instruction.
    Breakpoint,
}

/// State of the debugger.
#[derive(Debug, Default)]
pub(super) struct Debugger {
    stands: Option<Stands>,
    /// Set once the debugger has halted the processor: from then on BKPT halts, and flash may be written.
    attached: bool,
}

impl Debugger {
    pub(super) fn stands(&self) -> bool {
        self.stands.is_some()
    }
}

impl Machine {
    /// Cause of the present halt; `None` if the processor is not halted.
    pub fn stands(&self) -> Option<Stands> {
        self.debugger.stands
    }

    /// Returns `true` if the processor is in lock-up.
    pub fn is_locked_up(&self) -> bool {
        self.locked_up
    }

    /// Halts the processor; peripherals continue that DBGMCU does not stop.
    ///
    /// # Errors
    /// The emulator fails.
    pub fn halt(&mut self) -> Result<(), MachineError> {
        if !self.debugger.attached {
            self.debugger.attached = true;
            self.chip().flash.is_debugged = true;
            self.watch_flash()?;
        }
        self.stop(Stands::Halted);
        Ok(())
    }

    fn stop(&mut self, why: Stands) {
        if self.debugger.stands.is_none() {
            self.debugger.stands = Some(why);
            self.chip().set_core_halted(true);
        }
    }

    /// Continues after a halt.
    ///
    /// # Errors
    /// The emulator fails.
    pub fn go_on(&mut self) -> Result<(), MachineError> {
        if self.debugger.stands.take().is_some() {
            // The memory may hold other code now.
            self.cpu.ctl_flush_tb()?;
            let state = self.cpu.get_data_mut();
            state.timing.forget();
            (state.sleeping, state.stopped_at) = (false, None);
            state.chip.set_core_halted(false);
        }
        Ok(())
    }

    /// Executes one instruction and halts again.
    ///
    /// # Errors
    /// The emulator fails.
    pub fn step_once(&mut self) -> Result<(), MachineError> {
        self.go_on()?;
        let pc = self.pc();
        if !self.meets_breakpoint(&[pc]) {
            self.cpu.get_data_mut().run_until = Ticks::MAX;
            // An error is ignored: the next run handles or reports an instruction that a step cannot execute.
            let _ = self.cpu.emu_start(u64::from(pc | 1), u64::MAX, 0, 1);
        }
        self.stop(Stands::Halted);
        Ok(())
    }

    /// Resets the chip on a debugger's request.
    ///
    /// # Errors
    /// The emulator fails.
    pub fn reset_by_debugger(&mut self) -> Result<(), MachineError> {
        self.debugger.stands = None;
        self.cpu.ctl_flush_tb()?;
        self.timing().forget();
        self.reset(Reset::Software)
    }

    /// Value of a register by its number in `DCRSR`; 0 if it is not modelled.
    pub fn register(&self, number: u32) -> u32 {
        let which = NUMBERED.get(number as usize);
        which.map_or(0, |&which| self.cpu.reg_read(which).unwrap_or(0) as u32)
    }

    /// Sets a register by its number in `DCRSR`.
    pub fn set_register(&mut self, number: u32, value: u32) {
        let Some(&which) = NUMBERED.get(number as usize) else {
            return;
        };
        if which == RegisterARM::PC {
            self.locked_up = false;
            self.set_pc(value);
        } else {
            let _ = self.cpu.reg_write(which, u64::from(value));
        }
    }

    /// Reads past the processor; `None` if there is nothing at the address. A debugger's read is no violation by the program.
    pub fn bus_read(&mut self, address: u32, bytes: u32) -> Option<u32> {
        let chip = self.chip();
        let rules = chip.log.violations.len();
        let read = if PERIPHERALS.contains(&address) {
            Some(chip.read(address, bytes as usize))
        } else if SYSTEM.contains(&address) {
            Some(chip.read_system(address - SYSTEM.start))
        } else if let Some(offset) = in_pages(address) {
            // A double error is only for the program to detect.
            Some(self.chip().flash.peek(offset, bytes as usize))
        } else {
            let mut word = [0; 4];
            let place = word.get_mut(..bytes as usize)?;
            let read = self.cpu.mem_read(u64::from(address), place);
            read.is_ok().then(|| u32::from_le_bytes(word))
        };
        self.chip().log.violations.truncate(rules);
        read
    }

    /// Writes past the processor; `None` if nothing can be written at the address.
    pub fn bus_write(&mut self, address: u32, bytes: u32, value: u32) -> Option<()> {
        let rules = self.chip().log.violations.len();
        let written = if PERIPHERALS.contains(&address) {
            self.chip().write(address, bytes as usize, value);
            Some(())
        } else if SYSTEM.contains(&address) {
            self.chip()
                .write_system(address - SYSTEM.start, bytes as usize, value);
            Some(())
        } else if (FLASH as u32..PAGES + PAGES_BYTES as u32).contains(&address) {
            None
        } else {
            let value = value.to_le_bytes();
            let value = value.get(..bytes as usize)?;
            self.cpu.mem_write(u64::from(address), value).ok()
        };
        self.chip().log.violations.truncate(rules);
        written
    }

    /// Lets time pass while the processor is halted.
    pub(super) fn stand(&mut self, until: Ticks) {
        let state = self.cpu.get_data_mut();
        let now = state.chip.log.now;
        let next = state.chip.next_event().clamp(now + 1, until.max(now + 1));
        let cycles = (next - now).div_ceil(state.chip.ticks_per_cycle());
        state.wait(cycles);
    }

    /// Halts at a BKPT at one of these addresses, if a debugger is attached; returns `true` if it does.
    pub(super) fn meets_breakpoint(&mut self, places: &[u32]) -> bool {
        let is_breakpoint = |at: &&u32| self.half(**at) >> 8 == 0xBE;
        let at = places.iter().find(is_breakpoint).copied();
        let Some(at) = at.filter(|_| self.debugger.attached) else {
            return false;
        };
        self.set_pc(at);
        self.stop(Stands::Breakpoint);
        true
    }

    /// Hooks stores to the program's part of the flash: from now on they program it, as the flash controller allows.
    fn watch_flash(&mut self) -> Result<(), uc_error> {
        let bytes = PROGRAM_BYTES as u64;
        self.cpu.mem_protect(FLASH, bytes, Prot::ALL)?;
        let last = FLASH + bytes - 1;
        self.cpu
            .add_mem_hook(HookType::MEM_WRITE, FLASH, last, on_flash_write)?;
        Ok(())
    }
}

fn in_pages(address: u32) -> Option<u32> {
    let offset = address.checked_sub(PAGES)?;
    (offset < PAGES_BYTES as u32).then_some(offset)
}

/// Handles a store to the program's flash before Unicorn carries it out; a refused store is undone afterwards.
fn on_flash_write(
    cpu: &mut Unicorn<'_, State>,
    _: MemType,
    address: u64,
    bytes: usize,
    value: i64,
) -> bool {
    let mut was = [0; 4];
    let read = cpu.mem_read(address, &mut was);
    let chip = &mut cpu.get_data_mut().chip;
    let (address, was) = (address as u32, u32::from_le_bytes(was));
    let (flash, file, log) = (&mut chip.flash, &mut chip.file, &mut chip.log);
    let taken =
        read.is_ok() && bytes == 4 && flash.write_elsewhere(address, value as u32, was, file, log);
    if !taken {
        chip.flash.refused.push((address & !3, was));
    }
    true
}
