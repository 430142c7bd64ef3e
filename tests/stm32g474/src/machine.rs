//! Emulated board: processor, chip, power stage. Time passes while [`Machine::run_until`] runs.

mod debug;
mod probe;

use std::path::Path;

use ihd_sim::plant::Plant;
use unicorn_engine::{RegisterARM, Unicorn, uc_error};

use crate::chip::{Chip, Reset};
use crate::cpu::exceptions::{self, LockUp};
use crate::cpu::{CycleModel, State, Timing};
use crate::image::{FLASH, Image, ImageError};
use crate::processor::{
    CCM, CCM_BYTES, RAM, RAM_BYTES, apply_mpu, move_transfers, processor, ram_bytes,
};
use crate::registers::syscfg;
use crate::time::Ticks;
use crate::usb::Cable;
use crate::violation::Violation;

pub use debug::Stands;

/// Opcode of WFE.
const WFE: u16 = 0xBF20;

/// Failure of the emulation, independent of the program.
#[derive(Debug, thiserror::Error)]
pub enum MachineError {
    /// The image cannot be read.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// Unicorn fails, which is a defect of the emulator.
    #[error("the processor's emulator: {0:?}")]
    Engine(uc_error),
}

impl From<uc_error> for MachineError {
    fn from(error: uc_error) -> Self {
        Self::Engine(error)
    }
}

/// Chip with its program, on its board.
pub struct Machine {
    cpu: Unicorn<'static, State>,
    image: Image,
    /// Other end of the USB cable.
    pub cable: Cable,
    locked_up: bool,
    debugger: debug::Debugger,
    /// Times of watchdog resets before the timers ran: start-up tests the watchdog once after power-on, and a start that detects
    /// broken RAM ends in one.
    pub bites_at_start: Vec<Ticks>,
    /// Other resets since power-on, with their causes.
    pub resets: Vec<(Ticks, Reset)>,
}

impl Machine {
    /// Board at power-on, with `plant` at its pins.
    ///
    /// # Errors
    /// The image cannot be read, or the emulator fails.
    pub fn new(image: &Path, plant: Plant) -> Result<Self, MachineError> {
        Self::with(Image::read(image)?, plant)
    }

    /// Board at power-on, with any content of the flash.
    ///
    /// # Errors
    /// The emulator fails.
    pub fn with(image: Image, plant: Plant) -> Result<Self, MachineError> {
        let (cable, host) = Cable::new();
        let cpu = processor(&image, plant, host)?;
        let mut machine = Self {
            cpu,
            image,
            cable,
            locked_up: false,
            debugger: debug::Debugger::default(),
            bites_at_start: Vec::new(),
            resets: Vec::new(),
        };
        machine.start()?;
        Ok(machine)
    }

    /// Chip around the processor.
    pub fn chip(&mut self) -> &mut Chip {
        &mut self.cpu.get_data_mut().chip
    }

    /// Timing of the processor.
    pub fn timing(&mut self) -> &mut Timing {
        &mut self.cpu.get_data_mut().timing
    }

    /// Selects another cycle model.
    pub fn set_cycle_model(&mut self, model: CycleModel) {
        self.timing().model = model;
    }

    /// Flash image of the board.
    pub fn image(&self) -> &Image {
        &self.image
    }

    /// Time since power-on.
    pub fn now(&self) -> Ticks {
        self.cpu.get_data().chip.log.now
    }

    /// Violations of the reference manual by the program, those of the USB peripheral included.
    pub fn violations(&self) -> Vec<Violation> {
        let chip = &self.cpu.get_data().chip;
        let of_usb = chip.usb.violations.iter().map(|rule| Violation {
            at: chip.log.now,
            pc: 0,
            rule: rule.clone(),
        });
        chip.log.violations.iter().cloned().chain(of_usb).collect()
    }

    /// Resets the processor: stack pointer and program counter from the vector table.
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

    /// Switches the power off and on: RAM is lost, flash is not.
    ///
    /// # Errors
    /// The emulator fails.
    pub fn power_cycle(&mut self) -> Result<(), MachineError> {
        self.chip().flash.cut_power();
        self.fill_ram()?;
        self.reset(Reset::Power)
    }

    fn fill_ram(&mut self) -> Result<(), MachineError> {
        // The content of RAM at power-on is arbitrary.
        let noise: Vec<u8> = (0..RAM_BYTES as u32)
            .map(|k| (k.wrapping_mul(2_654_435_761) >> 24) as u8)
            .collect();
        self.cpu.mem_write(RAM, &noise[..ram_bytes(&self.image)])?;
        self.cpu.mem_write(CCM, &noise[..CCM_BYTES])?;
        Ok(())
    }

    fn reset(&mut self, why: Reset) -> Result<(), MachineError> {
        let now = self.now();
        if why == Reset::Watchdog && !self.chip().hrtim.is_running() {
            self.bites_at_start.push(now);
        } else {
            self.resets.push((now, why));
        }
        self.chip().after_reset(why);
        self.start()
    }

    /// Runs until a time.
    ///
    /// # Errors
    /// The emulator fails; a fault of the program is no error.
    pub fn run_until(&mut self, until: Ticks) -> Result<(), MachineError> {
        while self.now() < until {
            self.step(until)?;
        }
        Ok(())
    }

    /// Runs for a duration.
    ///
    /// # Errors
    /// The emulator fails.
    pub fn run_for(&mut self, ticks: Ticks) -> Result<(), MachineError> {
        let until = self.now() + ticks;
        self.run_until(until)
    }

    /// Executes code until an event, an exception or the end of the run, and handles it.
    fn step(&mut self, until: Ticks) -> Result<(), MachineError> {
        self.settle()?;
        if let Some(why) = self.chip().reset {
            return self.reset(why);
        }
        if self.chip().flash.power_gone {
            return self.power_cycle();
        }
        if self.debugger.stands() {
            self.stand(until);
            return Ok(());
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
            if state.sleeping {
                state.chip.sleep(cycles);
            }
            state.wait(cycles);
            return Ok(());
        }
        self.execute(until)
    }

    /// Processes all events that are due, and carries out the DMA's writes and the MPU's settings.
    fn settle(&mut self) -> Result<(), MachineError> {
        let chip = self.chip();
        if chip.log.now >= chip.next_event() {
            chip.advance();
        }
        move_transfers(&mut self.cpu)?;
        apply_mpu(&mut self.cpu)?;
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
        // Valid only if the run continues with the block before which it was stopped.
        state.stopped_at = state.stopped_at.filter(|&at| at == pc);
        let ended = self.cpu.emu_start(u64::from(pc | 1), u64::MAX, 0, 0);
        let Err(error) = ended else { return Ok(()) };
        let pc = self.pc();
        if exceptions::is_return(pc) {
            return Ok(());
        }
        // Unicorn does not implement WFE; it stops at it or after it.
        let wfe = [pc.wrapping_sub(2), pc]
            .into_iter()
            .find(|&at| self.half(at) == WFE);
        if let Some(at) = wfe.filter(|_| error == uc_error::INSN_INVALID) {
            self.cpu.set_pc(u64::from((at + 2) | 1))?;
            let state = self.cpu.get_data_mut();
            state.sleeping = !std::mem::take(&mut state.event);
            return Ok(());
        }
        // Unicorn stops at BKPT or after it.
        if error == uc_error::EXCEPTION && self.meets_breakpoint(&[pc, pc.wrapping_sub(2)]) {
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
