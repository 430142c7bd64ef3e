//! Blocks of silence in place of an ADC: timer 0 stands for the DMA, and every so many blocks the
//! mains crosses zero. Without half-cycles no lookup would ever become active.

use core::ptr;
use core::sync::atomic::{AtomicU32, Ordering};

use embassy_executor::InterruptExecutor;
use ihd_firmware::drive::bridge::Drive;
use ihd_firmware::sampling::path::AdcBlock;
use ihd_firmware::sense::bus::BusReading;
use ihd_shared::sampling::{ADC_LOCK_P, Pair};

use crate::board::sampling::SampleSource;

// CMSDK timer 0 (Arm DDI 0479, section 4.4), at 25 MHz on an an386.
const CTRL: *mut u32 = 0x4000_0000 as *mut u32;
const RELOAD: *mut u32 = 0x4000_0008 as *mut u32;
const INT_CLEAR: *mut u32 = 0x4000_000C as *mut u32;
const ENABLE: u32 = 1 << 0 | 1 << 3;

/// 1 ms. Slower than a board's 37.5 µs, so that an emulator that shares its processor keeps up.
const TICK: u32 = 25_000;

/// Blocks a tick.
const BLOCKS: u32 = 8;

/// Blocks of 37.5 µs in a half-cycle of 50 Hz.
const BLOCKS_PER_HALF_CYCLE: u32 = 267;

/// Polls the sampling task, in the tick's own interrupt.
pub static SAMPLING_EXECUTOR: InterruptExecutor = InterruptExecutor::new();

static DUE: AtomicU32 = AtomicU32::new(0);
static SILENCE: [Pair; ADC_LOCK_P] = [Pair { v: 0, i: 0 }; ADC_LOCK_P];

fn write(register: *mut u32, value: u32) {
    // SAFETY: the constants above are this timer's registers, always mapped; it touches no memory.
    unsafe { ptr::write_volatile(register, value) }
}

#[unsafe(no_mangle)]
extern "C" fn TIMER0() {
    write(INT_CLEAR, 1);
    DUE.store(BLOCKS, Ordering::Release);
    // SAFETY: this is the interrupt that the executor was started with.
    unsafe { SAMPLING_EXECUTOR.on_interrupt() }
}

/// An ADC without a signal.
pub struct SilentAdc {
    block: u32,
}

impl SilentAdc {
    /// Starts the tick.
    pub fn start() -> Self {
        write(RELOAD, TICK - 1);
        write(CTRL, ENABLE);
        Self { block: 0 }
    }
}

impl SampleSource for SilentAdc {
    fn next(&mut self, take: impl FnOnce(&AdcBlock<'_>) -> Drive) -> bool {
        let due = DUE.load(Ordering::Acquire);
        if due == 0 {
            return false;
        }
        DUE.store(due - 1, Ordering::Release);
        self.block += 1;
        let crossing = self.block >= BLOCKS_PER_HALF_CYCLE;
        if crossing {
            self.block = 0;
        }
        // There is no bridge to drive.
        let _ = take(&AdcBlock {
            pairs: &SILENCE,
            zero_crossing: crossing.then_some(0),
            bus: BusReading::steady(0),
            dc_link_ma: None,
            lost: 0,
        });
        true
    }

    /// QEMU's cycle counter stands still.
    fn block_cycles(&self) -> u32 {
        0
    }
}
