//! Entry and return of exceptions (Armv7-M Architecture Reference Manual, B1.5.6-B1.5.8).

use unicorn_engine::{RegisterARM, Unicorn, uc_error};

use super::State;
use super::nvic::HARD_FAULT;

/// Cycles from the request to the handler's first instruction, and from its end to the thread's next one (Cortex-M4
/// TRM, 3.9: 12 each without wait states; tail-chained 6).
const ENTRY_CYCLES: u64 = 12;
const RETURN_CYCLES: u64 = 12;
const TAIL_CYCLES: u64 = 6;

/// EXC_RETURN values: return to a handler or the thread on the main stack, with or without floating-point registers.
const RETURN_MIN: u32 = 0xFFFF_FFE0;
const TO_THREAD: u32 = 0xFFFF_FFF9;
const TO_HANDLER: u32 = 0xFFFF_FFF1;
const NO_FLOATS: u32 = 1 << 4;

/// CONTROL.FPCA: floating-point registers are in use.
const FPCA: u64 = 1 << 2;

/// Registers of a frame in its order, without xPSR.
const FRAME: [RegisterARM; 7] = [
    RegisterARM::R0,
    RegisterARM::R1,
    RegisterARM::R2,
    RegisterARM::R3,
    RegisterARM::R12,
    RegisterARM::LR,
    RegisterARM::PC,
];

type Cpu<'a> = Unicorn<'a, State>;

fn register(cpu: &Cpu<'_>, which: RegisterARM) -> u32 {
    cpu.reg_read(which).unwrap_or(0) as u32
}

fn word(cpu: &Cpu<'_>, address: u32) -> Result<u32, uc_error> {
    let mut bytes = [0; 4];
    cpu.mem_read(u64::from(address), &mut bytes)?;
    Ok(u32::from_le_bytes(bytes))
}

/// ICI/IT bits and the number of the exception in xPSR (Armv7-M, B1.4.2); this module keeps that number itself.
const IT_STATE: u32 = 0x0600_FC00;
const EXCEPTION: u32 = 0x3FF;

/// Returns `true` if a program counter is an EXC_RETURN value.
pub fn is_return(pc: u32) -> bool {
    pc >= RETURN_MIN
}

/// Exception to be taken now.
pub fn next(cpu: &mut Cpu<'_>) -> Option<usize> {
    if !cpu.get_data().chip.nvic.any_pending() {
        return None;
    }
    let primask = register(cpu, RegisterARM::PRIMASK) & 1 == 1;
    let basepri = register(cpu, RegisterARM::BASEPRI) as u8;
    cpu.get_data_mut().chip.nvic.next(primask, basepri)
}

/// Lock-up: the processor stops until a reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LockUp;

/// Takes an exception: pushes the frame and jumps to the handler.
///
/// # Errors
/// [`LockUp`] if the vector cannot be read.
pub fn enter(cpu: &mut Cpu<'_>, exception: usize, pc: u32) -> Result<(), LockUp> {
    let floats = register(cpu, RegisterARM::CONTROL) & FPCA as u32 != 0;
    let bytes = if floats { 26 * 4 } else { 8 * 4 };
    let sp = register(cpu, RegisterARM::SP);
    let aligned = sp & 4 != 0;
    let frame = (sp - if aligned { 4 } else { 0 }).wrapping_sub(bytes);
    let was_handler = cpu.get_data().chip.nvic.is_handler();
    let mut words = FRAME.map(|which| register(cpu, which)).to_vec();
    words[6] = pc & !1;
    let flags = register(cpu, RegisterARM::XPSR);
    words.push(flags | 1 << 24 | u32::from(aligned) << 9);
    if floats {
        words.extend((0..16).map(|k| register_s(cpu, k)));
        words.push(register(cpu, RegisterARM::FPSCR));
        words.push(0);
    }
    let bytes: Vec<u8> = words.iter().flat_map(|value| value.to_le_bytes()).collect();
    if cpu.mem_write(u64::from(frame), &bytes).is_err() && exception > HARD_FAULT {
        // A fault in stacking comes before the interrupt (B1.5.6, derived exceptions), which waits. The fault's handler
        // runs even if its own push fails.
        return enter(cpu, HARD_FAULT, pc);
    }
    let vectors = cpu
        .get_data()
        .chip
        .system
        .get(&0xED08)
        .copied()
        .unwrap_or(0);
    let vectors = if vectors == 0 { 0x0800_0000 } else { vectors };
    let handler = word(cpu, vectors + 4 * exception as u32).map_err(|_| LockUp)?;
    let back = if was_handler { TO_HANDLER } else { TO_THREAD };
    let back = if floats { back & !NO_FLOATS } else { back };
    // The handler begins outside an IT block (Armv7-M, B1.5.6); Unicorn ends a block of code at a page of 1 KiB,
    // which may be inside one.
    set(cpu, RegisterARM::XPSR, flags & !IT_STATE);
    set(cpu, RegisterARM::SP, frame);
    set(cpu, RegisterARM::LR, back);
    set(cpu, RegisterARM::PC, handler);
    let control = register(cpu, RegisterARM::CONTROL);
    set(cpu, RegisterARM::CONTROL, control & !(FPCA as u32));
    let state = cpu.get_data_mut();
    let began = state.chip.cycles;
    state.chip.nvic.enter(exception, began);
    if let Some(trace) = &mut state.timing.trace {
        trace.begin(exception, pc);
    }
    state.event = true;
    state.pass(ENTRY_CYCLES);
    Ok(())
}

fn register_s(cpu: &Cpu<'_>, k: i32) -> u32 {
    cpu.reg_read(i32::from(RegisterARM::S0) + k).unwrap_or(0) as u32
}

fn set(cpu: &mut Cpu<'_>, which: RegisterARM, value: u32) {
    // A write to a register of the processor cannot fail.
    let _ = cpu.reg_write(which, u64::from(value));
}

/// Returns from an exception to the address in its frame, which is the result.
///
/// # Errors
/// [`LockUp`] if the frame cannot be read.
pub fn leave(cpu: &mut Cpu<'_>, exc_return: u32) -> Result<u32, LockUp> {
    let state = cpu.get_data_mut();
    if let Some((exception, began)) = state.chip.nvic.leave() {
        let time = state.timing.handlers.entry(exception).or_default();
        let cycles = state.chip.cycles - began + RETURN_CYCLES;
        (time.runs, time.cycles, time.worst) =
            (time.runs + 1, time.cycles + cycles, time.worst.max(cycles));
        if let Some(trace) = &mut state.timing.trace {
            trace.end(exception, began, cycles);
        }
    }
    state.event = true;
    let sp = register(cpu, RegisterARM::SP);
    let floats = exc_return & NO_FLOATS == 0;
    let read = |k: u32| word(cpu, sp + 4 * k).map_err(|_| LockUp);
    let mut frame = [0; 8];
    for (k, slot) in frame.iter_mut().enumerate() {
        *slot = read(k as u32)?;
    }
    let mut singles = [0; 17];
    if floats {
        for (k, slot) in singles.iter_mut().enumerate() {
            *slot = read(8 + k as u32)?;
        }
    }
    for (&which, value) in FRAME.iter().zip(frame) {
        set(cpu, which, value);
    }
    let xpsr = frame[7];
    // Includes the state of an interrupted IT block.
    let now = register(cpu, RegisterARM::XPSR);
    set(cpu, RegisterARM::XPSR, xpsr & !EXCEPTION | now & EXCEPTION);
    let control = register(cpu, RegisterARM::CONTROL) & !(FPCA as u32);
    if floats {
        for (k, value) in singles[..16].iter().enumerate() {
            let _ = cpu.reg_write(i32::from(RegisterARM::S0) + k as i32, u64::from(*value));
        }
        set(cpu, RegisterARM::FPSCR, singles[16]);
        set(cpu, RegisterARM::CONTROL, control | FPCA as u32);
    } else {
        set(cpu, RegisterARM::CONTROL, control);
    }
    let popped = if floats { 26 * 4 } else { 8 * 4 };
    let sp = sp + popped + if xpsr & 1 << 9 != 0 { 4 } else { 0 };
    set(cpu, RegisterARM::SP, sp);
    let waiting = next(cpu).is_some();
    cpu.get_data_mut()
        .pass(if waiting { TAIL_CYCLES } else { RETURN_CYCLES });
    Ok(frame[6])
}

/// Raises a fault of the processor: HardFault, or lock-up if it runs at that priority already.
///
/// # Errors
/// [`LockUp`] if no handler can run.
pub fn fault(cpu: &mut Cpu<'_>, pc: u32) -> Result<(), LockUp> {
    if cpu.get_data().chip.nvic.running_priority() < 0 {
        return Err(LockUp);
    }
    cpu.get_data_mut().chip.nvic.pend(HARD_FAULT);
    enter(cpu, HARD_FAULT, pc)
}
