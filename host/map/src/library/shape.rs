//! What a pot is beside the physics of seven numbers: ln R and ln L of its map less those of its model, over frequency and current.
//!
//! Harmonics of the current and the shape of B(H) make it. They are the metal's, at the current that makes the field, and go with
//! the pot.

use std::sync::LazyLock;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use serde::{Deserialize, Serialize};

use crate::misfit::{Place, current_of_knots};

/// Frequencies in hertz and knots of the lookup's current axis at which it is kept: nearer together than the misfit's memory.
const FREQUENCIES_HZ: [f64; 4] = [32e3, 44e3, 60e3, 82e3];
const KNOTS: [f64; 4] = [1.5, 6.0, 10.5, 15.0];

const POINTS: usize = FREQUENCIES_HZ.len() * KNOTS.len();

/// What one counts: 1e-5 of R or L, so that it ends at a third.
const UNIT: f64 = 1e-5;

/// Deviation below which none counts: what is linear around the fit and what is not differ by some of it.
const LEAST_MISFIT: f64 = 0.004;

/// Variance, in shares of the misfit's, that keeps the interpolation from going far beyond its points.
const NUGGET: f64 = 1e-3;

/// Share of the misfit that does not go with a pot to another coil and lift (docs/pots.md).
const TRANSFER: f64 = 0.1;

/// Where the shape of a pot is kept, as frequency in hertz and current in ampere; places of one frequency lie together.
pub fn places() -> Vec<(f64, f64)> {
    let of = |f_hz: f64| KNOTS.map(move |knots| (f_hz, current_of_knots(knots)));
    FREQUENCIES_HZ.into_iter().flat_map(of).collect()
}

static AT: LazyLock<Vec<Place>> = LazyLock::new(|| {
    let of = |(f_hz, i_a): (f64, f64)| Place::of(f_hz, i_a);
    places().into_iter().map(of).collect()
});

static FACTOR: LazyLock<Option<Cholesky<f64, Dyn>>> = LazyLock::new(|| {
    let nugget = |m, n| if m == n { NUGGET } else { 0.0 };
    DMatrix::from_fn(POINTS, POINTS, |m, n| {
        AT[m].correlation(AT[n]) + nugget(m, n)
    })
    .cholesky()
});

/// Numbers that are kept: of R and then of L.
const NUMBERS: usize = 2 * POINTS;

/// ln R and ln L at [`places`] as they are kept.
pub(crate) fn codes(ln: &DVector<f64>) -> Vec<i16> {
    let limit = f64::from(i16::MAX);
    let code = |x: &f64| (x / UNIT).round().clamp(-limit, limit) as i16;
    ln.iter().map(code).collect()
}

/// Where the hob that found it saw the pot, and how large what the physics leaves was there.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Range {
    pub f_sw_hz: [f64; 2],
    pub i_a: [f64; 2],
    pub misfit: [f64; 2],
}

/// A shape as it is kept.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct KeptShape {
    pub codes: Vec<i16>,
    pub range: Range,
}

impl KeptShape {
    /// Of the right length, and finite.
    pub fn is_sound(&self) -> bool {
        let Range {
            f_sw_hz,
            i_a,
            misfit,
        } = self.range;
        let all = [f_sw_hz, i_a, misfit];
        let numbers = all
            .as_flattened()
            .iter()
            .all(|x| x.is_finite() && *x >= 0.0);
        let rises = f_sw_hz[0] > 0.0 && f_sw_hz[0] <= f_sw_hz[1] && i_a[0] <= i_a[1];
        numbers && rises && self.codes.len() == NUMBERS
    }

    /// Whether a misfit of this deviation can leave it: four of them, or of the least one that there is.
    pub fn is_likely(&self) -> bool {
        let within = |(k, code): (usize, &i16)| {
            let most = 4.0 * self.range.misfit[k / POINTS].max(LEAST_MISFIT) / UNIT;
            f64::from(code.unsigned_abs()) <= most
        };
        self.codes.len() == NUMBERS && self.codes.iter().enumerate().all(within)
    }
}

/// A shape at any place.
#[derive(Clone, Debug)]
pub(crate) struct Shape {
    kept: KeptShape,
    weights: [DVector<f64>; 2],
}

impl Shape {
    /// From what was kept and is sound.
    pub fn of(kept: KeptShape) -> Self {
        let weights = [0, 1].map(|x| {
            let code = |k: usize| kept.codes.get(x * POINTS + k).copied().unwrap_or(0);
            let ln = DVector::from_fn(POINTS, |k, _| f64::from(code(k)) * UNIT);
            let factor = FACTOR.as_ref();
            factor.map_or(DVector::zeros(POINTS), |f| f.solve(&ln))
        });
        Self { kept, weights }
    }

    /// What is to be kept.
    pub fn kept(&self) -> &KeptShape {
        &self.kept
    }

    /// ln R and ln L beside the physics at a frequency in hertz and a current in ampere.
    pub fn at(&self, f_hz: f64, i_a: f64) -> [f64; 2] {
        let here = Place::of(f_hz, i_a);
        let near = DVector::from_iterator(POINTS, AT.iter().map(|at| at.correlation(here)));
        [0, 1].map(|x| near.dot(&self.weights[x]))
    }

    /// Variance that ln R and ln L have there because another hob found the shape, and where it did not see the pot.
    pub fn variance(&self, f_hz: f64, i_a: f64) -> [f64; 2] {
        let Range {
            f_sw_hz: [low_hz, high_hz],
            i_a: [low_a, high_a],
            misfit,
        } = self.kept.range;
        let nearest = Place::of(f_hz.clamp(low_hz, high_hz), i_a.clamp(low_a, high_a));
        let common = Place::of(f_hz, i_a).correlation(nearest).powi(2);
        misfit.map(|tau| tau * tau * ((1.0 - common).max(0.0) + TRANSFER * TRANSFER))
    }
}
