//! Rows of a delimited text, with their line numbers for messages.

use std::io::{self, BufRead, Read};

use csv::{ByteRecord, Position};

use crate::error::FormatError;

/// Limit of a line's length in bytes: 10 000 columns of 100 characters.
pub const MAX_LINE_BYTES: usize = 1 << 20;

/// Error text for a longer line.
pub fn too_long() -> String {
    format!("a line of more than {MAX_LINE_BYTES} bytes: this is no table")
}

/// Delimiter and decimal sign.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Syntax {
    /// Delimiter between fields.
    pub delimiter: u8,
    /// Set if decimals are written with a comma.
    pub decimal_comma: bool,
    /// Set if lines end with CR and LF.
    pub crlf: bool,
}

impl Syntax {
    /// Detects both from the last complete line of the file's beginning; tab before semicolon before comma.
    pub fn detect(head: &[u8]) -> Self {
        // Old Macs end lines with CR alone.
        let end = if head.contains(&b'\n') { b'\n' } else { b'\r' };
        let complete = head.strip_suffix(&[end]).unwrap_or(head);
        let mut lines = complete
            .rsplit(|b| *b == end)
            .filter(|l| !l.trim_ascii().is_empty());
        let last = lines.next().unwrap_or(&[]);
        // A file larger than the head is cut within its last line.
        let line = lines
            .next()
            .filter(|_| head.last() != Some(&end))
            .unwrap_or(last);
        let delimiter = [b'\t', b';'].into_iter().find(|d| line.contains(d));
        // Between commas, the second part of each pair of quotes: `"0,5","1,25"`.
        let mut quoted = line.split(|b| *b == b'"').skip(1).step_by(2);
        Self {
            delimiter: delimiter.unwrap_or(b','),
            decimal_comma: match delimiter {
                Some(_) => line.contains(&b','),
                None => quoted.any(|text| text.contains(&b',')),
            },
            crlf: line.ends_with(b"\r"),
        }
    }

    /// Number in a field, finite or not; `None` if it is no number.
    pub fn number(self, field: &[u8]) -> Option<f64> {
        let text = std::str::from_utf8(field).ok()?;
        // Most fields are a bare number.
        if let Ok(value) = text.parse() {
            return Some(value);
        }
        let mut text = text.trim();
        if let Some(quoted) = text.strip_prefix('"') {
            // A quote that is not closed: the row was cut.
            text = quoted.strip_suffix('"')?.trim();
        }
        if self.decimal_comma && text.contains(',') {
            return text.replace(',', ".").parse().ok();
        }
        text.parse().ok()
    }

    /// Returns `true` if all fields of a row are numbers or empty, and at least one is a number. An overflow mark of a scope (`∞`)
    /// counts as a number: it is no heading.
    pub fn is_numbers(self, row: &ByteRecord) -> bool {
        let mut any = false;
        row.iter().all(|field| {
            let blank = field.trim_ascii().is_empty();
            let number = self.number(field).is_some() || is_overflow(field);
            any |= number;
            blank || number
        }) && any
    }
}

/// Returns `true` if a field is the overflow mark of a scope, `∞`.
pub fn is_overflow(field: &[u8]) -> bool {
    let sign = |c| matches!(c, '-' | '+' | '"');
    std::str::from_utf8(field).is_ok_and(|t| t.trim().trim_matches(sign) == "∞")
}

/// Field as text, without quotes and byte-order mark; what is not UTF-8 is taken for Latin-1, in which many programs write µ.
pub fn text(field: &[u8]) -> String {
    let latin = || field.iter().map(|b| char::from(*b)).collect();
    let text = std::str::from_utf8(field).map_or_else(|_| latin(), str::to_owned);
    let text = text.trim_start_matches('\u{feff}').trim();
    text.trim_matches('"').trim().to_owned()
}

/// Number of significant digits that a number is written with: 9 for `-9.99966406e-07`, 3 for `0.0120`.
pub fn significant_digits(field: &[u8]) -> usize {
    let mantissa = field.split(|c| matches!(c, b'e' | b'E')).next();
    let digits = mantissa
        .unwrap_or(field)
        .iter()
        .filter(|c| c.is_ascii_digit());
    digits.skip_while(|c| **c == b'0').count()
}

/// Joins the fields that a delimiter between quotes has parted. A quote that the line does not close stays one: it would swallow all
/// that follows.
fn joined(record: &ByteRecord, delimiter: u8) -> ByteRecord {
    let is_odd = |k: &usize| {
        let quotes = record.get(*k).unwrap_or(&[]).iter();
        quotes.filter(|b| **b == b'"').count() % 2 == 1
    };
    let mut whole = ByteRecord::with_capacity(record.as_slice().len(), record.len());
    whole.set_position(record.position().cloned());
    let mut next = 0;
    while let Some(field) = record.get(next) {
        let opens = field.trim_ascii_start().starts_with(b"\"") && is_odd(&next);
        let closed =
            (opens.then_some(next + 1..record.len())).and_then(|mut rest| rest.find(is_odd));
        let end = closed.unwrap_or(next);
        let parts: Vec<&[u8]> = record.iter().take(end + 1).skip(next).collect();
        whole.push_field(&parts.join(&delimiter));
        next = end + 1;
    }
    whole
}

/// One row.
#[derive(Clone, Copy)]
pub struct CsvRow<'a> {
    record: &'a ByteRecord,
    syntax: Syntax,
    line: u64,
}

impl<'a> CsvRow<'a> {
    /// Returns its line number in the file, from 1.
    pub fn line(&self) -> u64 {
        self.line
    }

    /// Returns all its fields.
    pub fn record(&self) -> &'a ByteRecord {
        self.record
    }

    /// Checks that the row has at most `width` fields.
    ///
    /// # Errors
    /// [`FormatError`] with both numbers.
    pub fn check_width(&self, width: usize) -> Result<(), FormatError> {
        if self.record.len() > width {
            let what = format!("{} fields, the first row has {width}", self.record.len());
            return Err(FormatError::at_line(self.line, what));
        }
        Ok(())
    }

    /// Returns the field in column `index`.
    ///
    /// # Errors
    /// [`FormatError`] when the row is shorter.
    pub fn field(&self, index: usize) -> Result<&'a [u8], FormatError> {
        self.record.get(index).ok_or_else(|| {
            let what = format!(
                "{} fields, column {} is missing: a row cut short",
                self.record.len(),
                index + 1
            );
            FormatError::at_line(self.line, what)
        })
    }

    /// Returns the finite number in a field of the time column.
    ///
    /// # Errors
    /// [`FormatError`] for anything else, overflow included.
    pub fn time(&self, field: &[u8]) -> Result<f64, FormatError> {
        match self.syntax.number(field) {
            Some(value) if (value as f32).is_finite() => Ok(value),
            Some(_) => Err(self.wrong(field, "not finite, or beyond f32")),
            None => Err(self.wrong(field, "no number")),
        }
    }

    /// Returns the sample in a field. A value that is not finite (NaN, the scope's overflow mark, beyond f32) stays one: the
    /// survey cuts the capture there.
    ///
    /// # Errors
    /// [`FormatError`] for anything else.
    pub fn sample(&self, field: &[u8]) -> Result<f32, FormatError> {
        match self.syntax.number(field) {
            Some(value) => Ok(value as f32),
            None if is_overflow(field) => Ok(f32::INFINITY),
            None => Err(self.wrong(field, "no number")),
        }
    }

    fn wrong(&self, field: &[u8], what: &str) -> FormatError {
        let shown: String = text(field).chars().take(40).collect();
        FormatError::at_line(self.line, format!("`{shown}` is {what}"))
    }
}

/// The rows of a text, front to back; empty lines are skipped.
pub struct Rows {
    reader: csv::Reader<LineLimited>,
    record: ByteRecord,
    syntax: Syntax,
    begin: Position,
}

impl Rows {
    /// Creates a reader; `source` is positioned at `begin` of its file.
    pub fn new(source: Box<dyn BufRead>, syntax: Syntax, begin: Position) -> Self {
        let bounded = LineLimited { source, in_line: 0 };
        // An unclosed quote would swallow the rest of the file: `joined` looks at one line at a time.
        let reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .quoting(false)
            .delimiter(syntax.delimiter)
            .buffer_capacity(1 << 16)
            .from_reader(bounded);
        Self {
            reader,
            record: ByteRecord::new(),
            syntax,
            begin,
        }
    }

    /// Position in the file after the row read last.
    pub fn position(&self) -> Position {
        let here = self.reader.position();
        let mut position = Position::new();
        position
            .set_byte(self.begin.byte() + here.byte())
            .set_line(self.begin.line() + here.line() - 1);
        position
    }

    /// Returns the next row; `None` at the end.
    ///
    /// # Errors
    /// [`FormatError`] when reading fails or a line is too long.
    pub fn next_row(&mut self) -> Result<Option<CsvRow<'_>>, FormatError> {
        let read = self.reader.read_byte_record(&mut self.record);
        let more = read.map_err(|e| {
            let line = self.begin.line() + self.reader.position().line() - 1;
            FormatError::at_line(line, e.to_string())
        })?;
        let (at_byte, line) = self
            .record
            .position()
            .map_or((0, 1), |at| (at.byte(), at.line()));
        if self.record.as_slice().contains(&b'"') {
            self.record = joined(&self.record, self.syntax.delimiter);
        }
        // The reader ends a row at CR and counts the line at LF, which it reads with the next row.
        let uncounted = u64::from(self.syntax.crlf && at_byte > 0);
        Ok(more.then_some(CsvRow {
            record: &self.record,
            syntax: self.syntax,
            line: self.begin.line() + line - 1 + uncounted,
        }))
    }
}

/// Reader that fails on lines longer than [`MAX_LINE_BYTES`].
struct LineLimited {
    source: Box<dyn BufRead>,
    in_line: usize,
}

impl Read for LineLimited {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.source.read(buffer)?;
        let bytes = buffer.get(..read).unwrap_or(&[]);
        let begun = bytes.iter().rposition(|b| matches!(b, b'\n' | b'\r'));
        match begun {
            Some(k) => self.in_line = read - k,
            None => self.in_line += read,
        }
        if self.in_line > MAX_LINE_BYTES {
            return Err(io::Error::new(io::ErrorKind::InvalidData, too_long()));
        }
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delimiter_and_decimal_sign() {
        let of = |head: &str| Syntax::detect(head.as_bytes());
        assert_eq!(of("a,b\n1.0,2.0\n").delimiter, b',');
        let german = of("t;v\n1,0;2,5\n");
        assert_eq!((german.delimiter, german.decimal_comma), (b';', true));
        assert_eq!(german.number(b" -2,5e-3"), Some(-2.5e-3));
        assert_eq!(of("Time\tA\n1.0\t2.0").delimiter, b'\t');
        assert_eq!(of("a;b\r1;2\r3").delimiter, b';', "CR alone");
        let quoted = of("\"t\",\"v, coil\"\n\"0,5\",\"-2,5e-3\"\n");
        assert_eq!((quoted.delimiter, quoted.decimal_comma), (b',', true));
        assert_eq!(quoted.number(b"\"-2,5e-3\""), Some(-2.5e-3));
        assert_eq!(quoted.number(b"\"-2"), None, "cut");
        assert!(!of("\"t\",\"v, coil\"\n\"0.5\",\"2.5\"\n").decimal_comma);
        // The head ends within a line that has no delimiter yet.
        assert_eq!(of("a;b\n1;2\n3").delimiter, b';');
    }

    #[test]
    fn zeros_before_the_first_digit_are_not_significant() {
        for (text, digits) in [
            ("-9.99966406e-07", 9),
            ("0.0120", 3),
            ("5", 1),
            ("1e-6", 1),
            ("1,25", 3),
            ("0", 0),
        ] {
            assert_eq!(significant_digits(text.as_bytes()), digits, "{text}");
        }
    }

    #[test]
    fn a_line_without_end_is_refused_in_bounded_memory() {
        let endless = io::BufReader::new(io::repeat(b'1'));
        let syntax = Syntax::detect(b"1");
        let mut rows = Rows::new(Box::new(endless), syntax, Position::new());
        let refused = rows.next_row().err().expect("refused");
        assert!(refused.what.contains("1048576"), "{refused}");
    }
}
