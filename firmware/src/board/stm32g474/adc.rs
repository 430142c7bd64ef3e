//! Blocks of pairs from the circular DMA, bus and mains beside them, and the drive to the bridge.

use core::cell::UnsafeCell;
use core::ops::Range;
use core::ptr;
use core::sync::atomic::{AtomicU32, Ordering};

use embassy_executor::InterruptExecutor;
use embassy_stm32::interrupt;
use ihd_firmware::drive::bridge::{Bridge, Drive};
use ihd_firmware::drive::pwm::Periods;
use ihd_firmware::drive::soft_start::{self, SoftStart};
use ihd_firmware::link::channel_test::SlowCodes;
use ihd_firmware::sampling::path::AdcBlock;
use ihd_firmware::sense::bus::{BusReading, SLOW_CODES, bus_places};
use ihd_firmware::sense::dma_buffer::DmaDoubleBuffer;
use ihd_firmware::sense::mains::{ZeroCrossingDetector, mains_place};
use ihd_firmware::sense::supply::SupplyScale;
use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q, Pair};

use super::registers::{adc, bridge, dma, faults, sampling_watchdog};
use crate::board::sampling::SampleSource;

/// Channels of the pins in the module's table.
const VOLTAGE: u8 = 1;
const CURRENT: u8 = 2;
const BUS: u8 = 1;
const MAINS: u8 = 12;

const WORDS: usize = 2 * ADC_LOCK_P;

/// Memory that a DMA writes.
struct DmaMemory<T>(UnsafeCell<T>);

// SAFETY: the processor only reads it, word by word and volatile, in one task.
unsafe impl<T> Sync for DmaMemory<T> {}

static PAIRS: DmaMemory<[u32; WORDS]> = DmaMemory(UnsafeCell::new([0; WORDS]));
static SLOW: DmaMemory<[i16; SLOW_CODES]> = DmaMemory(UnsafeCell::new([0; SLOW_CODES]));

/// Addresses that a DMA writes at any moment, interrupts masked or not.
pub fn written_by_dma() -> [Range<usize>; 2] {
    let (pairs, slow) = (PAIRS.0.get() as usize, SLOW.0.get() as usize);
    [
        pairs..pairs + size_of::<[u32; WORDS]>(),
        slow..slow + size_of::<[i16; SLOW_CODES]>(),
    ]
}

/// Code of bus or mains at one of the [`SLOW_CODES`] places.
#[inline(always)]
fn slow_code(place: usize) -> i16 {
    let codes = SLOW.0.get().cast::<i16>();
    // SAFETY: the remainder is inside SLOW, and a half-word is read as a whole.
    unsafe { ptr::read_volatile(codes.wrapping_add(place % SLOW_CODES)) }
}

/// A code of bus and mains each, two blocks old at most.
pub fn slow_codes() -> SlowCodes {
    let [.., bus] = bus_places(0);
    SlowCodes {
        bus: slow_code(bus).unsigned_abs(),
        mains: slow_code(mains_place(0)),
    }
}

/// Cycles that all blocks which were taken should have lasted; wraps.
static SAMPLED_CYCLES: AtomicU32 = AtomicU32::new(0);

/// See [`SAMPLED_CYCLES`].
pub fn sampled_cycles() -> u32 {
    SAMPLED_CYCLES.load(Ordering::Relaxed)
}

/// Correction of every code for the supply, from the thread.
static SUPPLY_SCALE: AtomicU32 = AtomicU32::new(SupplyScale::NOMINAL.to_bits());

/// Sets the correction of every code from the next block on.
pub fn set_supply_scale(scale: SupplyScale) {
    SUPPLY_SCALE.store(scale.to_bits(), Ordering::Relaxed);
}

/// Polls the sampling task, in the DMA's own interrupt.
pub static SAMPLING_EXECUTOR: InterruptExecutor = InterruptExecutor::new();

/// Half or all of the double block is filled. The executor runs in this interrupt and its task is
/// always ready, so that nothing comes between the flag and the task.
#[interrupt]
fn DMA1_CHANNEL1() {
    // SAFETY: this is the interrupt that the executor was started with.
    unsafe { SAMPLING_EXECUTOR.on_interrupt() }
}

/// A block is three switching periods, a cycle eight ticks.
fn block_cycles(periods: Periods) -> u32 {
    ADC_LOCK_Q * u32::from(periods.switching) / 8
}

/// The ADCs, and the bridge they are locked to.
pub struct Adc {
    ring: DmaDoubleBuffer,
    mains: ZeroCrossingDetector,
    drive: Drive,
    soft_start: SoftStart,
    /// Upper switch's part of half the period, in 1/[`soft_start::WHOLE_SHARE`].
    share: u32,
    block_cycles: u32,
    /// Pairs of the block that is taken, a word each.
    pairs: [u32; ADC_LOCK_P],
}

impl Adc {
    /// Starts the conversions, then the timers that trigger them, with the bridge off.
    pub fn start() -> Self {
        let periods = Periods::nearest(Drive::OFF.f_sw_hz);
        bridge::prepare_timers(periods);
        // SAFETY: both are static, and only the DMA writes them.
        unsafe {
            adc::start_slow(BUS, MAINS, SLOW.0.get().cast(), SLOW_CODES as u16);
            adc::start_pairs(VOLTAGE, CURRENT, PAIRS.0.get().cast(), WORDS as u16);
        }
        bridge::run_timers();
        Self {
            ring: DmaDoubleBuffer::default(),
            mains: ZeroCrossingDetector::default(),
            drive: Drive::OFF,
            soft_start: SoftStart::new(),
            share: soft_start::WHOLE_SHARE,
            block_cycles: block_cycles(periods),
            pairs: [0; ADC_LOCK_P],
        }
    }

    /// Copies a half and corrects it for the supply; the DMA is a block away unless this task came late, which the ring finds out.
    fn copy(&mut self, half: usize, scale: SupplyScale) {
        let begin = PAIRS.0.get().cast::<u32>().wrapping_add(half * ADC_LOCK_P);
        // SAFETY: `half` is 0 or 1 and `k` below 61, so this is inside PAIRS.
        let word = |k: usize| unsafe { ptr::read_volatile(begin.wrapping_add(k)) };
        // Two loops: a supply that needs no correction costs no time.
        if scale == SupplyScale::NOMINAL {
            for (k, pair) in self.pairs.iter_mut().enumerate() {
                *pair = word(k);
            }
        } else {
            for (k, pair) in self.pairs.iter_mut().enumerate() {
                *pair = scale.pair(word(k));
            }
        }
    }

    fn apply(&mut self, drive: Drive) {
        let share = self.soft_start.on_block(drive);
        if drive == self.drive && share == self.share {
            return;
        }
        if drive.bridge == Bridge::Open {
            if self.drive.bridge != Bridge::Open {
                faults::keep_flags();
            }
            bridge::open();
        }
        if drive.f_sw_hz != self.drive.f_sw_hz || share != self.share {
            let periods = Periods::nearest(drive.f_sw_hz);
            let on = u32::from(periods.half()) * share / soft_start::WHOLE_SHARE;
            bridge::set_periods(periods, on as u16);
            self.block_cycles = block_cycles(periods);
        }
        match (self.drive.bridge, drive.bridge) {
            (Bridge::Open, Bridge::LowerOn) => bridge::close_lower(),
            (Bridge::Open, Bridge::Switching) => {
                bridge::close_lower();
                bridge::switch(true);
            }
            (Bridge::LowerOn, Bridge::Switching) => bridge::switch(true),
            (Bridge::Switching, Bridge::LowerOn) => bridge::switch(false),
            _ => {}
        }
        (self.drive, self.share) = (drive, share);
    }
}

impl SampleSource for Adc {
    fn next(&mut self, take: impl FnOnce(&AdcBlock<'_>) -> Drive) -> bool {
        let Some(half) = self.ring.take(dma::filled()) else {
            return false;
        };
        let scale = SupplyScale::from_bits(SUPPLY_SCALE.load(Ordering::Relaxed));
        self.copy(half, scale);
        let at = WORDS.saturating_sub(usize::from(dma::words_left()));
        if !self.ring.is_whole(half, at) {
            return true;
        }
        // This interrupt is the only writer.
        let sampled = sampled_cycles().wrapping_add(self.block_cycles);
        SAMPLED_CYCLES.store(sampled, Ordering::Relaxed);
        let bus_codes = bus_places(half).map(|place| slow_code(place).unsigned_abs());
        let drive = take(&AdcBlock {
            pairs: Pair::of_words(&self.pairs),
            zero_crossing: self.mains.on_block(slow_code(mains_place(half)).into()),
            bus: BusReading::new(bus_codes, half, scale),
            dc_link_ma: None,
            lost: self.ring.take_lost(),
        });
        self.apply(drive);
        sampling_watchdog::feed();
        true
    }

    fn block_cycles(&self) -> u32 {
        self.block_cycles
    }
}
