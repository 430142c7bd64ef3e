//! Interpretation of a table's prelude, in the dialects of scopes; docs/captures.md names each.

use std::collections::BTreeMap;

use csv::Position;

use super::heading::{Heading, check_width, find, headings};
use super::prelude::Prelude;
use crate::error::FormatError;
use crate::formats::channel::FileChannel;
use crate::options::ReadOptions;

/// Source of the samples' times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TimeColumn {
    /// A column, times its scale in seconds.
    Column {
        /// Index of the column.
        index: usize,
        /// Seconds of one unit.
        scale: f64,
    },
    /// A column that counts the samples; start and interval in the prelude.
    Counter {
        /// Index of the column.
        index: usize,
        /// Time of sample 0 in seconds.
        t0_s: f64,
        /// Interval in seconds.
        dt_s: f64,
    },
    /// Start and interval in the prelude.
    Even {
        /// Time of the first sample in seconds.
        t0_s: f64,
        /// Interval in seconds.
        dt_s: f64,
    },
    /// The table states no times.
    Missing,
}

/// Meaning of the columns.
#[derive(Clone, Debug, PartialEq)]
pub struct ColumnLayout {
    /// The clock.
    pub time: TimeColumn,
    /// Columns that may be voltage or current.
    pub channels: Vec<FileChannel>,
    /// Their indices among all columns.
    pub columns: Vec<usize>,
    /// Sampling interval that the prelude declares, in seconds.
    pub interval_s: Option<f64>,
    /// Fields of a row.
    pub width: usize,
    /// Rows that the prelude declares.
    rows: Option<u64>,
    /// Format and instrument.
    pub metadata: BTreeMap<String, String>,
}

impl TimeColumn {
    /// Column of times in seconds.
    fn at(index: usize) -> Self {
        Self::Column { index, scale: 1.0 }
    }
}

impl ColumnLayout {
    /// Finds the clock and the channels, or takes the columns that the user names: time (`-` for
    /// none), voltage, current.
    ///
    /// # Errors
    /// [`FormatError`] when a column that the user names is not there or has two meanings, the times are in no unit of time, or the heading
    /// does not fit the rows.
    pub fn from_prelude(prelude: &Prelude, options: ReadOptions<'_>) -> Result<Self, FormatError> {
        check_waveform_type(prelude)?;
        let headings = headings(prelude);
        let wrong = |what: String| FormatError::at_line(prelude.end.line(), what);
        let (time, columns) = match options.columns {
            Some([time, v, i]) => {
                let index = |column| find(&headings, column, prelude.width).map_err(wrong);
                let clock = Some(time).filter(|t| !t.is_none_column());
                let (clock, v, i) = (clock.map(index).transpose()?, index(v)?, index(i)?);
                if let Some(twice) = [v, i].into_iter().find(|k| clock == Some(*k) || v == i) {
                    let what = format!("column {} is named twice in --input columns", twice + 1);
                    return Err(wrong(what));
                }
                let time = clock.map_or(TimeColumn::Missing, TimeColumn::at);
                (time, vec![v, i])
            }
            None => {
                let (time, others) = clock(prelude, &headings);
                check_width(prelude)?;
                let all = 0..prelude.width;
                let channel = |k: &usize| !others.contains(k) && is_channel(prelude, &headings, *k);
                (time, all.filter(channel).collect())
            }
        };
        let time = match time {
            _ if options.without_times => TimeColumn::Missing,
            TimeColumn::Column { index, .. } => TimeColumn::Column {
                index,
                scale: headings[index].unit.seconds().map_err(|unit| {
                    wrong(format!(
                        "times in {unit}, which is no unit of time known here: give the sampling rate, as in --input rate=50M, and they are not read"
                    ))
                })?,
            },
            other => other,
        };
        let channel = |k: &usize| FileChannel {
            name: headings[*k].name.clone(),
            unit: headings[*k].unit.clone(),
            full_scale: None,
        };
        Ok(Self {
            time,
            channels: columns.iter().map(channel).collect(),
            columns,
            width: prelude.width,
            interval_s: prelude
                .number(&["sample interval", "xinc"])
                .filter(|dt| *dt > 0.0),
            rows: prelude
                .number(&["record length"])
                .filter(|rows| *rows >= 0.0)
                .map(|rows| rows as u64),
            metadata: metadata(prelude, &headings),
        })
    }

    /// Checks the number of rows read against the prelude; `end` is the place after the last one.
    ///
    /// # Errors
    /// [`FormatError`] when there are fewer, or less than two.
    pub fn check_rows(&self, read: usize, end: Position) -> Result<(), FormatError> {
        let wrong = |what| Err(FormatError::at_line(end.line(), what));
        match self.rows {
            Some(declared) if (read as u64) < declared => wrong(format!(
                "the file ends after {read} samples, {declared} are declared: truncated"
            )),
            _ if read < 2 => wrong(format!("{read} sample; two are the least")),
            _ => Ok(()),
        }
    }
}

/// Checks the waveform type that Tektronix' CSV states: analogue, with its length.
fn check_waveform_type(prelude: &Prelude) -> Result<(), FormatError> {
    let wrong = |what: String| Err(FormatError::at_line(1, what));
    match prelude.value(&["waveform type"]) {
        Some(kind) if !kind.eq_ignore_ascii_case("analog") => {
            wrong(format!("a waveform of type {kind}, no voltage over time"))
        }
        Some(_) if prelude.number(&["record length"]).is_none() => {
            wrong("a Tektronix CSV without its Record Length".to_owned())
        }
        _ => Ok(()),
    }
}

/// Returns the clock, and the columns that it occupies.
fn clock(prelude: &Prelude, headings: &[Heading]) -> (TimeColumn, Vec<usize>) {
    if let Some(found) = start_and_increment(prelude, headings) {
        return found;
    }
    // Numbers without a heading: the first of several columns is the time.
    let nameless = headings.iter().all(|h| h.name.is_empty());
    let first = (prelude.width > 1 && nameless).then_some(0);
    let beside = prelude.beside.then_some(3);
    let by_heading = || headings.iter().position(Heading::is_time);
    if let Some(index) = beside.or_else(by_heading).or(first) {
        return (TimeColumn::at(index), vec![index]);
    }
    if let (Some(t0_s), Some(dt_s)) = (prelude.number(&["xorg"]), prelude.number(&["xinc"])) {
        return (TimeColumn::Even { t0_s, dt_s }, Vec::new());
    }
    (TimeColumn::Missing, Vec::new())
}

/// Parses Rigol's heading with the time of the first sample and the interval, either `Start,Increment` with the numbers below, or
/// `t0 = -1e-3, tInc = 1e-6`. Returns the clock and the columns that are no channels.
fn start_and_increment(
    prelude: &Prelude,
    headings: &[Heading],
) -> Option<(TimeColumn, Vec<usize>)> {
    let number = |text: &str| {
        prelude
            .syntax
            .number(text.as_bytes())
            .filter(|x| x.is_finite())
    };
    let at = |name: &str| {
        let starts = |h: &Heading| h.name.to_lowercase().starts_with(name);
        headings.iter().position(starts)
    };
    let assigned = |index: usize| number(headings[index].name.split_once('=')?.1);
    if let (Some(t0), Some(inc)) = (at("t0"), at("tinc")) {
        let dt_s = assigned(inc).filter(|dt| *dt > 0.0)?;
        let t0_s = assigned(t0)?;
        return Some((TimeColumn::Even { t0_s, dt_s }, vec![t0, inc]));
    }
    let (Some(start), Some(increment)) = (at("start"), at("increment")) else {
        return None;
    };
    let values = prelude.rows.last()?;
    let dt_s = number(values.get(increment)?).filter(|dt| *dt > 0.0)?;
    let t0_s = number(values.get(start)?)?;
    // A row that is missing shows in the counter alone.
    match headings.iter().position(|h| h.name == "X") {
        Some(index) => Some((
            TimeColumn::Counter { index, t0_s, dt_s },
            vec![start, increment, index],
        )),
        None => Some((TimeColumn::Even { t0_s, dt_s }, vec![start, increment])),
    }
}

/// Returns `true` if a column can be a channel: it has a name, or no column has one.
fn is_channel(prelude: &Prelude, headings: &[Heading], column: usize) -> bool {
    if prelude.beside {
        return column == 4;
    }
    let nameless = headings.iter().all(|h| h.name.is_empty());
    nameless || headings.get(column).is_some_and(|h| !h.name.is_empty())
}

fn metadata(prelude: &Prelude, headings: &[Heading]) -> BTreeMap<String, String> {
    let maker = maker(prelude, headings);
    let format = maker.map_or("CSV".to_owned(), |maker| format!("CSV, {maker}"));
    let mut all = BTreeMap::from([("format".to_owned(), format)]);
    let instrument = prelude.value(&["model", "model number"]);
    all.extend(instrument.map(|model| ("instrument".to_owned(), model.to_owned())));
    all
}

/// Maker of the instrument; `None` if the prelude does not show it.
fn maker(prelude: &Prelude, headings: &[Heading]) -> Option<&'static str> {
    let first = prelude.rows.first()?.first()?.to_lowercase();
    let heading = |name: &str| {
        headings
            .iter()
            .any(|h| h.name.to_lowercase().starts_with(name))
    };
    let last = prelude.rows.last()?.first()?;
    if first.starts_with("lecroy") {
        Some("LeCroy")
    } else if heading("increment") || heading("tinc") {
        Some("Rigol")
    } else if prelude
        .rows
        .iter()
        .any(|row| row.first().is_some_and(|k| k == "Source"))
        && !prelude.beside
    {
        Some("Siglent")
    } else if first == "x-axis" || prelude.values(&["xinc"]).is_some() {
        Some("Keysight")
    } else if prelude.beside || prelude.values(&["sample interval"]).is_some() {
        Some("Tektronix")
    } else if last.starts_with('(') {
        Some("PicoScope")
    } else {
        None
    }
}
