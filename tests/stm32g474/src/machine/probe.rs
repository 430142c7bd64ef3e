//! Observation of the machine by tests, and fault injection.

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

    /// Writes memory, for fault injection.
    pub fn set_memory(&mut self, address: u32, bytes: &[u8]) {
        let _ = self.cpu.mem_write(u64::from(address), bytes);
    }

    /// Makes a bit of the RAM stuck at 1, for fault injection.
    pub fn stick_bit(&mut self, address: u32, bit: u32) {
        let stuck = (address + bit / 8, 1 << (bit % 8));
        self.cpu.get_data_mut().stuck.push(stuck);
    }

    /// Makes bits of one of the processor's registers stuck at 1, for fault injection.
    pub fn stick_register(&mut self, register: RegisterARM, mask: u32) {
        self.cpu.get_data_mut().stuck_register = Some((register, mask));
    }

    /// Releases all stuck bits.
    pub fn release_bits(&mut self) {
        let state = self.cpu.get_data_mut();
        state.stuck.clear();
        state.stuck_register = None;
    }

    /// Program counter.
    pub fn pc(&self) -> u32 {
        self.cpu.pc_read().unwrap_or(0) as u32
    }

    /// Sets the program counter, for fault injection.
    pub fn set_pc(&mut self, pc: u32) {
        let _ = self.cpu.set_pc(u64::from(pc | 1));
    }

    /// Stack pointer.
    pub fn sp(&self) -> u32 {
        self.cpu.reg_read(RegisterARM::SP).unwrap_or(0) as u32
    }

    /// Sets the stack pointer, for fault injection.
    pub fn set_sp(&mut self, sp: u32) {
        let _ = self.cpu.reg_write(RegisterARM::SP, u64::from(sp));
    }

    /// Returns `true` if the program waits for an event.
    pub fn sleeping(&self) -> bool {
        self.cpu.get_data().sleeping
    }

    /// Number of entries of an exception since the last reset.
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

    /// Starts to record reads of RAM that was not written before; slow.
    ///
    /// # Errors
    /// The emulator fails.
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

    /// Flag for each byte of the RAM: written since [`Machine::watch_ram`].
    pub fn written(&self) -> Vec<bool> {
        self.cpu.get_data().written.clone()
    }

    /// Addresses read before they were written, with the block of code that read them.
    pub fn read_unwritten(&self) -> Vec<(u32, u32)> {
        self.cpu.get_data().read_unwritten.clone()
    }
}
