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
        let bare = without_brackets(text);
        let lower = bare.to_ascii_lowercase();
        let spelled = |(word, base): &(&str, Self)| {
            let prefix = lower.strip_suffix(word)?.len();
            base.prefixed(&bare[..prefix])
        };
        if let Some(unit) = SPELLED.iter().find_map(spelled) {
            return Some(unit);
        }
        let base = match bare.chars().next_back()? {
            'V' | 'v' => Self::VOLT,
            'A' | 'a' => Self::AMPERE,
            's' | 'S' => Self::SECOND,
            _ => return None,
        };
        base.prefixed(&bare[..bare.len() - 1])
    }

    /// Returns the unit with a prefix; `None` for a prefix that no capture has.
    fn prefixed(self, prefix: &str) -> Option<Self> {
        let scale = match prefix {
            "" => 1.0,
            "p" | "pico" => 1e-12,
            "n" | "nano" => 1e-9,
            "u" | "µ" | "μ" | "micro" => 1e-6,
            "m" | "milli" => 1e-3,
            "k" | "kilo" => 1e3,
            // `KS` counts samples.
            "K" if self.quantity != ColumnQuantity::Time => 1e3,
            _ => return None,
        };
        Some(Self { scale, ..self })
    }
}

/// Base units as words, longer ones first.
const SPELLED: [(&str, Unit); 9] = [
    ("amperes", Unit::AMPERE),
    ("ampere", Unit::AMPERE),
    ("amps", Unit::AMPERE),
    ("amp", Unit::AMPERE),
    ("volts", Unit::VOLT),
    ("volt", Unit::VOLT),
    ("seconds", Unit::SECOND),
    ("second", Unit::SECOND),
    ("sec", Unit::SECOND),
];

/// Text of a unit without the brackets and quotes around it.
pub fn without_brackets(text: &str) -> &str {
    let bare = text.trim().trim_matches(['(', ')', '[', ']', '"', '\'']);
    bare.trim()
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
            ("KV", ColumnQuantity::Voltage, 1e3),
            ("(KA)", ColumnQuantity::Current, 1e3),
            ("mVolts", ColumnQuantity::Voltage, 1e-3),
            ("milliamps", ColumnQuantity::Current, 1e-3),
            ("usec", ColumnQuantity::Time, 1e-6),
        ];
        for (text, quantity, scale) in cases {
            assert_eq!(Unit::parse(text), Some(Unit { quantity, scale }), "{text}");
        }
        for text in ["", "dBm", "Hz", "U", "XV", "MV", "KS", "clamp", "()", "CH1"] {
            assert_eq!(Unit::parse(text), None, "{text}");
        }
    }
}
