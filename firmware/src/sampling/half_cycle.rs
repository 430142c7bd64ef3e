//! Measurements over a mains half-cycle.

use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::wire::messages::Limit;

use crate::fixed::Complex;
use crate::limits::{COMPARED_FROM_DV, HALF_CYCLE_MAX_NS, HALF_CYCLE_MIN_NS, POT_CURRENT_MIN_MA};
use crate::sense::bus::BusReading;
use crate::sense::demodulator::{Phasors, amplitude_dv};

/// Measurements over one mains half-cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HalfCycle {
    /// Half-cycles since boot.
    pub half_cycle: u32,
    /// Switching frequency in hertz; 0 with the inverter off.
    pub f_sw_hz: u32,
    /// Duration, in nanoseconds.
    pub duration_ns: u32,
    /// Load, current and voltages at the crest of the current.
    pub crest: CurrentCrest,
    /// Mean power, in milliwatt, all harmonics included.
    pub power_mw: u32,
    /// Mean power out of the DC link, in milliwatt, where a sensor is fitted.
    pub dc_link_mw: Option<u32>,
    /// Highest bus voltage, in decivolt.
    pub bus_peak_dv: u16,
    /// Bus voltage at the zero crossing that ended it, in decivolt.
    pub bus_at_crossing_dv: u16,
    /// Largest sample of the coil voltage where it reached its soft limit, in decivolt; else 0.
    pub v_peak_dv: u32,
    /// Smallest current at a turn-off, in milliampere; `i32::MAX` where none was seen.
    pub i_turn_off_min_ma: i32,
    /// The soft limit that acted last.
    pub limit: Limit,
    /// The drive changed within it: R, L and power are of no one frequency.
    pub disturbed: bool,
    /// It is a pot probe, from the zero crossing to before the crest.
    pub is_pot_probe: bool,
    /// Offsets and gaps of the channels.
    pub channels: ChannelDefects,
}

/// Load, current and voltages where the current's amplitude was largest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CurrentCrest {
    /// Estimated R.
    pub r: MicroOhm,
    /// Estimated L.
    pub l: PicoHenry,
    /// Amplitude of the current's fundamental, in milliampere; 0 when none was seen.
    pub i_ma: u32,
    /// Bus voltage.
    pub bus: BusReading,
    /// Coil voltage and current.
    pub phasors: Phasors,
}

/// Signs of a channel that does not read what is there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ChannelDefects {
    /// Mean of the coil voltage, in decivolt.
    pub v_offset_dv: i32,
    /// Mean of the coil current, in milliampere.
    pub i_offset_ma: i32,
    /// The current has no code just below zero, or none just above: a bit of the converter sticks.
    pub i_gap: bool,
}

impl HalfCycle {
    /// All bits zero, as the default.
    pub(crate) const BLANK: Self = Self {
        half_cycle: 0,
        f_sw_hz: 0,
        duration_ns: 0,
        crest: CurrentCrest {
            r: MicroOhm(0),
            l: PicoHenry(0),
            i_ma: 0,
            bus: BusReading::steady(0),
            phasors: Phasors {
                v: Complex { re: 0, im: 0 },
                i: Complex { re: 0, im: 0 },
            },
        },
        power_mw: 0,
        dc_link_mw: None,
        bus_peak_dv: 0,
        bus_at_crossing_dv: 0,
        v_peak_dv: 0,
        i_turn_off_min_ma: 0,
        limit: Limit::None,
        disturbed: false,
        is_pot_probe: false,
        channels: ChannelDefects {
            v_offset_dv: 0,
            i_offset_ma: 0,
            i_gap: false,
        },
    };

    /// Returns `true` if it lasted as long as a mains' half-cycle does.
    pub fn is_in_time(&self) -> bool {
        (HALF_CYCLE_MIN_NS..=HALF_CYCLE_MAX_NS).contains(&self.duration_ns)
    }

    /// Returns `true` if the bus was high enough to compare readings with each other.
    pub fn is_comparable(&self) -> bool {
        self.bus_peak_dv >= COMPARED_FROM_DV
    }

    /// Returns `true` if the coil carried enough current to judge a load by.
    pub fn has_coil_current(&self) -> bool {
        self.crest.i_ma >= POT_CURRENT_MIN_MA
    }

    /// Amplitude of the coil voltage's fundamental at the crest, in decivolt.
    pub fn v_crest_dv(&self) -> u32 {
        amplitude_dv(self.crest.phasors.v.norm_squared())
    }
}
