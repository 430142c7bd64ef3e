//! A board file, read and checked.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use toml::de::{DeTable, DeValue};

use crate::error::BoardError;
use crate::order::ORDER;
use crate::pins::{self, PINS};
use crate::scales;
use crate::thermistors;
use crate::values::VALUES;

/// Answer to a key that no board has.
const UNKNOWN: &str = "unknown; boards/reference.toml has every value";

/// Values of a board.
#[derive(Clone, Debug)]
pub struct Board {
    path: PathBuf,
    name: String,
    /// Value and line, by section and key; with those that [`scales`] adds.
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
        board.require_all()?;
        for (name, number, line) in scales::values(&board)? {
            board.values.insert(name, (number, line));
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

    fn require_all(&self) -> Result<(), BoardError> {
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
        Ok(())
    }

    fn check(&self) -> Result<(), BoardError> {
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

    /// Value and line of a section and key that [`VALUES`] or [`scales`] has.
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
            text += &constant(value.key, value.kind, number, value.doc);
        }
        text + &scales::constants(self) + &thermistors::constants(self) + &pins::constants(self)
    }
}

/// Source text of a constant, whose name is its key in capitals.
pub(crate) fn constant(key: &str, kind: &str, number: i64, doc: &str) -> String {
    let name = key.to_uppercase();
    format!("/// {doc}\npub const {name}: {kind} = {number};\n")
}

/// Line of a place in a text, from 1.
fn line(text: &str, at: usize) -> usize {
    1 + text.bytes().take(at).filter(|b| *b == b'\n').count()
}

#[cfg(test)]
pub(crate) mod tests;
