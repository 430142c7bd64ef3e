//! Requests of control and link, and what they read, between two blocks.

use ihd_shared::fault::Fault;
use ihd_shared::units::{MicroOhm, PicoHenry};

use crate::drive::bridge::{Bridge, Drive};
use crate::drive::sequencer::PotProbe;
use crate::estimate::ekf::{Ekf, Noise};
use crate::sampling::half_cycle_sums::HalfCycleSums;
use crate::sampling::path::SamplingPath;
use crate::sampling::recorder::Recorder;
use crate::sampling::utilisation::{HousekeepingGap, Utilisation};
use crate::sense::demodulator::Demodulator;
use crate::sense::product_sums::PairArithmetic;

/// Drive and replay.
impl<M: PairArithmetic> SamplingPath<M> {
    /// Requests another drive: off at once, anything else at the next zero crossing, at the nearest
    /// frequency of the grid; out of off, the lower switch closes first, at once ([`crate::drive::bridge`]). Ignored while a
    /// fault is active.
    pub fn request(&mut self, drive: Drive) {
        self.sequencer.request(drive);
    }

    /// Requests a pot probe from the next zero crossing on.
    pub fn request_pot_probe(&mut self, probe: PotProbe) {
        self.sequencer.request_pot_probe(probe);
    }

    /// Requests that both switches open at the next zero crossing.
    pub fn request_off_at_crossing(&mut self) {
        self.sequencer.request_off_at_crossing();
    }

    /// The last request, or what a soft limit has made of it.
    pub fn requested_drive(&self) -> Drive {
        self.sequencer.requested()
    }

    /// Varies the switching frequency from half-cycle to half-cycle, in permille, at most
    /// [`crate::limits::DITHER_MAX_PERMILLE`], outside windows: +, 0, −, 0.
    pub fn set_dither(&mut self, permille: u8) {
        self.sequencer.set_dither(permille);
    }

    /// The drive in force at the bridge.
    pub fn drive(&self) -> Drive {
        if self.replaying {
            Drive::OFF
        } else {
            self.sequencer.drive()
        }
    }

    /// Returns `true` if both switches are open, and nothing requests anything else.
    pub fn is_bridge_open(&self) -> bool {
        [self.drive().bridge, self.requested_drive().bridge] == [Bridge::Open; 2]
    }

    /// Enters or leaves replay mode. Either way the bridge is off and the estimator begins anew
    /// with the given load; in replay mode it sees a bridge that runs at `f_sw_hz`.
    pub fn set_replay(&mut self, replay: bool, f_sw_hz: u32, r: MicroOhm, l: PicoHenry) {
        let drive = if replay && !self.faults.is_active() {
            Drive::switching(f_sw_hz)
        } else {
            Drive::OFF
        };
        self.replaying = replay;
        self.sequencer.force(drive);
        self.clock.set_frequency(drive.f_sw_hz);
        self.clock.restart_half_cycle();
        self.demodulator = Demodulator::new(drive.f_sw_hz);
        self.ekf = Ekf::new(drive.f_sw_hz, r, l, Noise::TUNED);
        self.protection.set_frequency(drive.f_sw_hz);
        self.soft_limits
            .set_frequency(drive.f_sw_hz, self.protection.l_min());
        self.protection.reset();
        self.half_cycles.restart();
        self.recorder.interrupt();
    }

    /// Returns `true` if samples come from a host.
    pub fn is_replaying(&self) -> bool {
        self.replaying
    }

    /// Returns `true` while zero crossings of the mains come.
    pub fn has_mains(&self) -> bool {
        self.protection.has_mains()
    }
}

/// Faults.
impl<M: PairArithmetic> SamplingPath<M> {
    /// Enters the safe state for a reason that lies outside the samples: the pot, the hardware.
    pub fn raise(&mut self, fault: Fault) {
        self.faults.trip(fault, self.clock.half_cycle());
    }

    /// Enters the safe state for good: the board is not as it must be, and clearing does not help.
    pub fn latch_fault(&mut self, fault: Fault) {
        self.faults.latch(fault, self.clock.half_cycle());
    }

    /// The active fault.
    pub fn fault(&self) -> Fault {
        self.faults.active()
    }

    /// The half-cycle in which the active fault tripped; the present one without a fault.
    pub fn fault_half_cycle(&self) -> u32 {
        let present = self.clock.half_cycle();
        self.faults.half_cycle().unwrap_or(present)
    }

    /// Leaves the safe state, but for a standing fault; the bridge stays off until it is requested
    /// again.
    pub fn clear_fault(&mut self) {
        self.faults.clear();
        self.sequencer.withdraw();
        self.protection.reset();
    }
}

/// Half-cycles, windows, counters.
impl<M: PairArithmetic> SamplingPath<M> {
    /// The last half-cycle, once; the thread works out its summary.
    pub fn take_half_cycle(&mut self) -> Option<HalfCycleSums> {
        self.half_cycles.take()
    }

    /// The window recorder, for the link to set and read.
    pub fn recorder(&mut self) -> &mut Recorder {
        &mut self.recorder
    }

    /// Time since boot, in milliseconds; wraps after 49 days.
    pub fn now_ms(&self) -> u32 {
        self.clock.now_ms()
    }

    /// Blocks from the ADC since boot.
    pub fn blocks(&self) -> u32 {
        self.clock.blocks()
    }

    /// Half-cycles since boot.
    pub fn half_cycles(&self) -> u32 {
        self.clock.half_cycle()
    }

    /// Sample pairs at the end of the ADC's range since boot.
    pub fn saturated_pairs(&self) -> u32 {
        self.saturated_pairs
    }

    /// Share of the processor's time, for the board to add each block to.
    pub fn utilisation(&mut self) -> &mut Utilisation {
        &mut self.utilisation
    }

    /// Time between two turns of housekeeping.
    pub fn housekeeping_gap(&mut self) -> &mut HousekeepingGap {
        &mut self.housekeeping_gap
    }
}
