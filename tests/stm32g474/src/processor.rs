//! Processor with its memory map, and Unicorn's callbacks: registers, flash pages, and each block of code.

use ihd_sim::front_end::REFERENCE_CALIBRATION;
use ihd_sim::plant::Plant;
use unicorn_engine::{Arch, Mode, Prot, Unicorn, uc_error};

use crate::chip::Chip;
use crate::chip::flash::{PAGE_BYTES, PAGES, PAGES_BYTES, Pages};
use crate::cpu::{State, Timing, exceptions};
use crate::image::{FLASH, Image, PROGRAM_BYTES};
use crate::pins::Pins;
use crate::registers::flash::flash_acr;
use crate::usb::HostController;

/// First address of the RAM.
pub const RAM: u64 = 0x2000_0000;
/// Size of the RAM in bytes, with the alias of CCM SRAM.
pub const RAM_BYTES: usize = 128 * 1024;

/// First address of CCM SRAM, where code executes without wait states.
pub const CCM: u64 = 0x1000_0000;
pub(crate) const CCM_BYTES: usize = 32 * 1024;

/// Address of the factory's data: device number, flash size and calibration values.
const FACTORY: u64 = 0x1FFF_7000;

/// First address of system memory, which holds ST's bootloader (AN2606).
pub const BOOTLOADER: u64 = 0x1FFF_0000;
/// Initial stack pointer of the code in place of ST's bootloader.
pub const BOOTLOADER_STACK: u32 = 0x2000_2000;

/// Addresses below the RAM, with the second bank's option bytes alone (RM0440, 2.2.2).
pub(crate) const BELOW_RAM: u64 = 0x1FFF_8000;
const BELOW_RAM_BYTES: u64 = RAM - BELOW_RAM;

/// Applies erased pages, refused stores and the DMA's writes to memory.
pub(crate) fn move_transfers(cpu: &mut Unicorn<'_, State>) -> Result<(), uc_error> {
    while let Some(page) = cpu.get_data_mut().chip.flash.erased.pop() {
        cpu.mem_write(u64::from(page), &[0xFF; PAGE_BYTES as usize])?;
    }
    while let Some((address, was)) = cpu.get_data_mut().chip.flash.refused.pop() {
        cpu.mem_write(u64::from(address), &was.to_le_bytes())?;
    }
    if cpu.get_data().chip.transfers.is_empty() {
        return Ok(());
    }
    let mut transfers = std::mem::take(&mut cpu.get_data_mut().chip.transfers);
    for transfer in &transfers {
        cpu.mem_write(
            u64::from(transfer.address),
            &transfer.value.to_le_bytes()[..transfer.bytes],
        )?;
    }
    // The allocation is reused.
    transfers.clear();
    cpu.get_data_mut().chip.transfers = transfers;
    Ok(())
}

/// Creates the processor with its memory map.
pub(crate) fn processor(
    image: &Image,
    plant: Plant,
    host: HostController,
) -> Result<Unicorn<'static, State>, uc_error> {
    let state = State {
        chip: Chip::new(Pins::new(plant, host), Pages::default()),
        timing: Timing::default(),
        event: false,
        sleeping: false,
        below_ram_denied: false,
        run_until: 0,
        stopped_at: None,
        stuck: Vec::new(),
        stuck_register: None,
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
    cpu.mem_write(FACTORY + 0x5AA, &REFERENCE_CALIBRATION.to_le_bytes())?;
    // In place of ST's bootloader: a stack pointer, a first instruction, and an endless loop (B .).
    cpu.mem_map(BOOTLOADER, 0x7000, Prot::READ | Prot::EXEC)?;
    let words = [BOOTLOADER_STACK, BOOTLOADER as u32 + 9, 0xE7FE_E7FE];
    cpu.mem_write(BOOTLOADER, &words.map(u32::to_le_bytes).concat())?;
    map_below_ram(&mut cpu)?;
    for (base, bytes) in [
        (0x4000_0000, 0x2_8000),
        (0x4800_0000, 0x2000),
        (0x5000_0000, 0x2000),
        (0x5006_0000, 0x1000),
    ] {
        map_registers(&mut cpu, base, bytes)?;
    }
    cpu.mmio_map(
        u64::from(PAGES),
        PAGES_BYTES as u64,
        Some(|cpu: &mut Unicorn<'_, State>, offset: u64, bytes: usize| {
            let read = cpu.get_data_mut().chip.read_page(offset as u32, bytes);
            // NMI interrupts the load: Unicorn does not complete it here, and it is repeated after the handler.
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

/// Maps the addresses below the RAM as what a chip may have there at worst: reads succeed, and writes are ignored. No manual says
/// that either raises a bus error.
fn map_below_ram(cpu: &mut Unicorn<'_, State>) -> Result<(), uc_error> {
    let read = |_: &mut Unicorn<'_, State>, _: u64, _: usize| u64::MAX;
    let ignore = |_: &mut Unicorn<'_, State>, _: u64, _: usize, _: u64| ();
    cpu.mmio_map(BELOW_RAM, BELOW_RAM_BYTES, Some(read), Some(ignore))
}

/// Unmaps the addresses below the RAM while the MPU denies access to them, so that an access is a fault.
pub(crate) fn apply_mpu(cpu: &mut Unicorn<'_, State>) -> Result<(), uc_error> {
    let state = cpu.get_data_mut();
    let denied = state.chip.mpu.denies(BELOW_RAM as u32);
    if denied != state.below_ram_denied {
        state.below_ram_denied = denied;
        if denied {
            cpu.mem_unmap(BELOW_RAM, BELOW_RAM_BYTES)?;
        } else {
            map_below_ram(cpu)?;
        }
    }
    Ok(())
}

/// UC_CPU_ARM_CORTEX_M4 in Unicorn's list.
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
                let address = base + offset as u32;
                state.chip.write(address, bytes, value as u32);
                if address & !3 == flash_acr::ADDRESS {
                    state.timing.set_access(&state.chip.file);
                }
                stop_if_reset(cpu);
            },
        ),
    )
}

/// Ends the run on a reset; Unicorn does not complete the instruction, which no longer matters.
fn stop_if_reset(cpu: &mut Unicorn<'_, State>) {
    let chip = &cpu.get_data().chip;
    if chip.reset.is_some() || chip.flash.power_gone {
        let _ = cpu.emu_stop();
    }
}

/// Size of the RAM in bytes. CCM SRAM is one memory at two addresses, and this emulator has two memories: an image with code
/// there has no access to the RAM's last 32 KiB, the alias.
pub(crate) fn ram_bytes(image: &Image) -> usize {
    if image.uses_ccm {
        RAM_BYTES - CCM_BYTES
    } else {
        RAM_BYTES
    }
}

/// Restores the stuck bits after any write, before the next block of code.
fn hold_stuck_bits(cpu: &mut Unicorn<'_, State>) {
    if let Some((register, mask)) = cpu.get_data().stuck_register
        && let Ok(value) = cpu.reg_read(register)
    {
        let _ = cpu.reg_write(register, value | u64::from(mask));
    }
    for k in 0..cpu.get_data().stuck.len() {
        let (address, mask) = cpu.get_data().stuck[k];
        let mut byte = [0];
        if cpu.mem_read(u64::from(address), &mut byte).is_ok() && byte[0] & mask != mask {
            let _ = cpu.mem_write(u64::from(address), &[byte[0] | mask]);
        }
    }
}

/// Handles a block of code before it is executed: counts its time and processes the events due in it.
fn on_block(cpu: &mut Unicorn<'_, State>, address: u64, bytes: u32) {
    let address = address as u32;
    // The time of a block that was stopped before it began has been counted already.
    if cpu.get_data_mut().stopped_at.take() == Some(address) {
        return;
    }
    hold_stuck_bits(cpu);
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
    state.note(address, cycles);
    state.event |= block.sends_event;
    state.pass(u64::from(cycles));
    let happens = state.chip.log.now >= state.chip.next_event();
    if !happens && !state.chip.nvic.any_pending() && state.chip.log.now < state.run_until {
        return;
    }
    if happens {
        state.chip.advance();
    }
    let ends = state.chip.log.now >= state.run_until || state.chip.reset.is_some();
    let _ = move_transfers(cpu);
    if ends || exceptions::next(cpu).is_some() {
        cpu.get_data_mut().stopped_at = Some(address);
        let _ = cpu.emu_stop();
    }
}
