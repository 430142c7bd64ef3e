//! Numbers with SI prefixes on the command line: `45k`, `50M`, `20ms`, `0.2us`.

use std::time::Duration;

use ihd_shared::hob::REQUESTED_POWER_MAX_W;

/// Error for a text that is no number.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotANumber {
    /// It is not a single number.
    #[error("`{0}` is no number: write it like 45k, 50M, 20ms, 0.2us, 1080n")]
    One(String),
    /// It is not a time.
    #[error("`{0}` is no time: write it in seconds, as 90, 20s or 20ms")]
    Time(String),
    /// It is not a power that may be asked of a hob.
    #[error("`{0}` is no power for a hob: 1 to {REQUESTED_POWER_MAX_W} W in whole watt, like 1200 or 1.5k", REQUESTED_POWER_MAX_W = REQUESTED_POWER_MAX_W)]
    Power(String),
    /// It has a wrong count of numbers.
    #[error("`{0}` must be {1} numbers with commas between them")]
    List(String, usize),
}

/// Number of a text, with its prefix and its unit.
struct Scaled<'a> {
    value: f64,
    has_prefix: bool,
    unit: &'a str,
}

/// Parses a number with an optional SI prefix and an optional unit after it, of any quantity.
pub fn quantity(text: &str) -> Result<f64, NotANumber> {
    parsed(text).map(|scaled| scaled.value)
}

/// Parses a time in seconds: `20`, `20ms`; not `5m`, which may be meant as minutes.
pub fn time_s(text: &str) -> Result<f64, NotANumber> {
    let scaled = parsed(text)?;
    let is_time = scaled.unit == "s" || (scaled.unit.is_empty() && !scaled.has_prefix);
    is_time
        .then_some(scaled.value)
        .ok_or_else(|| NotANumber::Time(text.to_owned()))
}

/// Parses a time that a clock can count, as [`time_s`] does.
pub fn duration(text: &str) -> Result<Duration, NotANumber> {
    Duration::try_from_secs_f64(time_s(text)?).map_err(|_| NotANumber::Time(text.to_owned()))
}

fn parsed(text: &str) -> Result<Scaled<'_>, NotANumber> {
    let wrong = || NotANumber::One(text.to_owned());
    let digits = |c: char| c.is_ascii_digit() || matches!(c, '.' | '-' | '+');
    let mut end = text.find(|c| !digits(c)).unwrap_or(text.len());
    // An exponent belongs to the number only if digits follow it.
    let rest = &text[end..];
    if let Some(exponent) = rest.strip_prefix(['e', 'E']) {
        let sign = usize::from(exponent.starts_with(['-', '+']));
        let figures = exponent[sign..]
            .chars()
            .take_while(char::is_ascii_digit)
            .count();
        if figures > 0 {
            end += 1 + sign + figures;
        }
    }
    let number: f64 = text[..end].parse().map_err(|_| wrong())?;
    let mut tail = text[end..].trim_start().chars();
    let scale = match tail.clone().next() {
        Some('n') => 1e-9,
        Some('u' | 'µ') => 1e-6,
        Some('m') => 1e-3,
        Some('k') => 1e3,
        Some('M') => 1e6,
        _ => 1.0,
    };
    if scale != 1.0 {
        tail.next();
    }
    let (unit, value) = (tail.as_str(), number * scale);
    let is_known = matches!(
        unit,
        "" | "s" | "Hz" | "F" | "V" | "A" | "W" | "ohm" | "S/s" | "m"
    );
    (is_known && value.is_finite())
        .then_some(Scaled {
            value,
            has_prefix: scale != 1.0,
            unit,
        })
        .ok_or_else(wrong)
}

/// Parses a power to ask for in whole watt, 1 to [`REQUESTED_POWER_MAX_W`]: `1200`, `1.5k`, `1.5kW`. The hob takes what
/// is above its rating as its rating.
pub fn power_w(text: &str) -> Result<u16, NotANumber> {
    let Scaled {
        value: watt, unit, ..
    } = parsed(text)?;
    let is_power = matches!(unit, "" | "W")
        && watt.fract() == 0.0
        && (1.0..=f64::from(REQUESTED_POWER_MAX_W)).contains(&watt);
    is_power
        .then_some(watt as u16)
        .ok_or_else(|| NotANumber::Power(text.to_owned()))
}

/// Parses `N` numbers with commas between them.
pub fn list<const N: usize>(text: &str) -> Result<[f64; N], NotANumber> {
    let numbers: Vec<f64> = text.split(',').map(quantity).collect::<Result<_, _>>()?;
    numbers
        .try_into()
        .map_err(|_| NotANumber::List(text.to_owned(), N))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers() {
        for (text, w) in [
            ("1200", 1200),
            ("1.5k", 1500),
            ("1.5kW", 1500),
            ("1W", 1),
            ("3kW", 3_000),
        ] {
            assert_eq!(power_w(text), Ok(w), "{text}");
        }
        for text in [
            "0", "1e9", "10001", "1.5", "-5", "k", "1500 rpm", "NaN", "inf", "-inf", "30A",
            "1200Hz",
        ] {
            assert!(power_w(text).is_err(), "{text}");
        }
    }

    #[test]
    fn times() {
        for (text, s) in [("90", 90.0), ("20s", 20.0), ("20ms", 20e-3), ("1e2", 100.0)] {
            assert_eq!(time_s(text), Ok(s), "{text}");
        }
        for text in ["5m", "5k", "5Hz", "5mV", "s"] {
            assert!(time_s(text).is_err(), "{text}");
        }
        assert_eq!(duration("20ms"), Ok(Duration::from_millis(20)));
        for text in ["1e300", "-1"] {
            assert!(duration(text).is_err(), "{text}");
        }
    }

    #[test]
    fn prefixes_units_and_exponents() {
        let cases = [
            ("45k", 45e3),
            ("50M", 50e6),
            ("50MS/s", 50e6),
            ("20ms", 20e-3),
            ("0.2us", 0.2e-6),
            ("0.2 µs", 0.2e-6),
            ("1080nF", 1080e-9),
            ("1e-3", 1e-3),
            ("45e3Hz", 45e3),
            ("-7", -7.0),
            ("10mm", 10e-3),
        ];
        for (text, value) in cases {
            let got = quantity(text).unwrap();
            assert!((got / value - 1.0).abs() < 1e-12, "{text}: {got}");
        }
    }

    #[test]
    fn lists_have_their_length() {
        assert_eq!(list::<2>("1.01,-2m"), Ok([1.01, -2e-3]));
        assert!(
            list::<2>("1,2,3")
                .unwrap_err()
                .to_string()
                .contains("2 numbers")
        );
        assert!(list::<2>("1,x").is_err());
    }

    #[test]
    fn nonsense_is_refused() {
        for text in [
            "", "k", "fast", "45x", "4.5.6", "NaN", "inf", "1e999", "45kk",
        ] {
            assert!(quantity(text).is_err(), "{text}");
        }
    }
}
