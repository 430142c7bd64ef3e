//! Names and units above the columns of a table.

use super::prelude::Prelude;
use crate::channels::{ChannelRef, quantity_of_name};
use crate::error::FormatError;
use crate::formats::stated_unit::StatedUnit;
use crate::formats::time::is_time_name;
use crate::formats::unit::{ColumnQuantity, Unit};

/// Heading of one column.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Heading {
    /// Name without its unit; may be empty.
    pub name: String,
    /// Text of the cell.
    pub text: String,
    /// Unit that the file states.
    pub unit: StatedUnit,
}

impl Heading {
    fn parse(text: &str) -> Self {
        let (name, unit) = StatedUnit::of_heading(text);
        // Rigol's `CH1V`: the unit follows the number without a gap.
        let digit = |c: char| c.is_ascii_digit();
        let end = name.rfind(digit).map_or(0, |k| k + 1);
        if unit == StatedUnit::Nothing && name.starts_with("CH") && end > 0 && end < name.len() {
            let (channel, tail) = name.split_at(end);
            if let Some(unit) = Unit::parse(tail) {
                return Self {
                    name: channel.to_owned(),
                    text: text.to_owned(),
                    unit: StatedUnit::Known(unit),
                };
            }
        }
        Self {
            name,
            text: text.to_owned(),
            unit,
        }
    }

    /// Returns `true` if the column is the time.
    pub fn is_time(&self) -> bool {
        let of_unit = (self.unit.known()).is_some_and(|u| u.quantity == ColumnQuantity::Time);
        of_unit || is_time_name(&self.name)
    }
}

/// Returns the heading of each column.
///
/// The last row of the prelude has the names, or the units with the names in the row before; makers
/// that state units under a key (`Vertical Units`) are asked after that.
pub fn headings(prelude: &Prelude) -> Vec<Heading> {
    let mut rows = prelude.rows.iter().rev();
    let last = rows.next().filter(|_| !prelude.beside);
    let mut all: Vec<Heading> = match last {
        Some(last) if is_units(last) => {
            let names = rows.next().map_or(&[][..], Vec::as_slice);
            let named = |(k, unit): (usize, &String)| {
                let name = names.get(k).cloned().unwrap_or_default();
                Heading {
                    text: name.clone(),
                    name,
                    unit: StatedUnit::parse(unit),
                }
            };
            last.iter().enumerate().map(named).collect()
        }
        Some(last) => last.iter().map(|text| Heading::parse(text)).collect(),
        None => Vec::new(),
    };
    all.resize(prelude.width.max(all.len()), Heading::default());
    from_keys(prelude, &mut all);
    all
}

/// Checks that the row above the numbers has a name or a unit for each of them; scopes state more there (Rigol's `Increment`).
///
/// # Errors
/// [`FormatError`] with both numbers: names would be those of other columns.
pub fn check_width(prelude: &Prelude) -> Result<(), FormatError> {
    let last = prelude.rows.last().filter(|_| !prelude.beside);
    match last.map(Vec::len) {
        Some(named) if named < prelude.filled => {
            let what = format!(
                "{} columns, {named} names or units above them: name the columns by their numbers, as in --input columns=1,2,3 (- for no time)",
                prelude.filled
            );
            Err(FormatError::at_line(prelude.end.line(), what))
        }
        _ => Ok(()),
    }
}

/// Index of a column specified by the user, with its unit or without: `coil_V` or `coil`. `width` is the number of columns.
///
/// # Errors
/// The columns that there are.
pub fn find(headings: &[Heading], column: &ChannelRef, width: usize) -> Result<usize, String> {
    let texts = headings.iter().map(|h| h.text.trim());
    let names = headings.iter().map(|h| h.name.as_str());
    let index = column.find(texts).or_else(|| column.find(names));
    index.filter(|k| *k < width).ok_or_else(|| {
        let names = headings.iter().take(12).map(|h| format!("`{}`", h.name));
        let names: Vec<_> = names.collect();
        format!("no column {column}; there are {}", names.join(", "))
    })
}

/// Returns `true` if a row names columns: two cells or more name a quantity or state a unit. Units under a key do not.
pub fn is_names(row: &[String]) -> bool {
    let says = |text: &&String| {
        let heading = Heading::parse(text);
        heading.is_time()
            || heading.unit != StatedUnit::Nothing
            || quantity_of_name(&heading.name).is_some()
    };
    let is_key = (row.first()).is_some_and(|key| key.trim_end_matches(':').ends_with("nits"));
    !is_key && row.iter().filter(says).count() > 1
}

/// Returns `true` if a row holds units: its first cell is one or counts samples, and another is one.
pub fn is_units(row: &[String]) -> bool {
    let unit = |text: &&String| Unit::parse(text).is_some() && text.len() > 1;
    let counts = |text: &&String| text.eq_ignore_ascii_case("sequence");
    let first = row.first().is_some_and(|f| unit(&f) || counts(&f));
    // `s,V,A` are units; `t,V,I` and `V,A` are names.
    let letters = row.len() > 2 && row.first().is_some_and(|f| f.eq_ignore_ascii_case("s"));
    let known = |text: &String| Unit::parse(text).is_some();
    (first || letters) && row.iter().skip(1).any(known)
}

/// Takes units from a key: `Vertical Units,V,A` in the order of the channels, or `Vertical Units,CH1:V,CH2:A` by name.
fn from_keys(prelude: &Prelude, all: &mut [Heading]) {
    let horizontal = prelude.value(&["horizontal units", "xunits"]);
    let vertical = prelude.values(&["vertical units", "yunits"]).unwrap_or(&[]);
    let (clock, first_channel) = if prelude.beside { (3, 4) } else { (0, 1) };
    if let Some(heading) = all.get_mut(clock)
        && (heading.is_time() || prelude.beside)
    {
        let stated = || StatedUnit::parse(horizontal.unwrap_or_default());
        heading.unit = std::mem::take(&mut heading.unit).or_else(stated);
    }
    for (k, text) in vertical.iter().enumerate() {
        let (name, unit) = match text.split_once(':') {
            Some((name, unit)) => (Some(name.trim()), unit),
            None => (None, text.as_str()),
        };
        let index = match name {
            Some(name) => all.iter().position(|h| h.name.eq_ignore_ascii_case(name)),
            None => Some(first_channel + k),
        };
        if let Some(heading) = index.and_then(|index| all.get_mut(index)) {
            let stated = || StatedUnit::parse(unit);
            heading.unit = std::mem::take(&mut heading.unit).or_else(stated);
        }
    }
    if prelude.beside
        && let (Some(heading), Some(source)) =
            (all.get_mut(first_channel), prelude.value(&["source"]))
    {
        heading.name = source.to_owned();
    }
}
