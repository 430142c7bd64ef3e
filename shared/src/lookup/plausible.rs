//! Plausibility of a lookup, which firmware checks before use: physics' signs and bounded slopes.
//!
//! With frequency the skin depth falls, so R rises and L falls. With current a ferromagnetic load
//! saturates, so both fall. Measured tables are noisy, so a little of the wrong way is allowed;
//! slopes are bounded so that one bad cell cannot make the power control jump. Where an observed
//! cell meets one that keeps the prior, the two may disagree about the pot: only the slope counts.
//! Observed cells are one pot's, so each must agree with the next observed one, however many lie between; and what lies between
//! them is that pot's, too.

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
/// of a full-size pot differs from the prior by 1.7 at small currents, a small pot by 4. Between observed cells
/// [`MAX_RATIO_Q10`] holds.
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
    /// A neighbour with larger index differs by more than [`MAX_RATIO_Q10`], or across a seam at the edge of what was observed by
    /// more than [`MAX_SEAM_RATIO_Q10`]; or one that lies between observed cells and the next of them do.
    Slope {
        /// Index of the cell.
        cell: u16,
    },
    /// R or L runs the wrong way towards a neighbour with larger index, or from an observed cell to the next observed one.
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
            along(lookup, (f, i), Axis::Current)?;
            along(lookup, (f, i), Axis::Frequency)?;
        }
    }
    Ok(())
}

#[derive(Clone, Copy, PartialEq)]
enum Axis {
    Frequency,
    Current,
}

impl Axis {
    /// The cell so many steps further along the axis, if there is one.
    fn further(self, (f, i): (usize, usize), steps: usize) -> Option<(usize, usize)> {
        let (f, i) = match self {
            Self::Frequency => (f + steps, i),
            Self::Current => (f, i + steps),
        };
        (f < FREQUENCIES && i < CURRENTS).then_some((f, i))
    }
}

/// Checks a cell against the next one along an axis, and an observed one against the next observed one.
fn along(lookup: &RlLookup, at: (usize, usize), axis: Axis) -> Result<(), Implausible> {
    let observed = |(f, i)| lookup.is_observed(f, i);
    let observed_from = |cell, from: usize| {
        (from..)
            .map_while(|steps| Some((steps, axis.further(cell, steps)?)))
            .find(|&(_, cell)| observed(cell))
    };
    let Some(next) = axis.further(at, 1) else {
        return Ok(());
    };
    if observed(at) == observed(next) {
        return compare(lookup, at, next, axis, &Step::Neighbours(1));
    }
    if !observed(at) {
        // What is enclosed was checked from the observed cell before it.
        return compare(lookup, at, next, axis, &Step::Seam(MAX_SEAM_RATIO_Q10));
    }
    let Some((steps, beyond)) = observed_from(at, 2) else {
        return compare(lookup, at, next, axis, &Step::Seam(MAX_SEAM_RATIO_Q10));
    };
    compare(lookup, at, beyond, axis, &Step::Neighbours(steps))?;
    let last = axis.further(at, steps - 1).unwrap_or(next);
    compare(lookup, at, next, axis, &Step::Seam(MAX_RATIO_Q10))?;
    compare(lookup, last, beyond, axis, &Step::Seam(MAX_RATIO_Q10))
}

enum Step {
    /// Cells of one pot, so many steps apart.
    Neighbours(usize),
    /// An observed cell and one that is not: either way, only not further than this ratio, in 1/1024.
    Seam(u32),
}

fn compare(
    lookup: &RlLookup,
    from: (usize, usize),
    to: (usize, usize),
    axis: Axis,
    step: &Step,
) -> Result<(), Implausible> {
    let cell = (from.0 * CURRENTS + from.1) as u16;
    for (table, rises) in [(&lookup.r, axis == Axis::Frequency), (&lookup.l, false)] {
        let (from, to) = (
            u64::from(table[from.0][from.1]),
            u64::from(table[to.0][to.1]),
        );
        let (low, high) = (from.min(to), from.max(to));
        let is_within = |ratio_q10: u32| high << 10 <= low * u64::from(ratio_q10);
        let is_gentle = match *step {
            Step::Seam(ratio_q10) => is_within(ratio_q10),
            Step::Neighbours(1) => is_within(MAX_RATIO_Q10),
            // Each of the steps between is bounded by itself.
            Step::Neighbours(_) => true,
        };
        if !is_gentle {
            return Err(Implausible::Slope { cell });
        }
        let is_wrong_way = if rises { to < from } else { to > from };
        if matches!(step, Step::Neighbours(_)) && is_wrong_way && !is_within(WRONG_WAY_Q10) {
            return Err(Implausible::NotMonotone { cell });
        }
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

    /// Every neighbour is a seam: R and L twice to two and a half times as large where nothing was observed.
    #[test]
    fn marks_on_every_other_cell_permit_no_sawtooth() {
        let mut checkerboard = prior();
        for f in 0..FREQUENCIES {
            for i in 0..CURRENTS {
                let is_marked = (f + i).is_multiple_of(2);
                (checkerboard.r[f][i], checkerboard.l[f][i]) = match is_marked {
                    true => (12_000, 20_000),
                    false => (29_000, 49_000),
                };
                if is_marked {
                    checkerboard.mark_observed(f, i);
                }
            }
        }
        assert_eq!(check(&checkerboard), Err(Implausible::Slope { cell: 0 }));
    }

    /// In no steel does R fall with frequency; here to 0.42 at each step, marks on every other frequency.
    #[test]
    fn marks_on_every_other_frequency_permit_no_falling_resistance() {
        for fall in [2.4, 1.2, 1.03] {
            let mut falling = prior();
            for f in 0..FREQUENCIES {
                for i in 0..CURRENTS {
                    falling.r[f][i] = (60_000.0 / f64::powi(fall, f as i32)) as u16;
                    if f.is_multiple_of(2) {
                        falling.mark_observed(f, i);
                    }
                }
            }
            assert_eq!(
                check(&falling),
                Err(Implausible::NotMonotone { cell: 0 }),
                "{fall}"
            );
        }
    }

    /// A pot that was measured at 30, 45 and 80 kHz, the rest predicted: R as √f, L falling.
    #[test]
    fn one_pot_measured_at_some_frequencies_is_plausible() {
        let mut pot = prior();
        for i in 0..CURRENTS {
            for f in 0..FREQUENCIES {
                pot.r[f][i] = (u32::from(pot.r[f][i]) * 70 / 100) as u16;
                if [0, 3, 7].contains(&f) {
                    pot.mark_observed(f, i);
                }
            }
        }
        assert_eq!(check(&pot), Ok(()));
    }

    #[test]
    fn a_little_of_the_wrong_way_is_noise() {
        let mut noisy = prior();
        noisy.r[0][1] = (f32::from(noisy.r[0][0]) * 1.02) as u16;
        assert_eq!(check(&noisy), Ok(()));
    }
}
