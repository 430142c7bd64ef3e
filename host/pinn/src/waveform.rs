//! Window of coil voltage and current, checked and normalised.

use std::f64::consts::TAU;

use crate::PinnError;

/// A window of (v, i) sample pairs within one mains half-cycle, evenly spaced in time.
#[derive(Debug, Clone, Copy)]
pub struct Waveform<'a> {
    /// Switching frequency, Hz; taken as exact (the device locks its sampling to it).
    pub f_sw_hz: f64,
    /// Mains frequency, Hz (50 or 60).
    pub f_mains_hz: f64,
    /// Time of the first pair after the mains zero crossing, s.
    pub t0_s: f64,
    /// Time between pairs, s.
    pub dt_s: f64,
    /// Coil voltage v_RL, V.
    pub v_volt: &'a [f64],
    /// Coil current i_L, A.
    pub i_ampere: &'a [f64],
}

/// Largest overlap of a window over a zero crossing, as a share of the half-cycle. The signal is close to zero there, and a
/// mains frequency that is wrong by a few per mille must not prevent an identification.
const OVERHANG: f64 = 0.02;

/// Window divided by its maxima (the paper's normalisation), with its time scales.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct NormalisedWaveform {
    pub v: Vec<f64>,
    pub i: Vec<f64>,
    pub v_max_volt: f64,
    pub i_max_ampere: f64,
    /// Angular switching frequency, rad/s.
    pub omega: f64,
    pub f_mains_hz: f64,
    /// Time of the first point after the mains zero crossing, s.
    pub t0_s: f64,
    /// Time between points, s.
    pub dt_s: f64,
    /// Samples per point, which is their mean.
    pub block: usize,
}

/// Fewest points per period of the highest harmonic: at 8 the mean over a point's block contains 97 % of it.
const POINTS_PER_PERIOD: f64 = 8.0;

impl Waveform<'_> {
    /// Checks the window and divides each channel by its largest magnitude.
    pub(crate) fn normalise(&self) -> Result<NormalisedWaveform, PinnError> {
        self.check_times()?;
        if self.v_volt.len() != self.i_ampere.len() {
            return Err(PinnError::LengthMismatch {
                v: self.v_volt.len(),
                i: self.i_ampere.len(),
            });
        }
        let v_max_volt = largest_magnitude(self.v_volt, "voltage")?;
        let i_max_ampere = largest_magnitude(self.i_ampere, "current")?;
        Ok(NormalisedWaveform {
            v: self.v_volt.iter().map(|v| v / v_max_volt).collect(),
            i: self.i_ampere.iter().map(|i| i / i_max_ampere).collect(),
            v_max_volt,
            i_max_ampere,
            omega: TAU * self.f_sw_hz,
            f_mains_hz: self.f_mains_hz,
            t0_s: self.t0_s,
            dt_s: self.dt_s,
            block: 1,
        })
    }

    fn check_times(&self) -> Result<(), PinnError> {
        for (what, value) in [
            ("f_sw_hz", self.f_sw_hz),
            ("f_mains_hz", self.f_mains_hz),
            ("dt_s", self.dt_s),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return Err(PinnError::NotPositive { what, value });
            }
        }
        let half_cycle_s = 0.5 / self.f_mains_hz;
        let to_s = self.t0_s + self.v_volt.len().saturating_sub(1) as f64 * self.dt_s;
        let slack_s = OVERHANG * half_cycle_s;
        // The comparison is false for a NaN in t0_s, which is an error, too.
        if !(self.t0_s >= -slack_s && to_s <= half_cycle_s + slack_s) {
            return Err(PinnError::SpansZeroCrossing {
                from_s: self.t0_s,
                to_s,
                half_cycle_s,
            });
        }
        Ok(())
    }
}

impl NormalisedWaveform {
    /// Averages blocks of samples, so that at most `most_points` are left, but no longer blocks than `harmonic` times the
    /// switching frequency allows. The noise of a mean is that of a sample over the root of the block's length, so that no
    /// information is lost.
    pub fn averaged(self, most_points: usize, harmonic: u32) -> Self {
        let samples_per_period = TAU / (f64::from(harmonic) * self.omega * self.dt_s);
        let allowed = (samples_per_period / POINTS_PER_PERIOD) as usize;
        let block = self.len().div_ceil(most_points.max(1)).min(allowed);
        if block <= 1 {
            return self;
        }
        let mean = |x: &[f64]| -> Vec<f64> {
            let blocks = x.chunks_exact(block);
            blocks
                .map(|x| x.iter().sum::<f64>() / block as f64)
                .collect()
        };
        Self {
            v: mean(&self.v),
            i: mean(&self.i),
            t0_s: self.t0_s + 0.5 * (block - 1) as f64 * self.dt_s,
            dt_s: self.dt_s * block as f64,
            block,
            ..self
        }
    }

    /// Gain of the mean over a block for a harmonic: sin(nx)/(n sin x), x half its angle per sample.
    pub fn gain(&self, harmonic: u32) -> f64 {
        let n = self.block as f64;
        let x = 0.5 * f64::from(harmonic) * self.omega * self.dt_s / n;
        (n * x).sin() / (n * x.sin())
    }

    /// Index of the sample next to the middle of point `n`'s block, and its time after the first point, s.
    pub fn sample_of(&self, n: usize) -> (usize, f64) {
        let within = self.block / 2;
        let off_centre = within as f64 - 0.5 * (self.block - 1) as f64;
        let time_s = (n as f64 + off_centre / self.block as f64) * self.dt_s;
        (n * self.block + within, time_s)
    }

    /// Returns the times and maxima without the points.
    pub fn outline(&self) -> Self {
        Self {
            v: Vec::new(),
            i: Vec::new(),
            ..*self
        }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.v.len()
    }

    /// Time from the first to the last point, s.
    pub fn duration_s(&self) -> f64 {
        (self.len().max(1) - 1) as f64 * self.dt_s
    }

    /// Factor from ohm (henry) to normalised impedance (inductance): `i_max / v_max`.
    pub fn impedance_scale(&self) -> f64 {
        self.i_max_ampere / self.v_max_volt
    }
}

fn largest_magnitude(samples: &[f64], channel: &'static str) -> Result<f64, PinnError> {
    if let Some(index) = samples.iter().position(|x| !x.is_finite()) {
        return Err(PinnError::NonFiniteSample {
            channel,
            index,
            value: samples[index],
        });
    }
    let max = samples.iter().fold(0.0_f64, |max, x| max.max(x.abs()));
    if max > 0.0 {
        Ok(max)
    } else if samples.is_empty() {
        Err(PinnError::TooShort {
            pairs: 0,
            needed: 1,
            why: "the window is empty",
        })
    } else {
        Err(PinnError::NoSignal { channel })
    }
}
