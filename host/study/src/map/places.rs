//! Pots and their places, by name: `ferritic-18`, `ferritic-18+lift-10mm`, `ferritic-18+offset-30mm`, `ferritic-18+150C`.

use std::str::FromStr;

use ihd_sim::pot::{SimulatedPot, UnknownPotName};
use thiserror::Error;

/// Pot in its place, and the name of both.
#[derive(Clone, Debug, PartialEq)]
pub struct PotPlacement {
    /// Name as written.
    pub name: String,
    /// The pot.
    pub pot: SimulatedPot,
}

/// Pots of the study: sizes, metals, places.
pub const POTS: [&str; 11] = [
    "ferritic-21",
    "ferritic-18",
    "ferritic-15",
    "ferritic-12",
    "ferritic-9",
    "cast-iron-21",
    "stainless-21",
    "aluminium-21",
    "ferritic-18+lift-10mm",
    "ferritic-18+offset-30mm",
    "ferritic-18+150C",
];

/// Error for a name that denotes no pot in a place.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum UnknownPlace {
    /// The pot is unknown.
    #[error(transparent)]
    Pot(#[from] UnknownPotName),
    /// The text after a plus is no place.
    #[error("`{0}` is no place of a pot: add +lift-10mm, +offset-30mm or +150C to its name")]
    Place(String),
}

impl FromStr for PotPlacement {
    type Err = UnknownPlace;

    fn from_str(name: &str) -> Result<Self, UnknownPlace> {
        let mut words = name.split('+');
        let mut pot: SimulatedPot = words.next().unwrap_or_default().parse()?;
        for word in words {
            let number = |text: &str, unit: &str| {
                let number = text.strip_suffix(unit)?.parse::<f64>().ok()?;
                number.is_finite().then_some(number)
            };
            let mm = |what: &str| number(word.strip_prefix(what)?, "mm");
            if let Some(lift) = mm("lift-") {
                pot.lift_m = lift * 1e-3;
            } else if let Some(offset) = mm("offset-") {
                pot.offset_m = offset * 1e-3;
            } else if let Some(celsius) = number(word, "C") {
                pot.temperature_c = celsius;
            } else {
                return Err(UnknownPlace::Place(word.to_owned()));
            }
        }
        Ok(Self {
            name: name.to_owned(),
            pot,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pot_of_the_study_is_one() {
        for name in POTS {
            let placed: PotPlacement = name.parse().unwrap();
            assert!(placed.pot.field_settings(0.1).is_ok(), "{name}");
        }
        let lifted: PotPlacement = "ferritic-18+lift-10mm+60C".parse().unwrap();
        assert_eq!((lifted.pot.lift_m, lifted.pot.temperature_c), (10e-3, 60.0));
    }

    #[test]
    fn other_words_are_refused_with_what_there_is() {
        for name in [
            "ferritic-18+left",
            "ferritic-18+lift-mm",
            "ferritic-18+NaNC",
            "ferritic-18+",
        ] {
            let why = name.parse::<PotPlacement>().unwrap_err().to_string();
            assert!(why.contains("+lift-10mm"), "{why}");
        }
        assert!("copper-18".parse::<PotPlacement>().is_err());
    }
}
