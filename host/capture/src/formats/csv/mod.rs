//! CSV as written by scopes, programs and people, including tab- and semicolon-separated text.
//!
//! Lines before the first row of numbers are the prelude ([`dialect`] understands it); after it only
//! the selected columns are read. The length of a line is limited, so that memory is bounded whatever the
//! file holds.

pub mod dialect;
pub mod first_row;
pub mod heading;
pub mod prelude;
pub mod rows;

use std::collections::BTreeMap;
use std::io::{BufReader, Read, SeekFrom};

use ihd_signal::TimeBase;

use self::dialect::{ColumnLayout, TimeColumn};
use self::rows::{MAX_LINE_BYTES, Rows, too_long};
use super::input::ReadSeek;
use super::time::{decimal_resolution, time_base, written_resolution};
use super::{CaptureFile, FileChannel, FileSamples, ReadProgress};
use crate::error::FormatError;
use crate::options::ReadOptions;

/// Rows after which the number of rows is estimated.
const ESTIMATE_AFTER: usize = 1000;

/// Rows between two reports of progress.
const REPORT_EVERY: usize = 4096;
/// Rows between two of which the digits of the time are counted: a prime, as every thousandth time has fewer.
const DIGITS_EVERY: usize = 997;

/// A CSV file whose prelude has been read.
pub struct CsvSource {
    rows: Rows,
    layout: ColumnLayout,
    length: u64,
}

impl CsvSource {
    /// Reads the prelude. Columns of the options override what is detected: the source then has these two channels.
    ///
    /// # Errors
    /// [`FormatError`] when no row of numbers is found or a column is not there.
    pub fn open(
        mut file: impl ReadSeek + 'static,
        options: ReadOptions<'_>,
    ) -> Result<Self, FormatError> {
        let failed = |e: std::io::Error| FormatError::io(0, &e);
        let length = file.seek(SeekFrom::End(0)).map_err(failed)?;
        file.seek(SeekFrom::Start(0)).map_err(failed)?;
        let mut head = Vec::new();
        let mut beginning = (&mut file).take(MAX_LINE_BYTES as u64);
        beginning.read_to_end(&mut head).map_err(failed)?;
        let has_lines = head.iter().any(|b| matches!(b, b'\n' | b'\r'));
        if head.len() == MAX_LINE_BYTES && !has_lines {
            return Err(FormatError::at_line(1, too_long()));
        }
        let prelude = first_row::prelude(&head, options)?;
        let layout = ColumnLayout::from_prelude(&prelude, options)?;
        file.seek(SeekFrom::Start(prelude.end.byte()))
            .map_err(failed)?;
        let source = BufReader::with_capacity(1 << 16, file);
        let rows = Rows::new(Box::new(source), prelude.syntax, prelude.end);
        Ok(Self {
            rows,
            layout,
            length,
        })
    }
}

/// Columns while they are being read.
struct Columns {
    /// Numbers of the clock's column, as written.
    stamps: Vec<f64>,
    values: Vec<Vec<f32>>,
    /// Most significant digits of a time. A program that leaves zeros at the end away writes most times with fewer.
    digits: usize,
    rows: usize,
}

impl Columns {
    /// Times of the rows from line `first` on, from stamps of a number and a unit, in seconds, each.
    fn clock(
        &mut self,
        first: u64,
        (t0_s, unit_s): (f64, f64),
        resolution: f64,
        interval_s: Option<f64>,
    ) -> Result<TimeBase, FormatError> {
        let mut stamps = std::mem::take(&mut self.stamps);
        stamps.iter_mut().for_each(|t| *t = t0_s + *t * unit_s);
        time_base(stamps, resolution * unit_s, interval_s).map_err(|e| {
            // Empty lines between samples are not counted.
            FormatError::at_line(first + e.sample() as u64, e.to_string())
        })
    }

    /// Makes room for `more` rows.
    fn reserve(&mut self, more: usize) {
        if !self.stamps.is_empty() {
            self.stamps.reserve_exact(more);
        }
        self.values.iter_mut().for_each(|v| v.reserve_exact(more));
    }
}

impl CaptureFile for CsvSource {
    fn channels(&self) -> &[FileChannel] {
        &self.layout.channels
    }

    fn metadata(&self) -> BTreeMap<String, String> {
        self.layout.metadata.clone()
    }

    fn read(
        &mut self,
        selected: &[usize],
        progress: ReadProgress<'_>,
    ) -> Result<FileSamples, FormatError> {
        let begin = self.rows.position();
        let mut columns = self.columns(selected, progress)?;
        self.layout.check_rows(columns.rows, self.rows.position())?;
        let time = match self.layout.time {
            TimeColumn::Even { t0_s, dt_s } => Some(TimeBase::Even { t0_s, dt_s }),
            TimeColumn::Missing => None,
            TimeColumn::Column { scale, .. } => {
                let resolution = written_resolution(&columns.stamps, columns.digits);
                let interval_s = self.layout.interval_s;
                Some(columns.clock(begin.line(), (0.0, scale), resolution, interval_s)?)
            }
            TimeColumn::Counter { t0_s, dt_s, .. } => {
                let decimal = decimal_resolution(&columns.stamps, columns.digits);
                // Whole numbers are rounded only where they are written with fewer digits than they have.
                let resolution = if decimal > 1.0 { decimal } else { 0.0 };
                Some(columns.clock(begin.line(), (t0_s, dt_s), resolution, Some(dt_s))?)
            }
        };
        Ok(FileSamples {
            time,
            columns: columns.values,
        })
    }
}

impl CsvSource {
    fn columns(
        &mut self,
        selected: &[usize],
        progress: ReadProgress<'_>,
    ) -> Result<Columns, FormatError> {
        let of_channel = |k: &usize| self.layout.columns.get(*k).copied();
        let picked: Vec<usize> = selected.iter().filter_map(of_channel).collect();
        let clock = match self.layout.time {
            TimeColumn::Column { index, .. } | TimeColumn::Counter { index, .. } => Some(index),
            TimeColumn::Even { .. } | TimeColumn::Missing => None,
        };
        let begin = self.rows.position().byte();
        let mut columns = Columns {
            stamps: Vec::new(),
            values: vec![Vec::new(); picked.len()],
            digits: 0,
            rows: 0,
        };
        while let Some(row) = self.rows.next_row()? {
            row.check_width(self.layout.width)?;
            if let Some(index) = clock {
                let field = row.field(index)?;
                columns.stamps.push(row.time(field)?);
                if columns.rows < ESTIMATE_AFTER || columns.rows.is_multiple_of(DIGITS_EVERY) {
                    columns.digits = columns.digits.max(rows::significant_digits(field));
                }
            }
            for (values, index) in columns.values.iter_mut().zip(&picked) {
                values.push(row.sample(row.field(*index)?)?);
            }
            columns.rows += 1;
            if columns.rows == ESTIMATE_AFTER {
                let byte = self.rows.position().byte();
                let per_row = (byte - begin) as f64 / ESTIMATE_AFTER as f64;
                let left = self.length.saturating_sub(byte) as f64;
                columns.reserve((1.02 * left / per_row) as usize);
            }
            if columns.rows.is_multiple_of(REPORT_EVERY) {
                let byte = self.rows.position().byte();
                progress(byte as f64 / self.length.max(1) as f64);
            }
        }
        Ok(columns)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;
    use crate::channels::ChannelRef;

    fn read(text: impl Into<Vec<u8>>) -> Result<FileSamples, FormatError> {
        let mut source = CsvSource::open(Cursor::new(text.into()), ReadOptions::default())?;
        source.read(&[0, 1], &mut |_| ())
    }

    /// Spreadsheets of old Macs and of Western Windows: lines end with CR, µ is one byte.
    #[test]
    fn old_line_ends_and_a_latin_micro_sign_are_understood() {
        let lines = "t (µs),v (V),i (A)\n0,1,2\n1,3,4\n2,5,6\n";
        let expected = read(lines).unwrap();
        assert!(
            matches!(expected.time, Some(TimeBase::Even { dt_s, .. }) if (dt_s / 1e-6 - 1.0).abs() < 1e-9)
        );
        let latin: Vec<u8> = lines.chars().map(|c| c as u8).collect();
        let old_mac = lines.replace('\n', "\r");
        // Long enough that no line end lies in the beginning but CR.
        let long = format!("{}{}", old_mac, "3,7,8\r".repeat(MAX_LINE_BYTES / 6));
        for text in [latin, old_mac.into_bytes()] {
            assert_eq!(read(text), Ok(expected.clone()));
        }
        let why = read(long).unwrap_err().to_string();
        assert!(why.contains("ascend"), "read as far as its times: {why}");
    }

    /// Spreadsheets, and PowerShell where decimals have a comma.
    #[test]
    fn commas_between_quotes_part_no_columns() {
        let expected = read("t (s),v (V),i (A)\n0,0.25,1.5\n0.5,-0.25,2\n").unwrap();
        for text in [
            "\u{feff}\"t, all (s)\",\"v, coil (V)\",\"i \"\"x\"\", (A)\"\n0,0.25,1.5\n0.5,-0.25,2\n",
            "\"t (s)\",\"v (V)\",\"i (A)\"\r\n\"0\",\"0,25\",\"1,5\"\r\n\"0,5\",\"-0,25\",\"2\"\r\n",
            "\"0\",\"0,25\",\"1,5\"\n\"0,5\",\"-0,25\",\"2\"\n",
        ] {
            assert_eq!(read(text), Ok(expected.clone()), "{text}");
        }
        let cut =
            read("\"t\",\"v\",\"i\"\n\"0\",\"0,25\",\"1,5\"\n\"0,5\",\"0,25\",\"1,").unwrap_err();
        assert!(cut.what.contains("fields"), "{cut}");
    }

    #[test]
    fn a_heading_with_fewer_names_than_columns_is_refused_unless_they_are_named() {
        for text in [
            // Names of rows without a heading, as R writes them; a text.
            "v,i\n0,1,2\n1,3,4\n",
            "of the coil\n0,1,2\n1,3,4\n",
        ] {
            let why = read(text).unwrap_err();
            assert!(why.what.contains("--input columns=1,2,3"), "{why}");
            let columns = [1, 2, 3].map(ChannelRef::Number);
            let options = ReadOptions {
                columns: Some(&columns),
                ..ReadOptions::default()
            };
            let source = CsvSource::open(Cursor::new(text), options);
            assert!(source.is_ok(), "{text}");
        }
        // An index without a name, as pandas writes it; empty columns; more names.
        for text in [
            ",t,v,i\n0,0,1,2\n1,1,3,4\n",
            "t,v,i\n0,1,2,,\n1,3,4,,\n",
            "t,v,i,notes\n0,1,2\n1,3,4\n",
        ] {
            assert!(read(text).is_ok(), "{text}");
        }
    }

    /// Times of a table.
    fn times(text: &str) -> Result<TimeBase, FormatError> {
        Ok(read(text)?.time.unwrap())
    }

    #[test]
    fn a_row_missing_under_rigols_counter_is_a_gap() {
        let head = "X,CH1,CH2,Start,Increment,\nSequence,Volt,Ampere,-1.0e-3,1.0e-6,\n";
        let rows = |numbers: &[u32]| -> String {
            numbers.iter().map(|x| format!("{x},1,2,,,\n")).collect()
        };
        let whole = times(&format!("{head}{}", rows(&[0, 1, 2, 3]))).unwrap();
        assert_eq!(
            whole,
            TimeBase::Even {
                t0_s: -1e-3,
                dt_s: 1e-6
            }
        );
        let TimeBase::Stamps(t_s) = times(&format!("{head}{}", rows(&[0, 1, 2, 5, 6]))).unwrap()
        else {
            panic!("a gap");
        };
        assert!((t_s[3] - t_s[2] - 3e-6).abs() < 1e-15, "{t_s:?}");
        let why = times(&format!("{head}{}", rows(&[0, 1, 0, 1]))).unwrap_err();
        assert!(why.to_string().starts_with("line 5"), "{why}");
    }

    /// numpy.savetxt and pandas of a float32.
    #[test]
    fn times_of_single_precision_are_even() {
        for decimals in [true, false] {
            let row = |k: i32| {
                let t = (-2e-3 + f64::from(k) * 1.2345678e-7) as f32;
                let t = match decimals {
                    true => format!("{t:.18e}"),
                    false => t.to_string(),
                };
                format!("{t},1,2\n")
            };
            let text: String = (0..20_000).map(row).collect();
            let time = times(&format!("time_s,v_V,i_A\n{text}")).unwrap();
            let TimeBase::Even { dt_s, .. } = time else {
                panic!("{decimals}");
            };
            assert!((dt_s / 1.2345678e-7 - 1.0).abs() < 1e-6, "{dt_s}");
        }
    }

    #[test]
    fn blanks_between_columns_are_named() {
        for rows in [3, 2000] {
            let why = read(format!("t v i\n{}", "0.1  1.0 2.0\n".repeat(rows))).unwrap_err();
            assert!(why.what.contains("separated by blanks"), "{why}");
        }
    }
}
