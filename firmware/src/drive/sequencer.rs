//! Sequencer of the bridge: from a requested drive to the drive in force, block by block.
//!
//! A request takes effect at the next zero crossing, off at once. Between the two lie the bootstrap capacitor's charge and the
//! tank's discharge ([`crate::drive::bridge`]), a probe's end, and the dither of the frequency.

use crate::drive::bridge::{Bridge, Drive};
use crate::drive::bus_watch::BusWatch;
use crate::drive::pwm;
use crate::limits::{
    BUS_AT_START_DV, BUS_START_MAX_DV, DITHER_MAX_PERMILLE, IDLE_LINK_NS, PROBE_NS,
    SECOND_PROBE_HZ, SECOND_PROBE_NS, SOFT_STEP_PERMILLE,
};

/// Pulse that shows what stands on the coil: from a zero crossing to before the crest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PotProbe {
    f_sw_hz: u32,
    lasts_ns: u32,
}

impl PotProbe {
    /// Switching frequency, in hertz.
    pub fn f_sw_hz(self) -> u32 {
        self.f_sw_hz
    }

    /// At the highest frequency, where any load takes least.
    pub const FIRST: Self = Self {
        f_sw_hz: pwm::MAX_HZ,
        lasts_ns: PROBE_NS,
    };
    /// At a lower one: how R changes with the frequency.
    pub const SECOND: Self = Self {
        f_sw_hz: SECOND_PROBE_HZ,
        lasts_ns: SECOND_PROBE_NS,
    };
}

/// Conditions of a block for the next drive.
#[derive(Clone, Copy, Debug)]
pub struct BlockConditions {
    /// A zero crossing fell into the block.
    pub at_crossing: bool,
    /// Bus voltage, in decivolt.
    pub bus_dv: u16,
    /// Duration of the block, in nanoseconds.
    pub block_ns: u32,
    /// A fault is active.
    pub is_faulty: bool,
    /// Half-cycle that begins with the block, if its frequency may be varied.
    pub dithered_half_cycle: Option<u32>,
}

/// Change of the drive with the next block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DriveChange {
    /// The drive from then on.
    pub drive: Drive,
    /// It begins no half-cycle of the mains: what is measured in this one has no one frequency.
    pub within_half_cycle: bool,
}

/// Requested drive, drive in force, and what stands between them.
#[derive(Clone, Debug)]
pub struct DriveSequencer {
    drive: Drive,
    requested: Drive,
    /// Time that the lower switch has been closed, while only it is.
    lower_on_ns: u32,
    /// The lower switch may close: the mains has passed its zero since the switches opened after switching.
    may_close: bool,
    /// Off, which was requested, waits for a zero crossing.
    off_at_crossing: bool,
    /// The next half-cycle that the bridge switches is a pot probe, which ends so long after its zero crossing; 0 for none.
    probe_ns: u32,
    dither_permille: u8,
    bus: BusWatch,
}

impl DriveSequencer {
    /// All bits zero; [`DriveSequencer::begin`] comes before anything else.
    pub const fn blank() -> Self {
        let drive = Drive {
            f_sw_hz: 0,
            bridge: Bridge::Open,
        };
        Self {
            drive,
            requested: drive,
            lower_on_ns: 0,
            may_close: false,
            off_at_crossing: false,
            probe_ns: 0,
            dither_permille: 0,
            bus: BusWatch::blank(),
        }
    }

    /// Makes a blank sequencer ready: both switches open since long.
    pub fn begin(&mut self) {
        self.force(Drive::OFF);
        self.may_close = true;
    }

    /// Sets request and drive at once, without the sequence: the drive of a recording, or off.
    pub fn force(&mut self, drive: Drive) {
        self.drive = drive;
        self.requested = drive;
        // The bridge may have switched until now.
        self.may_close = false;
    }

    /// Requests another drive, at the nearest frequency of the grid.
    pub fn request(&mut self, drive: Drive) {
        self.off_at_crossing = false;
        self.probe_ns = 0;
        self.requested = Drive {
            f_sw_hz: pwm::nearest_hz(drive.f_sw_hz),
            ..drive
        };
    }

    /// Requests a pot probe from the next zero crossing on.
    pub fn request_pot_probe(&mut self, probe: PotProbe) {
        self.request(Drive::switching(probe.f_sw_hz));
        self.probe_ns = probe.lasts_ns;
    }

    /// Requests that both switches open, a bridge that switches at the next zero crossing; a pot probe ends at once, as it would
    /// before the crest.
    pub fn request_off_at_crossing(&mut self) {
        let is_probe = self.probe_ns > 0;
        self.request(Drive::OFF);
        self.off_at_crossing = !is_probe;
    }

    /// Withdraws what was requested: off.
    pub fn withdraw(&mut self) {
        self.requested = Drive::OFF;
        (self.off_at_crossing, self.probe_ns) = (false, 0);
    }

    /// Varies the switching frequency from half-cycle to half-cycle, in permille, at most
    /// [`DITHER_MAX_PERMILLE`]: +, 0, −, 0.
    pub fn set_dither(&mut self, permille: u8) {
        self.dither_permille = permille.min(DITHER_MAX_PERMILLE);
    }

    /// Returns `true` if the frequency is varied.
    #[inline]
    pub fn is_dithering(&self) -> bool {
        self.dither_permille > 0
    }

    /// The last request, or what a soft limit has made of it.
    #[inline]
    pub fn requested(&self) -> Drive {
        self.requested
    }

    /// The drive in force.
    #[inline]
    pub fn drive(&self) -> Drive {
        self.drive
    }

    /// Switching frequency in hertz; 0 while no power flows.
    #[inline]
    pub fn f_sw_hz(&self) -> u32 {
        if self.drive.is_switching() {
            self.drive.f_sw_hz
        } else {
            0
        }
    }

    /// Duration of the pot probe for which the bridge switches, or is about to, in nanoseconds; 0 for none.
    #[inline]
    pub fn probe_ns(&self) -> u32 {
        self.probe_ns
    }

    /// Takes the bus voltage of a block, in decivolt.
    #[inline]
    pub fn watch_bus(&mut self, bus_dv: u16, at_crossing: bool, block_ns: u32) {
        let switching = self.drive.is_switching();
        self.bus.on_block(bus_dv, at_crossing, switching, block_ns);
    }

    /// The drive while the mains is away: both switches open until its next zero crossing; `None` if it is there.
    #[inline]
    pub fn without_mains(&self) -> Option<Drive> {
        self.bus.is_mains_away().then_some(Drive {
            bridge: Bridge::Open,
            ..self.drive
        })
    }

    /// The drive after a soft limit: the next higher frequency, which a later request keeps; `None` at the highest one,
    /// where what is left is to trip.
    pub fn raise_frequency(&mut self) -> Option<Drive> {
        let step_hz = self.drive.f_sw_hz * SOFT_STEP_PERMILLE / 1_000;
        let higher = Drive::switching(pwm::nearest_hz(self.drive.f_sw_hz + step_hz));
        if higher == self.drive {
            return None;
        }
        if self.requested.is_switching() {
            self.requested.f_sw_hz = self.requested.f_sw_hz.max(higher.f_sw_hz);
        }
        Some(higher)
    }

    /// The change with the next block ([`Drive::next`]); `None` if the drive stays.
    #[inline]
    pub fn next(&mut self, block: &BlockConditions) -> Option<DriveChange> {
        let at_crossing = block.at_crossing;
        if self.drive.bridge == Bridge::LowerOn {
            self.lower_on_ns = self.lower_on_ns.saturating_add(block.block_ns);
        }
        // A fault ends the request too: a bridge that is open for good is off.
        if block.is_faulty {
            self.withdraw();
        }
        self.off_at_crossing &= self.drive.is_switching() && !at_crossing;
        let requested = if self.off_at_crossing {
            self.drive
        } else {
            self.dithered(block.dithered_half_cycle)
        };
        self.may_close |= at_crossing && self.drive.bridge == Bridge::Open;
        let may_start = block.bus_dv < BUS_AT_START_DV
            || (self.lower_on_ns > IDLE_LINK_NS && block.bus_dv < BUS_START_MAX_DV);
        let may_change = at_crossing && (self.drive.is_switching() || may_start);
        let next = self
            .drive
            .next(requested, may_change, self.lower_on_ns, self.may_close);
        (next != self.drive).then_some(DriveChange {
            drive: next,
            within_half_cycle: !may_change,
        })
    }

    /// Puts a drive in force.
    #[inline]
    pub fn apply(&mut self, next: Drive) {
        if self.drive.is_switching() {
            self.may_close &= next.is_switching();
        }
        self.lower_on_ns = 0;
        self.drive = next;
    }

    /// The requested drive with the frequency of a half-cycle: its own in every other one, by which power control regulates.
    fn dithered(&self, half_cycle: Option<u32>) -> Drive {
        let requested = self.requested;
        let Some(half_cycle) = half_cycle.filter(|_| requested.is_switching()) else {
            return requested;
        };
        let by_hz = requested.f_sw_hz * u32::from(self.dither_permille) / 1_000;
        let f_sw_hz = match half_cycle & 3 {
            1 => pwm::nearest_hz(requested.f_sw_hz + by_hz),
            3 => pwm::nearest_hz(requested.f_sw_hz - by_hz),
            _ => requested.f_sw_hz,
        };
        Drive {
            f_sw_hz,
            ..requested
        }
    }
}
