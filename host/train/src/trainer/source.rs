//! Source of a training run's windows.

use std::fmt;

use ihd_shared::sampling::{Pair, Scales};
use ihd_signal::Segment;
use ihd_signal::truth::{PeriodTruth, Truth};

use crate::replay::stretch::{BUS_DV, Stretch};

/// Least share of a half-cycle that a recording must hold to be replayed.
const WHOLE: f64 = 0.99;

/// Operating points, in order.
#[derive(Clone, Debug, PartialEq)]
pub enum TrainingSource {
    /// Powers in watt that the hob heats with.
    Powers(Vec<u16>),
    /// Recorded half-cycles that replace the samples of the device's ADC; its power outputs are locked off meanwhile.
    Replay(Vec<RecordedHalfCycle>),
}

/// One mains half-cycle on the device's ADC grid, from its zero crossing on.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedHalfCycle {
    /// Switching frequency in hertz.
    pub f_sw_hz: u32,
    /// Whole blocks of sample pairs at f_sw·61/3.
    pub pairs: Vec<Pair>,
    /// Bus voltage at the crest in decivolt.
    pub bus_dv: u16,
    /// Truth of the load, in seconds from the first pair on; `None` if the capture holds none.
    pub truth: Option<Truth>,
}

impl RecordedHalfCycle {
    /// Returns the complete mains half-cycles of a segment, resampled to the ADC's grid in codes of the device's scales. `truth` is that of
    /// the whole capture, empty if it holds none.
    pub fn half_cycles(segment: &Segment, scales: Scales, truth: &[PeriodTruth]) -> Vec<Self> {
        let whole = WHOLE * segment.half_cycle_s() / segment.dt_s;
        let bounds = segment.half_cycles().into_iter();
        bounds
            .filter(|(from, to)| (to - from) as f64 >= whole)
            .filter_map(|(from, to)| Stretch::of(&segment.part(from, to), scales))
            .map(|stretch| Self {
                f_sw_hz: stretch.f_sw_hz,
                truth: truth_of(&stretch, truth),
                pairs: stretch.pairs,
                bus_dv: BUS_DV,
            })
            .collect()
    }
}

/// Returns the part of a capture's truth within a stretch; `None` if there is none.
fn truth_of(stretch: &Stretch, truth: &[PeriodTruth]) -> Option<Truth> {
    let from = truth.partition_point(|t| t.t_s < stretch.t0_s);
    let end_s = stretch.t0_s + stretch.pairs.len() as f64 * stretch.dt_s;
    let to = truth.partition_point(|t| t.t_s <= end_s);
    let within = truth.get(from..to).filter(|within| !within.is_empty())?;
    let of = |value: fn(&PeriodTruth) -> f64| within.iter().map(value).collect::<Vec<_>>();
    Some(Truth {
        half_cycle: 0,
        f_sw_hz: f64::from(stretch.f_sw_hz),
        t_s: within.iter().map(|t| t.t_s - stretch.t0_s).collect(),
        r_ohm: of(|t| t.r_ohm[0]),
        l_h: of(|t| t.l_h[0]),
        i_a: of(|t| t.i_a),
    })
}

/// Operating point of a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OperatingPoint {
    /// Heating with a requested power.
    Heating {
        /// Requested power in watt.
        asked_w: u16,
    },
    /// A recorded half-cycle.
    Replayed {
        /// Its switching frequency in hertz.
        f_sw_hz: u32,
    },
}

impl OperatingPoint {
    /// Returns the requested power in watt; `None` in a replay.
    pub fn asked_w(self) -> Option<u16> {
        match self {
            Self::Heating { asked_w } => Some(asked_w),
            Self::Replayed { .. } => None,
        }
    }
}

impl fmt::Display for OperatingPoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Heating { asked_w } => write!(f, "{asked_w} W"),
            Self::Replayed { f_sw_hz } => {
                write!(f, "{:.2} kHz (replayed)", f64::from(*f_sw_hz) * 1e-3)
            }
        }
    }
}
