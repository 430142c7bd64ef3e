//! Errors of a lookup against the truth, over the cells that the hob reaches.

use ihd_signal::truth::MapTruth;
use serde::Serialize;

use super::BuiltLookup;

/// One cell beside its truth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct JudgedCell {
    /// Knot of its frequency.
    pub frequency: usize,
    /// Knot of its current.
    pub current: usize,
    /// `true` if it rests on observations; otherwise it is predicted.
    pub observed: bool,
    /// R of the lookup less the true one, in percent of the true one.
    pub r_pct: f64,
    /// L of the lookup less the true one, in percent of the true one.
    pub l_pct: f64,
    /// Stated standard deviation of R, in percent of the true R.
    pub r_sigma_pct: f64,
    /// Stated standard deviation of L, in percent of the true L.
    pub l_sigma_pct: f64,
}

/// Errors over a set of cells; `None` if it is empty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct CellErrors {
    /// Number of cells.
    pub cells: usize,
    /// Mean of the absolute errors of R in percent.
    pub r_mean_pct: Option<f64>,
    /// Largest absolute error of R in percent.
    pub r_worst_pct: Option<f64>,
    /// Mean of the absolute errors of L in percent.
    pub l_mean_pct: Option<f64>,
    /// Largest absolute error of L in percent.
    pub l_worst_pct: Option<f64>,
}

/// Accuracy of a lookup over the cells that the hob reaches with its load.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LookupAccuracy {
    /// Errors of the cells that rest on observations.
    pub observed: CellErrors,
    /// Errors of the predicted cells.
    pub unseen: CellErrors,
    /// Root mean square of (cell − truth)/σ over R and L of every reached cell: 1 if the stated deviations are right, more if they are too
    /// small. `None` without cells.
    pub z_rms: Option<f64>,
}

/// Compares every reached cell, as quantised for the device, with its truth; by rising frequency and current.
pub fn judge_cells(built: &BuiltLookup, truth: &MapTruth) -> Vec<JudgedCell> {
    let mut judged = Vec::with_capacity(truth.reached());
    let (all_r_ohm, all_l_h) = (built.lookup.r_ohm(), built.lookup.l_h());
    for (frequency, row) in truth.cells.iter().enumerate() {
        for (current, is) in row.iter().enumerate() {
            let Some(is) = is else { continue };
            let cell = &built.cells[frequency][current];
            let pct = |x: f64, is: f64| 100.0 * x / is;
            let (r_ohm, l_h) = (all_r_ohm[frequency][current], all_l_h[frequency][current]);
            judged.push(JudgedCell {
                frequency,
                current,
                observed: cell.is_observed(),
                r_pct: pct(r_ohm - is.r_ohm, is.r_ohm),
                l_pct: pct(l_h - is.l_h, is.l_h),
                r_sigma_pct: pct(cell.value.r_sigma * cell.value.r_ohm, is.r_ohm),
                l_sigma_pct: pct(cell.value.l_sigma * cell.value.l_h, is.l_h),
            });
        }
    }
    judged
}

impl CellErrors {
    fn from_cells<'a>(cells: impl Iterator<Item = &'a JudgedCell> + Clone) -> Self {
        let count = cells.clone().count();
        let mean = |pct: fn(&JudgedCell) -> f64| {
            let sum: f64 = cells.clone().map(|c| pct(c).abs()).sum();
            (count > 0).then(|| sum / count as f64)
        };
        let worst = |pct: fn(&JudgedCell) -> f64| {
            let all = cells.clone().map(|c| pct(c).abs());
            // `total_cmp` ranks NaN highest: a cell that is not a number is the worst.
            all.max_by(f64::total_cmp)
        };
        Self {
            cells: count,
            r_mean_pct: mean(|c| c.r_pct),
            r_worst_pct: worst(|c| c.r_pct),
            l_mean_pct: mean(|c| c.l_pct),
            l_worst_pct: worst(|c| c.l_pct),
        }
    }
}

impl LookupAccuracy {
    /// Computes the accuracy over judged cells.
    pub fn from_cells(cells: &[JudgedCell]) -> Self {
        let z = |c: &JudgedCell| [c.r_pct / c.r_sigma_pct, c.l_pct / c.l_sigma_pct];
        let z: Vec<f64> = cells.iter().flat_map(z).collect();
        let square: f64 = z.iter().map(|z| z * z).sum();
        Self {
            observed: CellErrors::from_cells(cells.iter().filter(|c| c.observed)),
            unseen: CellErrors::from_cells(cells.iter().filter(|c| !c.observed)),
            z_rms: (!z.is_empty()).then(|| (square / z.len() as f64).sqrt()),
        }
    }
}

#[cfg(test)]
mod tests {
    use ihd_map::{Cells, MapCell, RlPrediction};
    use ihd_shared::lookup::grid::{CURRENTS, FREQUENCIES};
    use ihd_signal::Load;

    use super::*;

    const Z: Load = Load {
        r_ohm: 4.0,
        l_h: 25e-6,
    };

    /// A lookup of 4 ohm and 25 µH everywhere, with deviations of one percent; nothing is observed.
    fn built(change: impl FnOnce(&mut Cells)) -> BuiltLookup {
        let value = RlPrediction {
            r_ohm: Z.r_ohm,
            l_h: Z.l_h,
            r_sigma: 0.01,
            l_sigma: 0.01,
        };
        let cell = MapCell {
            value,
            confidence: 0.0,
            age_s: None,
        };
        let mut cells = [[cell; CURRENTS]; FREQUENCIES];
        change(&mut cells);
        BuiltLookup::from_cells(cells, 1).expect("a plausible lookup")
    }

    /// True load in some cells.
    fn truth(cells: &[(usize, usize)]) -> MapTruth {
        let mut truth = MapTruth::UNREACHED;
        for &(f, i) in cells {
            truth.cells[f][i] = Some(Z);
        }
        truth
    }

    #[test]
    fn observed_and_unseen_cells_are_told_apart_and_unreached_ones_not_judged() {
        let built = built(|cells| {
            cells[2][3].confidence = 1.0;
            // Three percent in an observed cell, two in an unseen one, more where the hob never comes.
            cells[2][3].value.r_ohm *= 1.03;
            cells[5][1].value.l_h *= 0.98;
            cells[0][16].value.r_ohm *= 0.5;
            cells[0][16].value.r_sigma = 1.0;
        });
        let truth = truth(&[(2, 3), (2, 4), (5, 1)]);
        let error = LookupAccuracy::from_cells(&judge_cells(&built, &truth));
        assert_eq!((error.observed.cells, error.unseen.cells), (1, 2));
        let near = |is: Option<f64>, pct: f64| (is.unwrap() - pct).abs() < 0.02;
        assert!(near(error.observed.r_mean_pct, 3.0) && near(error.observed.r_worst_pct, 3.0));
        assert!(near(error.observed.l_worst_pct, 0.0));
        assert!(near(error.unseen.l_mean_pct, 1.0) && near(error.unseen.l_worst_pct, 2.0));
        assert!(near(error.unseen.r_worst_pct, 0.0));
        // Of six numbers one is off by 3 σ and one by 2.
        let z_rms = (13.0 / 6.0_f64).sqrt();
        assert!((error.z_rms.unwrap() - z_rms).abs() < 0.02, "{error:?}");
    }

    #[test]
    fn without_reached_cells_there_are_no_numbers() {
        let error = LookupAccuracy::from_cells(&judge_cells(&built(|_| ()), &MapTruth::UNREACHED));
        assert_eq!(error.unseen, CellErrors::default());
        let json = serde_json::to_value(error).unwrap();
        assert!(json["unseen"]["r_mean_pct"].is_null() && json["z_rms"].is_null());
    }

    #[test]
    fn a_cell_that_is_no_number_is_the_worst() {
        let mut truth = truth(&[(3, 3), (3, 4)]);
        truth.cells[3][3] = Some(Load {
            r_ohm: f64::NAN,
            l_h: 1.0,
        });
        let error = LookupAccuracy::from_cells(&judge_cells(&built(|_| ()), &truth));
        assert!(error.unseen.r_worst_pct.unwrap().is_nan());
    }
}
