//! Limits of a scenario on its record: docs/control.md says what each name stands for.

use std::fmt;
use std::ops::RangeInclusive;

use serde::Deserialize;
use toml::Value;

use super::measured::{MEANS, Mean, NUMBERS, Number, WORDS, Word};
use super::record::Record;
use super::summary::within;

/// Error of `[limits]`.
#[derive(Debug, thiserror::Error)]
pub enum LimitError {
    /// A name that no quantity of this form has.
    #[error("limit {name} = {given}: unknown; {form} are for {}", known.join(", "))]
    Unknown {
        /// Name in the file.
        name: String,
        /// Value in the file.
        given: String,
        /// Form of the value.
        form: &'static str,
        /// Names that take this form.
        known: Vec<&'static str>,
    },
    /// A value that is no limit.
    #[error(
        "limit {name} = {given}: give [least, most], rows of [from_s, to_s, least, most], a word or a truth"
    )]
    Form {
        /// Name in the file.
        name: String,
        /// Value in the file.
        given: String,
    },
}

/// The `[limits]` of a scenario's file.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(try_from = "toml::Table")]
pub struct Limits(Vec<Limit>);

#[derive(Clone, Debug)]
struct Limit {
    name: &'static str,
    /// Allowed values, as in the file.
    allowed: String,
    bound: Bound,
}

#[derive(Clone, Debug)]
enum Bound {
    /// One of these words.
    Words(Word, Vec<String>),
    /// Every number within.
    Range(Number, RangeInclusive<f64>),
    /// The mean over each row's time within.
    Rows(Mean, Vec<[f64; 4]>),
}

/// A limit and what was measured.
#[derive(Clone, Debug, PartialEq)]
pub struct LimitCheck {
    /// Name of the limit.
    pub name: &'static str,
    /// Allowed values, as in the file.
    pub allowed: String,
    /// Measured values.
    pub measured: MeasuredValues,
    /// `true` if the limit is met.
    pub ok: bool,
}

impl fmt::Display for LimitCheck {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, allowed, .. } = self;
        write!(f, "{name} is {}, allowed {allowed}", self.measured)
    }
}

/// Values that a limit is compared with.
#[derive(Clone, Debug, PartialEq)]
pub enum MeasuredValues {
    /// Numbers; NaN for what never happened.
    Numbers(Vec<f64>),
    /// A word or a truth.
    Word(String),
}

impl fmt::Display for MeasuredValues {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Numbers(numbers) if numbers.is_empty() => f.write_str("never"),
            Self::Numbers(numbers) => {
                let all: Vec<String> = numbers.iter().map(|n| three_digits(*n)).collect();
                f.write_str(&all.join(", "))
            }
            Self::Word(word) => f.write_str(word),
        }
    }
}

/// Formats a number with three digits, or fewer where it is whole; NaN is `never`.
pub fn three_digits(number: f64) -> String {
    match number.abs() {
        x if x.is_nan() => "never".to_owned(),
        x if x >= 100.0 => format!("{number:.0}"),
        x if x >= 10.0 => format!("{number:.1}"),
        x if x == x.round() => format!("{number:.0}"),
        x if x >= 1.0 => format!("{number:.2}"),
        _ => format!("{number:.3}"),
    }
}

impl Limits {
    /// Compares every limit with a record, in order of their names.
    pub fn check(&self, record: &Record) -> Vec<LimitCheck> {
        self.0.iter().map(|limit| limit.check(record)).collect()
    }
}

impl TryFrom<toml::Table> for Limits {
    type Error = LimitError;

    fn try_from(table: toml::Table) -> Result<Self, LimitError> {
        let limits = table
            .iter()
            .map(|(name, allowed)| Limit::new(name, allowed));
        limits.collect::<Result<_, _>>().map(Self)
    }
}

impl Limit {
    fn new(name: &str, allowed: &Value) -> Result<Self, LimitError> {
        let wrong = || LimitError::Form {
            name: name.to_owned(),
            given: allowed.to_string(),
        };
        let (name, bound) = match allowed {
            Value::Boolean(truth) => {
                let (name, word) = find(&WORDS, "words and truths", name, allowed)?;
                (name, Bound::Words(word, vec![truth.to_string()]))
            }
            Value::String(words) => {
                let (name, word) = find(&WORDS, "words and truths", name, allowed)?;
                let words = words.split('|').map(str::to_owned).collect();
                (name, Bound::Words(word, words))
            }
            Value::Array(rows) if rows.first().is_some_and(Value::is_array) => {
                let (name, mean) = find(&MEANS, "rows", name, allowed)?;
                let rows = rows.iter().map(numbers).collect::<Option<_>>();
                (name, Bound::Rows(mean, rows.ok_or_else(wrong)?))
            }
            Value::Array(_) => {
                let (name, number) = find(&NUMBERS, "ranges", name, allowed)?;
                let [least, most] = numbers(allowed).ok_or_else(wrong)?;
                (name, Bound::Range(number, least..=most))
            }
            _ => return Err(wrong()),
        };
        Ok(Self {
            name,
            allowed: allowed.to_string(),
            bound,
        })
    }

    fn check(&self, record: &Record) -> LimitCheck {
        let (measured, ok) = match &self.bound {
            Bound::Words(word, allowed) => {
                let word = word(record);
                let ok = allowed.contains(&word);
                (MeasuredValues::Word(word), ok)
            }
            Bound::Range(number, range) => {
                let numbers = number(record);
                // A limit on nothing would be met by a record that lacks what it is about.
                let ok = !numbers.is_empty() && numbers.iter().all(|n| range.contains(n));
                (MeasuredValues::Numbers(numbers), ok)
            }
            Bound::Rows(mean, rows) => {
                let over = |&[from_s, to_s, ..]: &[f64; 4]| {
                    mean(within(&record.half_cycles, from_s, to_s))
                };
                let means: Vec<f64> = rows.iter().map(over).collect();
                // NaN, of a row without any half-cycle, is outside of every range.
                let ok = |(n, [_, _, least, most]): (&f64, &[f64; 4])| (least..=most).contains(&n);
                let ok = means.iter().zip(rows).all(ok);
                (MeasuredValues::Numbers(means), ok)
            }
        };
        LimitCheck {
            name: self.name,
            allowed: self.allowed.clone(),
            measured,
            ok,
        }
    }
}

/// Row of a table of quantities with this name.
fn find<T: Copy>(
    table: &[(&'static str, T)],
    form: &'static str,
    name: &str,
    given: &Value,
) -> Result<(&'static str, T), LimitError> {
    let row = table.iter().find(|(known, _)| *known == name);
    row.copied().ok_or_else(|| LimitError::Unknown {
        name: name.to_owned(),
        given: given.to_string(),
        form,
        known: table.iter().map(|(known, _)| *known).collect(),
    })
}

/// Numbers of a list of exactly this length; `None` for anything else.
fn numbers<const N: usize>(list: &Value) -> Option<[f64; N]> {
    let number = |value: &Value| match value {
        Value::Float(x) => Some(*x),
        Value::Integer(x) => Some(*x as f64),
        _ => None,
    };
    let list: Option<Vec<f64>> = list.as_array()?.iter().map(number).collect();
    list?.try_into().ok()
}

#[cfg(test)]
mod tests;
