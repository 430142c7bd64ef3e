//! What a test looks at from outside, and interferes with.

use unicorn_engine::{HookType, RegisterARM};

use super::{Machine, MachineError};
use crate::processor::{RAM, ram_bytes};

impl Machine {
    /// Reads memory.
    pub fn memory(&self, address: u32, bytes: usize) -> Vec<u8> {
        self.cpu
            .mem_read_as_vec(u64::from(address), bytes)
            .unwrap_or_default()
    }

    /// Writes memory: a test's interference.
    pub fn set_memory(&mut self, address: u32, bytes: &[u8]) {
        let _ = self.cpu.mem_write(u64::from(address), bytes);
    }

    /// From now on a bit of the RAM is stuck at 1: a test's interference.
    pub fn stick_bit(&mut self, address: u32, bit: u32) {
        let stuck = (address + bit / 8, 1 << (bit % 8));
        self.cpu.get_data_mut().stuck.push(stuck);
    }

    /// From now on bits of one of the processor's registers are stuck at 1: a test's interference.
    pub fn stick_register(&mut self, register: RegisterARM, mask: u32) {
        self.cpu.get_data_mut().stuck_register = Some((register, mask));
    }

    /// No bit is stuck any more.
    pub fn release_bits(&mut self) {
        let state = self.cpu.get_data_mut();
        state.stuck.clear();
        state.stuck_register = None;
    }

    /// Program counter.
    pub fn pc(&self) -> u32 {
        self.cpu.pc_read().unwrap_or(0) as u32
    }

    /// Lets the program go on elsewhere: a test's interference.
    pub fn set_pc(&mut self, pc: u32) {
        let _ = self.cpu.set_pc(u64::from(pc | 1));
    }

    /// The stack pointer.
    pub fn sp(&self) -> u32 {
        self.cpu.reg_read(RegisterARM::SP).unwrap_or(0) as u32
    }

    /// Moves the stack pointer: a test's interference.
    pub fn set_sp(&mut self, sp: u32) {
        let _ = self.cpu.reg_write(RegisterARM::SP, u64::from(sp));
    }

    /// Whether the program waits for an event.
    pub fn sleeping(&self) -> bool {
        self.cpu.get_data().sleeping
    }

    /// Entries of an exception since the last reset.
    pub fn entries(&self, exception: usize) -> u64 {
        self.cpu
            .get_data()
            .chip
            .nvic
            .entries
            .get(exception)
            .copied()
            .unwrap_or(0)
    }

    /// From now on notes what of the RAM is read before it was written; slow.
    ///
    /// # Errors
    /// Of the emulator.
    pub fn watch_ram(&mut self) -> Result<(), MachineError> {
        let length = ram_bytes(&self.image);
        let end = RAM + length as u64 - 1;
        self.cpu.get_data_mut().written = vec![false; length];
        self.cpu.add_mem_hook(
            HookType::MEM_WRITE,
            RAM,
            end,
            |cpu, _, address, bytes, _| {
                let at = (address - RAM) as usize;
                cpu.get_data_mut().written[at..][..bytes].fill(true);
                true
            },
        )?;
        self.cpu
            .add_mem_hook(HookType::MEM_READ, RAM, end, |cpu, _, address, bytes, _| {
                let at = (address - RAM) as usize;
                let state = cpu.get_data_mut();
                // Frames of exceptions and the DMA's pairs are written by the emulator itself.
                if state.written[at..][..bytes].iter().all(|&written| !written)
                    && state.read_unwritten.len() < 100
                {
                    state
                        .read_unwritten
                        .push((address as u32, state.chip.log.pc));
                }
                true
            })?;
        Ok(())
    }

    /// Which bytes of the RAM have been written since [`Machine::watch_ram`].
    pub fn written(&self) -> Vec<bool> {
        self.cpu.get_data().written.clone()
    }

    /// Addresses that were read before they were written, with the block of code that did it.
    pub fn read_unwritten(&self) -> Vec<(u32, u32)> {
        self.cpu.get_data().read_unwritten.clone()
    }
}
