//! Values with their standard deviation, as texts and tables show them.

use std::fmt;

/// Value and standard deviation in one unit, written to two significant digits of the latter: `29.4 ± 1.2`, `0.0512 ± 0.0031`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WithSigma {
    /// Value.
    pub value: f64,
    /// Standard deviation.
    pub sigma: f64,
}

/// Decimals of a deviation of zero, and of one that is unknown.
const UNKNOWN_DECIMALS: usize = 3;

/// Most decimals, which a picoohm has.
const MAX_DECIMALS: i32 = 12;

impl WithSigma {
    /// Creates one.
    pub fn new(value: f64, sigma: f64) -> Self {
        Self { value, sigma }
    }

    /// Value and deviation, each as text.
    pub fn texts(self) -> [String; 2] {
        let decimals = self.decimals();
        [self.value, self.sigma].map(|x| {
            let text = format!("{x:.decimals$}");
            // No -0.0.
            match text.strip_prefix('-') {
                Some(rest) if !rest.contains(|c| ('1'..='9').contains(&c)) => rest.to_owned(),
                _ => text,
            }
        })
    }

    fn decimals(self) -> usize {
        let is_known = self.sigma.is_finite() && self.sigma != 0.0;
        if !is_known {
            return UNKNOWN_DECIMALS;
        }
        // Rounded as it is shown: 0.0996 has two digits as 0.10.
        let shown = format!("{:.1e}", self.sigma.abs());
        let exponent = shown
            .split_once('e')
            .and_then(|(_, e)| e.parse::<i32>().ok());
        (1 - exponent.unwrap_or(0)).clamp(0, MAX_DECIMALS) as usize
    }
}

impl fmt::Display for WithSigma {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [value, sigma] = self.texts();
        write!(f, "{value} ± {sigma}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_deviation_has_two_digits_and_its_value_as_many_decimals() {
        let text = |value, sigma| WithSigma::new(value, sigma).to_string();
        assert_eq!(text(2.734_12, 0.000_234), "2.73412 ± 0.00023");
        assert_eq!(text(1080.04, 0.0351), "1080.040 ± 0.035");
        assert_eq!(text(-0.02, 0.31), "-0.02 ± 0.31");
        assert_eq!(text(-0.002, 0.31), "0.00 ± 0.31");
        assert_eq!(text(29.4, 0.0996), "29.40 ± 0.10");
        assert_eq!(text(-76.4, 14.2), "-76 ± 14");
        assert_eq!(text(1234.5, 171.0), "1234 ± 171");
        assert_eq!(text(1.5, f64::NAN), "1.500 ± NaN");
        assert_eq!(text(1.5, 0.0), "1.500 ± 0.000");
    }
}
