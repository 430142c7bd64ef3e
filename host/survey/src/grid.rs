//! Mains of grids: the frequencies that occur, and the origin of a number.

use serde::Serialize;

/// Range of a mains frequency, in hertz: grids', and what a generator may have.
pub const RANGE_HZ: (f64, f64) = (45.0, 65.0);

/// Depth of modulation below which the bus counts as constant.
pub(super) const MIN_MODULATION: f64 = 0.3;

/// Origin of a number of the mains.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum MainsSource {
    /// Given by the user or stated by the capture.
    #[serde(rename = "told")]
    Specified,
    /// Measured from the envelope.
    Measured,
    /// Assumed, because it is neither specified nor measurable.
    Assumed,
}

impl std::fmt::Display for MainsSource {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Specified => "given",
            Self::Measured => "measured",
            Self::Assumed => "assumed",
        })
    }
}

/// Returns `true` for a frequency in hertz that the mains of a generator may have.
pub(super) fn is_possible(hz: f64) -> bool {
    (RANGE_HZ.0..=RANGE_HZ.1).contains(&hz)
}
