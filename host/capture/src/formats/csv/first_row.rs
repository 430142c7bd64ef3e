//! Search for the first row of samples. A damaged row above the first row of numbers is one of samples, not a heading.

use super::heading::{find, headings, is_names, is_units};
use super::prelude::Prelude;
use super::rows::{Syntax, is_overflow};
use crate::error::FormatError;
use crate::options::ReadOptions;

/// Texts for "no value" of meters and spreadsheets, in lower case.
const NO_VALUE: [&str; 12] = [
    "ol", "o.l", "over", "ovld", "n/a", "na", "#n/a", "null", "none", "err", "error", "---",
];

/// Reads the lines before the samples. Only the columns that are read must be numbers.
///
/// # Errors
/// [`FormatError`] when no row of samples follows, or at the first one that holds anything but numbers.
pub fn prelude(head: &[u8], options: ReadOptions<'_>) -> Result<Prelude, FormatError> {
    let (mut prelude, error) = match Prelude::read(head) {
        Ok(prelude) => (prelude, None),
        Err(none) => (none.prelude, Some(none.error)),
    };
    let Some(first) = damaged(&prelude) else {
        return error.map_or(Ok(prelude), Err);
    };
    let row = prelude.rows[first].clone();
    prelude.end_at(first);
    let line = prelude.end.line();
    let read = columns(&prelude, options).map_err(|what| FormatError::at_line(line, what))?;
    let cell = |k: &usize| row.get(*k).map_or("", String::as_str);
    let is_wrong = |k: &&usize| !cell(k).is_empty() && !is_number(prelude.syntax, cell(k));
    match read.iter().find(is_wrong) {
        None => Ok(prelude),
        Some(k) => {
            let shown: String = cell(k).chars().take(40).collect();
            let what = format!(
                "`{shown}` in column {} is no number: correct or remove the row, or read other columns, as in --input columns=1,2,3 (- for no time)",
                k + 1
            );
            Err(FormatError::at_line(line, what))
        }
    }
}

/// Index of the first row of samples that the prelude holds: without a break up to its end rows hold numbers, and this one begins with one or
/// stands below names. Keys with a number and rows of units are none.
fn damaged(prelude: &Prelude) -> Option<usize> {
    if prelude.beside {
        return None;
    }
    let of_samples = |row: &&Vec<String>| {
        let has = row.iter().any(|cell| is_number(prelude.syntax, cell));
        (has || is_without_value(row)) && !is_units(row)
    };
    let count = prelude.rows.iter().rev().take_while(of_samples).count();
    let begins = |k: &usize| {
        let first = prelude.rows[*k].iter().find(|cell| !cell.is_empty());
        let above = k.checked_sub(1).map(|k| &prelude.rows[k]);
        first.is_some_and(|cell| is_number(prelude.syntax, cell))
            || above.is_some_and(|row| is_names(row) || is_units(row))
    };
    (prelude.rows.len() - count..prelude.rows.len()).find(begins)
}

fn is_number(syntax: Syntax, cell: &str) -> bool {
    syntax.number(cell.as_bytes()).is_some() || is_overflow(cell.as_bytes())
}

/// Returns `true` if every cell says that there is no value.
fn is_without_value(row: &[String]) -> bool {
    let filled = || row.iter().filter(|cell| !cell.is_empty());
    let none = |cell: &String| NO_VALUE.contains(&cell.to_lowercase().as_str());
    filled().count() > 0 && filled().all(none)
}

/// Indices of the columns that are read.
///
/// # Errors
/// The column that is not there.
fn columns(prelude: &Prelude, options: ReadOptions<'_>) -> Result<Vec<usize>, String> {
    let headings = headings(prelude);
    let Some([time, v, i]) = options.columns else {
        let is_read = |k: &usize| !(options.without_times && headings[*k].is_time());
        return Ok((0..prelude.width).filter(is_read).collect());
    };
    let unread = options.without_times || time.is_none_column();
    let named = [Some(time).filter(|_| !unread), Some(v), Some(i)];
    let index = |column| find(&headings, column, prelude.width);
    named.into_iter().flatten().map(index).collect()
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;
    use crate::channels::ChannelRef;
    use crate::formats::CaptureFile;
    use crate::formats::csv::CsvSource;

    /// Times or `None`, and the two columns; else the error.
    fn read(
        text: &str,
        columns: Option<[&str; 3]>,
        without_times: bool,
    ) -> Result<Vec<f32>, String> {
        let columns = columns.map(|c| c.map(ChannelRef::parse));
        let options = ReadOptions {
            columns: columns.as_ref(),
            without_times,
        };
        let source = CsvSource::open(Cursor::new(text.to_owned()), options);
        let samples = source.and_then(|mut source| source.read(&[0, 1], &mut |_| ()));
        let samples = samples.map_err(|e| e.to_string())?;
        assert!(samples.time.is_none() || !without_times);
        Ok(samples.columns.concat())
    }

    /// Current in milliampere was read as ampere, as the heading with its unit was lost.
    #[test]
    fn a_damaged_first_row_is_no_heading() {
        let rows = "1,5,6\n2,7,8\n";
        for (row, cell) in [
            ("0,OL,-0.1", "`OL` in column 2"),
            ("0,,#N/A", "`#N/A` in column 3"),
            ("OL,0.1,0.2", "`OL` in column 1"),
            ("#N/A,#N/A,#N/A", "`#N/A` in column 1"),
            ("0,0.1,1 A", "`1 A` in column 3"),
        ] {
            let why = read(&format!("time_s,v_V,i_mA\n{row}\n{rows}"), None, false).unwrap_err();
            assert!(why.contains("line 2") && why.contains(cell), "{row}: {why}");
        }
        let why = read(&format!("time,v,i\ns,V,mA\n0,OL,1\n{rows}"), None, false).unwrap_err();
        assert!(why.contains("line 3: `OL`"), "{why}");
        // Keys of scopes, numbers of channels.
        for text in [
            "Vertical Units,V,A\nProbe Atten,1,10\n",
            "x-axis,1,2\nsecond,Volt,Ampere\n",
            "Time,1,2\n",
        ] {
            let samples = read(&format!("{text}{rows}"), None, false);
            assert!(samples.is_ok(), "{text}: {samples:?}");
        }
    }

    #[test]
    fn only_the_columns_that_are_read_must_be_numbers() {
        let text = "note,clock,time_s,v_V,i_A\nbegin,12:00:00.1,0,1,2\n,12:00:00.2,1,3,4\nend,12:00:00.3,2,5,6\n";
        let expected = Ok(vec![1.0, 3.0, 5.0, 2.0, 4.0, 6.0]);
        for columns in [["3", "4", "5"], ["time_s", "v", "i"], ["-", "v_V", "i_A"]] {
            assert_eq!(read(text, Some(columns), false), expected, "{columns:?}");
        }
        let why = read(text, Some(["1", "4", "5"]), false).unwrap_err();
        assert!(why.contains("line 2: `begin` in column 1"), "{why}");
        let why = read(text, Some(["3", "u", "i"]), false).unwrap_err();
        assert!(why.contains("no column `u`"), "{why}");
        // Text in every row.
        let clocks = "time,v,i\n12:00:00.1,1,2\n12:00:00.2,3,4\n";
        let why = read(clocks, None, false).unwrap_err();
        assert!(why.contains("line 2: `12:00:00.1` in column 1"), "{why}");
        assert_eq!(read(clocks, None, true), Ok(vec![1.0, 3.0, 2.0, 4.0]));
        assert_eq!(
            read(clocks, Some(["time", "v", "i"]), true),
            Ok(vec![1.0, 3.0, 2.0, 4.0])
        );
    }

    #[test]
    fn a_column_has_one_meaning() {
        let text = "time_s,v_V,i_A\n0,1,2\n1,3,4\n";
        for columns in [
            ["1", "2", "2"],
            ["1", "1", "3"],
            ["time_s", "v", "time"],
            ["-", "3", "i"],
        ] {
            let why = read(text, Some(columns), false).unwrap_err();
            assert!(why.contains("twice"), "{columns:?}: {why}");
        }
    }

    #[test]
    fn a_stated_rate_leaves_the_times_unread() {
        // Times that descend, and in a unit that is no time.
        for text in [
            "time_s,v_V,i_A\n1,1,2\n0,3,4\n",
            "time (min),v_V,i_A\n0,1,2\n1,3,4\n",
        ] {
            assert!(read(text, None, false).is_err(), "{text}");
            assert_eq!(read(text, None, true), Ok(vec![1.0, 3.0, 2.0, 4.0]));
        }
    }
}
