//! Axes of equal steps and of decades, with their numbers.

use std::ops::Range;

use plotters::coord::ranged1d::{
    BoldPoints, KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter,
};
use plotters::coord::types::RangedCoordf64;

/// Smallest value of an axis of decades.
const MIN_DECADE_VALUE: f64 = 1e-300;

/// Largest magnitude of any axis.
const MAX_MAGNITUDE: f64 = 1e300;

/// Range and division of an axis.
#[derive(Clone, Debug, PartialEq)]
pub enum Scale {
    /// Equal steps.
    Linear(Range<f64>),
    /// Equal ratios; both ends are above zero.
    Decades(Range<f64>),
}

impl Scale {
    /// Creates equal steps; a range that is empty or not finite is replaced by a valid one.
    pub fn linear(range: Range<f64>) -> Self {
        let Range { start, end } = range;
        if !(start.abs() < MAX_MAGNITUDE && end.abs() < MAX_MAGNITUDE) {
            return Self::Linear(0.0..1.0);
        }
        let least = 1e-9 * start.abs().max(end.abs()).max(1e-12);
        Self::Linear(start..end.max(start + least))
    }

    /// Creates equal ratios; values that are not positive are cut off.
    pub fn decades(range: Range<f64>) -> Self {
        let start = if range.start.is_finite() {
            range.start.clamp(MIN_DECADE_VALUE, MAX_MAGNITUDE)
        } else {
            1.0
        };
        let end = if range.end.is_finite() {
            range.end.max(start * 1.001)
        } else {
            start * 10.0
        };
        Self::Decades(start..end)
    }

    /// Ends of the range.
    pub fn ends(&self) -> Range<f64> {
        match self {
            Self::Linear(range) | Self::Decades(range) => range.clone(),
        }
    }

    /// Position of a value: 0 at the start, 1 at the end. On decades, zero and less are below everything.
    pub fn unit(&self, value: f64) -> f64 {
        match self {
            Self::Linear(r) => (value - r.start) / (r.end - r.start),
            Self::Decades(_) if value <= 0.0 => f64::NEG_INFINITY,
            Self::Decades(r) => (value / r.start).log10() / (r.end / r.start).log10(),
        }
    }

    /// Value at a position.
    pub fn value(&self, unit: f64) -> f64 {
        match self {
            Self::Linear(r) => r.start + unit * (r.end - r.start),
            Self::Decades(r) => r.start * (r.end / r.start).powf(unit),
        }
    }
}

/// Powers of ten within a range of values.
fn exponents(range: &Range<f64>) -> std::ops::RangeInclusive<i32> {
    // A power of ten that misses the end by rounding counts as the end.
    let low = (range.start.log10() - 1e-9).ceil() as i32;
    let high = (range.end.log10() + 1e-9).floor() as i32;
    low..=high
}

/// Decades of a range: each if no more than `most` fit, else every second, third, …; with fewer than two decades also their double
/// and fivefold.
fn decades(range: &Range<f64>, most: usize) -> Vec<f64> {
    let all = exponents(range);
    let count = all.clone().count();
    let step = count.div_ceil(most.max(1)).max(1) as i32;
    let mut values: Vec<f64> = all
        .filter(|n| n.rem_euclid(step) == 0)
        .map(|n| 10f64.powi(n))
        .collect();
    if count < 2 {
        values = between(range, &[1.0, 2.0, 5.0]);
    }
    values
}

/// Multiples of all decades within the range.
fn between(range: &Range<f64>, multiples: &[f64]) -> Vec<f64> {
    let all = exponents(range);
    let wide = (*all.start() - 1)..=(*all.end() + 1);
    let values = wide.flat_map(|n| multiples.iter().map(move |m| m * 10f64.powi(n)));
    let slack = 1.0 + 1e-9;
    values
        .filter(|x| *x >= range.start / slack && *x <= range.end * slack)
        .collect()
}

impl Ranged for Scale {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let unit = self.unit(*value).clamp(0.0, 1.0);
        limit.0 + (unit * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        match self {
            // Finer lines between equal steps do not help.
            Self::Linear(range) => {
                let most = BoldPoints(hint.bold_points());
                RangedCoordf64::from(range.clone()).key_points(most)
            }
            Self::Decades(range) if hint.weight().allow_light_points() => {
                let all = between(range, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]);
                // Too many lines: only decades.
                if all.len() > hint.max_num_points() {
                    decades(range, usize::MAX)
                } else {
                    all
                }
            }
            Self::Decades(range) => decades(range, hint.max_num_points()),
        }
    }

    fn range(&self) -> Range<f64> {
        self.ends()
    }
}

impl ValueFormatter<f64> for Scale {
    fn format_ext(&self, value: &f64) -> String {
        match self {
            // Rounding errors of adding up steps become zero.
            Self::Linear(range) if value.abs() < ROUNDING * (range.end - range.start).abs() => {
                "0".into()
            }
            Self::Linear(_) => plain(*value),
            Self::Decades(_) => power_of_ten(*value),
        }
    }
}

/// Largest rounding error of the steps, as a part of the axis.
const ROUNDING: f64 = 1e-9;

/// Formats a number with no more digits than necessary: `0.25`, `50`, `2.5·10⁶`.
pub fn plain(value: f64) -> String {
    if value.abs() >= 1e6 || (value != 0.0 && value.abs() < 1e-4) {
        return power_of_ten(value);
    }
    let text = format!("{value:.5}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    match text {
        "-0" => "0".into(),
        text => text.into(),
    }
}

/// Formats `10⁻³`, `2·10⁴`, `7.3·10⁵`: two digits, and the power of ten.
pub fn power_of_ten(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let (mut exponent, sign) = (value.abs().log10().floor() as i32, value.signum());
    let mut mantissa = (value.abs() / 10f64.powi(exponent) * 10.0).round() / 10.0;
    if mantissa >= 10.0 {
        (mantissa, exponent) = (1.0, exponent + 1);
    }
    let power = format!("10{}", superscript(exponent));
    let minus = if sign < 0.0 { "-" } else { "" };
    if mantissa == 1.0 {
        format!("{minus}{power}")
    } else {
        format!("{minus}{mantissa}·{power}")
    }
}

fn superscript(n: i32) -> String {
    let raised = |c: char| match c {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        '4' => '⁴',
        '5' => '⁵',
        '6' => '⁶',
        '7' => '⁷',
        '8' => '⁸',
        '9' => '⁹',
        _ => '⁰',
    };
    n.to_string().chars().map(raised).collect()
}

#[cfg(test)]
mod tests {
    use plotters::coord::ranged1d::LightPoints;

    use super::*;

    fn labels(scale: &Scale, most: usize) -> Vec<String> {
        let at = scale.key_points(BoldPoints(most));
        at.iter().map(|x| scale.format_ext(x)).collect()
    }

    #[test]
    fn what_rounding_leaves_of_zero_is_written_as_zero() {
        let axis = Scale::linear(-0.6..0.8);
        assert_eq!(axis.format_ext(&-1.1e-16), "0");
        assert_eq!(axis.format_ext(&0.2), "0.2");
        // On an axis of such numbers they are what they are.
        let fine = Scale::linear(0.0..2e-16);
        assert_eq!(fine.format_ext(&1e-16), power_of_ten(1e-16));
    }

    #[test]
    fn an_axis_of_decades_is_labelled_with_powers_of_ten() {
        let scale = Scale::decades(3e-4..2e1);
        assert_eq!(labels(&scale, 10), ["10⁻³", "10⁻²", "10⁻¹", "10⁰", "10¹"]);
        // Both ends are decades.
        assert_eq!(
            labels(&Scale::decades(1e3..1e6), 10),
            ["10³", "10⁴", "10⁵", "10⁶"]
        );
        // More than fit: every fourth, and still decades.
        assert_eq!(
            labels(&Scale::decades(1e-12..1.0), 4),
            ["10⁻¹²", "10⁻⁸", "10⁻⁴", "10⁰"]
        );
        // Less than two: what engineers put between them.
        assert_eq!(
            labels(&Scale::decades(15.0..600.0), 10),
            ["2·10¹", "5·10¹", "10²", "2·10²", "5·10²"]
        );
    }

    #[test]
    fn between_decades_stand_the_other_eight_lines() {
        let scale = Scale::decades(1.0..100.0);
        let all = scale.key_points(LightPoints::new(10, 100));
        assert_eq!(all.len(), 19);
        let steps = all.windows(2).map(|w| scale.unit(w[1]) - scale.unit(w[0]));
        // Closer and closer up to the next decade.
        let steps: Vec<f64> = steps.collect();
        assert!(steps[..9].is_sorted_by(|a, b| a > b), "{steps:?}");
        let few = scale.key_points(LightPoints::new(10, 18));
        assert_eq!(few.len(), 3);
    }

    #[test]
    fn values_lie_where_their_logarithm_does() {
        let scale = Scale::decades(1e-2..1e2);
        assert!((scale.unit(1.0) - 0.5).abs() < 1e-12);
        assert!((scale.value(0.75) - 10.0).abs() < 1e-9);
        assert_eq!(scale.unit(-1.0), f64::NEG_INFINITY);
        assert_eq!(scale.map(&1e-9, (400, 0)), 400);
        assert_eq!(Scale::linear(-2.0..2.0).map(&1.0, (0, 400)), 300);
    }

    #[test]
    fn no_range_makes_an_axis_without_length() {
        for range in [
            1.0..1.0,
            0.0..0.0,
            f64::NAN..1.0,
            f64::MAX..f64::MIN,
            0.0..f64::INFINITY,
        ] {
            for scale in [Scale::linear(range.clone()), Scale::decades(range.clone())] {
                let ends = scale.ends();
                assert!(ends.start < ends.end, "{range:?} {scale:?}");
                assert!(ends.end.is_finite());
            }
        }
    }

    #[test]
    fn numbers_have_no_more_digits_than_they_need() {
        let text = [0.0, -0.0, 0.25, 50.0, -1.5, 1e5, 2.5e6, 3e-7].map(plain);
        assert_eq!(
            text,
            [
                "0",
                "0",
                "0.25",
                "50",
                "-1.5",
                "100000",
                "2.5·10⁶",
                "3·10⁻⁷"
            ]
        );
        assert_eq!(power_of_ten(-730_000.0), "-7.3·10⁵");
        assert_eq!(power_of_ten(9.99e5), "10⁶");
    }
}
