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

/// One mains half-cycle on the device's ADC grid.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedHalfCycle {
    /// Switching frequency in hertz.
    pub f_sw_hz: u32,
    /// Time of the first pair after the mains zero crossing, in nanoseconds.
    pub first_pair_ns: i32,
    /// Duration of the half-cycle, of which `pairs` may lack part of a block, in nanoseconds.
    pub half_cycle_ns: u32,
    /// Whole blocks of sample pairs at f_sw·61/3.
    pub pairs: Vec<Pair>,
    /// Bus voltage at the crest in decivolt.
    pub bus_dv: u16,
    /// Truth of the load, in seconds after the mains zero crossing; `None` if the capture holds none.
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
            .filter_map(|(from, to)| {
                let stretch = Stretch::resample(&segment.part(from, to), scales).ok()?;
                let crossing_s = segment.crossing_of_s((from, to));
                Some(Self {
                    f_sw_hz: stretch.f_sw_hz,
                    first_pair_ns: (1e9 * (stretch.t0_s - crossing_s)).round() as i32,
                    half_cycle_ns: (1e9 * segment.half_cycle_s()).round() as u32,
                    truth: truth_of(&stretch, crossing_s, truth),
                    pairs: stretch.pairs,
                    bus_dv: BUS_DV,
                })
            })
            .collect()
    }
}

/// Returns the part of a capture's truth within a stretch, its times after a zero crossing; `None` if there is none.
fn truth_of(stretch: &Stretch, crossing_s: f64, truth: &[PeriodTruth]) -> Option<Truth> {
    let from = truth.partition_point(|t| t.t_s < stretch.t0_s);
    let end_s = stretch.t0_s + stretch.pairs.len() as f64 * stretch.dt_s;
    let to = truth.partition_point(|t| t.t_s <= end_s);
    let within = truth.get(from..to).filter(|within| !within.is_empty())?;
    let of = |value: fn(&PeriodTruth) -> f64| within.iter().map(value).collect::<Vec<_>>();
    Some(Truth {
        half_cycle: 0,
        f_sw_hz: f64::from(stretch.f_sw_hz),
        t_s: within.iter().map(|t| t.t_s - crossing_s).collect(),
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A board's window begins 11 µs after the crossing and is cut to whole blocks.
    #[test]
    fn a_recording_keeps_the_time_of_its_first_pair_and_the_mains() {
        let dt_s = 3.0 / (61.0 * 50_000.0);
        let samples = vec![0.0; (0.01 / dt_s) as usize];
        let segment = Segment {
            f_sw_hz: 50_000.0,
            mains_hz: 50.0,
            zero_crossing_s: 0.0,
            t0_s: 11e-6,
            dt_s,
            v_v: samples.clone().into(),
            i_a: samples.into(),
        };
        let truth = [PeriodTruth {
            t_s: 5e-3,
            f_sw_hz: 50_000.0,
            r_ohm: [3.0; _],
            l_h: [20e-6; _],
            i_a: 40.0,
            r_power_ohm: 3.0,
            p_w: 1_200.0,
        }];
        let recorded = RecordedHalfCycle::half_cycles(&segment, Scales::OF_THIS_BUILD, &truth);
        assert_eq!(recorded.len(), 1);
        let one = &recorded[0];
        assert_eq!((one.first_pair_ns, one.half_cycle_ns), (11_000, 10_000_000));
        assert_eq!(one.truth.as_ref().unwrap().t_s, [5e-3]);
    }
}
