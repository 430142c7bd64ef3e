//! Amplitude of the current's fundamental, continuous in time.

use std::f64::consts::TAU;

/// Sliding Fourier sum over the last switching period: a load that follows it follows the envelope, not the carrier.
#[derive(Clone, Debug)]
pub struct FourierEnvelope {
    cos_sin: Vec<(f64, f64)>,
    ring: Vec<(f64, f64)>,
    sum: (f64, f64),
    /// Number of zero currents in a row.
    zeros: usize,
}

impl FourierEnvelope {
    /// Creates one for a period of `steps` integration steps.
    pub fn new(steps: usize) -> Self {
        let step = TAU / steps as f64;
        Self {
            cos_sin: (0..steps)
                .map(|n| (libm::cos(step * n as f64), libm::sin(step * n as f64)))
                .collect(),
            ring: vec![(0.0, 0.0); steps],
            sum: (0.0, 0.0),
            zeros: 0,
        }
    }

    /// Returns the same phasor for another number of steps in a period, after a change of the switching frequency.
    pub fn resized(&self, steps: usize) -> Self {
        let scale = 2.0 / self.ring.len() as f64;
        let (re, im) = (self.sum.0 * scale, self.sum.1 * scale);
        let mut new = Self::new(steps);
        for n in 0..steps {
            let (c, s) = new.cos_sin[n];
            new.push(n, re * c + im * s);
        }
        new
    }

    /// Adds the current in ampere at step `n` of the period.
    #[inline]
    pub fn push(&mut self, n: usize, i_a: f64) {
        self.zeros = if i_a == 0.0 { self.zeros + 1 } else { 0 };
        let (c, s) = self.cos_sin[n];
        let new = (i_a * c, i_a * s);
        let old = std::mem::replace(&mut self.ring[n], new);
        self.sum.0 += new.0 - old.0;
        self.sum.1 += new.1 - old.1;
        if n == 0 {
            // Recomputed once a period, so that rounding errors do not accumulate over minutes.
            self.sum = self
                .ring
                .iter()
                .fold((0.0, 0.0), |sum, v| (sum.0 + v.0, sum.1 + v.1));
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
