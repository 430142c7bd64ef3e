//! A first-order low pass: the anti-alias filter before an ADC channel.

use std::f64::consts::TAU;

/// Filter of one channel. Both channels of a board have the same one, so R and L, which are ratios of voltage to current, are not
/// affected.
#[derive(Clone, Copy, Debug)]
pub struct LowPass {
    corner_hz: f64,
    input: f64,
    output: f64,
    /// Step in seconds, and half of it as a share of the filter's time constant.
    step: (f64, f64),
}

impl LowPass {
    /// Creates a filter settled at a value; a corner of 0 Hz passes everything.
    pub fn settled(corner_hz: f64, value: f64) -> Self {
        Self {
            corner_hz,
            input: value,
            output: value,
            step: (0.0, 0.0),
        }
    }

    /// Advances by `dt_s` seconds to the next input; returns the output. Trapezoidal: stable for any step.
    #[inline]
    pub fn advance(&mut self, input: f64, dt_s: f64) -> f64 {
        if self.step.0 != dt_s {
            self.step = (dt_s, 0.5 * TAU * self.corner_hz * dt_s);
        }
        let (_, g) = self.step;
        self.output = match self.corner_hz {
            0.0 => input,
            _ => ((1.0 - g) * self.output + g * (self.input + input)) / (1.0 + g),
        };
        self.input = input;
        self.output
    }

    /// Present output.
    pub fn output(&self) -> f64 {
        self.output
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_the_corner_the_gain_is_minus_three_decibel_and_the_lag_45_degrees() {
        let (corner_hz, steps) = (100e3, 1000);
        let dt_s = 1.0 / (corner_hz * f64::from(steps));
        let mut pole = LowPass::settled(corner_hz, 0.0);
        let mut sum = (0.0, 0.0);
        for n in 0..20 * steps {
            let angle = TAU * f64::from(n) / f64::from(steps);
            let y = pole.advance(angle.sin(), dt_s);
            if n >= 19 * steps {
                sum.0 += y * angle.sin() * 2.0 / f64::from(steps);
                sum.1 += y * angle.cos() * 2.0 / f64::from(steps);
            }
        }
        assert!(
            (sum.0 - 0.5).abs() < 1e-3 && (sum.1 + 0.5).abs() < 1e-3,
            "{sum:?}"
        );
    }

    #[test]
    fn without_a_corner_everything_passes() {
        let mut pole = LowPass::settled(0.0, 3.0);
        assert_eq!(pole.advance(7.0, 1e-9), 7.0);
        assert_eq!(pole.output(), 7.0);
    }
}
