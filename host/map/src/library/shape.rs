//! Shape of a pot beside the physics of seven numbers: ln R and ln L of its map less those of its model, over frequency and
//! current.
//!
//! It comes from harmonics of the current and the shape of B(H). Both belong to the metal, so that the shape is shared with the pot.

use std::sync::LazyLock;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use serde::{Deserialize, Serialize};

use crate::misfit::{MapPoint, current_of_knots};

/// Frequencies in hertz of the stored shape; like the knots of its current axis they are closer than the misfit's correlation.
const FREQUENCIES_HZ: [f64; 4] = [32e3, 44e3, 60e3, 82e3];
const KNOTS: [f64; 4] = [1.5, 6.0, 10.5, 15.0];

const POINTS: usize = FREQUENCIES_HZ.len() * KNOTS.len();

/// Unit of the stored values: 1e-5 of R or L, which limits them to a third.
pub const UNIT: f64 = 1e-5;

/// Least misfit with which a shape is used: the linearisation around the fit has an error of this size.
const MIN_MISFIT: f64 = 0.004;

/// Variance as a share of the misfit's, which keeps the interpolation bounded far from its points.
const NUGGET: f64 = 1e-3;

/// Share of the misfit that changes with coil and lift (docs/map.md).
const TRANSFER: f64 = 0.1;

/// Places of the stored shape as frequency in hertz and current in ampere; places of one frequency are adjacent.
pub fn places() -> Vec<(f64, f64)> {
    let of = |f_hz: f64| KNOTS.map(move |knots| (f_hz, current_of_knots(knots)));
    FREQUENCIES_HZ.into_iter().flat_map(of).collect()
}

static AT: LazyLock<Vec<MapPoint>> = LazyLock::new(|| {
    let of = |(f_hz, i_a): (f64, f64)| MapPoint::new(f_hz, i_a);
    places().into_iter().map(of).collect()
});

static FACTOR: LazyLock<Option<Cholesky<f64, Dyn>>> = LazyLock::new(|| {
    let nugget = |m, n| if m == n { NUGGET } else { 0.0 };
    DMatrix::from_fn(POINTS, POINTS, |m, n| {
        AT[m].correlation(AT[n]) + nugget(m, n)
    })
    .cholesky()
});

/// Number of stored values: of R, then of L.
const NUMBERS: usize = 2 * POINTS;

/// Stored values of ln R and ln L at [`places`].
pub(crate) fn codes(ln: &DVector<f64>) -> Vec<i16> {
    let limit = f64::from(i16::MAX);
    let code = |x: &f64| (x / UNIT).round().clamp(-limit, limit) as i16;
    ln.iter().map(code).collect()
}

/// Range in which the finding hob measured the pot, and its misfit there.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Range {
    pub f_sw_hz: [f64; 2],
    pub i_a: [f64; 2],
    pub misfit: [f64; 2],
}

/// Stored form of a shape.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ShapeState {
    pub codes: Vec<i16>,
    pub range: Range,
}

impl ShapeState {
    /// Returns `true` if it has the right length and finite values.
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

    /// Returns `true` if a misfit of this deviation can cause the shape: within four deviations, or four of the least misfit.
    pub fn is_likely(&self) -> bool {
        let within = |(k, code): (usize, &i16)| {
            let most = 4.0 * self.range.misfit[k / POINTS].max(MIN_MISFIT) / UNIT;
            f64::from(code.unsigned_abs()) <= most
        };
        self.codes.len() == NUMBERS && self.codes.iter().enumerate().all(within)
    }
}

/// Shape interpolated to any place.
#[derive(Clone, Debug)]
pub(crate) struct Shape {
    state: ShapeState,
    weights: [DVector<f64>; 2],
}

impl Shape {
    /// Interpolates a stored shape, which must be sound.
    pub fn from_state(state: ShapeState) -> Self {
        let weights = [0, 1].map(|x| {
            let code = |k: usize| state.codes.get(x * POINTS + k).copied().unwrap_or(0);
            let ln = DVector::from_fn(POINTS, |k, _| f64::from(code(k)) * UNIT);
            let factor = FACTOR.as_ref();
            factor.map_or(DVector::zeros(POINTS), |f| f.solve(&ln))
        });
        Self { state, weights }
    }

    /// Stored form.
    pub fn state(&self) -> &ShapeState {
        &self.state
    }

    /// ln R and ln L beside the physics at a frequency in hertz and a current in ampere.
    pub fn at(&self, f_hz: f64, i_a: f64) -> [f64; 2] {
        let here = MapPoint::new(f_hz, i_a);
        let near = DVector::from_iterator(POINTS, AT.iter().map(|at| at.correlation(here)));
        [0, 1].map(|x| near.dot(&self.weights[x]))
    }

    /// Variance of ln R and ln L there: the transfer between hobs, and more outside the range that was measured.
    pub fn variance(&self, f_hz: f64, i_a: f64) -> [f64; 2] {
        let Range {
            f_sw_hz: [low_hz, high_hz],
            i_a: [low_a, high_a],
            misfit,
        } = self.state.range;
        let nearest = MapPoint::new(f_hz.clamp(low_hz, high_hz), i_a.clamp(low_a, high_a));
        let common = MapPoint::new(f_hz, i_a).correlation(nearest).powi(2);
        misfit.map(|tau| tau * tau * ((1.0 - common).max(0.0) + TRANSFER * TRANSFER))
    }
}
