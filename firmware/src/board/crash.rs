//! The end of the program: panic, processor fault, stack overflow, error of flash or RAM. Outputs
//! off, crash record, reset.

use core::panic::PanicInfo;
use core::sync::atomic::{AtomicU32, Ordering};

use ihd_firmware::retained::control::RetainedControl;
use ihd_firmware::retained::reset::{
    CrashRecord, MAX_ENDS, NEXT_BOOTLOADER, ResetFlags, ResetReason, WORDS,
};
use ihd_shared::wire::messages::Program;

use super::stm32g474::safe_state::{is_damaged_page, outputs_off, stay, system_fault};

/// Not cleared at start: memory.x places it outside what start-up code writes.
#[unsafe(link_section = ".crash_record")]
static CRASH_RECORD: [AtomicU32; WORDS] = [const { AtomicU32::new(0) }; WORDS];

/// Number of times in a row that the program ended before it had run for a while, and its complement.
#[unsafe(link_section = ".crash_record")]
static ENDS: [AtomicU32; 2] = [const { AtomicU32::new(0) }; 2];

unsafe extern "C" {
    /// [`NEXT_BOOTLOADER`] and its complement where that is to run next: start-up reads it (`start_up.rs`). The
    /// linker's (memory.x), as a variable that no Rust reads is not written either.
    static __next_program: [AtomicU32; 2];
}

fn count_end() -> u32 {
    let [ends, check] = ENDS.each_ref().map(|word| word.load(Ordering::Relaxed));
    let ends = if check == !ends { ends + 1 } else { 1 };
    set_ends(ends);
    ends
}

fn set_ends(ends: u32) {
    for (slot, word) in ENDS.iter().zip([ends, !ends]) {
        slot.store(word, Ordering::Relaxed);
    }
}

/// Counts a start after the watchdog; stays there if it is one too many in a row. The reset pin begins anew, and so does power-on, whose
/// RAM holds no count; a supply that sagged does not. To be called before [`read_crash_record`], which begins another record: the LED
/// and the start that follows tell the fault of the last run.
pub fn count_start(flags: ResetFlags) {
    if flags.watchdog {
        if count_end() > MAX_ENDS {
            stay(stored_record().fault);
        }
    } else if flags.pin && !flags.software && !flags.brown_out {
        set_ends(0);
    }
}

/// The program has run for a while.
pub fn ran_well() {
    set_ends(0);
}

/// Reads the record that the last run left, and counts this start.
pub fn read_crash_record() -> Option<CrashRecord> {
    let last = CrashRecord::from_words(stored_words());
    write(CrashRecord::begun(last));
    last
}

/// Notes the active fault, for whatever may come.
pub fn note_fault(number: u16) {
    note(CrashRecord {
        fault: number,
        ..stored_record()
    });
}

/// Notes the active fault, and what control keeps through a reset.
pub fn note_state(fault: u16, control: RetainedControl) {
    note(CrashRecord {
        fault,
        control,
        ..stored_record()
    });
}

fn note(record: CrashRecord) {
    if record != stored_record() {
        write(record);
    }
}

fn stored_words() -> [u32; WORDS] {
    core::array::from_fn(|k| CRASH_RECORD[k].load(Ordering::Relaxed))
}

fn stored_record() -> CrashRecord {
    CrashRecord::from_words(stored_words()).unwrap_or_default()
}

/// Writes the record at once: an end in between, in an interrupt, would find a damaged one, and no lock-out.
fn write(record: CrashRecord) {
    let words = record.to_words();
    cortex_m::interrupt::free(|_| {
        for (slot, word) in CRASH_RECORD.iter().zip(words) {
            slot.store(word, Ordering::Relaxed);
        }
    });
}

/// Begins anew because a host has asked for it, outputs open.
pub fn restart(into: Program) -> ! {
    outputs_off();
    write(CrashRecord {
        reason: Some(ResetReason::Software),
        ..stored_record()
    });
    let words = match into {
        Program::Firmware => [0; 2],
        Program::Bootloader => [NEXT_BOOTLOADER, !NEXT_BOOTLOADER],
    };
    // SAFETY: two words of RAM that nothing else uses.
    let next_program = unsafe { &__next_program };
    for (slot, word) in next_program.iter().zip(words) {
        slot.store(word, Ordering::Relaxed);
    }
    cortex_m::peripheral::SCB::sys_reset()
}

fn end(reason: ResetReason) -> ! {
    // From here on no interrupt closes a switch.
    cortex_m::interrupt::disable();
    outputs_off();
    write(CrashRecord {
        reason: Some(reason),
        ..stored_record()
    });
    if count_end() > MAX_ENDS {
        stay(stored_record().fault);
    }
    cortex_m::peripheral::SCB::sys_reset()
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    end(ResetReason::Panic)
}

/// An error of flash or RAM that cannot be corrected (RM0440: FLASH, "Error code correction (ECC)";
/// SYSCFG, SYSCFG_CFGR2). In a page of the lookup it is what a power failure leaves, and the page counts as
/// empty. Elsewhere HRTIM's system fault has opened the bridge already; the number is left for the next
/// start, as no code is to be trusted from here on.
#[cortex_m_rt::exception]
unsafe fn NonMaskableInt() {
    if is_damaged_page() {
        return;
    }
    if let Some(fault) = system_fault() {
        note_fault(fault.number());
    }
    end(ResetReason::Panic)
}

/// Every fault of the processor ends here, as none but the hard fault is enabled. After a stack
/// overflow the stack pointer is outside the RAM, so it is set first. The frame of the faulting
/// code is not needed: "the fault handler executes even though the stack push for the handler
/// failed" (Cortex-M4 Devices Generic User Guide, 2.4.2).
#[unsafe(naked)]
#[unsafe(export_name = "HardFault")]
unsafe extern "C" fn hard_fault() -> ! {
    core::arch::naked_asm!(
        "mrs r0, msp",
        "ldr r1, =_stack_start",
        "msr msp, r1",
        "b {end}",
        end = sym processor_fault,
    )
}

/// `sp` is the stack pointer after the processor pushed, or tried to push, its frame.
extern "C" fn processor_fault(sp: usize) -> ! {
    unsafe extern "C" {
        static _stack_end: u32;
    }
    let stack_end = &raw const _stack_end as usize;
    end(if sp < stack_end {
        ResetReason::StackOverflow
    } else {
        ResetReason::Panic
    })
}
