//! A board file, read and checked.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use toml::de::{DeTable, DeValue};

use crate::error::BoardError;
use crate::order::ORDER;
use crate::pins::{self, PINS};
use crate::thermistors;
use crate::values::VALUES;

/// Answer to a key that no board has.
const UNKNOWN: &str = "unknown; boards/reference.toml has every value";

/// Values of a board.
#[derive(Clone, Debug)]
pub struct Board {
    path: PathBuf,
    name: String,
    /// Value and line, by section and key.
    values: BTreeMap<String, (i64, usize)>,
    /// Port, line of the port, and line of the file, by key.
    pins: BTreeMap<&'static str, ((u8, u8), usize)>,
}

impl Board {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// [`BoardError`]: it cannot be read, lacks a value, has one that is unknown or out of its range, or limits that are not in order.
    pub fn read(path: &Path) -> Result<Self, BoardError> {
        let text = std::fs::read_to_string(path).map_err(|source| BoardError::Read {
            path: path.to_owned(),
            source,
        })?;
        Self::parse(path, &text)
    }

    /// Checks a file's text.
    ///
    /// # Errors
    /// As [`Board::read`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, BoardError> {
        let table = DeTable::parse(text).map_err(|why| BoardError::Syntax {
            path: path.to_owned(),
            why: why.to_string(),
        })?;
        let mut board = Self {
            path: path.to_owned(),
            name: String::new(),
            values: BTreeMap::new(),
            pins: BTreeMap::new(),
        };
        for (key, value) in table.get_ref() {
            let line = line(text, value.span().start);
            let key = key.get_ref().as_ref();
            match value.get_ref() {
                DeValue::String(name) if key == "name" => board.name = name.to_string(),
                DeValue::Table(section) if key == "pins" => board.take_pins(section, text)?,
                DeValue::Table(section) => board.take(key, section, text)?,
                _ => {
                    return Err(board.error(
                        key,
                        line,
                        "unknown: a file has a name and sections".to_owned(),
                    ));
                }
            }
        }
        board.check()?;
        Ok(board)
    }

    fn take(&mut self, section: &str, table: &DeTable<'_>, text: &str) -> Result<(), BoardError> {
        for (key, value) in table {
            let (name, line) = (
                format!("{section}.{}", key.get_ref()),
                line(text, value.span().start),
            );
            let known = VALUES
                .iter()
                .find(|v| v.section == section && v.key == key.get_ref().as_ref());
            let Some(known) = known else {
                return Err(self.error(&name, line, UNKNOWN.to_owned()));
            };
            let number = match value.get_ref() {
                DeValue::Integer(number) => {
                    i64::from_str_radix(&number.as_str().replace('_', ""), number.radix()).ok()
                }
                _ => None,
            };
            let (min, max) = known.range;
            match number.filter(|n| (min..=max).contains(n)) {
                Some(number) => self.values.insert(name, (number, line)),
                None => {
                    let why = format!("must be a whole number from {min} to {max}");
                    return Err(self.error(&name, line, why));
                }
            };
        }
        Ok(())
    }

    fn take_pins(&mut self, table: &DeTable<'_>, text: &str) -> Result<(), BoardError> {
        for (key, value) in table {
            let line = line(text, value.span().start);
            let known = PINS.iter().find(|pin| pin.key == key.get_ref().as_ref());
            let pin = match (known, value.get_ref()) {
                (None, _) => Err(UNKNOWN.to_owned()),
                (Some(known), DeValue::String(name)) => {
                    pins::parse_for(known, name).map(|pin| (known.key, pin))
                }
                _ => Err("must be a pin's name".to_owned()),
            };
            let name = format!("pins.{}", key.get_ref());
            let (key, pin) = pin.map_err(|why| self.error(&name, line, why))?;
            self.pins.insert(key, (pin, line));
        }
        Ok(())
    }

    fn check(&self) -> Result<(), BoardError> {
        for value in VALUES {
            let name = format!("{}.{}", value.section, value.key);
            if !self.values.contains_key(&name) {
                return Err(BoardError::Missing {
                    path: self.path.clone(),
                    name,
                    purpose: value.doc,
                });
            }
        }
        for pin in PINS {
            if !self.pins.contains_key(pin.key) {
                return Err(BoardError::Missing {
                    path: self.path.clone(),
                    name: format!("pins.{}", pin.key),
                    purpose: pin.doc,
                });
            }
        }
        for order in ORDER {
            let ((lower, lower_line), (upper, line)) =
                (self.value(order.lower), self.value(order.upper));
            if lower as f64 * order.factor >= upper as f64 {
                let why = format!(
                    "is {upper}, too small beside {} = {lower} in line {lower_line}: {}",
                    order.lower, order.why
                );
                return Err(self.error(order.upper, line, why));
            }
        }
        pins::check(self)?;
        thermistors::check(self)
    }

    /// Port and line of a function that [`PINS`] has, and its line of the file.
    pub(crate) fn pin(&self, key: &str) -> ((u8, u8), usize) {
        self.pins[key]
    }

    /// Value and line of a section and key that [`VALUES`] has.
    pub(crate) fn value(&self, name: &str) -> (i64, usize) {
        self.values[name]
    }

    pub(crate) fn error(&self, name: &str, line: usize, why: String) -> BoardError {
        BoardError::Value {
            path: self.path.clone(),
            line,
            name: name.to_owned(),
            why,
        }
    }

    /// Source text of the constants, in Rust.
    pub fn constants(&self) -> String {
        let mut text = format!(
            "/// Name of the board.\npub const NAME: &str = {:?};\n",
            self.name
        );
        for value in VALUES {
            let (number, _) = self.value(&format!("{}.{}", value.section, value.key));
            let name = value.key.to_uppercase();
            let _ = writeln!(
                text,
                "/// {}\npub const {name}: {} = {number};",
                value.doc, value.kind
            );
        }
        text + &thermistors::constants(self) + &pins::constants(self)
    }
}

/// Line of a place in a text, from 1.
fn line(text: &str, at: usize) -> usize {
    1 + text.bytes().take(at).filter(|b| *b == b'\n').count()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn reference() -> String {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("reference.toml");
        std::fs::read_to_string(path).unwrap()
    }

    pub(crate) fn refused(from: &str, to: &str) -> String {
        let text = reference();
        assert!(text.contains(from), "{from}");
        let wrong = Board::parse(Path::new("my.toml"), &text.replace(from, to));
        wrong.unwrap_err().to_string()
    }

    #[test]
    fn a_file_becomes_constants() {
        let text = reference().replace("trip_current_ma = 76_000", "trip_current_ma = 75_500");
        let constants = Board::parse(Path::new("my.toml"), &text)
            .unwrap()
            .constants();
        assert!(
            constants.contains("pub const TRIP_CURRENT_MA: u32 = 75500;"),
            "{constants}"
        );
        assert!(constants.contains("pub const NAME: &str = \"reference\";"));
    }

    #[test]
    fn every_file_of_the_folder_is_a_board() {
        for file in std::fs::read_dir(env!("CARGO_MANIFEST_DIR")).unwrap() {
            let path = file.unwrap().path();
            if path.extension().is_some_and(|e| e == "toml") && !path.ends_with("Cargo.toml") {
                Board::read(&path).unwrap();
            }
        }
    }

    #[test]
    fn a_limit_that_cannot_be_kept_names_its_line() {
        let why = refused("trip_current_ma = 76_000", "trip_current_ma = 79_000");
        assert!(why.starts_with("my.toml:"), "{why}");
        let text = reference().replace("trip_current_ma = 76_000", "trip_current_ma = 79_000");
        let at = text
            .lines()
            .position(|l| l.starts_with("coil_current_full_scale_ma"))
            .unwrap();
        assert!(why.contains(&format!("my.toml:{}:", at + 1)), "{why}");
        assert!(why.contains("limits.trip_current_ma = 79000"), "{why}");
        assert!(
            refused("soft_current_ma = 73_000", "soft_current_ma = 69_000").contains("soft limit")
        );
        assert!(refused("mains_voltage_v = 230", "mains_voltage_v = 250").contains("crest"));
    }

    /// From the probe frequency to the second probe at 50 kHz the R of pots falls as f^.67 or steeper, that of sheets as f^.45 or flatter
    /// (firmware/src/control/pot.rs); the limit between them is 77 %, and noise needs room on both sides.
    #[test]
    fn a_probe_frequency_at_which_pots_and_sheets_are_alike_is_refused() {
        for (hz, is_right) in [
            (45_000, false),
            (72_000, false),
            (77_000, true),
            (80_000, true),
            (84_000, true),
            (90_000, false),
            (120_000, false),
        ] {
            let left = |exponent: f64| (50e3 / f64::from(hz)).powf(exponent);
            let (pot, sheet) = (left(0.67), left(0.45));
            assert_eq!(pot < 0.75 && sheet > 0.79, is_right, "{pot} {sheet}");
            let text = reference().replace("f_sw_max_hz = 80_000", &format!("f_sw_max_hz = {hz}"));
            let board = Board::parse(Path::new("my.toml"), &text);
            assert_eq!(board.is_ok(), is_right, "{hz} Hz");
            if let Err(why) = board {
                let why = why.to_string();
                assert!(why.contains("rating.f_sw_max_hz"), "{why}");
            }
        }
    }

    /// The built-in lookup's L: 20.5 µH with saturated steel and 38.5 µH without current, over 23 turns at 45 kHz; it goes with f^−.3 and
    /// with the turns' square. A lookup holds 2 to 63.9 µH.
    #[test]
    fn turns_whose_built_in_lookup_no_lookup_could_hold_are_refused() {
        for turns in 4..32 {
            let k = f64::from(turns) / 23.0;
            let least_uh = (20.5 + 18.0 / (1.0 + 80.0 * k / 10.0)) * (80f64 / 45.0).powf(-0.3);
            let most_uh = 38.5 * (30f64 / 45.0).powf(-0.3);
            let is_right = least_uh * k * k >= 2.0 && most_uh * k * k <= 63.9;
            let text = reference().replace("coil_turns = 23", &format!("coil_turns = {turns}"));
            let board = Board::parse(Path::new("my.toml"), &text);
            assert_eq!(board.is_ok(), is_right, "{turns} turns");
        }
    }

    #[test]
    fn unknown_missing_and_wrong_values_are_refused() {
        assert!(refused("bleeder_ohm", "bleeder_kohm").contains("supply.bleeder_kohm: unknown"));
        assert!(refused("bleeder_ohm = 94_000\n", "").contains("supply.bleeder_ohm is missing"));
        assert!(refused("= 94_000", "= 94.5").contains("whole number"));
        assert!(refused("= 94_000", "= 10").contains("from 1000"));
        assert!(refused("[bridge]", "[bridge").starts_with("my.toml"));
    }
}
