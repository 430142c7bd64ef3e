//! Fault injection: accidents on demand, named by QEMU's `-semihosting-config arg=`, so that a test
//! sees what the next start reports. Only at power-on, or they would repeat for ever.

use ihd_firmware::retained::reset::CrashRecord;

use crate::board::crash;

/// Bytes of the emulator's command line that are looked at.
const LENGTH: usize = 64;

/// Has the accident that the command line asks for.
pub fn if_asked(last: Option<CrashRecord>) {
    if last.is_some() {
        return;
    }
    let mut line = [0u8; LENGTH];
    match command_line(&mut line) {
        Some("panic") => {
            crash::note_fault(4);
            panic!("asked to")
        }
        Some("stack-overflow") => {
            overflow(&line);
        }
        Some("processor-fault") => {
            // SAFETY: not sound, on purpose: nothing answers at this address, and the test needs the
            // fault that follows.
            unsafe { core::ptr::read_volatile(0xA000_0000 as *const u32) };
        }
        _ => {}
    }
}

/// SYS_GET_CMDLINE (Arm semihosting, 0x15).
fn command_line(buf: &mut [u8; LENGTH]) -> Option<&str> {
    let mut block = [buf.as_mut_ptr() as usize, LENGTH - 1];
    // SAFETY: the block is what the call asks for, a buffer and its length; QEMU writes no more
    // than that, a terminating zero included, and the length it wrote.
    let failed = unsafe { cortex_m_semihosting::syscall1(0x15, block.as_mut_ptr() as usize) };
    let length = core::hint::black_box(block)[1].min(LENGTH);
    let line = buf.get(..length).filter(|_| failed == 0)?;
    core::str::from_utf8(line).ok().map(str::trim)
}

#[expect(
    unconditional_recursion,
    reason = "to overflow the stack is its purpose"
)]
#[inline(never)]
fn overflow(seed: &[u8; LENGTH]) -> u8 {
    // Volatile, or the recursion becomes a loop.
    let mut frame = core::hint::black_box(*seed);
    frame[0] = frame[0].wrapping_add(1);
    let deeper = overflow(&frame);
    core::hint::black_box(&frame)[1].wrapping_add(deeper)
}
