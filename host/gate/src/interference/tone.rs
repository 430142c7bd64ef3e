//! A tone beside the carrier.

use std::f64::consts::TAU;

use ihd_signal::Segment;
use nalgebra::Complex;

/// A tone beside the carrier.
#[derive(Clone, Debug, PartialEq)]
pub struct Tone {
    /// Frequency less f_sw, in hertz.
    pub offset_hz: f64,
    /// Amplitude and phase in volt, counted from the segment's first sample.
    pub v: Complex<f64>,
    /// Shape over time with a mean of 1: constant, or that of the bus.
    pub shape: Vec<f64>,
    /// Position of the shape's first value, and distance from one value to the next, in samples.
    pub place: (f64, f64),
    /// Samples of the part in which the tone was found, from the segment's first to its last where the part is at an end.
    pub reach: std::ops::Range<f64>,
    /// Error of R in percent that an estimator makes if it follows the tone; least squares follows up to about 1 kHz.
    pub may_cost_pct: f64,
    /// `true` if a harmonic of the inverter's own edges aliases to this frequency.
    pub alias: bool,
}

impl Tone {
    /// Calls with the tone's voltage in volt, sample by sample of its segment, up to `samples`; the segment's switching frequency is in
    /// hertz, its sampling interval in seconds.
    pub fn each(
        &self,
        (f_sw_hz, dt_s): (f64, f64),
        samples: usize,
        mut each: impl FnMut(usize, f64),
    ) {
        let periods = (f_sw_hz + self.offset_hz) * dt_s;
        for k in 0..samples {
            let Some(shape) = self.at(k) else {
                continue;
            };
            let (sin, cos) = libm::sincos(TAU * (periods * k as f64).fract());
            each(k, shape * (self.v.re * cos - self.v.im * sin));
        }
    }

    /// Shape at a sample, constant beyond its values; `None` outside the part in which the tone was searched for.
    pub(super) fn at(&self, sample: usize) -> Option<f64> {
        if !self.reach.contains(&(sample as f64)) {
            return None;
        }
        let x = (sample as f64 - self.place.0) / self.place.1;
        let last = self.shape.len().checked_sub(1)?;
        let x = x.clamp(0.0, last as f64);
        let k = (x as usize).min(last.saturating_sub(1));
        let next = self.shape.get(k + 1).unwrap_or(&self.shape[k]);
        Some(self.shape[k] + (x - k as f64) * (next - self.shape[k]))
    }
}

/// Returns the segment with these tones subtracted from its voltage.
pub fn remove_tones(segment: &Segment, tones: &[Tone]) -> Segment {
    let mut v_v = segment.v_v.to_vec();
    for tone in tones {
        let sampling = (segment.f_sw_hz, segment.dt_s);
        tone.each(sampling, v_v.len(), |k, v| v_v[k] -= v);
    }
    Segment {
        v_v: v_v.into(),
        ..segment.clone()
    }
}
