//! Captures: coil voltage and current over time, from whatever recorded them, and the log of what a
//! device sent.

pub mod channels;
pub mod error;
pub mod exports;
pub mod formats;
pub mod mcap;
pub mod open;
pub mod pair;
mod recognise;
pub mod resample;

pub use error::CaptureError;
pub use open::{OpenOptions, open};

use std::collections::BTreeMap;

use crate::sim::inverter::meter::PeriodTruth;
use crate::sim::recording::run::Recording;
use crate::sim::recording::sensing::Rate;

/// Where the samples lie in time.
#[derive(Clone, Debug, PartialEq)]
pub enum TimeBase {
    /// Evenly spaced.
    Even {
        /// Time of the first sample in seconds.
        t0_s: f64,
        /// Time from one sample to the next in seconds.
        dt_s: f64,
    },
    /// One time a sample in seconds, ascending.
    Stamps(Vec<f64>),
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

/// From `t_s` on the hob switches at `f_sw_hz`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrequencyStep {
    /// When, in seconds.
    pub t_s: f64,
    /// Switching frequency in hertz.
    pub f_sw_hz: f64,
}

impl FrequencyStep {
    /// The steps that the truth shows, one at least where there is any.
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
#[derive(Clone, Debug, PartialEq)]
pub struct Capture {
    /// Where it comes from, for messages: a path, or what simulated it.
    pub name: String,
    /// When the samples were taken. `v_v` and `i_a` have one length, and so have stamps.
    pub time: TimeBase,
    /// Coil voltage in volt.
    pub v_v: Vec<f32>,
    /// Coil current in ampere, positive where positive voltage feeds power into the load.
    pub i_a: Vec<f32>,
    /// Largest magnitude the voltage channel can show, in volt, where known: beyond it clips.
    pub v_full_scale_v: Option<f64>,
    /// Likewise of the current channel, in ampere.
    pub i_full_scale_a: Option<f64>,
    /// Switching frequencies in order of time; empty where the capture does not tell.
    pub f_sw: Vec<FrequencyStep>,
    /// Mains frequency in hertz where the capture tells.
    pub mains_hz: Option<f64>,
    /// Time of one mains zero crossing in seconds where the capture tells.
    pub zero_crossing_s: Option<f64>,
    /// Truth, one entry a switching period in order of time; empty where there is none.
    pub truth: Vec<PeriodTruth>,
    /// Anything else, as text.
    pub metadata: BTreeMap<String, String>,
}

impl Capture {
    /// Samples of each channel.
    pub fn len(&self) -> usize {
        self.v_v.len()
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.v_v.is_empty()
    }

    /// A simulated recording, named `name`.
    pub fn from_recording(recording: &Recording, name: &str) -> Self {
        let settings = &recording.settings;
        let scaled = |codes: &[i16], unit: f64| {
            let volt = |c: &i16| (f64::from(*c) * unit) as f32;
            codes.iter().map(volt).collect()
        };
        let time = match settings.sensing.rate {
            Rate::Locked => TimeBase::Stamps(recording.t_s.clone()),
            Rate::Hz(rate_hz) => TimeBase::Even {
                t0_s: recording.t_s.first().copied().unwrap_or(0.0),
                dt_s: 1.0 / rate_hz,
            },
        };
        Self {
            name: name.to_owned(),
            time,
            v_v: scaled(&recording.v_code, recording.volt_per_code()),
            i_a: scaled(&recording.i_code, recording.ampere_per_code()),
            v_full_scale_v: Some(settings.sensing.v_full_scale_v),
            i_full_scale_a: Some(settings.sensing.i_full_scale_a),
            f_sw: FrequencyStep::of_truth(&recording.truth),
            mains_hz: Some(settings.mains_hz),
            zero_crossing_s: Some(-settings.start_s),
            truth: recording.truth.clone(),
            metadata: BTreeMap::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::recording::run::record;
    use crate::sim::recording::settings::{Change, Event, LoadKind, Settings};

    #[test]
    fn a_recording_tells_its_frequency_steps() {
        let settings = Settings {
            load: LoadKind::Behavioural,
            duration_s: 1e-3,
            events: vec![Event {
                t_s: 0.5e-3,
                change: Change::Frequency(50e3),
            }],
            ..Settings::default()
        };
        let capture = Capture::from_recording(&record(&settings, |_| ()).unwrap(), "steps");
        let hz: Vec<f64> = capture.f_sw.iter().map(|s| s.f_sw_hz.round()).collect();
        assert_eq!(hz, [45e3, 50e3]);
        assert!((capture.f_sw[1].t_s - 0.5e-3).abs() < 1.0 / 45e3);
        assert_eq!(capture.len(), capture.i_a.len());
    }
}
