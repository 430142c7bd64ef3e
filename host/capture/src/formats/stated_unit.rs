//! Unit as a file states it, understood or not: what looks like a unit and is none of volt, ampere and second is no name.

use std::fmt;

use super::unit::{ColumnQuantity, Unit, without_brackets};

/// Unit that a file states for a column.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum StatedUnit {
    /// The file states none.
    #[default]
    Nothing,
    /// Volt, ampere or second, with a prefix.
    Known(Unit),
    /// Text of another unit: counts of a converter, divisions of a screen, a mean value, watt.
    Unknown(String),
}

impl StatedUnit {
    /// Parses a field that holds a unit and nothing else.
    pub fn parse(text: &str) -> Self {
        match (Unit::parse(text), without_brackets(text)) {
            (Some(unit), _) => Self::Known(unit),
            (None, "") => Self::Nothing,
            (None, bare) => Self::Unknown(bare.to_owned()),
        }
    }

    /// Splits a heading with a unit at its end, as `v_mV`, `Volts (mV)`, `i[A]` or `CH1 in V`, into
    /// name and unit. A heading that is only a unit (`Volt`) is its own name. Text in brackets that looks like no unit, as in
    /// `v (coil)`, is part of the name.
    pub fn of_heading(heading: &str) -> (String, Self) {
        let heading = heading.trim().trim_matches('"').trim();
        if let Some(open) = heading.rfind(['(', '[']).filter(|open| *open > 0) {
            let unit = Self::parse(&heading[open..]);
            if unit.known().is_some() || is_unit_like(without_brackets(&heading[open..])) {
                return (heading[..open].trim().to_owned(), unit);
            }
        }
        for separator in [" in ", "_", " ", "/"] {
            if let Some((name, unit)) = heading.rsplit_once(separator)
                && !name.trim().is_empty()
            {
                if let Some(unit) = Unit::parse(unit) {
                    return (name.trim().to_owned(), Self::Known(unit));
                }
                // The name keeps it: `v_raw` and `v` can be two channels.
                if is_unit_like(unit) {
                    return (heading.to_owned(), Self::Unknown(unit.to_owned()));
                }
            }
        }
        let whole = Unit::parse(heading).filter(|_| heading.len() > 1);
        (heading.to_owned(), whole.map_or(Self::Nothing, Self::Known))
    }

    /// Returns the unit if it is volt, ampere or second.
    pub fn known(&self) -> Option<Unit> {
        match self {
            Self::Known(unit) => Some(*unit),
            Self::Nothing | Self::Unknown(_) => None,
        }
    }

    /// Returns seconds of one unit; a column without a unit is in seconds.
    ///
    /// # Errors
    /// The unit, if it is none of time.
    pub fn seconds(&self) -> Result<f64, &Self> {
        match self {
            Self::Nothing => Ok(1.0),
            Self::Known(unit) if unit.quantity == ColumnQuantity::Time => Ok(unit.scale),
            Self::Known(_) | Self::Unknown(_) => Err(self),
        }
    }

    /// Returns the unit, or another one if there is none.
    pub fn or_else(self, other: impl FnOnce() -> Self) -> Self {
        match self {
            Self::Nothing => other(),
            stated => stated,
        }
    }
}

impl fmt::Display for StatedUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Nothing => write!(f, "no unit"),
            Self::Known(unit) => write!(f, "{unit}"),
            Self::Unknown(text) => write!(f, "`{}`", ihd_signal::printable(text)),
        }
    }
}

/// Words for other units, in lower case: of converters and screens, of levels, of other quantities.
const WORDS: [&str; 47] = [
    "count",
    "counts",
    "cnt",
    "cnts",
    "code",
    "codes",
    "digit",
    "digits",
    "lsb",
    "lsbs",
    "bit",
    "bits",
    "adc",
    "adu",
    "raw",
    "div",
    "divs",
    "division",
    "divisions",
    "pixel",
    "pixels",
    "norm",
    "normalized",
    "normalised",
    "a.u.",
    "p.u.",
    "percent",
    "db",
    "dbv",
    "dbmv",
    "dbuv",
    "dbµv",
    "dba",
    "dbm",
    "dbfs",
    "watt",
    "watts",
    "ohm",
    "ohms",
    "tesla",
    "min",
    "minutes",
    "hrs",
    "hours",
    "samples",
    "ticks",
    "points",
];

/// Symbols of other units, in their case.
const SYMBOLS: [&str; 17] = [
    "W", "mW", "kW", "MW", "kVA", "Ohm", "mOhm", "kOhm", "Ω", "mΩ", "kΩ", "Hz", "kHz", "MHz", "mT",
    "°C", "degC",
];

/// Ends of a volt or ampere that is a mean or a span.
const KINDS: [&str; 10] = [
    "rms", "eff", "pp", "p-p", "pk", "peak", "p", "ac", "dc", "avg",
];

/// Returns `true` if a word is no name but a unit that is none of ours: a known one, a ratio (`V/div`), a share (`% FS`), a volt of
/// another kind (`Vrms`) or with a letter that is no prefix here (`MV`).
fn is_unit_like(word: &str) -> bool {
    let lower = word.to_lowercase();
    let of_kind = |kind: &&str| {
        let base = lower
            .strip_suffix(*kind)
            .and_then(|base| word.get(..base.len()));
        base.is_some_and(|base| base.ends_with(['V', 'A']) && Unit::parse(base).is_some())
    };
    let ratio = || {
        let (over, under) = word.split_once('/')?;
        Some(!under.is_empty() && (Unit::parse(over).is_some() || is_unit_like(over)))
    };
    let prefixed = || {
        let mut letters = word.chars();
        let two = letters.next_back().is_some_and(|c| matches!(c, 'V' | 'A'))
            && letters.next().is_some_and(char::is_alphabetic)
            && letters.next().is_none();
        let spelled = ["volt", "volts", "ampere", "amperes"];
        let one_word = lower.chars().all(char::is_alphabetic);
        two || one_word && spelled.iter().any(|end| lower.ends_with(end))
    };
    WORDS.contains(&lower.as_str())
        || SYMBOLS.contains(&word)
        || word.starts_with('%')
        || KINDS.iter().any(of_kind)
        || ratio() == Some(true)
        || prefixed()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headings_split_into_name_and_unit() {
        let volt = StatedUnit::Known(Unit::VOLT);
        let milli = |unit: Unit| {
            StatedUnit::Known(Unit {
                scale: 1e-3,
                ..unit
            })
        };
        for (heading, name, unit) in [
            ("v_V", "v", volt.clone()),
            ("i_mA", "i", milli(Unit::AMPERE)),
            ("time_s", "time", StatedUnit::Known(Unit::SECOND)),
            ("Channel A (mV)", "Channel A", milli(Unit::VOLT)),
            ("v (mVolts)", "v", milli(Unit::VOLT)),
            ("CH1 in V", "CH1", volt.clone()),
            ("u [V]", "u", volt.clone()),
            ("Volt", "Volt", volt.clone()),
            ("CH1", "CH1", StatedUnit::Nothing),
            ("V", "V", StatedUnit::Nothing),
            ("(V)", "(V)", volt),
        ] {
            let expected = (name.to_owned(), unit);
            assert_eq!(StatedUnit::of_heading(heading), expected, "{heading}");
        }
    }

    #[test]
    fn other_units_are_kept_and_other_words_are_names() {
        for unit in [
            "counts",
            "Counts",
            "LSB",
            "div",
            "raw",
            "ADC",
            "Vrms",
            "mVpp",
            "Arms",
            "VRMS",
            "Vpp",
            "dBV",
            "dB",
            "%",
            "% FS",
            "W",
            "kW",
            "Ohm",
            "V/div",
            "mV/A",
            "MV",
            "GA",
            "VV",
            "VA",
            "megavolts",
        ] {
            let expected = StatedUnit::Unknown(unit.to_owned());
            let (name, found) = StatedUnit::of_heading(&format!("CH1 ({unit})"));
            assert_eq!((name.as_str(), found), ("CH1", expected.clone()));
            assert_eq!(StatedUnit::of_heading(&format!("v [{unit}]")).1, expected);
            assert_eq!(StatedUnit::parse(unit), expected);
        }
        let (name, unit) = StatedUnit::of_heading("v_counts");
        assert_eq!(
            (name.as_str(), unit.to_string().as_str()),
            ("v_counts", "`counts`")
        );
        for name in [
            "v (coil)",
            "CH1 (filtered)",
            "Channel A (probe 1)",
            "i (clamp)",
            "u (L1)",
            "v (bus)",
            "i (primary)",
            "v [1]",
            "v_coil",
            "u_L",
            "i (app)",
            "current (Hall)",
            "v (x100)",
        ] {
            let expected = (name.to_owned(), StatedUnit::Nothing);
            assert_eq!(StatedUnit::of_heading(name), expected);
        }
    }

    #[test]
    fn a_time_in_another_unit_is_no_second() {
        assert_eq!(StatedUnit::parse("ms").seconds(), Ok(1e-3));
        assert_eq!(StatedUnit::parse("").seconds(), Ok(1.0));
        for unit in ["min", "Hz", "V"] {
            assert!(StatedUnit::parse(unit).seconds().is_err(), "{unit}");
        }
    }
}
