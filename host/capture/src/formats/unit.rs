//! Units as written by scopes and table headers: `V`, `(mV)`, `Amps`, `µs`.

use std::fmt;

/// Quantity that a column measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColumnQuantity {
    /// Voltage, base unit volt.
    Voltage,
    /// Current, base unit ampere.
    Current,
    /// Time, base unit second.
    Time,
}

/// Unit: a quantity and the size of one unit in its base unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unit {
    /// Quantity.
    pub quantity: ColumnQuantity,
    /// Size of one unit in the base unit: 1e-3 for mV.
    pub scale: f64,
}

impl Unit {
    /// One volt.
    pub const VOLT: Self = Self {
        quantity: ColumnQuantity::Voltage,
        scale: 1.0,
    };
    /// One ampere.
    pub const AMPERE: Self = Self {
        quantity: ColumnQuantity::Current,
        scale: 1.0,
    };
    /// One second.
    pub const SECOND: Self = Self {
        quantity: ColumnQuantity::Time,
        scale: 1.0,
    };

    /// Parses a unit, with or without brackets; `None` for anything else.
    pub fn parse(text: &str) -> Option<Self> {
        let bare = text
            .trim()
            .trim_matches(['(', ')', '[', ']', '"', '\''])
            .trim();
        let word = bare.to_ascii_lowercase();
        let spelled = match word.as_str() {
            "volt" | "volts" => Some(Self::VOLT),
            "amp" | "amps" | "ampere" | "amperes" => Some(Self::AMPERE),
            "sec" | "second" | "seconds" => Some(Self::SECOND),
            _ => None,
        };
        if spelled.is_some() {
            return spelled;
        }
        let base = match bare.chars().next_back()? {
            'V' | 'v' => Self::VOLT,
            'A' | 'a' => Self::AMPERE,
            's' | 'S' => Self::SECOND,
            _ => return None,
        };
        let prefix = &bare[..bare.len() - 1];
        let scale = match prefix {
            "" => 1.0,
            "p" => 1e-12,
            "n" => 1e-9,
            "u" | "µ" | "μ" => 1e-6,
            "m" => 1e-3,
            "k" => 1e3,
            _ => return None,
        };
        Some(Self { scale, ..base })
    }

    /// Splits a heading with a unit at its end, as `v_mV`, `Volts (mV)`, `i[A]` or `CH1 in V`, into
    /// name and unit. A heading that is only a unit (`Volt`) is its own name.
    pub fn of_heading(heading: &str) -> (String, Option<Self>) {
        let heading = heading.trim().trim_matches('"').trim();
        if let Some(open) = heading.rfind(['(', '[']).filter(|open| *open > 0)
            && let Some(unit) = Self::parse(&heading[open..])
        {
            return (heading[..open].trim().to_owned(), Some(unit));
        }
        for separator in [" in ", "_", " ", "/"] {
            if let Some((name, unit)) = heading.rsplit_once(separator)
                && let Some(unit) = Self::parse(unit)
                && !name.trim().is_empty()
            {
                return (name.trim().to_owned(), Some(unit));
            }
        }
        let whole = Self::parse(heading).filter(|_| heading.len() > 1);
        (heading.to_owned(), whole)
    }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let base = match self.quantity {
            ColumnQuantity::Voltage => "V",
            ColumnQuantity::Current => "A",
            ColumnQuantity::Time => "s",
        };
        if self.scale == 1.0 {
            write!(f, "{base}")
        } else {
            write!(f, "{:e} {base}", self.scale)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_as_scopes_write_them() {
        let cases = [
            ("V", ColumnQuantity::Voltage, 1.0),
            ("(mV)", ColumnQuantity::Voltage, 1e-3),
            ("[kV]", ColumnQuantity::Voltage, 1e3),
            ("Volts", ColumnQuantity::Voltage, 1.0),
            ("A", ColumnQuantity::Current, 1.0),
            ("mA", ColumnQuantity::Current, 1e-3),
            ("µA", ColumnQuantity::Current, 1e-6),
            ("Ampere", ColumnQuantity::Current, 1.0),
            ("s", ColumnQuantity::Time, 1.0),
            ("(us)", ColumnQuantity::Time, 1e-6),
            ("ns", ColumnQuantity::Time, 1e-9),
            ("Second", ColumnQuantity::Time, 1.0),
        ];
        for (text, quantity, scale) in cases {
            assert_eq!(Unit::parse(text), Some(Unit { quantity, scale }), "{text}");
        }
        for text in ["", "dBm", "Hz", "U", "XV", "()", "CH1"] {
            assert_eq!(Unit::parse(text), None, "{text}");
        }
    }

    #[test]
    fn headings_split_into_name_and_unit() {
        let volt = Some(Unit::VOLT);
        let milli = |unit: Unit| {
            Some(Unit {
                scale: 1e-3,
                ..unit
            })
        };
        for (heading, name, unit) in [
            ("v_V", "v", volt),
            ("i_mA", "i", milli(Unit::AMPERE)),
            ("time_s", "time", Some(Unit::SECOND)),
            ("Channel A (mV)", "Channel A", milli(Unit::VOLT)),
            ("CH1 in V", "CH1", volt),
            ("u [V]", "u", volt),
            ("Volt", "Volt", volt),
            ("CH1", "CH1", None),
            ("V", "V", None),
            ("(V)", "(V)", volt),
        ] {
            assert_eq!(
                Unit::of_heading(heading),
                (name.to_owned(), unit),
                "{heading}"
            );
        }
    }
}
