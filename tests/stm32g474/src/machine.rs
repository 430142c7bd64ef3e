//! The emulated board: processor, chip, power stage. Time passes while [`Machine::run_until`] runs.

use std::path::Path;

use ihd_sim::plant::Plant;
use unicorn_engine::{Arch, HookType, Mode, Prot, RegisterARM, Unicorn, uc_error};

use crate::chip::flash::{PAGES, PAGES_BYTES, Pages};
use crate::chip::{Chip, Reset};
use crate::cpu::exceptions::{self, LockUp};
use crate::cpu::{CycleModel, State, Timing};
use crate::image::{FLASH, Image, ImageError, PROGRAM_BYTES};
use crate::pins::Pins;
use crate::registers::syscfg;
use crate::time::Ticks;
use crate::usb::{Cable, HostController};
use crate::violation::Violation;

/// First address of the RAM, and its bytes with the alias of CCM SRAM.
pub const RAM: u64 = 0x2000_0000;
/// See [`RAM`].
pub const RAM_BYTES: usize = 128 * 1024;

/// CCM SRAM, where code executes without wait states.
pub const CCM: u64 = 0x1000_0000;
const CCM_BYTES: usize = 32 * 1024;

/// Device number, flash size and calibration values of the factory.
const FACTORY: u64 = 0x1FFF_7000;

/// WFE.
const WFE: u16 = 0xBF20;

/// An end of a run that is no end of the program.
#[derive(Debug, thiserror::Error)]
pub enum MachineError {
    /// The image cannot be read.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// Unicorn refuses; a defect of the emulator.
    #[error("the processor's emulator: {0:?}")]
    Engine(uc_error),
}

impl From<uc_error> for MachineError {
    fn from(error: uc_error) -> Self {
        Self::Engine(error)
    }
}

/// A chip with its program, on its board.
pub struct Machine {
    cpu: Unicorn<'static, State>,
    image: Image,
    /// The other end of the USB cable.
    pub cable: Cable,
    locked_up: bool,
    /// Resets since power-on, with their causes.
    pub resets: Vec<(Ticks, Reset)>,
}

impl Machine {
    /// A board that has just got its power, with `plant` on its pins.
    ///
    /// # Errors
    /// The image cannot be read.
    pub fn new(image: &Path, plant: Plant) -> Result<Self, MachineError> {
        let image = Image::read(image)?;
        let (cable, host) = Cable::new();
        let cpu = processor(&image, plant, host)?;
        let mut machine = Self {
            cpu,
            image,
            cable,
            locked_up: false,
            resets: Vec::new(),
        };
        machine.start()?;
        Ok(machine)
    }

    /// The chip.
    pub fn chip(&mut self) -> &mut Chip {
        &mut self.cpu.get_data_mut().chip
    }

    /// Time-keeping of the processor.
    pub fn timing(&mut self) -> &mut Timing {
        &mut self.cpu.get_data_mut().timing
    }

    /// Counts cycles another way.
    pub fn set_cycle_model(&mut self, model: CycleModel) {
        self.timing().model = model;
    }

    /// The image.
    pub fn image(&self) -> &Image {
        &self.image
    }

    /// Time since power-on.
    pub fn now(&self) -> Ticks {
        self.cpu.get_data().chip.log.now
    }

    /// What the program did that the manual forbids, the USB peripheral's included.
    pub fn violations(&self) -> Vec<Violation> {
        let chip = &self.cpu.get_data().chip;
        let of_usb = chip.usb.violations.iter().map(|rule| Violation {
            at: chip.log.now,
            pc: 0,
            rule: rule.clone(),
        });
        chip.log.violations.iter().cloned().chain(of_usb).collect()
    }

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

    /// Whether the processor has locked up.
    pub fn is_locked_up(&self) -> bool {
        self.locked_up
    }

    /// Reset of the processor: stack pointer and program counter from the vector table.
    fn start(&mut self) -> Result<(), MachineError> {
        let vectors = self.memory(FLASH as u32, 8);
        let word = |at: usize| {
            u32::from_le_bytes([
                vectors[at],
                vectors[at + 1],
                vectors[at + 2],
                vectors[at + 3],
            ])
        };
        for which in [
            RegisterARM::PRIMASK,
            RegisterARM::BASEPRI,
            RegisterARM::CONTROL,
        ] {
            self.cpu.reg_write(which, 0)?;
        }
        self.cpu.reg_write(RegisterARM::LR, 0xFFFF_FFFF)?;
        self.cpu.reg_write(RegisterARM::SP, u64::from(word(0)))?;
        self.cpu.set_pc(u64::from(word(4)))?;
        self.locked_up = false;
        let state = self.cpu.get_data_mut();
        (state.event, state.sleeping) = (false, false);
        state.timing.set_access(&state.chip.file);
        Ok(())
    }

    /// The power goes and comes back: RAM is lost, flash is not.
    ///
    /// # Errors
    /// Of the emulator.
    pub fn power_cycle(&mut self) -> Result<(), MachineError> {
        self.chip().flash.cut_power();
        self.fill_ram()?;
        self.reset(Reset::Power)
    }

    fn fill_ram(&mut self) -> Result<(), MachineError> {
        // RAM comes up with anything in it.
        let noise: Vec<u8> = (0..RAM_BYTES as u32)
            .map(|k| (k.wrapping_mul(2_654_435_761) >> 24) as u8)
            .collect();
        self.cpu.mem_write(RAM, &noise[..ram_bytes(&self.image)])?;
        self.cpu.mem_write(CCM, &noise[..CCM_BYTES])?;
        Ok(())
    }

    fn reset(&mut self, why: Reset) -> Result<(), MachineError> {
        let now = self.now();
        self.resets.push((now, why));
        self.chip().after_reset(why);
        self.start()
    }

    /// Runs until a moment.
    ///
    /// # Errors
    /// Of the emulator; whatever the program does is no error.
    pub fn run_until(&mut self, until: Ticks) -> Result<(), MachineError> {
        while self.now() < until {
            self.step(until)?;
        }
        Ok(())
    }

    /// Runs for a duration.
    ///
    /// # Errors
    /// As [`Machine::run_until`].
    pub fn run_for(&mut self, ticks: Ticks) -> Result<(), MachineError> {
        let until = self.now() + ticks;
        self.run_until(until)
    }

    /// Executes until the next thing that is not plain execution, and does that.
    fn step(&mut self, until: Ticks) -> Result<(), MachineError> {
        self.settle()?;
        if let Some(why) = self.chip().reset {
            return self.reset(why);
        }
        if self.chip().flash.power_gone {
            return self.power_cycle();
        }
        let pc = self.pc();
        if !self.locked_up
            && let Some(exception) = exceptions::next(&mut self.cpu)
        {
            let state = self.cpu.get_data_mut();
            state.sleeping = false;
            let entered = exceptions::enter(&mut self.cpu, exception, pc);
            return self.or_lock_up(entered);
        }
        let state = self.cpu.get_data_mut();
        if state.sleeping && (state.event || state.chip.nvic.would_wake()) {
            (state.sleeping, state.event) = (false, false);
        }
        if state.sleeping || self.locked_up {
            let next = state
                .chip
                .next_event()
                .clamp(state.chip.log.now + 1, until.max(state.chip.log.now + 1));
            let ticks_per_cycle = state.chip.ticks_per_cycle();
            let cycles = (next - state.chip.log.now).div_ceil(ticks_per_cycle);
            state.pass(cycles);
            return Ok(());
        }
        self.execute(until)
    }

    /// Lets everything happen that is due, and moves what the DMA has.
    fn settle(&mut self) -> Result<(), MachineError> {
        let chip = self.chip();
        if chip.log.now >= chip.next_event() {
            chip.advance();
        }
        move_transfers(&mut self.cpu)?;
        Ok(())
    }

    fn execute(&mut self, until: Ticks) -> Result<(), MachineError> {
        let pc = self.pc();
        if exceptions::is_return(pc) {
            let left = exceptions::leave(&mut self.cpu, pc | 1);
            return match left {
                Ok(pc) => Ok(self.cpu.set_pc(u64::from(pc | 1))?),
                Err(lock_up) => self.or_lock_up(Err(lock_up)),
            };
        }
        let state = self.cpu.get_data_mut();
        state.run_until = until;
        // Stopped behind that block, or gone elsewhere since.
        state.stopped_at = state.stopped_at.filter(|&at| at == pc);
        let ended = self.cpu.emu_start(u64::from(pc | 1), u64::MAX, 0, 0);
        let Err(error) = ended else { return Ok(()) };
        let pc = self.pc();
        if exceptions::is_return(pc) {
            return Ok(());
        }
        if error == uc_error::INSN_INVALID && self.half(pc.wrapping_sub(2)) == WFE {
            self.cpu.set_pc(u64::from(pc | 1))?;
            let state = self.cpu.get_data_mut();
            state.sleeping = !state.event;
            state.event = false;
            return Ok(());
        }
        if error == uc_error::INSN_INVALID && self.half(pc) == WFE {
            self.cpu.set_pc(u64::from((pc + 2) | 1))?;
            let state = self.cpu.get_data_mut();
            state.sleeping = !state.event;
            state.event = false;
            return Ok(());
        }
        let faulted = exceptions::fault(&mut self.cpu, pc);
        self.or_lock_up(faulted)
    }

    fn half(&self, address: u32) -> u16 {
        let mut bytes = [0; 2];
        match self.cpu.mem_read(u64::from(address), &mut bytes) {
            Ok(()) => u16::from_le_bytes(bytes),
            Err(_) => 0,
        }
    }

    fn or_lock_up(&mut self, result: Result<(), LockUp>) -> Result<(), MachineError> {
        if result.is_err() && !self.locked_up {
            self.locked_up = true;
            self.chip().system_fault(syscfg::cfgr2::CLL);
        }
        Ok(())
    }
}

fn move_transfers(cpu: &mut Unicorn<'_, State>) -> Result<(), uc_error> {
    if cpu.get_data().chip.transfers.is_empty() {
        return Ok(());
    }
    let transfers = std::mem::take(&mut cpu.get_data_mut().chip.transfers);
    for transfer in &transfers {
        cpu.mem_write(
            u64::from(transfer.address),
            &transfer.value.to_le_bytes()[..transfer.bytes],
        )?;
    }
    let mut transfers = transfers;
    transfers.clear();
    cpu.get_data_mut().chip.transfers = transfers;
    Ok(())
}

/// Processor and memory map.
fn processor(
    image: &Image,
    plant: Plant,
    host: HostController,
) -> Result<Unicorn<'static, State>, uc_error> {
    let state = State {
        chip: Chip::new(Pins::new(plant, host), Pages::default()),
        timing: Timing::default(),
        event: false,
        sleeping: false,
        run_until: 0,
        stopped_at: None,
        written: Vec::new(),
        read_unwritten: Vec::new(),
    };
    let mut cpu = Unicorn::new_with_data(Arch::ARM, Mode::THUMB, state)?;
    // UC_CPU_ARM_CORTEX_M4.
    cpu.ctl_set_cpu_model(CORTEX_M4)?;
    cpu.mem_map(FLASH, PROGRAM_BYTES as u64, Prot::READ | Prot::EXEC)?;
    cpu.mem_write(FLASH, &image.flash)?;
    cpu.mem_map(RAM, ram_bytes(image) as u64, Prot::ALL)?;
    cpu.mem_map(CCM, CCM_BYTES as u64, Prot::ALL)?;
    cpu.mem_map(FACTORY, 0x1000, Prot::READ)?;
    cpu.mem_write(
        FACTORY + 0x590,
        b"\x12\x34\x56\x78\x9a\xbc\xde\xf0\x11\x22\x33\x44",
    )?;
    cpu.mem_write(FACTORY + 0x5E0, &512u16.to_le_bytes())?;
    for (base, bytes) in [
        (0x4000_0000, 0x2_8000),
        (0x4800_0000, 0x2000),
        (0x5000_0000, 0x2000),
    ] {
        map_registers(&mut cpu, base, bytes)?;
    }
    cpu.mmio_map(
        u64::from(PAGES),
        PAGES_BYTES as u64,
        Some(|cpu: &mut Unicorn<'_, State>, offset: u64, bytes: usize| {
            let read = cpu.get_data_mut().chip.read_page(offset as u32, bytes);
            // NMI comes with the load: Unicorn leaves it undone here, and it is done after the handler.
            u64::from(read.unwrap_or_else(|| {
                let _ = cpu.emu_stop();
                0
            }))
        }),
        Some(
            |cpu: &mut Unicorn<'_, State>, offset: u64, bytes: usize, value: u64| {
                cpu.get_data_mut()
                    .chip
                    .write_page(offset as u32, bytes, value as u32);
                stop_if_reset(cpu);
            },
        ),
    )?;
    cpu.mmio_map(
        0xE000_0000,
        0x10_0000,
        Some(|cpu: &mut Unicorn<'_, State>, offset: u64, _: usize| {
            u64::from(cpu.get_data_mut().chip.read_system(offset as u32))
        }),
        Some(
            |cpu: &mut Unicorn<'_, State>, offset: u64, bytes: usize, value: u64| {
                cpu.get_data_mut()
                    .chip
                    .write_system(offset as u32, bytes, value as u32);
                stop_if_reset(cpu);
            },
        ),
    )?;
    cpu.add_block_hook(1, 0, on_block)?;
    Ok(cpu)
}

/// UC_CPU_ARM_CORTEX_M4 of Unicorn's list.
const CORTEX_M4: i32 = 9;

fn map_registers(cpu: &mut Unicorn<'static, State>, base: u32, bytes: u32) -> Result<(), uc_error> {
    cpu.mmio_map(
        u64::from(base),
        u64::from(bytes),
        Some(
            move |cpu: &mut Unicorn<'_, State>, offset: u64, bytes: usize| {
                u64::from(cpu.get_data_mut().chip.read(base + offset as u32, bytes))
            },
        ),
        Some(
            move |cpu: &mut Unicorn<'_, State>, offset: u64, bytes: usize, value: u64| {
                let state = cpu.get_data_mut();
                state.chip.write(base + offset as u32, bytes, value as u32);
                state.timing.set_access(&state.chip.file);
                stop_if_reset(cpu);
            },
        ),
    )
}

/// Ends the run where the chip starts again; Unicorn leaves the instruction undone, which no longer matters.
fn stop_if_reset(cpu: &mut Unicorn<'_, State>) {
    let chip = &cpu.get_data().chip;
    if chip.reset.is_some() || chip.flash.power_gone {
        let _ = cpu.emu_stop();
    }
}

/// CCM SRAM is one memory seen at two addresses, and this emulator has two memories: an image with code there does
/// without the RAM's last 32 KiB, the alias.
fn ram_bytes(image: &Image) -> usize {
    if image.uses_ccm {
        RAM_BYTES - CCM_BYTES
    } else {
        RAM_BYTES
    }
}

/// Before each block of code: its time passes, and what is due meanwhile happens.
fn on_block(cpu: &mut Unicorn<'_, State>, address: u64, bytes: u32) {
    let address = address as u32;
    // A block that was stopped before it began has had its time already.
    if cpu.get_data_mut().stopped_at.take() == Some(address) {
        return;
    }
    let known = cpu.get_data().timing.known(address, bytes);
    let block = match known {
        Some(block) => block,
        None => {
            let code = cpu
                .mem_read_as_vec(u64::from(address), bytes as usize)
                .unwrap_or_default();
            cpu.get_data_mut().timing.learn(address, &code)
        }
    };
    let state = cpu.get_data_mut();
    let cycles = state.timing.run(&block);
    state.chip.log.pc = address;
    state.event |= block.sends_event;
    state.pass(u64::from(cycles));
    if state.chip.log.now < state.chip.next_event()
        && !state.chip.nvic.any_pending()
        && state.chip.log.now < state.run_until
    {
        return;
    }
    if state.chip.log.now >= state.chip.next_event() {
        state.chip.advance();
    }
    let ends = state.chip.log.now >= state.run_until || state.chip.reset.is_some();
    let _ = move_transfers(cpu);
    let pending = cpu.get_data().chip.nvic.any_pending() && {
        let primask = cpu.reg_read(RegisterARM::PRIMASK).unwrap_or(0) & 1 == 1;
        let basepri = cpu.reg_read(RegisterARM::BASEPRI).unwrap_or(0) as u8;
        cpu.get_data_mut()
            .chip
            .nvic
            .next(primask, basepri)
            .is_some()
    };
    if ends || pending {
        cpu.get_data_mut().stopped_at = Some(address);
        let _ = cpu.emu_stop();
    }
}
