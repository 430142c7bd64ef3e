//! The sampling path: what runs once per block of 61 pairs, in the sampling interrupt.
//!
//! Budget at f_sw = 70 kHz: a block is 42.9 µs, 7 286 cycles of 170 MHz, and this may take 2 430
//! instructions of it, 33 %: 61 times at most 14.6 to correlate, 225 for the boxcars, 726 for the
//! estimator, the rest for protection, soft limits and recording. firmware/budget.toml holds these ceilings,
//! docs/performance.md what was counted, and an estimate in cycles that exceeds 36 %. A block that
//! comes late is counted as lost; the third of a half-cycle trips [`Fault::SAMPLES_LOST`].
//! Nothing here waits, allocates, divides by a variable of 64 bit, uses
//! floating point or can panic.

use ihd_shared::fault::Fault;
use ihd_shared::sampling::{ADC_LOCK_P, Pair, block_ns};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::window::TrajectoryEntry;
use ihd_shared::wire::messages::Limit;

use crate::demod::{BlockSums, Demodulator, correlate};
pub use crate::drive::{Bridge, Drive};
use crate::ekf::{Ekf, Noise};
use crate::half_cycle::{Accumulator, Gathered};
use crate::limits::{
    BUS_AT_START_DV, BUS_DOWN_DV, BUS_DOWN_NS, BUS_MIN_DV, DITHER_MAX_PERMILLE, IDLE_LINK_NS,
    LOOK_NS, SHORTEST_HALF_CYCLE_NS, SOFT_STEP_PERMILLE,
};
use crate::protection::Protection;
use crate::pwm;
use crate::recorder::Recorder;
use crate::soft_limit::SoftLimits;
use crate::utilisation::Utilisation;

/// One block as the board delivers it.
#[derive(Clone, Copy, Debug)]
pub struct Block<'a> {
    /// Sample pairs of three switching periods.
    pub pairs: &'a [Pair; ADC_LOCK_P],
    /// Index of the first pair after a mains zero crossing, if one fell into the block.
    pub zero_crossing: Option<u8>,
    /// Bus voltage, in decivolt.
    pub bus_dv: u16,
    /// Mean current out of the DC link, in milliampere, where a sensor is fitted.
    pub dc_link_ma: Option<u32>,
    /// Blocks lost since the last one (DMA overrun).
    pub lost: u32,
}

/// Exclusive use of the sampling path for the duration of a closure. The board takes a critical
/// section; every closure is short (the longest copies one 960-byte chunk).
pub trait Access {
    /// Runs `f` on the sampling path.
    fn with<R>(&mut self, f: impl FnOnce(&mut RealTime) -> R) -> R;
}

impl Access for RealTime {
    fn with<R>(&mut self, f: impl FnOnce(&mut RealTime) -> R) -> R {
        f(self)
    }
}

/// Everything the sampling interrupt owns.
pub struct RealTime {
    drive: Drive,
    wanted: Drive,
    /// How long the lower switch has been closed, while only it is.
    lower_on_ns: u32,
    /// The mains has passed its zero since the switches opened after switching.
    at_rest: bool,
    block_ns: u32,
    demod: Demodulator,
    ekf: Ekf,
    protection: Protection,
    soft: SoftLimits,
    /// How long the bus has been down while the bridge switches.
    bus_down_ns: u32,
    /// The bus has had voltage in this half-cycle, and in the one before.
    bus_was_up: (bool, bool),
    /// The next open bridge waits for a zero crossing.
    off_at_crossing: bool,
    /// The next half-cycle that the bridge switches is a look for a pot, and ends before its crest.
    looking: bool,
    dither_permille: u8,
    /// Time since boot: whole milliseconds, and the rest.
    now_ms: u32,
    now_rest_ns: u32,
    accumulator: Accumulator,
    recorder: Recorder,
    windows_every: u8,
    /// Time of the current block's first pair since the last zero crossing.
    since_crossing_ns: i64,
    half_cycle: u32,
    /// The last half-cycle, while nobody has taken it. No option, whose `None` may have bits set.
    gathered: Gathered,
    has_gathered: bool,
    fault: Fault,
    /// Half-cycle in which the fault tripped.
    fault_half_cycle: u32,
    saturated_pairs: u32,
    /// Blocks since boot.
    blocks: u32,
    /// Samples come from a host; the bridge is off whatever `drive` says.
    replaying: bool,
    /// Version of the active lookup, for the windows' headers.
    lookup_version: u32,
    utilisation: Utilisation,
    /// Time since housekeeping's last turn, and the longest so far.
    gap_ns: u32,
    longest_gap_ns: u32,
    /// A fault of the board itself, which clearing does not end.
    standing_fault: Fault,
}

impl RealTime {
    /// Bridge off; the estimator expects the given load.
    pub fn new(r: MicroOhm, l: PicoHenry) -> Self {
        let mut new = Self::blank();
        new.begin(r, l);
        new
    }

    /// All bits zero: 68 KiB that a board places in its cleared memory and that never cross a
    /// stack. [`RealTime::begin`] comes before anything else.
    pub const fn blank() -> Self {
        let drive = Drive {
            f_sw_hz: 0,
            bridge: Bridge::Open,
        };
        Self {
            drive,
            wanted: drive,
            lower_on_ns: 0,
            at_rest: false,
            block_ns: 0,
            demod: Demodulator::blank(),
            ekf: Ekf::blank(),
            protection: Protection::blank(),
            soft: SoftLimits::blank(),
            bus_down_ns: 0,
            bus_was_up: (false, false),
            off_at_crossing: false,
            looking: false,
            dither_permille: 0,
            now_ms: 0,
            now_rest_ns: 0,
            accumulator: Accumulator::blank(),
            recorder: Recorder::new(),
            windows_every: 0,
            since_crossing_ns: 0,
            half_cycle: 0,
            gathered: Gathered::blank(),
            has_gathered: false,
            fault: Fault::NONE,
            fault_half_cycle: 0,
            saturated_pairs: 0,
            blocks: 0,
            replaying: false,
            lookup_version: 0,
            utilisation: Utilisation::blank(),
            gap_ns: 0,
            longest_gap_ns: 0,
            standing_fault: Fault::NONE,
        }
    }

    /// Makes a blank path ready: bridge off, the estimator expects the given load.
    pub fn begin(&mut self, r: MicroOhm, l: PicoHenry) {
        self.drive = Drive::OFF;
        self.wanted = Drive::OFF;
        self.at_rest = true;
        self.block_ns = block_ns(Drive::OFF.f_sw_hz);
        self.demod = Demodulator::new(Drive::OFF.f_sw_hz);
        self.ekf = Ekf::new(Drive::OFF.f_sw_hz, r, l, Noise::TUNED);
    }

    /// Takes one block from the ADC; returns what the bridge is to do from the next block on. In
    /// replay mode the block is ignored and the bridge is off.
    pub fn on_block(&mut self, block: &Block<'_>) -> Drive {
        self.blocks = self.blocks.wrapping_add(1);
        self.gap_ns = self.gap_ns.saturating_add(self.block_ns);
        self.now_rest_ns += self.block_ns;
        // Not a division: a block is 37 to 88 µs.
        if self.now_rest_ns >= 1_000_000 {
            self.now_rest_ns -= 1_000_000;
            self.now_ms = self.now_ms.wrapping_add(1);
        }
        if !self.replaying {
            self.take_block(block);
        }
        self.drive()
    }

    /// Asks for another drive: off at once, anything else at the next zero crossing, at the nearest
    /// frequency of the grid; out of off, the lower switch closes first, at once ([`crate::drive`]). Ignored while a fault is active.
    pub fn request(&mut self, drive: Drive) {
        self.off_at_crossing = false;
        self.looking = false;
        self.wanted = Drive {
            f_sw_hz: pwm::nearest_hz(drive.f_sw_hz),
            ..drive
        };
    }

    /// Asks for a look at what stands on the coil: at the highest frequency, from the next zero crossing to
    /// before the crest. A summary that is a glance tells.
    pub fn request_look(&mut self) {
        self.request(Drive::switching(pwm::HIGHEST_HZ));
        self.looking = true;
    }

    /// Asks for both switches to open at the next zero crossing.
    pub fn request_off_at_crossing(&mut self) {
        self.off_at_crossing = true;
    }

    /// What is asked for: the last request, or what a soft limit has made of it.
    pub fn wanted(&self) -> Drive {
        self.wanted
    }

    /// Varies the switching frequency from half-cycle to half-cycle by so much, at most
    /// [`DITHER_MAX_PERMILLE`], outside windows: +, 0, −, 0.
    pub fn set_dither(&mut self, permille: u8) {
        self.dither_permille = permille.min(DITHER_MAX_PERMILLE);
    }

    /// Time since boot, in milliseconds; wraps after 49 days.
    pub fn now_ms(&self) -> u32 {
        self.now_ms
    }

    /// Blocks from the ADC since boot.
    pub fn blocks(&self) -> u32 {
        self.blocks
    }

    /// Switching frequency in hertz, 0 while no power flows.
    fn f_sw_hz(&self) -> u32 {
        if self.drive.is_switching() {
            self.drive.f_sw_hz
        } else {
            0
        }
    }

    /// The drive in force at the bridge.
    pub fn drive(&self) -> Drive {
        if self.replaying {
            Drive::OFF
        } else {
            self.drive
        }
    }

    /// Enters or leaves replay mode. Either way the bridge is off and the estimator begins anew
    /// with the given load; in replay mode it sees a bridge that runs at `f_sw_hz`.
    pub fn set_replay(&mut self, replay: bool, f_sw_hz: u32, r: MicroOhm, l: PicoHenry) {
        let drive = if replay && self.fault == Fault::NONE {
            Drive::switching(f_sw_hz)
        } else {
            Drive::OFF
        };
        self.replaying = replay;
        self.drive = drive;
        self.wanted = drive;
        self.block_ns = block_ns(drive.f_sw_hz);
        self.demod = Demodulator::new(drive.f_sw_hz);
        self.ekf = Ekf::new(drive.f_sw_hz, r, l, Noise::TUNED);
        self.protection.set_frequency(drive.f_sw_hz);
        self.soft
            .set_frequency(drive.f_sw_hz, self.protection.l_min());
        self.protection.reset();
        self.accumulator = Accumulator::default();
        self.recorder.interrupt();
        self.since_crossing_ns = SHORTEST_HALF_CYCLE_NS;
    }

    /// Whether samples come from a host.
    pub fn is_replaying(&self) -> bool {
        self.replaying
    }

    /// Takes one block from a host; returns the estimate it led to, if any.
    pub fn replay_block(&mut self, block: &Block<'_>) -> Option<TrajectoryEntry> {
        if self.replaying {
            self.take_block(block)
        } else {
            None
        }
    }

    /// Enters the safe state for a reason that lies outside the samples: the pot, the hardware.
    pub fn raise(&mut self, fault: Fault) {
        self.trip(fault);
    }

    /// Enters the safe state for good: the board is not as it must be, and clearing does not help.
    pub fn raise_standing(&mut self, fault: Fault) {
        self.standing_fault = fault;
        self.trip(fault);
    }

    /// What the sampling path costs, for the board to add each block to.
    pub fn utilisation(&mut self) -> &mut Utilisation {
        &mut self.utilisation
    }

    /// Housekeeping has its turn.
    pub fn note_turn(&mut self) {
        self.longest_gap_ns = self.longest_gap_ns.max(self.gap_ns);
        self.gap_ns = 0;
    }

    /// Longest time between two turns of housekeeping since this was asked last, in microseconds, to
    /// a block.
    pub fn take_longest_gap_us(&mut self) -> u32 {
        core::mem::take(&mut self.longest_gap_ns) / 1_000
    }

    /// The active fault.
    pub fn fault(&self) -> Fault {
        self.fault
    }

    /// The half-cycle in which the active fault tripped; the present one without a fault.
    pub fn fault_half_cycle(&self) -> u32 {
        match self.fault {
            Fault::NONE => self.half_cycle,
            _ => self.fault_half_cycle,
        }
    }

    /// Leaves the safe state, but for a standing fault; the bridge stays off until it is asked for
    /// again.
    pub fn clear_fault(&mut self) {
        self.fault = self.standing_fault;
        self.wanted = Drive::OFF;
        self.off_at_crossing = false;
        self.protection.reset();
    }

    /// The last half-cycle, once; its summary is worked out by whoever has taken it.
    pub fn take_half_cycle(&mut self) -> Option<Gathered> {
        core::mem::take(&mut self.has_gathered).then(|| self.gathered.clone())
    }

    /// A window every this many half-cycles; 0 for none.
    pub fn set_windows_every(&mut self, half_cycles: u8) {
        self.windows_every = half_cycles;
    }

    /// Another lookup is active from the next window on.
    pub fn set_lookup_version(&mut self, version: u32) {
        self.lookup_version = version;
    }

    /// The window recorder, for the link to read.
    pub fn recorder(&mut self) -> &mut Recorder {
        &mut self.recorder
    }

    /// Half-cycles since boot.
    pub fn half_cycles(&self) -> u32 {
        self.half_cycle
    }

    /// Sample pairs at the end of the ADC's range since boot.
    pub fn saturated_pairs(&self) -> u32 {
        self.saturated_pairs
    }

    /// Takes one block; returns the estimate it led to.
    fn take_block(&mut self, block: &Block<'_>) -> Option<TrajectoryEntry> {
        let mut estimate = None;
        let sums = correlate(block.pairs);
        self.saturated_pairs = self.saturated_pairs.wrapping_add(u32::from(sums.saturated));
        let crossing = block
            .zero_crossing
            .filter(|_| self.since_crossing_ns >= SHORTEST_HALF_CYCLE_NS);
        self.accumulator
            .add_block(&sums, block.bus_dv, block.dc_link_ma);
        self.accumulator.look_at_offset(block.pairs);
        let raw = self.protection.check_block(
            &sums,
            block.bus_dv,
            block.lost,
            self.block_ns,
            crossing.is_some(),
            // A recording may repeat itself.
            self.drive.is_switching() && !self.replaying,
        );
        if let Some(fault) = raw {
            self.trip(fault);
        }
        match crossing {
            Some(at) => self.cross_zero(block, usize::from(at).min(ADC_LOCK_P)),
            None => self.recorder.push(block.pairs, sums.saturated == 0),
        }
        if self.drive.is_switching()
            && let Some(phasors) = self.demod.push(&sums)
        {
            self.ekf.step(&phasors);
            self.accumulator.add_estimate(&phasors, &self.ekf);
            let entry = TrajectoryEntry {
                r: self.ekf.r(),
                l: self.ekf.l(),
            };
            estimate = Some(entry);
            self.recorder
                .estimate(entry, self.block_ns, self.demod.delay_blocks());
            if !self.ekf.is_held()
                && let Some(fault) = self.protection.check_estimate(&self.ekf)
            {
                self.trip(fault);
            }
        }
        self.recorder.advance(self.block_ns);
        self.since_crossing_ns = self
            .since_crossing_ns
            .saturating_add(i64::from(self.block_ns));
        if crossing.is_some() {
            self.bus_was_up = (false, self.bus_was_up.0);
        }
        self.bus_was_up.0 |= block.bus_dv >= BUS_MIN_DV;
        if self.drive.is_switching() {
            self.watch(block, &sums);
            self.end_look(block.bus_dv);
        } else {
            self.bus_down_ns = 0;
        }
        self.take_drive(crossing.is_some(), block.bus_dv);
        estimate
    }

    /// Ends a look once it has lasted, and tells what it saw.
    fn end_look(&mut self, bus_dv: u16) {
        if !self.looking || self.since_crossing_ns < i64::from(LOOK_NS) {
            return;
        }
        let f_sw_hz = self.f_sw_hz();
        self.gathered = self
            .accumulator
            .finish(self.half_cycle, f_sw_hz, LOOK_NS, bus_dv, true);
        self.has_gathered = true;
        self.accumulator.disturb();
        self.request(Drive::OFF);
    }

    /// What acts within a block while the bridge switches: the soft limits, and a mains that is away,
    /// which opens both switches until its next zero crossing.
    fn watch(&mut self, block: &Block<'_>, sums: &BlockSums) {
        let checked = self.soft.check(sums, block.pairs, block.bus_dv);
        self.accumulator.add_check(&checked);
        let down = block.bus_dv < BUS_DOWN_DV;
        self.bus_down_ns = if down {
            self.bus_down_ns + self.block_ns
        } else {
            0
        };
        // A recording's drive is what it was.
        if self.replaying {
            return;
        }
        // A bus that never comes up is a sensor's fault, or a bench without power.
        let was_up = self.bus_was_up.0 || self.bus_was_up.1;
        if was_up && self.bus_down_ns > BUS_DOWN_NS {
            self.bus_down_ns = 0;
            self.accumulator.disturb();
            self.change_drive(Drive {
                bridge: Bridge::Open,
                ..self.drive
            });
        } else if checked.limit != Limit::None && self.fault == Fault::NONE {
            let step_hz = self.drive.f_sw_hz * SOFT_STEP_PERMILLE / 1_000;
            let higher = Drive::switching(pwm::nearest_hz(self.drive.f_sw_hz + step_hz));
            if higher == self.drive {
                // At the highest frequency what is left is to trip.
                return;
            }
            if self.wanted.is_switching() {
                self.wanted.f_sw_hz = self.wanted.f_sw_hz.max(higher.f_sw_hz);
            }
            self.accumulator.disturb();
            self.change_drive(higher);
        }
    }

    /// Ends a half-cycle before pair `at` of the block and begins the next with it.
    fn cross_zero(&mut self, block: &Block<'_>, at: usize) {
        let (before, after) = block.pairs.split_at(at);
        // 61 times 88 µs at most: 32 bit, as one of 64 is divided by a library.
        let offset_ns = i64::from(at as u32 * self.block_ns / ADC_LOCK_P as u32);
        let duration_ns = self.since_crossing_ns.saturating_add(offset_ns);
        self.since_crossing_ns = -offset_ns;
        self.recorder.push(before, false);
        let duration_ns = u32::try_from(duration_ns).unwrap_or(u32::MAX);
        self.recorder.end(duration_ns);
        let f_sw_hz = self.f_sw_hz();
        self.gathered =
            self.accumulator
                .finish(self.half_cycle, f_sw_hz, duration_ns, block.bus_dv, false);
        self.has_gathered = true;
        self.half_cycle = self.half_cycle.wrapping_add(1);
        // A window wants one frequency throughout, so none begins at a frequency step.
        if self.is_window_due(0) && self.drive.is_switching() && self.wanted == self.drive {
            self.recorder.begin(
                self.half_cycle,
                self.drive.f_sw_hz,
                self.lookup_version,
                -offset_ns,
            );
            self.recorder.push(after, false);
        }
    }

    /// Whether the half-cycle that runs, or one so many after it, is to be recorded.
    fn is_window_due(&self, ahead: u32) -> bool {
        let every = u32::from(self.windows_every);
        every > 0 && self.half_cycle.wrapping_add(ahead).is_multiple_of(every)
    }

    /// The drive that [`Drive::next`] says, from the next block on.
    fn take_drive(&mut self, at_crossing: bool, bus_dv: u16) {
        if self.drive.bridge == Bridge::LowerOn {
            self.lower_on_ns = self.lower_on_ns.saturating_add(self.block_ns);
        }
        if at_crossing && self.off_at_crossing {
            self.wanted = Drive::OFF;
            self.off_at_crossing = false;
        }
        let wanted = if self.fault == Fault::NONE {
            self.dithered(self.wanted, at_crossing)
        } else {
            Drive::OFF
        };
        self.at_rest |= at_crossing && self.drive.bridge == Bridge::Open;
        let may_start = bus_dv < BUS_AT_START_DV || self.lower_on_ns > IDLE_LINK_NS;
        let at_crossing = at_crossing && (self.drive.is_switching() || may_start);
        let next = self
            .drive
            .next(wanted, at_crossing, self.lower_on_ns, self.at_rest);
        if next != self.drive {
            if !at_crossing {
                self.accumulator.disturb();
            }
            self.change_drive(next);
        }
    }

    /// The frequency that a half-cycle gets: its own in every other one, which power control looks at,
    /// and in those that are recorded.
    fn dithered(&self, wanted: Drive, at_crossing: bool) -> Drive {
        if self.dither_permille == 0 || !wanted.is_switching() || !at_crossing {
            return wanted;
        }
        let by_hz = wanted.f_sw_hz * u32::from(self.dither_permille) / 1_000;
        let f_sw_hz = match self.half_cycle & 3 {
            // A window begins at a frequency that was there before.
            _ if self.is_window_due(0) || self.is_window_due(1) => wanted.f_sw_hz,
            1 => pwm::nearest_hz(wanted.f_sw_hz + by_hz),
            3 => pwm::nearest_hz(wanted.f_sw_hz - by_hz),
            _ => wanted.f_sw_hz,
        };
        Drive { f_sw_hz, ..wanted }
    }

    fn change_drive(&mut self, next: Drive) {
        if next.f_sw_hz != self.drive.f_sw_hz {
            self.block_ns = block_ns(next.f_sw_hz);
            self.ekf.set_frequency(next.f_sw_hz);
            self.protection.set_frequency(next.f_sw_hz);
        }
        if self.drive.is_switching() {
            self.at_rest &= next.is_switching();
        } else {
            self.ekf.restart();
        }
        self.soft
            .set_frequency(next.f_sw_hz, self.protection.l_min());
        self.lower_on_ns = 0;
        self.demod.restart(next.f_sw_hz);
        self.recorder.interrupt();
        self.drive = next;
    }

    fn trip(&mut self, fault: Fault) {
        if self.fault == Fault::NONE {
            self.fault = fault;
            self.fault_half_cycle = self.half_cycle;
        }
    }
}
