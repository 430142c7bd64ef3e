//! The sampling path, once per block of 61 pairs, in the sampling interrupt.
//!
//! Budget at f_sw = 70 kHz: a block is 42.9 µs, 7 286 cycles of 170 MHz, and this may take 1 907
//! instructions of it, 26 %, most of them to correlate and estimate. firmware/budget.toml holds the ceilings of its
//! parts, docs/performance.md what was counted, in cycles with registers and memory 40.6 %. A block that
//! comes late is counted as lost; the third of a half-cycle trips [`SAMPLES_LOST`](ihd_shared::fault::Fault::SAMPLES_LOST).
//! Nothing here waits, allocates, divides by a variable of 64 bit, uses
//! floating point or can panic.

use core::marker::PhantomData;

use ihd_shared::sampling::{ADC_LOCK_P, Pair, block_ns};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::window::TrajectoryEntry;
use ihd_shared::wire::messages::Limit;

use crate::drive::bridge::Drive;
use crate::drive::sequencer::{BlockConditions, DriveSequencer};
use crate::estimate::ekf::{Ekf, Noise};
use crate::limits::PROBE_CURRENT_MA;
use crate::protect::fault_latch::FaultLatch;
use crate::protect::soft_limit::SoftLimits;
use crate::protect::trips::TripChecks;
use crate::sampling::half_cycle_sums::HalfCycles;
use crate::sampling::mains_clock::MainsClock;
use crate::sampling::recorder::Recorder;
use crate::sampling::utilisation::{HousekeepingGap, Utilisation};
use crate::sense::bus::BusReading;
use crate::sense::correlation::{BlockSums, correlate_by};
use crate::sense::demodulator::Demodulator;
use crate::sense::mains::MAINS_DELAY_NS;
use crate::sense::product_sums::{PairArithmetic, PlainArithmetic};

/// Duration of a block with the bridge open, in nanoseconds.
const OFF_BLOCK_NS: u32 = block_ns(Drive::OFF.f_sw_hz);

mod requests;

/// One block as the board delivers it.
#[derive(Clone, Copy, Debug)]
pub struct AdcBlock<'a> {
    /// Sample pairs of three switching periods.
    pub pairs: &'a [Pair; ADC_LOCK_P],
    /// Index of the pair next to a mains zero crossing as its source sees it, if one fell into the block: the board's is late by
    /// [`MAINS_DELAY_NS`].
    pub zero_crossing: Option<u8>,
    /// Bus voltage.
    pub bus: BusReading,
    /// Mean current out of the DC link, in milliampere, where a sensor is fitted.
    pub dc_link_ma: Option<u32>,
    /// Blocks lost since the last one (DMA overrun).
    pub lost: u32,
}

/// Exclusive use of the sampling path for the duration of a closure. The board takes a critical
/// section; every closure is short: the longest with the bridge closed copies 120 bytes of a window, with it open a block of a recording.
pub trait SamplingLock {
    /// Arithmetic of the path.
    type Arithmetic: PairArithmetic;

    /// Runs `f` on the sampling path.
    fn with<R>(&mut self, f: impl FnOnce(&mut SamplingPath<Self::Arithmetic>) -> R) -> R;
}

impl<M: PairArithmetic> SamplingLock for SamplingPath<M> {
    type Arithmetic = M;

    fn with<R>(&mut self, f: impl FnOnce(&mut Self) -> R) -> R {
        f(self)
    }
}

/// Everything the sampling interrupt owns. A board may bring its own arithmetic for the sums of a block.
pub struct SamplingPath<M = PlainArithmetic> {
    arithmetic: PhantomData<M>,
    clock: MainsClock,
    sequencer: DriveSequencer,
    demodulator: Demodulator,
    ekf: Ekf,
    protection: TripChecks,
    soft_limits: SoftLimits,
    faults: FaultLatch,
    half_cycles: HalfCycles,
    recorder: Recorder,
    /// Samples come from a host; the bridge is off, whatever the sequencer's drive.
    replaying: bool,
    /// Pairs at the end of the ADC's range since boot.
    saturated_pairs: u32,
    utilisation: Utilisation,
    housekeeping_gap: HousekeepingGap,
}

impl SamplingPath {
    /// Bridge off; the estimator expects the given load.
    pub fn new(r: MicroOhm, l: PicoHenry) -> Self {
        let mut new = Self::blank();
        new.begin(r, l);
        new
    }
}

impl<M: PairArithmetic> SamplingPath<M> {
    /// All bits zero: 53 KiB that a board places in its cleared memory and that never cross a
    /// stack. [`SamplingPath::begin`] comes before anything else.
    pub const fn blank() -> Self {
        Self {
            arithmetic: PhantomData,
            clock: MainsClock::blank(),
            sequencer: DriveSequencer::blank(),
            demodulator: Demodulator::blank(),
            ekf: Ekf::blank(),
            protection: TripChecks::blank(),
            soft_limits: SoftLimits::blank(),
            faults: FaultLatch::new(),
            half_cycles: HalfCycles::blank(),
            recorder: Recorder::new(),
            replaying: false,
            saturated_pairs: 0,
            utilisation: Utilisation::blank(),
            housekeeping_gap: HousekeepingGap::blank(),
        }
    }

    /// Makes a blank path ready: bridge off, the estimator expects the given load.
    pub fn begin(&mut self, r: MicroOhm, l: PicoHenry) {
        self.sequencer.begin();
        self.clock.set_frequency(Drive::OFF.f_sw_hz);
        self.demodulator = Demodulator::new(Drive::OFF.f_sw_hz);
        self.ekf = Ekf::new(Drive::OFF.f_sw_hz, r, l, Noise::TUNED);
        self.protection.set_frequency(Drive::OFF.f_sw_hz);
    }

    /// Takes one block from the ADC; returns the drive from the next block on. In
    /// replay mode the block is ignored and the bridge is off.
    pub fn on_block(&mut self, block: &AdcBlock<'_>) -> Drive {
        if block.lost > 0 {
            self.lose_blocks(block.lost);
        }
        let block_ns = self.adc_block_ns();
        self.clock.count_block(block_ns);
        self.housekeeping_gap.add(block_ns);
        if !self.replaying {
            self.take_block(block);
        }
        self.drive()
    }

    /// Duration of the ADC's blocks, in nanoseconds: while a recording is replayed, those of an open bridge.
    #[inline]
    fn adc_block_ns(&self) -> u32 {
        if self.replaying {
            OFF_BLOCK_NS
        } else {
            self.clock.block_ns()
        }
    }

    /// Takes one block from a host; returns the estimate it led to; `None` outside replay mode or before the first.
    pub fn replay_block(&mut self, block: &AdcBlock<'_>) -> Option<TrajectoryEntry> {
        if self.replaying {
            self.take_block(block)
        } else {
            None
        }
    }
}

/// Steps of a block.
impl<M: PairArithmetic> SamplingPath<M> {
    /// Takes one block; returns the estimate it led to; `None` while the demodulator fills.
    fn take_block(&mut self, block: &AdcBlock<'_>) -> Option<TrajectoryEntry> {
        let sums = correlate_by::<M>(block.pairs);
        self.saturated_pairs = self.saturated_pairs.wrapping_add(u32::from(sums.saturated));
        let crossing = block.zero_crossing.filter(|_| self.clock.may_cross());
        let at_crossing = crossing.is_some();
        let block_ns = self.clock.block_ns();
        let running = self.half_cycles.running();
        running.add_block(&sums, block.bus.dv, block.dc_link_ma);
        if !at_crossing {
            running.add_offsets(block.pairs);
            running.look_near_zero(block.pairs);
        }
        let tripped = self.protection.check_block(
            &sums,
            block.bus.dv,
            block_ns,
            at_crossing,
            // A recording may repeat itself.
            self.sequencer.drive().is_switching() && !self.replaying,
        );
        if let Some(fault) = tripped {
            self.raise(fault);
        }
        match crossing {
            Some(at) => self.cross_zero(block, usize::from(at).min(ADC_LOCK_P), sums.saturated),
            None => {
                let all = 0..ADC_LOCK_P;
                self.recorder.push(block.pairs, all, sums.saturated);
            }
        }
        let estimate = self.estimate(&sums, &block.bus);
        self.recorder.advance(block_ns);
        self.clock.advance();
        self.sequencer
            .watch_bus(block.bus.dv, at_crossing, block_ns);
        if self.sequencer.drive().is_switching() {
            self.limit_within_block(block, &sums);
            self.end_pot_probe(block.bus.dv);
        }
        self.take_drive(at_crossing, block.bus.dv);
        estimate
    }

    /// Passes the time of blocks that are missing before this one. Pairs that do not follow one another are no window.
    #[cold]
    #[inline(never)]
    fn lose_blocks(&mut self, lost: u32) {
        // A half-cycle has 267 at most, and the third trips.
        let lost_ns = lost.min(300) * self.adc_block_ns();
        self.clock.pass(lost_ns);
        self.housekeeping_gap.add(lost_ns);
        if !self.replaying {
            self.clock.pass_in_half_cycle(lost_ns);
            self.protection.lose_blocks(lost);
            self.recorder.interrupt();
        }
    }

    /// Ends a half-cycle before pair `at` of the block and begins the next with it.
    fn cross_zero(&mut self, block: &AdcBlock<'_>, at: usize, saturated: u16) {
        // A recording's crossing is where its host says.
        let since_ns = if self.replaying {
            0
        } else {
            MAINS_DELAY_NS as i32
        };
        let over = self.clock.cross_zero(at, since_ns);
        self.recorder.push(block.pairs, 0..at, saturated);
        self.recorder.end(over.duration_ns);
        self.finish_half_cycle(over.half_cycle, over.duration_ns, block.bus.dv, false);
        let drive = self.sequencer.drive();
        let half_cycle = self.clock.half_cycle();
        // A window has one frequency throughout, so none begins at a frequency step.
        if self.recorder.is_due(half_cycle)
            && drive.is_switching()
            && self.sequencer.requested() == drive
        {
            self.recorder
                .begin(half_cycle, drive.f_sw_hz, over.block_start_ns, since_ns);
            let after = at..ADC_LOCK_P;
            self.recorder.push(block.pairs, after, saturated);
        }
    }

    #[inline]
    fn finish_half_cycle(
        &mut self,
        half_cycle: u32,
        duration_ns: u32,
        bus_dv: u16,
        is_pot_probe: bool,
    ) {
        let f_sw_hz = self.sequencer.f_sw_hz();
        self.half_cycles
            .finish(half_cycle, f_sw_hz, duration_ns, bus_dv, is_pot_probe);
    }

    /// Demodulates and estimates while the bridge switches, and checks the estimate.
    #[inline]
    fn estimate(&mut self, sums: &BlockSums, bus: &BusReading) -> Option<TrajectoryEntry> {
        if !self.sequencer.drive().is_switching() {
            return None;
        }
        let phasors = self.demodulator.push(sums)?;
        self.ekf.step(&phasors);
        let entry = TrajectoryEntry {
            r: self.ekf.r(),
            l: self.ekf.l(),
        };
        if !self.ekf.is_held() {
            let running = self.half_cycles.running();
            running.add_estimate(&phasors, entry, bus);
        }
        let delay_blocks = self.demodulator.delay_blocks();
        self.recorder
            .estimate(entry, self.clock.block_ns(), delay_blocks);
        if !self.ekf.is_held()
            && let Some(fault) = self.protection.check_estimate(&self.ekf)
        {
            self.raise(fault);
        }
        Some(entry)
    }

    /// Acts within a block while the bridge switches: on the soft limits, and on a mains that is away,
    /// which opens both switches until its next zero crossing.
    fn limit_within_block(&mut self, block: &AdcBlock<'_>, sums: &BlockSums) {
        let checked = self.soft_limits.check(sums, block.pairs, block.bus.dv);
        self.half_cycles.running().add_check(&checked);
        // A recording's drive is what it was.
        if self.replaying {
            return;
        }
        let limited = checked.limit != Limit::None && !self.faults.is_active();
        let next = match self.sequencer.without_mains() {
            None if limited => self.sequencer.raise_frequency(),
            off => off,
        };
        if let Some(next) = next {
            self.half_cycles.running().disturb();
            self.change_drive(next);
        }
    }

    /// Ends a pot probe once it has lasted, or the coil carries more than any pot takes, and hands over its measurements.
    fn end_pot_probe(&mut self, bus_dv: u16) {
        let probe_ns = self.sequencer.probe_ns();
        if probe_ns == 0 {
            return;
        }
        let since_ns = self.clock.since_crossing_ns();
        let is_enough = self.half_cycles.running().has_reached(PROBE_CURRENT_MA);
        if since_ns < i64::from(probe_ns) && !is_enough {
            return;
        }
        let lasts_ns = since_ns.min(i64::from(probe_ns)) as u32;
        self.finish_half_cycle(self.clock.half_cycle(), lasts_ns, bus_dv, true);
        self.half_cycles.running().disturb();
        self.request(Drive::OFF);
    }

    /// Takes the sequencer's drive from the next block on.
    fn take_drive(&mut self, at_crossing: bool, bus_dv: u16) {
        let half_cycle = self.clock.half_cycle();
        // A window begins at a frequency that was there before, and keeps it.
        let may_dither = at_crossing
            && self.sequencer.is_dithering()
            && !self.recorder.is_recording()
            && !self.recorder.is_due(half_cycle.wrapping_add(1));
        let next = self.sequencer.next(&BlockConditions {
            at_crossing,
            bus_dv,
            block_ns: self.clock.block_ns(),
            is_faulty: self.faults.is_active(),
            dithered_half_cycle: may_dither.then_some(half_cycle),
        });
        if let Some(next) = next {
            if next.within_half_cycle {
                self.half_cycles.running().disturb();
            }
            self.change_drive(next.drive);
        }
    }

    fn change_drive(&mut self, next: Drive) {
        let before = self.sequencer.drive();
        if next.f_sw_hz != before.f_sw_hz {
            self.clock.set_frequency(next.f_sw_hz);
            self.ekf.set_frequency(next.f_sw_hz);
            self.protection.set_frequency(next.f_sw_hz);
        }
        if !before.is_switching() {
            self.ekf.restart();
        }
        self.soft_limits
            .set_frequency(next.f_sw_hz, self.protection.l_min());
        if !before.is_switching() {
            self.soft_limits.hold_start();
        }
        self.demodulator.restart(next.f_sw_hz);
        self.recorder.interrupt();
        self.sequencer.apply(next);
    }
}

#[cfg(test)]
mod tests;
