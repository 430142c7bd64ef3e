//! Capture: coil voltage and current over time, from any source.

use std::collections::BTreeMap;

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
}
