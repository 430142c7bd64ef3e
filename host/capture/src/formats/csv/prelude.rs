//! Lines of a table before its numbers.

use csv::{ByteRecord, Position};

use super::rows::{CsvRow, Rows, Syntax, text};
use crate::error::FormatError;

/// Limit of lines in a prelude.
const LINES: usize = 1000;

/// Rows with samples that are searched for keys, in the layout that has both in a row.
const BESIDE_ROWS: usize = 20;

/// The prelude, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Prelude {
    /// Delimiter and decimal sign.
    pub syntax: Syntax,
    /// Fields of each non-empty line, without quotes.
    pub rows: Vec<Vec<String>>,
    /// Place of each of them.
    pub places: Vec<Position>,
    /// For each row, set if it also has a sample, in columns four and five (Tektronix TDS, TPS).
    pub beside: bool,
    /// Fields of the first row of numbers.
    pub width: usize,
    /// The same without empty ones at its end.
    pub filled: usize,
    /// Place of the first row of numbers.
    pub end: Position,
}

/// Lines after which no row of numbers follows.
pub struct NoNumbers {
    /// The lines.
    pub prelude: Prelude,
    /// Reason why they are no table.
    pub error: FormatError,
}

impl Prelude {
    /// Reads the prelude from the beginning of a file.
    ///
    /// # Errors
    /// The lines, when no row of numbers follows.
    pub fn read(head: &[u8]) -> Result<Self, Box<NoNumbers>> {
        let syntax = Syntax::detect(head);
        let mut rows = Rows::new(
            Box::new(std::io::Cursor::new(head.to_vec())),
            syntax,
            Position::new(),
        );
        let mut prelude = Self {
            syntax,
            rows: Vec::new(),
            places: Vec::new(),
            beside: false,
            width: 0,
            filled: 0,
            end: Position::new(),
        };
        loop {
            let read = rows.next_row();
            let Ok(Some(row)) = read else {
                let why = || prelude.why("no row of numbers: this is no table of samples");
                let error = read
                    .err()
                    .unwrap_or_else(|| FormatError::at_line(rows.position().line(), why()));
                return Err(Box::new(NoNumbers { prelude, error }));
            };
            let record = row.record();
            prelude.beside |= prelude.rows.is_empty() && is_beside(record, syntax);
            if prelude.width == 0 && (prelude.beside || syntax.is_numbers(record)) {
                prelude.width = record.len();
                prelude.filled = filled(record.iter().map(|field| !field.trim_ascii().is_empty()));
                prelude.end = place(row);
            }
            let enough = !prelude.beside || prelude.rows.len() == BESIDE_ROWS;
            if prelude.width > 0 && enough {
                return Ok(prelude);
            }
            if prelude.rows.len() == LINES {
                let what = prelude.why(&format!("no row of numbers in the first {LINES} lines"));
                let error = FormatError::at_line(rows.position().line(), what);
                return Err(Box::new(NoNumbers { prelude, error }));
            }
            prelude.rows.push(record.iter().map(text).collect());
            prelude.places.push(place(row));
        }
    }

    /// Lets the samples begin at row `first` of the prelude already.
    pub fn end_at(&mut self, first: usize) {
        let Some(end) = self.places.get(first).cloned() else {
            return;
        };
        self.width = self.rows[first].len();
        self.filled = filled(self.rows[first].iter().map(|field| !field.is_empty()));
        self.end = end;
        self.rows.truncate(first);
        self.places.truncate(first);
    }

    /// Reason why a file without a row of numbers is no table: `otherwise`, unless its last line is a row with blanks.
    fn why(&self, otherwise: &str) -> String {
        let mut words = match self.rows.last().map(Vec::as_slice) {
            Some([only]) => only.split_whitespace(),
            _ => "".split_whitespace(),
        };
        let number = |word: &str| self.syntax.number(word.as_bytes()).is_some();
        if words.clone().count() > 1 && words.all(number) {
            return "its columns are separated by blanks: separate them by commas, semicolons or tabs".to_owned();
        }
        otherwise.to_owned()
    }

    /// Values after a key; the key is compared in lower case without a closing colon.
    pub fn values(&self, keys: &[&str]) -> Option<&[String]> {
        let of_row = |row: &'_ &Vec<String>| {
            let key = row.first().map(|k| k.trim_end_matches(':').to_lowercase());
            key.is_some_and(|key| keys.contains(&key.as_str()))
        };
        self.rows.iter().find(of_row).and_then(|row| row.get(1..))
    }

    /// First value after a key; text before a colon (Siglent's `Analog:`) is dropped.
    pub fn value(&self, keys: &[&str]) -> Option<&str> {
        let first = self.values(keys)?.first()?;
        let bare = first.rsplit_once(':').map_or(first.as_str(), |(_, v)| v);
        Some(bare.trim()).filter(|v| !v.is_empty())
    }

    /// First value after a key, as a number.
    pub fn number(&self, keys: &[&str]) -> Option<f64> {
        let number = self.syntax.number(self.value(keys)?.as_bytes())?;
        number.is_finite().then_some(number)
    }
}

/// Number of fields without empty ones at the end, from which of them are filled.
fn filled(mut are_filled: impl DoubleEndedIterator<Item = bool> + ExactSizeIterator) -> usize {
    are_filled.rposition(|is| is).map_or(0, |k| k + 1)
}

/// Place of a row in the file.
fn place(row: CsvRow<'_>) -> Position {
    let mut place = row
        .record()
        .position()
        .cloned()
        .unwrap_or_else(Position::new);
    // Behind a CR the reader stands before its LF.
    let after_cr = u64::from(row.line() > place.line());
    place.set_byte(place.byte() + after_cr).set_line(row.line());
    place
}

/// Returns `true` if a row has a key in its first column and a sample in the fourth and fifth.
fn is_beside(row: &ByteRecord, syntax: Syntax) -> bool {
    let number = |k: usize| row.get(k).is_some_and(|f| syntax.number(f).is_some());
    let key = row.get(0).map(text).unwrap_or_default();
    key.eq_ignore_ascii_case("record length") && number(3) && number(4)
}
