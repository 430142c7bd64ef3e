//! What one identified window says about the load: R and L over current at one frequency.

use ihd_shared::lookup::grid::{CURRENTS, I_BEND_MA, I_MAX_MA};
use serde::{Deserialize, Serialize};

/// Points per step of the lookup's current axis.
const POINTS_PER_STEP: usize = 8;

/// Points of a curve at most: up to the highest current, and the one at zero current.
pub const MAX_POINTS: usize = POINTS_PER_STEP * (CURRENTS + 3);

/// Currents below this, in ampere, are left out: the firmware's filter holds R and L there, and the
/// network extrapolates.
const LOWEST_A: f64 = 1.0;

/// Currents above this, in ampere, are left out: no hob has them, only a device that lies.
const HIGHEST_A: f64 = 2e-3 * I_MAX_MA as f64;

/// A curve that reaches below this, in ampere, is continued to zero current. No half-cycle shows the
/// load there, but the grid's first knot lies there, and without it the prior's would stay beside
/// cells that know better.
const CONTINUED_BELOW_A: f64 = 3.0;

/// Largest relative change by which a curve is continued: less than a lookup may run the wrong way, so
/// that curves of neighbouring frequencies stay in order.
const CONTINUED_BY: f64 = 0.03;

/// One point: current amplitude in ampere, R in ohm, L in henry.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LoadPoint {
    /// Amplitude of the current's fundamental in ampere.
    pub i_a: f64,
    /// Resistance in ohm.
    pub r_ohm: f64,
    /// Inductance in henry.
    pub l_h: f64,
}

/// R and L over current at one switching frequency, at even steps of the lookup's current axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LoadCurve {
    /// Switching frequency in hertz.
    pub f_sw_hz: f64,
    /// Points of rising current.
    pub points: Vec<LoadPoint>,
}

/// Coordinate of a current on the lookup's axis, in knots.
fn coordinate(i_a: f64) -> f64 {
    let bend_a = f64::from(I_BEND_MA) * 1e-3;
    let whole = (1.0 + f64::from(I_MAX_MA) * 1e-3 / bend_a).ln();
    (1.0 + i_a.max(0.0) / bend_a).ln() / whole * (CURRENTS - 1) as f64
}

impl LoadCurve {
    /// From a half-cycle's samples in time order, current rising and falling: both flanks are
    /// averaged where they pass the same current, so that an envelope that leans does not count
    /// twice. Points that are not finite are left out.
    pub fn from_half_cycle(f_sw_hz: f64, samples: impl Iterator<Item = LoadPoint>) -> Self {
        let mut bins: Vec<(LoadPoint, f64)> = Vec::new();
        let finite = |p: &LoadPoint| p.i_a.is_finite() && p.r_ohm.is_finite() && p.l_h.is_finite();
        for p in samples.filter(|p| finite(p) && (LOWEST_A..=HIGHEST_A).contains(&p.i_a)) {
            let bin = (coordinate(p.i_a) * POINTS_PER_STEP as f64) as usize;
            if bins.len() <= bin {
                let none = LoadPoint {
                    i_a: 0.0,
                    r_ohm: 0.0,
                    l_h: 0.0,
                };
                bins.resize(bin + 1, (none, 0.0));
            }
            let (sum, n) = &mut bins[bin];
            sum.i_a += p.i_a;
            sum.r_ohm += p.r_ohm;
            sum.l_h += p.l_h;
            *n += 1.0;
        }
        let mut points: Vec<LoadPoint> = bins
            .into_iter()
            .filter(|(_, n)| *n > 0.0)
            .map(|(sum, n)| LoadPoint {
                i_a: sum.i_a / n,
                r_ohm: sum.r_ohm / n,
                l_h: sum.l_h / n,
            })
            .collect();
        if let Some(zero) = at_zero_current(&points) {
            points.insert(0, zero);
        }
        Self { f_sw_hz, points }
    }

    /// Weight of one point: a curve that covers a whole step of the axis weighs one there.
    pub fn point_weight() -> f64 {
        1.0 / POINTS_PER_STEP as f64
    }
}

/// The straight line through the two lowest points, at zero current.
fn at_zero_current(points: &[LoadPoint]) -> Option<LoadPoint> {
    let [a, b, ..] = points else {
        return None;
    };
    if a.i_a > CONTINUED_BELOW_A {
        return None;
    }
    let back = a.i_a / (b.i_a - a.i_a);
    let line = |a: f64, b: f64| {
        // R and L fall with current; a slope the other way is noise.
        a + ((a - b) * back).clamp(0.0, CONTINUED_BY * a.max(0.0))
    };
    Some(LoadPoint {
        i_a: 0.0,
        r_ohm: line(a.r_ohm, b.r_ohm),
        l_h: line(a.l_h, b.l_h),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_flanks_are_averaged_and_small_currents_left_out() {
        let flank = |k: usize, r: f64| LoadPoint {
            i_a: 0.5 * k as f64,
            r_ohm: r,
            l_h: 20e-6,
        };
        let samples = (0..80)
            .map(|k| flank(k, 3.0))
            .chain((0..80).rev().map(|k| flank(k, 5.0)));
        let curve = LoadCurve::from_half_cycle(45e3, samples);
        assert!(curve.points.iter().all(|p| (p.r_ohm - 4.0).abs() < 1e-12));
        assert!(curve.points.iter().skip(1).all(|p| p.i_a >= LOWEST_A));
        assert!(curve.points.windows(2).all(|w| w[0].i_a < w[1].i_a));
    }

    #[test]
    fn a_curve_is_continued_to_zero_current_by_its_slope() {
        let line = |k: u32| LoadPoint {
            i_a: 1.0 + f64::from(k),
            r_ohm: 5.0 - 0.1 * f64::from(k),
            l_h: 20e-6,
        };
        let curve = LoadCurve::from_half_cycle(45e3, (0..20).map(line));
        let zero = curve.points[0];
        assert_eq!((zero.i_a, zero.l_h), (0.0, 20e-6));
        assert!((zero.r_ohm - 5.1).abs() < 1e-9, "{zero:?}");
        // One that begins far up says nothing about zero.
        let high = (0..20).map(|k| line(k + 10));
        assert!(LoadCurve::from_half_cycle(45e3, high).points[0].i_a > 10.0);
    }

    /// Found by fuzzing: a panic in `clamp`.
    #[test]
    fn a_negative_resistance_is_continued_as_it_is() {
        let line = |k: u32| LoadPoint {
            i_a: 1.0 + f64::from(k),
            r_ohm: -2.0,
            l_h: 20e-6,
        };
        let curve = LoadCurve::from_half_cycle(45e3, (0..20).map(line));
        assert_eq!(curve.points[0].r_ohm, -2.0);
    }

    #[test]
    fn what_is_not_a_number_is_left_out() {
        let bad = LoadPoint {
            i_a: 10.0,
            r_ohm: f64::NAN,
            l_h: 1e-6,
        };
        assert!(
            LoadCurve::from_half_cycle(45e3, std::iter::once(bad))
                .points
                .is_empty()
        );
    }
}
