//! Plausibility of a lookup, which firmware checks before use: physics' signs and bounded slopes.
//!
//! With frequency the skin depth falls, so R rises and L falls. With current a ferromagnetic load
//! saturates, so both fall. Measured tables are noisy, so a little of the wrong way is allowed;
//! slopes are bounded so that one bad cell cannot make the power control jump. Where an observed
//! cell meets one that keeps the prior, the two may disagree about the pot: only the slope counts.

use core::fmt;

use super::RlLookup;
use super::grid::{CURRENTS, FREQUENCIES};

/// Smallest and largest plausible resistance code: 0.02 and 15.9 ohm.
pub const R_CODES: core::ops::RangeInclusive<u16> = 82..=65_126;

/// Smallest and largest plausible inductance code: 2 and 63.9 µH.
pub const L_CODES: core::ops::RangeInclusive<u16> = 2_048..=65_433;

/// Largest ratio of neighbouring cells, in 1/1024: 1.6.
pub const MAX_RATIO_Q10: u32 = 1_638;

/// Largest ratio where an observed cell meets one that is not, in 1/1024: 2.5. That one may keep the prior; a field model
/// of a full-size pot differs from the prior by 1.7 at small currents, a small pot by 4.
pub const MAX_SEAM_RATIO_Q10: u32 = 2_560;

/// Ratio of a cell to its neighbour in the wrong direction, at most, in 1/1024: 4 %.
pub const WRONG_WAY_Q10: u32 = 1_065;

/// Reason that a lookup is not plausible, and the cell (`frequency · CURRENTS + current`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Implausible {
    /// R or L outside its range.
    Range {
        /// Index of the cell.
        cell: u16,
    },
    /// A neighbour with larger index differs by more than [`MAX_RATIO_Q10`], or across a seam by more
    /// than [`MAX_SEAM_RATIO_Q10`].
    Slope {
        /// Index of the cell.
        cell: u16,
    },
    /// R or L runs the wrong way towards a neighbour with larger index.
    NotMonotone {
        /// Index of the cell.
        cell: u16,
    },
}

impl fmt::Display for Implausible {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (cell, what) = match self {
            Self::Range { cell } => (cell, "is outside 0.02-15.9 ohm or 2-63.9 µH"),
            Self::Slope { cell } => (
                cell,
                "differs too much from a neighbour (factor 1.6; 2.5 where taught cells meet the prior)",
            ),
            Self::NotMonotone { cell } => (
                cell,
                "runs the wrong way with frequency or current by more than 4 %",
            ),
        };
        let (frequency, current) = (usize::from(*cell) / CURRENTS, usize::from(*cell) % CURRENTS);
        write!(
            f,
            "cell {cell} (frequency {frequency}, current {current}) {what}"
        )
    }
}

impl core::error::Error for Implausible {}

/// Checks range, slopes and monotony of every cell.
///
/// # Errors
/// The first cell, in index order, outside its range; else the first with a bad neighbour.
pub fn check(lookup: &RlLookup) -> Result<(), Implausible> {
    // Ranges first: a wild cell would otherwise be reported as its neighbour's slope.
    for (cell, (r, l)) in lookup
        .r
        .iter()
        .flatten()
        .zip(lookup.l.iter().flatten())
        .enumerate()
    {
        if !R_CODES.contains(r) || !L_CODES.contains(l) {
            return Err(Implausible::Range { cell: cell as u16 });
        }
    }
    for f in 0..FREQUENCIES {
        for i in 0..CURRENTS {
            let cell = (f * CURRENTS + i) as u16;
            let (r, l) = (lookup.r[f][i], lookup.l[f][i]);
            let seam = |f2, i2| lookup.is_observed(f, i) != lookup.is_observed(f2, i2);
            if i + 1 < CURRENTS {
                let falls = if seam(f, i + 1) {
                    Trend::Seam
                } else {
                    Trend::Falls
                };
                step(r, lookup.r[f][i + 1], falls, cell)?;
                step(l, lookup.l[f][i + 1], falls, cell)?;
            }
            if f + 1 < FREQUENCIES {
                let (rises, falls) = if seam(f + 1, i) {
                    (Trend::Seam, Trend::Seam)
                } else {
                    (Trend::Rises, Trend::Falls)
                };
                step(r, lookup.r[f + 1][i], rises, cell)?;
                step(l, lookup.l[f + 1][i], falls, cell)?;
            }
        }
    }
    Ok(())
}

#[derive(Clone, Copy, PartialEq)]
enum Trend {
    Rises,
    Falls,
    /// Between an observed cell and one that is not: either way, only not too far.
    Seam,
}

fn step(from: u16, to: u16, trend: Trend, cell: u16) -> Result<(), Implausible> {
    let (low, high) = (u32::from(from.min(to)), u32::from(from.max(to)));
    let limit = match trend {
        Trend::Rises | Trend::Falls => MAX_RATIO_Q10,
        Trend::Seam => MAX_SEAM_RATIO_Q10,
    };
    if high << 10 > low * limit {
        return Err(Implausible::Slope { cell });
    }
    let wrong_way = match trend {
        Trend::Rises => to < from,
        Trend::Falls => to > from,
        Trend::Seam => false,
    };
    if wrong_way && high << 10 > low * WRONG_WAY_Q10 {
        return Err(Implausible::NotMonotone { cell });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::prior::prior;
    use super::*;

    #[test]
    fn the_prior_is_plausible() {
        assert_eq!(check(&prior()), Ok(()));
    }

    #[test]
    fn each_kind_of_nonsense_is_named_with_its_cell() {
        let mut low = prior();
        low.r[2][3] = 1;
        assert_eq!(check(&low), Err(Implausible::Range { cell: 2 * 17 + 3 }));
        let mut jump = prior();
        jump.l[0][0] = jump.l[0][1] / 2;
        assert_eq!(check(&jump), Err(Implausible::Slope { cell: 0 }));
        let mut rising = prior();
        rising.r[0][1] = (f32::from(rising.r[0][0]) * 1.1) as u16;
        assert_eq!(check(&rising), Err(Implausible::NotMonotone { cell: 0 }));
        let mut falling = prior();
        for i in 0..CURRENTS {
            falling.r[1][i] = (f32::from(falling.r[0][i]) * 0.94) as u16;
        }
        assert_eq!(check(&falling), Err(Implausible::NotMonotone { cell: 0 }));
    }

    #[test]
    fn a_seam_between_taught_cells_and_the_prior_may_be_steeper() {
        let taught = |percent: u32| {
            let mut lookup = prior();
            for i in 0..9 {
                for f in 0..FREQUENCIES {
                    lookup.r[f][i] = (u32::from(lookup.r[f][i]) * percent / 100) as u16;
                    lookup.mark_observed(f, i);
                }
            }
            check(&lookup)
        };
        assert_eq!(taught(55), Ok(()));
        assert_eq!(taught(25), Err(Implausible::Slope { cell: 8 }));
    }

    #[test]
    fn a_little_of_the_wrong_way_is_noise() {
        let mut noisy = prior();
        noisy.r[0][1] = (f32::from(noisy.r[0][0]) * 1.02) as u16;
        assert_eq!(check(&noisy), Ok(()));
    }
}
