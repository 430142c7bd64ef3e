//! True load of a simulation, which estimators are not given.

use ihd_shared::lookup::grid::{CURRENTS, FREQUENCIES};

use crate::interpolation::linear;
use crate::load::{Load, ORDERS};

/// Truth over one switching period, or two.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PeriodTruth {
    /// Middle of the periods measured, in seconds.
    pub t_s: f64,
    /// Switching frequency in hertz.
    pub f_sw_hz: f64,
    /// R of each order in ohm.
    pub r_ohm: [f64; ORDERS.len()],
    /// L of each order in henry.
    pub l_h: [f64; ORDERS.len()],
    /// Amplitude of the current's fundamental in ampere.
    pub i_a: f64,
    /// Mean of v i over mean of i², P/I_rms², in ohm.
    pub r_power_ohm: f64,
    /// Mean of v i in watt.
    pub p_w: f64,
}

/// True R, L and current amplitude over one mains half-cycle.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Truth {
    /// Half-cycle since the start of the simulation, as the firmware counts it.
    pub half_cycle: u32,
    /// Switching frequency in hertz; 0 with the bridge off at the start of the half-cycle.
    pub f_sw_hz: f64,
    /// Times after the zero crossing in seconds, increasing.
    pub t_s: Vec<f64>,
    /// Resistance in ohm at these times.
    pub r_ohm: Vec<f64>,
    /// Inductance in henry at these times.
    pub l_h: Vec<f64>,
    /// Amplitude of the current's fundamental in ampere at these times.
    pub i_a: Vec<f64>,
}

impl Truth {
    /// R in ohm and L in henry at a time after the zero crossing, linear between the points and constant beyond them; `None`
    /// if there are no points.
    pub fn at(&self, t_s: f64) -> Option<(f64, f64)> {
        let at = |values: &[f64]| linear(&self.t_s, values, t_s);
        Some((at(&self.r_ohm)?, at(&self.l_h)?))
    }
}

/// True R and L in the cells of a lookup.
#[derive(Clone, Debug, PartialEq)]
pub struct MapTruth {
    /// R and L at the lookup's knots `[frequency][current]`; `None` for operating points that the hob never reaches with this load.
    pub cells: [[Option<Load>; CURRENTS]; FREQUENCIES],
}

impl MapTruth {
    /// Truth of a load that the hob does not heat: no cell is reached.
    pub const UNREACHED: Self = Self {
        cells: [[None; CURRENTS]; FREQUENCIES],
    };

    /// Number of cells that the hob reaches.
    pub fn reached(&self) -> usize {
        self.cells.iter().flatten().flatten().count()
    }
}

/// Mean relative errors of R and L in percent (paper, section V).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mre {
    /// Error of R in percent.
    pub r_pct: f64,
    /// Error of L in percent.
    pub l_pct: f64,
}

impl Mre {
    /// Errors of estimates (time in seconds, R in ohm, L in henry) against the truth; times outside `[from_s, to_s]` do not
    /// count. `None` if no estimate is left to compare.
    pub fn compute(
        truth: &Truth,
        estimates: impl Iterator<Item = (f64, f64, f64)>,
        from_s: f64,
        to_s: f64,
    ) -> Option<Self> {
        let inside = estimates.filter(|e| (from_s..=to_s).contains(&e.0));
        Self::weighted(truth, inside, |_| 1.0)
    }

    /// Errors of all estimates, weighted by a function of time; `None` if none is left to compare.
    pub fn weighted(
        truth: &Truth,
        estimates: impl Iterator<Item = (f64, f64, f64)>,
        weight: impl Fn(f64) -> f64,
    ) -> Option<Self> {
        let mut sum = Self::default();
        let mut weights = 0.0;
        for (t_s, r, l) in estimates {
            let (r0, l0) = truth.at(t_s)?;
            let w = weight(t_s);
            sum.r_pct += w * (r / r0 - 1.0).abs();
            sum.l_pct += w * (l / l0 - 1.0).abs();
            weights += w;
        }
        (weights > 0.0).then_some(Self {
            r_pct: 100.0 * sum.r_pct / weights,
            l_pct: 100.0 * sum.l_pct / weights,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> Truth {
        Truth {
            half_cycle: 0,
            f_sw_hz: 45e3,
            t_s: vec![0.0, 1.0, 2.0],
            r_ohm: vec![1.0, 2.0, 4.0],
            l_h: vec![3.0, 3.0, 1.0],
            i_a: vec![0.0; 3],
        }
    }

    #[test]
    fn between_the_points_it_is_linear() {
        assert_eq!(ramp().at(0.5), Some((1.5, 3.0)));
        assert_eq!(ramp().at(1.5), Some((3.0, 2.0)));
        assert_eq!(ramp().at(-1.0), Some((1.0, 3.0)));
        assert_eq!(ramp().at(9.0), Some((4.0, 1.0)));
        assert_eq!(Truth::default().at(0.0), None);
    }

    #[test]
    fn mean_relative_error_counts_only_its_interval() {
        let estimates = [(0.5, 1.5, 3.3), (1.0, 2.2, 3.0), (2.0, 99.0, 99.0)];
        let mre = Mre::compute(&ramp(), estimates.into_iter(), 0.0, 1.5).unwrap();
        assert!((mre.r_pct - 5.0).abs() < 1e-9 && (mre.l_pct - 5.0).abs() < 1e-9);
        assert_eq!(Mre::compute(&ramp(), estimates.into_iter(), 5.0, 6.0), None);
        // Three parts of 0 and 10 % and one of 10 % and 0.
        let weight = |t: f64| if t < 0.7 { 3.0 } else { 1.0 };
        let first = estimates.into_iter().take(2);
        let mre = Mre::weighted(&ramp(), first, weight).unwrap();
        assert!((mre.r_pct - 2.5).abs() < 1e-9 && (mre.l_pct - 7.5).abs() < 1e-9);
    }
}
