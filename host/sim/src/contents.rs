//! Contents of the pot.

use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Range of volumes that have a name, in litre.
const LITRES: RangeInclusive<f64> = 0.05..=10.0;

/// Contents of the pot, which take its heat and may boil.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum PotContents {
    /// Food as one lump with base and lower wall that loses its heat to the room; it never boils.
    #[default]
    Food,
    /// Empty pot.
    Empty,
    /// Volume of water in litre, under a lid.
    Water(f64),
    /// Volume of vegetable oil in litre; it does not boil below its smoke point.
    Oil(f64),
}

/// A name that denotes no contents.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "unknown contents `{0}`: use water-LITRE or oil-LITRE with 0.05 to 10 litre, food or empty"
)]
pub struct UnknownContents(String);

impl FromStr for PotContents {
    type Err = UnknownContents;

    fn from_str(name: &str) -> Result<Self, UnknownContents> {
        let unknown = || UnknownContents(name.to_owned());
        match name {
            "food" => return Ok(Self::Food),
            "empty" => return Ok(Self::Empty),
            _ => {}
        }
        let (what, litre) = name.rsplit_once('-').ok_or_else(unknown)?;
        let litre: f64 = litre.parse().map_err(|_| unknown())?;
        match what {
            _ if !LITRES.contains(&litre) => Err(unknown()),
            "water" => Ok(Self::Water(litre)),
            "oil" => Ok(Self::Oil(litre)),
            _ => Err(unknown()),
        }
    }
}

impl TryFrom<String> for PotContents {
    type Error = UnknownContents;

    fn try_from(name: String) -> Result<Self, UnknownContents> {
        name.parse()
    }
}

impl From<PotContents> for String {
    fn from(contents: PotContents) -> Self {
        contents.to_string()
    }
}

impl fmt::Display for PotContents {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Food => f.write_str("food"),
            Self::Empty => f.write_str("empty"),
            Self::Water(litre) => write!(f, "water-{litre}"),
            Self::Oil(litre) => write!(f, "oil-{litre}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip_and_unknown_ones_are_refused() {
        for name in ["food", "empty", "water-1.5", "oil-0.5"] {
            assert_eq!(name.parse::<PotContents>().unwrap().to_string(), name);
        }
        for bad in [
            "",
            "water",
            "water-0",
            "water-NaN",
            "water--1",
            "soup-1",
            "oil-11",
        ] {
            let refused = bad.parse::<PotContents>().unwrap_err().to_string();
            assert!(refused.contains("water-LITRE"), "{bad}");
        }
    }
}
