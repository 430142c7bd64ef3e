//! Interpretation of a table's prelude, in the dialects of scopes; docs/captures.md names each.

use std::collections::BTreeMap;

use csv::Position;

use super::heading::{Heading, check_width, headings};
use super::prelude::Prelude;
use crate::channels::ChannelRef;
use crate::error::FormatError;
use crate::formats::channel::FileChannel;

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

impl ColumnLayout {
    /// Finds the clock and the channels, or takes the columns that the user names: time (`-` for
    /// none), voltage, current.
    ///
    /// # Errors
    /// [`FormatError`] when a column that the user names is not there, or the heading does not fit the rows.
    pub fn from_prelude(
        prelude: &Prelude,
        named: Option<&[ChannelRef; 3]>,
    ) -> Result<Self, FormatError> {
        check_waveform_type(prelude)?;
        let headings = headings(prelude);
        let (time, columns) = match named {
            Some([time, v, i]) => {
                let index = |column| find(prelude, &headings, column);
                let time = match time {
                    ChannelRef::Name(name) if name == "-" => TimeColumn::Missing,
                    column => clock_at(&headings, index(column)?),
                };
                (time, vec![index(v)?, index(i)?])
            }
            None => {
                let (time, others) = clock(prelude, &headings);
                check_width(prelude)?;
                let all = 0..prelude.width;
                let channel = |k: &usize| !others.contains(k) && is_channel(prelude, &headings, *k);
                (time, all.filter(channel).collect())
            }
        };
        let channel = |k: &usize| FileChannel {
            name: headings[*k].name.clone(),
            unit: headings[*k].unit,
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

/// Index of a column specified by the user, with its unit or without: `coil_V` or `coil`.
fn find(
    prelude: &Prelude,
    headings: &[Heading],
    column: &ChannelRef,
) -> Result<usize, FormatError> {
    let texts = headings.iter().map(|h| h.text.trim());
    let names = headings.iter().map(|h| h.name.as_str());
    let index = column.find(texts).or_else(|| column.find(names));
    let index = index.filter(|k| *k < prelude.width);
    index.ok_or_else(|| {
        let names = headings.iter().take(12).map(|h| format!("`{}`", h.name));
        let names: Vec<_> = names.collect();
        let what = format!("no column {column}; there are {}", names.join(", "));
        FormatError::at_line(prelude.end.line(), what)
    })
}

fn clock_at(headings: &[Heading], index: usize) -> TimeColumn {
    let unit = headings.get(index).and_then(|h| h.unit);
    TimeColumn::Column {
        index,
        scale: unit.map_or(1.0, |u| u.scale),
    }
}

/// Returns the clock, and the columns that it occupies.
fn clock(prelude: &Prelude, headings: &[Heading]) -> (TimeColumn, Vec<usize>) {
    if let Some((t0_s, dt_s, columns)) = start_and_increment(prelude, headings) {
        return (TimeColumn::Even { t0_s, dt_s }, columns);
    }
    // Numbers without a heading: the first of several columns is the time.
    let nameless = headings.iter().all(|h| h.name.is_empty());
    let first = (prelude.width > 1 && nameless).then_some(0);
    let beside = prelude.beside.then_some(3);
    let by_heading = || headings.iter().position(Heading::is_time);
    if let Some(index) = beside.or_else(by_heading).or(first) {
        return (clock_at(headings, index), vec![index]);
    }
    if let (Some(t0_s), Some(dt_s)) = (prelude.number(&["xorg"]), prelude.number(&["xinc"])) {
        return (TimeColumn::Even { t0_s, dt_s }, Vec::new());
    }
    (TimeColumn::Missing, Vec::new())
}

/// Parses Rigol's heading with the time of the first sample and the interval, either `Start,Increment` with the numbers below, or
/// `t0 = -1e-3, tInc = 1e-6`. Returns them and the columns that are no channels.
fn start_and_increment(prelude: &Prelude, headings: &[Heading]) -> Option<(f64, f64, Vec<usize>)> {
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
        return Some((assigned(t0)?, dt_s, vec![t0, inc]));
    }
    let (Some(start), Some(increment)) = (at("start"), at("increment")) else {
        return None;
    };
    let values = prelude.rows.last()?;
    let dt_s = number(values.get(increment)?).filter(|dt| *dt > 0.0)?;
    let counter = headings.iter().position(|h| h.name == "X");
    let mut columns = vec![start, increment];
    columns.extend(counter);
    Some((number(values.get(start)?)?, dt_s, columns))
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
    let stated = [
        ("instrument", &["model", "model number"][..]),
        ("probe_attenuation", &["probe attenuation", "probe atten"]),
    ];
    for (key, keys) in stated {
        if let Some(value) = prelude.value(keys) {
            all.insert(key.to_owned(), value.to_owned());
        }
    }
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
