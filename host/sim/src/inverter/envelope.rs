//! Amplitude of the current's fundamental, continuous in time.

use std::f64::consts::TAU;

/// Sliding Fourier sum over the last switching period: a load that follows it follows the envelope, not the carrier.
#[derive(Clone, Debug)]
pub struct FourierEnvelope {
    ring: Vec<PeriodStep>,
    sum: (f64, f64),
    /// Number of zero currents in a row.
    zeros: usize,
    /// Number of periods since the sum was computed anew.
    periods: u32,
}

/// Place of a step in the period, with the last current there.
#[derive(Clone, Copy, Debug)]
struct PeriodStep {
    cos: f64,
    sin: f64,
    i_a: f64,
}

/// Number of periods after which the sum is computed anew, so that rounding errors do not accumulate over minutes.
const SUMMED_PERIODS: u32 = 64;

impl FourierEnvelope {
    /// Creates one for a period of `steps` integration steps.
    pub fn new(steps: usize) -> Self {
        let step = TAU / steps as f64;
        let place = |n| PeriodStep {
            cos: libm::cos(step * n as f64),
            sin: libm::sin(step * n as f64),
            i_a: 0.0,
        };
        Self {
            ring: (0..steps).map(place).collect(),
            sum: (0.0, 0.0),
            zeros: 0,
            periods: 0,
        }
    }

    /// Returns the same phasor for another number of steps in a period, after a change of the switching frequency.
    pub fn resized(&self, steps: usize) -> Self {
        let scale = 2.0 / self.ring.len() as f64;
        let (re, im) = (self.sum.0 * scale, self.sum.1 * scale);
        let mut new = Self::new(steps);
        for n in 0..steps {
            let PeriodStep { cos, sin, .. } = new.ring[n];
            new.push(n, re * cos + im * sin);
        }
        new
    }

    /// Adds the current in ampere at step `n` of the period.
    #[inline]
    pub fn push(&mut self, n: usize, i_a: f64) {
        self.zeros = if i_a == 0.0 { self.zeros + 1 } else { 0 };
        let place = &mut self.ring[n];
        let change_a = i_a - std::mem::replace(&mut place.i_a, i_a);
        self.sum.0 += change_a * place.cos;
        self.sum.1 += change_a * place.sin;
        if n == 0 {
            self.end_period();
        }
    }

    fn end_period(&mut self) {
        self.periods += 1;
        if self.periods == SUMMED_PERIODS {
            self.periods = 0;
            let add =
                |sum: (f64, f64), p: &PeriodStep| (sum.0 + p.i_a * p.cos, sum.1 + p.i_a * p.sin);
            self.sum = self.ring.iter().fold((0.0, 0.0), add);
        }
    }

    /// Returns `true` if no current has flowed for a whole period.
    pub fn is_empty(&self) -> bool {
        self.zeros >= self.ring.len()
    }

    /// Amplitude in ampere.
    pub fn amplitude_a(&self) -> f64 {
        let (c, s) = self.sum;
        libm::sqrt(c * c + s * s) * 2.0 / self.ring.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sine_has_its_amplitude_whatever_its_phase_and_offset() {
        let mut e = FourierEnvelope::new(488);
        for n in 0..1000 {
            e.push(n % 488, 3.0 + 7.0 * (TAU * n as f64 / 488.0 + 0.4).cos());
        }
        assert!((e.amplitude_a() - 7.0).abs() < 1e-9);
        assert!((e.resized(413).amplitude_a() - 7.0).abs() < 1e-9);
    }

    #[test]
    fn it_is_empty_after_a_period_without_current() {
        let mut e = FourierEnvelope::new(10);
        e.push(3, 1.0);
        for n in 4..13 {
            e.push(n % 10, 0.0);
            assert!(!e.is_empty());
        }
        e.push(3, 0.0);
        assert!(e.is_empty() && e.amplitude_a() == 0.0);
    }
}
