//! Transfer of a pot between hobs: its prior on another hob, the test whether two entries are one pot, and their merging.

use nalgebra::{Matrix3, Vector3};

use super::PotEntry;
use crate::parameters::{self, COUNT, OF_POT, PotSpread, Prior};

/// Deviations between two hobs of α (its ln), s (its ln) and the base's radius in metre, beside the deviations of each entry.
/// ln s: a pot may be taught warm and met cold, half of 1.1e-3 to 1.9e-3 per kelvin (ferritic steel, cast iron) over some 80 K.
/// The others come from coils that differ from the paper's (docs/map.md, "What transfers").
const TRANSFER: [f64; OF_POT] = [0.06, 0.06, 1.5e-3];

/// Squared distance above which two pots differ: chance exceeds it in 1 % with three numbers.
const MAX_POT_DISTANCE: f64 = 11.34;

/// Largest difference of the shapes of one pot measured twice, in units of 1e-5: two percent.
const MAX_SHAPE_DIFFERENCE: u16 = 2_000;

impl PotEntry {
    /// Covariance of α, s and radius as another hob would find them.
    fn elsewhere(&self) -> Matrix3<f64> {
        self.covariance() + transfer()
    }

    /// Prior of this pot on another coil, in another place.
    pub(crate) fn prior(&self) -> Prior {
        let l = self.elsewhere().cholesky().map(|c| c.unpack());
        // A sum of squares and a positive diagonal has a factor.
        let spread = l.map_or_else(PotSpread::default, |l| {
            PotSpread([
                l[(0, 0)],
                l[(1, 0)],
                l[(1, 1)],
                l[(2, 0)],
                l[(2, 1)],
                l[(2, 2)],
            ])
        });
        Prior {
            from: parameters::anywhere(&self.model),
            spread,
        }
    }

    /// Returns `true` if both entries may be one pot.
    pub fn is_same(&self, other: &Self) -> bool {
        let shapes = self.shape.iter().zip(&other.shape);
        let alike = shapes
            .map(|(a, b)| a.abs_diff(*b))
            .all(|by| by < MAX_SHAPE_DIFFERENCE);
        alike
            && self
                .squares_to(other)
                .is_some_and(|d2| d2 < MAX_POT_DISTANCE)
    }

    /// Squared distance of the pots' own numbers: about 3 for one pot measured twice. Deviations beyond the transfer's are limited
    /// to it, because otherwise all badly known pots would be one.
    fn squares_to(&self, other: &Self) -> Option<f64> {
        let apart = self.numbers() - other.numbers();
        let all = (self.known_well() + other.known_well() + transfer()).cholesky()?;
        Some(apart.dot(&all.solve(&apart)))
    }

    /// Covariance of α, s and radius, each limited to its transfer.
    fn known_well(&self) -> Matrix3<f64> {
        let covariance = self.covariance();
        let shrink = Vector3::from_fn(|k, _| (TRANSFER[k] / covariance[(k, k)].sqrt()).min(1.0));
        let shrink = Matrix3::from_diagonal(&shrink);
        shrink * covariance * shrink
    }

    /// Merges another hob's entry of the same pot: the mean of both by their weights. No weight exceeds what the transfer
    /// allows, however small the deviation that an entry states.
    pub(crate) fn merge(&mut self, other: &Self) -> Option<()> {
        let hobs = self.hobs.len() as f64;
        // The transfer's share of a mean of several hobs is theirs divided by their number.
        let (a, b) = (
            (self.covariance() + transfer() / hobs).try_inverse()?,
            other.elsewhere().try_inverse()?,
        );
        let covariance = (a + b).try_inverse()?;
        let mean = covariance * (a * self.numbers() + b * other.numbers());
        // The transfer counts when it is used.
        let left = covariance - transfer() / (hobs + 1.0);
        let floor = self
            .covariance()
            .diagonal()
            .inf(&other.covariance().diagonal());
        let deviation = |k: usize| left[(k, k)].max(0.25 * floor[k]).sqrt();
        let shapes = self.shape.iter().zip(&other.shape);
        let shape = shapes.map(|(a, b)| {
            // Between two codes: a code.
            ((hobs * f64::from(*a) + f64::from(*b)) / (hobs + 1.0)).round() as i16
        });
        let mut merged = Self {
            shape: shape.collect(),
            model: parameters::clamped(&{
                let mut all = parameters::raw(&other.model);
                (0..OF_POT).for_each(|k| all[k] = mean[k]);
                all
            }),
            factor: other.factor.clone(),
            misfit: [0, 1].map(|x| self.misfit[x].max(other.misfit[x])),
            seen: self.seen.and(&other.seen),
            label: self.label.clone().or_else(|| other.label.clone()),
            build: other.build.clone(),
            t_unix_s: self.t_unix_s.max(other.t_unix_s),
            ..self.clone()
        };
        for row in 0..COUNT {
            for k in 0..OF_POT.min(row + 1) {
                let own = if k == row { deviation(k) } else { 0.0 };
                merged.factor[row * (row + 1) / 2 + k] = own;
            }
        }
        merged.hobs.extend(other.hobs.iter().cloned());
        merged.check().ok()?;
        *self = merged;
        Some(())
    }
}

fn transfer() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::from(TRANSFER.map(|x| x * x)))
}
