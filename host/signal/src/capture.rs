//! Capture: coil voltage and current over time, from any source.

use std::collections::BTreeMap;
use std::ops::Range;

use crate::truth::PeriodTruth;

/// Times of the samples.
#[derive(Clone, Debug, PartialEq)]
pub enum TimeBase {
    /// Evenly spaced.
    Even {
        /// Time of the first sample in seconds.
        t0_s: f64,
        /// Time from one sample to the next in seconds.
        dt_s: f64,
    },
    /// One time per sample in seconds, ascending.
    Stamps(Vec<f64>),
}

impl Default for TimeBase {
    /// Grid of a capture without samples.
    fn default() -> Self {
        Self::Even {
            t0_s: 0.0,
            dt_s: 0.0,
        }
    }
}

impl TimeBase {
    /// Time of sample `k` in seconds; `None` beyond the last stamp.
    pub fn at(&self, k: usize) -> Option<f64> {
        match self {
            Self::Even { t0_s, dt_s } => Some(t0_s + k as f64 * dt_s),
            Self::Stamps(t_s) => t_s.get(k).copied(),
        }
    }
}

/// Change of the switching frequency to `f_sw_hz` at `t_s`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrequencyStep {
    /// Time of the change in seconds.
    pub t_s: f64,
    /// Switching frequency in hertz.
    pub f_sw_hz: f64,
}

impl FrequencyStep {
    /// Frequency steps in a truth; the first entry is its first frequency.
    pub fn of_truth(truth: &[PeriodTruth]) -> Vec<Self> {
        let mut steps: Vec<Self> = Vec::new();
        for t in truth {
            if steps.last().is_none_or(|last| last.f_sw_hz != t.f_sw_hz) {
                steps.push(Self {
                    t_s: t.t_s - 0.5 / t.f_sw_hz,
                    f_sw_hz: t.f_sw_hz,
                });
            }
        }
        steps
    }
}

/// Coil voltage and current, sampled together.
///
/// Samples are f32: 24 bits, more than any scope gives, at half the memory of f64.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Capture {
    /// Source for messages: a path, or a description of the simulation.
    pub name: String,
    /// Times of the samples. `v_v` and `i_a` have one length, and so have stamps.
    pub time: TimeBase,
    /// Coil voltage in volt.
    pub v_v: Vec<f32>,
    /// Coil current in ampere, positive where positive voltage feeds power into the load.
    pub i_a: Vec<f32>,
    /// Largest magnitude of the voltage channel in volt, beyond which it clips; `None` if unknown.
    pub v_full_scale_v: Option<f64>,
    /// Largest magnitude of the current channel in ampere, beyond which it clips; `None` if unknown.
    pub i_full_scale_a: Option<f64>,
    /// Switching frequencies in order of time; empty if the capture states none.
    pub f_sw: Vec<FrequencyStep>,
    /// Mains frequency in hertz; `None` if the capture does not state it.
    pub mains_hz: Option<f64>,
    /// Time of one mains zero crossing in seconds; `None` if the capture does not state it.
    pub zero_crossing_s: Option<f64>,
    /// Truth, one entry per switching period in order of time; empty if there is none.
    pub truth: Vec<PeriodTruth>,
    /// Further information as text.
    pub metadata: BTreeMap<String, String>,
}

impl Capture {
    /// Number of samples of each channel.
    pub fn len(&self) -> usize {
        self.v_v.len()
    }

    /// Returns `true` if there is no sample.
    pub fn is_empty(&self) -> bool {
        self.v_v.is_empty()
    }

    /// Copies a range of pairs, clamped to the existing ones, with the truth of their time and with everything that holds for the
    /// whole capture. The first part has the truth before its samples too, the last one that after them.
    #[must_use]
    pub fn part(&self, range: Range<usize>) -> Self {
        let to = range.end.min(self.len());
        let from = range.start.min(to);
        let inside = self.truth_within(from, to);
        let part = |x: &[f32]| x.get(from..to).unwrap_or(&[]).to_vec();
        Self {
            name: self.name.clone(),
            time: match &self.time {
                TimeBase::Even { t0_s, dt_s } => TimeBase::Even {
                    t0_s: t0_s + from as f64 * dt_s,
                    dt_s: *dt_s,
                },
                TimeBase::Stamps(t_s) => {
                    TimeBase::Stamps(t_s.get(from..to).unwrap_or(&[]).to_vec())
                }
            },
            v_v: part(&self.v_v),
            i_a: part(&self.i_a),
            v_full_scale_v: self.v_full_scale_v,
            i_full_scale_a: self.i_full_scale_a,
            f_sw: self.f_sw.clone(),
            mains_hz: self.mains_hz,
            zero_crossing_s: self.zero_crossing_s,
            truth: self.truth[inside].to_vec(),
            metadata: self.metadata.clone(),
        }
    }

    /// Entries of the truth that belong to pairs `from` to `to`.
    fn truth_within(&self, from: usize, to: usize) -> Range<usize> {
        let before = |k: usize| {
            let t_s = self.time.at(k).unwrap_or(f64::INFINITY);
            self.truth.partition_point(|t| t.t_s < t_s)
        };
        let first = if from == 0 { 0 } else { before(from) };
        let last = if to == self.len() {
            self.truth.len()
        } else {
            before(to)
        };
        first..last.max(first)
    }

    /// Removes the first `pairs` pairs, and the truth before what remains.
    pub fn forget(&mut self, pairs: usize) {
        let pairs = pairs.min(self.len());
        let truth = self.truth_within(0, pairs);
        self.truth.drain(truth);
        self.v_v.drain(..pairs);
        self.i_a.drain(..pairs.min(self.i_a.len()));
        match &mut self.time {
            TimeBase::Even { t0_s, dt_s } => *t0_s += pairs as f64 * *dt_s,
            TimeBase::Stamps(t_s) => {
                t_s.drain(..pairs.min(t_s.len()));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn capture(time: TimeBase, n: usize) -> Capture {
        Capture {
            time,
            v_v: (0..n).map(|k| k as f32).collect(),
            i_a: (0..n).map(|k| -(k as f32)).collect(),
            truth: (0..n / 2)
                .map(|k| PeriodTruth {
                    t_s: 2.0 * k as f64 + 0.5,
                    f_sw_hz: 45e3,
                    r_ohm: [3.0; 4],
                    l_h: [20e-6; 4],
                    i_a: 30.0,
                    r_power_ohm: 3.0,
                    p_w: 1e3,
                })
                .collect(),
            mains_hz: Some(50.0),
            ..Capture::default()
        }
    }

    #[test]
    fn parts_together_are_the_whole() {
        let times = [
            TimeBase::Even {
                t0_s: 0.0,
                dt_s: 1.0,
            },
            TimeBase::Stamps((0..20).map(f64::from).collect()),
        ];
        for time in times {
            let whole = capture(time, 20);
            let mut rest = whole.clone();
            let (mut v, mut truth) = (Vec::new(), Vec::new());
            for range in [0..7, 7..8, 8..20] {
                let part = whole.part(range.clone());
                assert_eq!(part.time.at(0), Some(range.start as f64));
                assert_eq!(part.mains_hz, Some(50.0));
                assert_eq!(part, rest.part(0..range.len()));
                rest.forget(range.len());
                v.extend(part.v_v);
                truth.extend(part.truth);
            }
            assert!(rest.is_empty() && rest.truth.is_empty());
            assert_eq!((v, truth), (whole.v_v.clone(), whole.truth.clone()));
            assert!(whole.part(25..30).is_empty());
        }
    }
}
