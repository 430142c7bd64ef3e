//! The RL lookup of what is known of a pot.
//!
//! Every cell is the map's: observed, or predicted by the pot's physics and what it left where it was taught. A cell
//! is marked for the device where its deviation is small, whoever it comes from.

pub mod error;

use ihd_map::Cells;
use ihd_shared::lookup::grid::{CURRENTS, FREQUENCIES};
use ihd_shared::lookup::plausible::{self, Implausible, L_CODES, R_CODES};
use ihd_shared::lookup::{HENRY_PER_CODE, OBSERVED_BYTES, OHM_PER_CODE, RlLookup};

pub use error::{CellErrors, JudgedCell, MapError, judged};

/// Largest relative deviation of R at which a cell is marked: what the power of a step may be off by.
const MARKED_R: f64 = 0.03;

/// The same of L, half of it: near resonance the power goes with the square of the detuning.
const MARKED_L: f64 = 0.015;

/// A lookup, and what it was made of.
#[derive(Clone, Debug, PartialEq)]
pub struct Built {
    /// The lookup; cells whose deviation is small are marked.
    pub lookup: RlLookup,
    /// R and L of each cell with their deviations, what they rest on, and how old that is.
    pub cells: Box<Cells>,
}

/// A device would refuse the lookup.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("no lookup of this pot is one that a device takes: {0}")]
pub struct NotTeachable(#[from] Implausible);

impl Built {
    /// The lookup of what is known.
    ///
    /// # Errors
    /// [`NotTeachable`], with the cell.
    pub fn of(cells: Cells, version: u32) -> Result<Self, NotTeachable> {
        let mut lookup = RlLookup {
            version,
            r: [[0; CURRENTS]; FREQUENCIES],
            l: [[0; CURRENTS]; FREQUENCIES],
            observed: [0; OBSERVED_BYTES],
        };
        for (f, row) in cells.iter().enumerate() {
            for (i, cell) in row.iter().enumerate() {
                let value = cell.value;
                let [r, l] = [(value.r_ohm, OHM_PER_CODE), (value.l_h, HENRY_PER_CODE)]
                    .map(|(x, unit)| (x / unit).round().clamp(0.0, f64::from(u16::MAX)) as u16);
                let known = value.r_sigma <= MARKED_R && value.l_sigma <= MARKED_L;
                if known {
                    lookup.mark_observed(f, i);
                    (lookup.r[f][i], lookup.l[f][i]) = (r, l);
                } else {
                    // Nobody relies on it; a device would refuse all for its sake.
                    lookup.r[f][i] = r.clamp(*R_CODES.start(), *R_CODES.end());
                    lookup.l[f][i] = l.clamp(*L_CODES.start(), *L_CODES.end());
                }
            }
        }
        plausible::check(&lookup)?;
        let cells = Box::new(cells);
        Ok(Self { lookup, cells })
    }

    /// Cells that were seen themselves; the others follow from them.
    pub fn seen_cells(&self) -> usize {
        self.cells
            .iter()
            .flatten()
            .filter(|cell| cell.is_observed())
            .count()
    }

    /// How well each cell is founded on observations: 0, never observed, to 1.
    pub fn confidence(&self) -> [[f64; CURRENTS]; FREQUENCIES] {
        self.cells.map(|row| row.map(|cell| cell.confidence))
    }
}

#[cfg(test)]
mod tests {
    use ihd_map::{Cell, Predicted};

    use super::*;

    fn cells(r_ohm: f64, sigma: f64) -> Cells {
        let value = Predicted {
            r_ohm,
            l_h: 25e-6,
            r_sigma: sigma,
            l_sigma: 0.001,
        };
        let cell = Cell {
            value,
            confidence: 0.0,
            age_s: None,
        };
        [[cell; CURRENTS]; FREQUENCIES]
    }

    #[test]
    fn what_is_known_well_is_marked_and_the_rest_is_kept_in_range() {
        let mut known = cells(4.0, 0.001);
        known[7][16].value.r_sigma = 0.2;
        known[7][15].value.r_sigma = 0.2;
        let built = Built::of(known, 3).unwrap();
        assert_eq!(
            (built.lookup.version, built.lookup.observed_cells()),
            (3, 134)
        );
        assert!(!built.lookup.is_observed(7, 16));
        let (r, l) = built.lookup.interpolate(50_000, 20_000);
        assert!((r.ohm() - 4.0).abs() < 1e-3 && (l.henry() - 25e-6).abs() < 1e-9);
        assert!(Built::of(cells(1e3, 0.5), 1).is_ok());
    }

    #[test]
    fn what_no_device_takes_is_refused_with_its_cell() {
        let why = Built::of(cells(1e3, 0.001), 1).unwrap_err().to_string();
        assert!(why.contains("cell 0"), "{why}");
        let mut steep = cells(4.0, 0.001);
        steep[3][5].value.r_ohm = 9.0;
        assert!(Built::of(steep, 1).unwrap_err().to_string().contains("1.6"));
    }
}
