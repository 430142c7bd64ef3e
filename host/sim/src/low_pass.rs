//! A first-order low pass: the anti-alias filter before an ADC channel.

use std::f64::consts::TAU;

/// Filter of one channel. Both channels of a board have the same one, so R and L, which are ratios of voltage to current, are not
/// affected.
#[derive(Clone, Copy, Debug)]
pub struct LowPass {
    corner_hz: f64,
    input: f64,
    output: f64,
    /// Step in seconds that the factors are of.
    step_s: f64,
    /// Factors of the last output, the last input and the new one.
    factors: [f64; 3],
}

impl LowPass {
    /// Creates a filter settled at a value; a corner of 0 Hz passes everything.
    pub fn settled(corner_hz: f64, value: f64) -> Self {
        Self {
            corner_hz,
            input: value,
            output: value,
            step_s: 0.0,
            factors: [0.0, 0.0, 1.0],
        }
    }

    /// Advances by `dt_s` seconds to the next input; returns the output. Trapezoidal: stable for any step.
    #[inline]
    pub fn advance(&mut self, input: f64, dt_s: f64) -> f64 {
        self.set_step(dt_s);
        self.step(input);
        self.output
    }

    /// Advances by the step last set to the next input.
    #[inline(always)]
    pub fn step(&mut self, input: f64) {
        let [keep, old, new] = self.factors;
        self.output = keep * self.output + (old * self.input + new * input);
        self.input = input;
    }

    /// Advances by the step last set over an input of this mean, which ends at `input`: of an input with edges it keeps their place.
    #[inline(always)]
    pub fn step_mean(&mut self, mean: f64, input: f64) {
        let [keep, old, new] = self.factors;
        self.output = match self.corner_hz {
            0.0 => input,
            _ => keep * self.output + (old + new) * mean,
        };
        self.input = input;
    }

    /// Ends an output that has decayed: processors multiply subnormal numbers a hundred times more slowly.
    pub fn end_decay(&mut self) {
        self.output = without_decayed(self.output);
    }

    /// Sets the step in seconds.
    #[inline]
    pub fn set_step(&mut self, dt_s: f64) {
        if self.step_s != dt_s {
            self.change_step(dt_s);
        }
    }

    fn change_step(&mut self, dt_s: f64) {
        self.step_s = dt_s;
        // Half of the step as a share of the time constant.
        let g = 0.5 * TAU * self.corner_hz * dt_s;
        if self.corner_hz > 0.0 {
            let by = g / (1.0 + g);
            self.factors = [(1.0 - g) / (1.0 + g), by, by];
        }
    }

    /// Present output.
    pub fn output(&self) -> f64 {
        self.output
    }
}

/// Returns a quantity, zero where it is too small to change a digit of anything.
pub(crate) fn without_decayed(quantity: f64) -> f64 {
    match quantity.abs() < 1e-200 {
        true => 0.0,
        false => quantity,
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

    /// Half of a step at 1 V is a step at half a volt; at its ends it would be all or nothing.
    #[test]
    fn an_edge_inside_a_step_counts_by_its_share() {
        let mut pole = LowPass::settled(500e3, 0.0);
        pole.set_step(80e-9);
        pole.step_mean(0.5, 1.0);
        let expected = 1.0 - (-TAU * 500e3 * 40e-9f64).exp();
        assert!(
            (pole.output() / expected - 1.0).abs() < 0.06,
            "{}",
            pole.output()
        );
        let mut none = LowPass::settled(0.0, 0.0);
        none.set_step(80e-9);
        none.step_mean(0.5, 1.0);
        assert_eq!(none.output(), 1.0);
    }

    #[test]
    fn without_a_corner_everything_passes() {
        let mut pole = LowPass::settled(0.0, 3.0);
        assert_eq!(pole.advance(7.0, 1e-9), 7.0);
        assert_eq!(pole.output(), 7.0);
    }
}
