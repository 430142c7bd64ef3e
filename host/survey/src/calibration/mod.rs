//! Skew, gain and offset of the two channels: estimated from a reference, stored in a file, applied to captures.
//!
//! Information in a capture of a known load:
//! - **skew** (how much later the current is sampled) turns the impedance by −ω·skew. It is separable
//!   from the load's own phase if that is known, or if there are several frequencies: the phase
//!   of R/(ωL) falls with frequency, that of a skew grows.
//! - **gain** shows only as the ratio of both channels' gains, and only against a known |Z|.
//!   The current's is assumed right, so the voltage is corrected.
//! - **offsets** are the channels' means: the resonance capacitor carries no direct current, and a
//!   coil without direct current has no mean voltage.

pub mod blind;
mod delay;
mod estimate;
mod reference;
pub mod transformer;

use std::path::{Path, PathBuf};

pub use self::blind::Correction;
use self::blind::{SelfCalibration, SensorResponse};
use crate::Survey;
pub use estimate::{CalibrateError, estimate};
use ihd_signal::Capture;
pub use reference::ReferenceLoad;
use serde::{Deserialize, Serialize};

use crate::time::runs;

/// Corrections of a measuring chain, and their uncertainties.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// Time by which the current is sampled later than the voltage, in seconds.
    pub skew_s: f64,
    /// Standard deviation of the skew in seconds: noise, and the uncertainty of the reference.
    pub skew_sigma_s: f64,
    /// Gain of the voltage channel over that of the current channel; 1 is right.
    pub gain_ratio: f64,
    /// Standard deviation of the gain ratio; 0 if the ratio is assumed.
    pub gain_ratio_sigma: f64,
    /// Offset of the voltage channel in volt.
    pub v_offset_v: f64,
    /// Offset of the current channel in ampere.
    pub i_offset_a: f64,
    /// Bandwidths and droop, if any; its own skew is 0.
    #[serde(default, skip_serializing_if = "Correction::is_none")]
    pub response: Correction,
    /// Description of the reference.
    pub reference: String,
    /// Assumptions that were made.
    pub assumed: Vec<String>,
    /// Name of the capture.
    pub capture: String,
    /// Contradictions within that capture, as texts.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub contradictions: Vec<String>,
}

/// Key of a capture's metadata that describes the calibration it has.
pub const METADATA_KEY: &str = "calibration";

/// Name of the plateaus as a reference.
const BLIND: &str = "blind";

/// Key of a capture's metadata with the standard deviations of that calibration: of the skew in seconds, and of ln of the gains' ratio.
const SIGMA_KEY: &str = "calibration_sigma";

/// Standard deviations of the calibration that a capture has, of the skew in seconds and of ln of the gains' ratio; `None` without one.
pub fn sigma_of(capture: &Capture) -> Option<[f64; 2]> {
    let (skew_s, gain) = capture.metadata.get(SIGMA_KEY)?.split_once(' ')?;
    let number = |text: &str| {
        text.parse::<f64>()
            .ok()
            .filter(|x| (0.0..=f64::MAX).contains(x))
    };
    Some([number(skew_s)?, number(gain)?])
}

/// Standard deviations from which a difference of two numbers is a contradiction.
const CONTRADICTION_SIGMAS: f64 = 5.0;

/// Reason why a calibration file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationFileError {
    /// The file system reported an error.
    #[error("{path}: {source}")]
    Io {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The file does not hold a calibration.
    #[error("{path} is no calibration: {what}; write one with `ihd calibrate`")]
    Content {
        /// Path of the file.
        path: PathBuf,
        /// Description of the fault.
        what: String,
    },
}

/// Number of a calibration that no measuring chain has.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{name} is {value}, but must lie between {least} and {most}")]
pub struct OutOfRange {
    /// Name of the number.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// Least value.
    pub least: f64,
    /// Largest value.
    pub most: f64,
}

/// Uncertainty of a skew in seconds that costs next to nothing (docs/accuracy.md).
const WELL_KNOWN_S: f64 = 1e-9;

/// Largest plausible skew in seconds; the simulator's limit.
const MAX_SKEW_S: f64 = 10e-6;

/// Skew in seconds that no usual pair of probes has: more is doubted.
const DOUBTED_SKEW_S: f64 = 1e-6;

/// Factor between the gains from which they are doubted: probes are right to a few percent.
const DOUBTED_GAIN: f64 = 1.1;

impl Calibration {
    /// Creates a calibration from a self-calibration, with any load.
    pub fn from_self_calibration(sensors: &SelfCalibration, survey: &Survey) -> Self {
        let alike = sensors.full_correction();
        let gain_ratio = sensors
            .known_capacitance_f
            .map(|c_f| c_f / sensors.capacitance_f.value);
        let mut contradictions = Vec::new();
        if !sensors.is_sound() {
            let faults = sensors.remarks(false).into_iter();
            let worse = faults.filter(|r| r.severity > ihd_signal::Severity::Info);
            contradictions.extend(worse.map(|r| r.text));
        }
        Self {
            skew_s: match sensors.response {
                SensorResponse::Right => 0.0,
                _ => alike.skew_s,
            },
            skew_sigma_s: sensors.lag_s.sigma.hypot(sensors.loop_sigma_s()),
            gain_ratio: gain_ratio.unwrap_or(1.0),
            gain_ratio_sigma: gain_ratio.map_or(0.0, |ratio| ratio * sensors.gain_share()),
            v_offset_v: survey.voltage.mean,
            i_offset_a: survey.current.mean,
            response: Correction {
                skew_s: 0.0,
                ..alike
            },
            reference: BLIND.to_owned(),
            assumed: vec![
                format!(
                    "no resistance outside the voltage's probe (bridge, shunt, cables): 10 mohm would be {:.0} ns",
                    10e-3 * sensors.capacitance_f.value * 1e9
                ),
                "no direct current in the coil (offsets)".to_owned(),
            ],
            capture: survey.name.clone(),
            contradictions,
        }
    }

    /// Reads a file: JSON if it is named so, else TOML.
    ///
    /// # Errors
    /// [`CalibrationFileError`] with the path, and what is wrong with its content.
    pub fn read(path: &Path) -> Result<Self, CalibrationFileError> {
        let text = std::fs::read_to_string(path).map_err(|source| CalibrationFileError::Io {
            path: path.to_owned(),
            source,
        })?;
        let content = |what: String| CalibrationFileError::Content {
            path: path.to_owned(),
            what,
        };
        let read: Self = if is_json(path) {
            serde_json::from_str(&text).map_err(|e| content(e.to_string()))?
        } else {
            toml::from_str(&text).map_err(|e| content(e.message().to_owned()))?
        };
        read.check().map_err(|e| content(e.to_string()))?;
        Ok(read)
    }

    /// Writes a file: JSON if it is named so, else TOML.
    ///
    /// # Errors
    /// [`CalibrationFileError::Io`] if the file cannot be written, [`CalibrationFileError::Content`] for what could not be read back.
    pub fn write(&self, path: &Path) -> Result<(), CalibrationFileError> {
        let content = |what: String| CalibrationFileError::Content {
            path: path.to_owned(),
            what,
        };
        self.check().map_err(|e| content(e.to_string()))?;
        let text = if is_json(path) {
            serde_json::to_string_pretty(self).map_err(|e| content(e.to_string()))?
        } else {
            toml::to_string(self).map_err(|e| content(e.to_string()))?
        };
        ihd_signal::atomic::replace(path, text.as_bytes()).map_err(|source| {
            CalibrationFileError::Io {
                path: path.to_owned(),
                source,
            }
        })
    }

    /// Checks that the numbers are ones of a measuring chain.
    ///
    /// # Errors
    /// The first that is not.
    pub fn check(&self) -> Result<(), OutOfRange> {
        for (name, value, least, most) in [
            ("skew_s", self.skew_s, -MAX_SKEW_S, MAX_SKEW_S),
            ("skew_sigma_s", self.skew_sigma_s, 0.0, MAX_SKEW_S),
            ("gain_ratio", self.gain_ratio, 0.01, 100.0),
            ("gain_ratio_sigma", self.gain_ratio_sigma, 0.0, 100.0),
            ("v_offset_v", self.v_offset_v, -1e5, 1e5),
            ("i_offset_a", self.i_offset_a, -1e5, 1e5),
            ("response.skew_s", self.response.skew_s, 0.0, 0.0),
            ("response.i_tau_s", self.response.i_tau_s, 0.0, MAX_SKEW_S),
            ("response.v_tau_s", self.response.v_tau_s, 0.0, MAX_SKEW_S),
            ("response.i_droop_hz", self.response.i_droop_hz, 0.0, 1e5),
        ] {
            if !(least..=most).contains(&value) {
                return Err(OutOfRange {
                    name,
                    value,
                    least,
                    most,
                });
            }
        }
        Ok(())
    }

    /// Reasons to distrust the calibration, as texts: contradictions in its capture, numbers that usual sensors do not have, and a
    /// skew whose uncertainty exceeds its value.
    pub fn doubts(&self) -> Vec<String> {
        let mut doubts = self.contradictions.clone();
        if self.skew_s.abs() > DOUBTED_SKEW_S {
            doubts.push(format!(
                "a skew of {:.0} ns is more than probes have: look at the reference, and whether both channels are of one acquisition",
                self.skew_s * 1e9
            ));
        }
        if !(1.0 / DOUBTED_GAIN..=DOUBTED_GAIN).contains(&self.gain_ratio) {
            doubts.push(format!(
                "a ratio of the gains of {:.4} is far from 1: look at the reference and at the probes' factors (--input probe)",
                self.gain_ratio
            ));
        }
        // A skew that is known to a nanosecond is precise enough, however small it is. That of plateaus is uncertain by an assumption, which
        // is stated, and no longer capture helps.
        let by_noise = self.reference != BLIND && self.skew_sigma_s > WELL_KNOWN_S;
        if by_noise && self.skew_sigma_s > self.skew_s.abs() {
            doubts.push(format!(
                "a skew of {:.1} ± {:.1} ns cannot be told from none: capture longer, with more current or a known r=",
                self.skew_s * 1e9,
                self.skew_sigma_s * 1e9
            ));
        }
        if self.gain_ratio_sigma > (self.gain_ratio - 1.0).abs() && self.gain_ratio_sigma > 0.01 {
            doubts.push(format!(
                "a ratio of the gains of {:.4} ± {:.4} cannot be told from 1",
                self.gain_ratio, self.gain_ratio_sigma
            ));
        }
        doubts
    }

    /// Differences from another calibration of the same chain beyond the uncertainties of both, as texts.
    pub fn contradicts(&self, other: &Self) -> Vec<String> {
        let mut differences = Vec::new();
        let sigma_s = self.skew_sigma_s.hypot(other.skew_sigma_s);
        if (self.skew_s - other.skew_s).abs()
            > CONTRADICTION_SIGMAS * sigma_s.max(0.1 * WELL_KNOWN_S)
        {
            differences.push(format!(
                "a skew of {:.2} ± {:.2} ns, now {:.2} ± {:.2} ns",
                other.skew_s * 1e9,
                other.skew_sigma_s * 1e9,
                self.skew_s * 1e9,
                self.skew_sigma_s * 1e9
            ));
        }
        let sigma = self.gain_ratio_sigma.hypot(other.gain_ratio_sigma);
        // 0 stands for an assumed ratio, which cannot contradict.
        let both = self.gain_ratio_sigma > 0.0 && other.gain_ratio_sigma > 0.0;
        if both && (self.gain_ratio - other.gain_ratio).abs() > CONTRADICTION_SIGMAS * sigma {
            differences.push(format!(
                "a ratio of the gains of {:.5}, now {:.5}",
                other.gain_ratio, self.gain_ratio
            ));
        }
        differences
    }

    /// Removes offsets, gain error and skew from a capture; all samples then belong to the times of the
    /// voltage's samples.
    ///
    /// The current is interpolated within each run; its first and last
    /// samples repeat beyond the ends.
    pub fn apply(&self, capture: &mut Capture) {
        let v_gain = 1.0 / self.gain_ratio;
        for v in &mut capture.v_v {
            *v = ((f64::from(*v) - self.v_offset_v) * v_gain) as f32;
        }
        for i in &mut capture.i_a {
            *i = (f64::from(*i) - self.i_offset_a) as f32;
        }
        self.response.apply(capture);
        let rail = |full: f64, offset: f64, gain: f64| (full - offset.abs()).max(0.0) * gain;
        capture.v_full_scale_v = capture
            .v_full_scale_v
            .map(|full| rail(full, self.v_offset_v, v_gain));
        capture.i_full_scale_a = capture
            .i_full_scale_a
            .map(|full| rail(full, self.i_offset_a, 1.0));
        for run in runs(capture, &mut Vec::new()) {
            if let Some(i) = capture.i_a.get_mut(run.samples.clone()) {
                delay::delay(i, self.skew_s / run.dt_s);
            }
        }
        let note = format!(
            "skew {:.3} ns, against {}",
            self.skew_s * 1e9,
            self.reference
        );
        capture.metadata.insert(METADATA_KEY.to_owned(), note);
        let sigma = format!(
            "{:e} {:e}",
            self.skew_sigma_s,
            self.gain_ratio_sigma / self.gain_ratio
        );
        capture.metadata.insert(SIGMA_KEY.to_owned(), sigma);
    }
}

fn is_json(path: &Path) -> bool {
    path.extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("json"))
}

#[cfg(test)]
mod tests;
