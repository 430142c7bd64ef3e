//! RL lookup built from a pot's map.
//!
//! Every cell is the map's: observed, or predicted by the pot's physics and the residual at the observed cells. A cell is marked for the
//! device if its deviation is small, observed or not.

pub mod error;

use ihd_map::{Cells, MapCell};
use ihd_shared::lookup::grid::{CURRENTS, FREQUENCIES};
use ihd_shared::lookup::plausible::{self, Implausible, L_CODES, R_CODES};
use ihd_shared::lookup::{HENRY_PER_CODE, OBSERVED_BYTES, OHM_PER_CODE, RlLookup};

pub use error::{CellErrors, JudgedCell, LookupAccuracy, judge_cells};

/// Largest relative deviation of R at which a cell is marked: the tolerable error of the power after a step.
const MARKED_R: f64 = 0.03;

/// Largest relative deviation of L at which a cell is marked, half that of R: near resonance the power goes with the square of the
/// detuning.
const MARKED_L: f64 = 0.015;

/// A lookup with the cells that it was built from.
#[derive(Clone, Debug, PartialEq)]
pub struct BuiltLookup {
    /// The lookup; cells whose deviation is small are marked.
    pub lookup: RlLookup,
    /// R and L of each cell with deviation, confidence and age.
    pub cells: Box<Cells>,
}

/// Lookup that a device would refuse.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("no lookup of this pot is one that a device takes: {0}")]
pub struct ImplausibleLookup(#[from] Implausible);

impl BuiltLookup {
    /// Builds the lookup of this version from the map's cells.
    ///
    /// # Errors
    /// [`ImplausibleLookup`] if a device would refuse it, with the cell.
    pub fn from_cells(cells: Cells, version: u32) -> Result<Self, ImplausibleLookup> {
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
                    // Power control ignores unmarked cells, but one out of range would make the device refuse the whole lookup.
                    lookup.r[f][i] = r.clamp(*R_CODES.start(), *R_CODES.end());
                    lookup.l[f][i] = l.clamp(*L_CODES.start(), *L_CODES.end());
                }
            }
        }
        plausible::check(&lookup)?;
        let cells = Box::new(cells);
        Ok(Self { lookup, cells })
    }

    /// Returns the number of observed cells.
    pub fn seen_cells(&self) -> usize {
        self.cells
            .iter()
            .flatten()
            .filter(|cell| cell.is_observed())
            .count()
    }

    /// Returns the confidence of each cell: 0 if never observed, to 1.
    pub fn confidence(&self) -> [[f64; CURRENTS]; FREQUENCIES] {
        self.cells.map(|row| row.map(|cell| cell.confidence))
    }

    /// Returns the relative standard deviations of R and of L of each cell.
    pub fn sigma(&self) -> [[[f64; CURRENTS]; FREQUENCIES]; 2] {
        let of: [fn(&MapCell) -> f64; 2] = [|cell| cell.value.r_sigma, |cell| cell.value.l_sigma];
        of.map(|of| self.cells.each_ref().map(|row| row.each_ref().map(of)))
    }
}

#[cfg(test)]
mod tests {
    use ihd_map::RlPrediction;

    use super::*;

    fn cells(r_ohm: f64, sigma: f64) -> Cells {
        let value = RlPrediction {
            r_ohm,
            l_h: 25e-6,
            r_sigma: sigma,
            l_sigma: 0.001,
        };
        let cell = MapCell {
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
        let built = BuiltLookup::from_cells(known, 3).unwrap();
        assert_eq!(
            (built.lookup.version, built.lookup.observed_cells()),
            (3, 134)
        );
        assert!(!built.lookup.is_observed(7, 16));
        let (r, l) = built.lookup.interpolate(50_000, 20_000);
        assert!((r.ohm() - 4.0).abs() < 1e-3 && (l.henry() - 25e-6).abs() < 1e-9);
        assert!(BuiltLookup::from_cells(cells(1e3, 0.5), 1).is_ok());
    }

    #[test]
    fn what_no_device_takes_is_refused_with_its_cell() {
        let why = BuiltLookup::from_cells(cells(1e3, 0.001), 1)
            .unwrap_err()
            .to_string();
        assert!(why.contains("cell 0"), "{why}");
        let mut steep = cells(4.0, 0.001);
        steep[3][5].value.r_ohm = 9.0;
        assert!(
            BuiltLookup::from_cells(steep, 1)
                .unwrap_err()
                .to_string()
                .contains("1.6")
        );
    }
}
