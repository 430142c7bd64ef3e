//! The least-squares problem behind a lookup.

use ihd_shared::lookup::grid::{
    CELLS, CURRENTS, FREQUENCIES, ONE, current_coordinate, frequency_coordinate, split,
};
use ihd_shared::lookup::{HENRY_PER_CODE, OBSERVED_BYTES, OHM_PER_CODE, RlLookup};
use nalgebra::{DMatrix, DVector};

use super::curve::LoadCurve;

/// Tie between the ratios of neighbouring frequencies. A curve between two rows determines only
/// their blend; the tie makes both ratios alike.
const TIE_FREQUENCY: f64 = 1e-3;

/// Tie between the ratios of neighbouring currents, for cells at the end of a curve.
const TIE_CURRENT: f64 = 1e-4;

/// Tie to the prior, which only makes the problem regular where nothing was observed.
const TIE_PRIOR: f64 = 1e-8;

/// Observation mass at which a cell's confidence is one half: a quarter of a curve.
const MASS_AT_HALF: f64 = 0.25;

/// Confidence from which a cell counts as observed.
pub const OBSERVED_FROM: f64 = 0.1;

/// A lookup and how well each cell is founded.
#[derive(Clone, Debug, PartialEq)]
pub struct Built {
    /// The lookup, observed cells marked.
    pub lookup: RlLookup,
    /// Confidence per cell `[frequency][current]`, 0 (never observed) to 1.
    pub confidence: [[f64; CURRENTS]; FREQUENCIES],
}

/// Normal equations of the ratios for one of R and L.
#[derive(Clone, Debug)]
struct Ratios {
    normal: DMatrix<f64>,
    right: DVector<f64>,
}

impl Ratios {
    fn new() -> Self {
        Self {
            normal: DMatrix::zeros(CELLS, CELLS),
            right: DVector::zeros(CELLS),
        }
    }

    /// Σ row·ratio should be `target`, relative to the target.
    fn add(&mut self, row: &[(usize, f64)], target: f64, weight: f64) {
        let w = weight / (target * target);
        for &(a, x) in row {
            self.right[a] += w * x * target;
            for &(b, y) in row {
                self.normal[(a, b)] += w * x * y;
            }
        }
    }

    fn solve(&self) -> Option<DVector<f64>> {
        let mut normal = self.normal.clone();
        let mut right = self.right.clone();
        for f in 0..FREQUENCIES {
            for i in 0..CURRENTS {
                let cell = f * CURRENTS + i;
                normal[(cell, cell)] += TIE_PRIOR;
                right[cell] += TIE_PRIOR;
                let mut tie = |other: usize, weight: f64| {
                    normal[(cell, cell)] += weight;
                    normal[(other, other)] += weight;
                    normal[(cell, other)] -= weight;
                    normal[(other, cell)] -= weight;
                };
                if i + 1 < CURRENTS {
                    tie(cell + 1, TIE_CURRENT);
                }
                if f + 1 < FREQUENCIES {
                    tie(cell + CURRENTS, TIE_FREQUENCY);
                }
            }
        }
        normal.cholesky().map(|c| c.solve(&right))
    }
}

/// Collects load curves; builds lookups.
#[derive(Clone, Debug)]
pub struct LookupBuilder {
    prior: RlLookup,
    r: Ratios,
    l: Ratios,
    mass: [[f64; CURRENTS]; FREQUENCIES],
}

impl LookupBuilder {
    /// Starts from a prior; its observed marks are dropped.
    pub fn new(prior: RlLookup) -> Self {
        Self {
            prior,
            r: Ratios::new(),
            l: Ratios::new(),
            mass: [[0.0; CURRENTS]; FREQUENCIES],
        }
    }

    /// Adds what one window says. `weight` 1 for a good one; curves outside the grid are clamped
    /// to its edge by the firmware, so they are left out here.
    pub fn observe(&mut self, curve: &LoadCurve, weight: f64) {
        let f_hz = curve.f_sw_hz.round() as u32;
        let (kf, wf) = split(frequency_coordinate(f_hz), FREQUENCIES);
        let wf = wf as f64 / ONE as f64;
        for p in &curve.points {
            let (ki, wi) = split(current_coordinate((p.i_a * 1e3) as u32), CURRENTS);
            let wi = wi as f64 / ONE as f64;
            let corners = [
                (kf, ki, (1.0 - wf) * (1.0 - wi)),
                (kf, ki + 1, (1.0 - wf) * wi),
                (kf + 1, ki, wf * (1.0 - wi)),
                (kf + 1, ki + 1, wf * wi),
            ];
            let weight = weight * LoadCurve::point_weight();
            let row = |cells: &[[u16; CURRENTS]; FREQUENCIES], unit: f64| {
                corners.map(|(f, i, w)| (f * CURRENTS + i, w * f64::from(cells[f][i]) * unit))
            };
            self.r
                .add(&row(&self.prior.r, OHM_PER_CODE), p.r_ohm, weight);
            self.l
                .add(&row(&self.prior.l, HENRY_PER_CODE), p.l_h, weight);
            for (f, i, w) in corners {
                self.mass[f][i] += weight * w;
            }
        }
    }

    /// The lookup of everything observed so far. `None` only if the numbers went beyond what a
    /// Cholesky factorisation bears.
    pub fn build(&self, version: u32) -> Option<Built> {
        let (r, l) = (self.r.solve()?, self.l.solve()?);
        let mut lookup = RlLookup {
            version,
            observed: [0; OBSERVED_BYTES],
            ..self.prior.clone()
        };
        let confidence = self.mass.map(|row| row.map(|m| m / (m + MASS_AT_HALF)));
        for (f, row) in confidence.iter().enumerate() {
            for (i, &confidence) in row.iter().enumerate() {
                if confidence < OBSERVED_FROM {
                    continue;
                }
                let cell = f * CURRENTS + i;
                let scaled = |prior: u16, ratio: f64| {
                    (f64::from(prior) * ratio)
                        .round()
                        .clamp(0.0, f64::from(u16::MAX)) as u16
                };
                lookup.r[f][i] = scaled(self.prior.r[f][i], r[cell]);
                lookup.l[f][i] = scaled(self.prior.l[f][i], l[cell]);
                lookup.mark_observed(f, i);
            }
        }
        Some(Built { lookup, confidence })
    }
}

#[cfg(test)]
mod tests {
    use ihd_shared::lookup::plausible;
    use ihd_shared::lookup::prior::prior;
    use ihd_sim::behavioural::{BehaviouralLoad as Load, PotKind};

    use super::super::curve::LoadPoint;
    use super::*;

    /// The exact curve of the behavioural reference load up to a current.
    fn curve(f_sw_hz: f64, i_max_a: f64) -> LoadCurve {
        let load = Load::new(PotKind::Ferromagnetic, f_sw_hz);
        let points = (0..400).map(|k| {
            let i_a = i_max_a * (f64::from(k) / 399.0);
            let (r_ohm, l_h) = load.r_l(i_a);
            LoadPoint { i_a, r_ohm, l_h }
        });
        LoadCurve::from_half_cycle(f_sw_hz, points)
    }

    #[test]
    fn observed_currents_are_reproduced_and_the_rest_keeps_the_prior() {
        let mut builder = LookupBuilder::new(prior());
        builder.observe(&curve(45e3, 54.0), 1.0);
        let built = builder.build(1).unwrap();
        let load = Load::new(PotKind::Ferromagnetic, 45e3);
        for i_a in [2.0, 5.0, 12.0, 30.0, 50.0] {
            let (r, l) = built.lookup.interpolate(45_000, (i_a * 1e3) as u32);
            let (r0, l0) = load.r_l(i_a);
            // The grid's own interpolation error is up to 0.3 %.
            assert!(
                (r.ohm() / r0 - 1.0).abs() < 4e-3,
                "R at {i_a}: {} {r0}",
                r.ohm()
            );
            assert!(
                (l.henry() / l0 - 1.0).abs() < 4e-3,
                "L at {i_a}: {} {l0}",
                l.henry()
            );
        }
        for f in 0..FREQUENCIES {
            for i in 0..CURRENTS {
                if !built.lookup.is_observed(f, i) {
                    assert_eq!(built.lookup.r[f][i], prior().r[f][i], "cell {f},{i}");
                    assert_eq!(built.lookup.l[f][i], prior().l[f][i], "cell {f},{i}");
                    assert!(built.confidence[f][i] < OBSERVED_FROM);
                }
            }
        }
        assert!(!built.lookup.is_observed(7, 3), "80 kHz was never seen");
        assert!(!built.lookup.is_observed(3, 16), "80 A was never seen");
        assert!(built.lookup.is_observed(3, 8));
        assert_eq!(plausible::check(&built.lookup), Ok(()));
    }

    #[test]
    fn more_curves_cover_more_cells_with_more_confidence() {
        let mut builder = LookupBuilder::new(prior());
        builder.observe(&curve(45e3, 54.0), 1.0);
        let one = builder.build(1).unwrap();
        for f in [50e3, 60e3, 70e3] {
            builder.observe(&curve(f, 30.0), 1.0);
        }
        let four = builder.build(2).unwrap();
        assert!(four.lookup.observed_cells() > one.lookup.observed_cells());
        assert!(four.confidence[3][6] >= one.confidence[3][6]);
        assert_eq!(plausible::check(&four.lookup), Ok(()));
        for f in [47_000, 50_000, 55_000, 65_000] {
            let (r, l) = four.lookup.interpolate(f, 20_000);
            let (r0, l0) = Load::new(PotKind::Ferromagnetic, f64::from(f)).r_l(20.0);
            assert!((r.ohm() / r0 - 1.0).abs() < 8e-3, "R at {f}");
            assert!((l.henry() / l0 - 1.0).abs() < 8e-3, "L at {f}");
        }
    }

    #[test]
    fn nothing_observed_is_the_prior() {
        let built = LookupBuilder::new(prior()).build(3).unwrap();
        assert_eq!(
            built.lookup,
            RlLookup {
                version: 3,
                ..prior()
            }
        );
    }
}
