//! Misfit of the physics: smooth normal processes of ln R and ln L over ln f and the lookup's current axis.

use ihd_shared::lookup::grid::{CURRENTS, I_BEND_MA, I_MAX_MA};

use crate::heat::changes;

/// Correlation length of the misfit in ln f: half the way from 30 to 80 kHz. Its causes, harmonics of the current and
/// shapes of B(H), change R by a few percent that vary this slowly.
const REACH_LN_F: f64 = 0.5;

/// Correlation length of the misfit in knots of the current axis: half of it.
const REACH_KNOTS: f64 = 8.0;

/// Correlation length of the misfit in ln s: heat and frequency act through the skin depth alone, and 1/f changes it like s².
const REACH_LN_S: f64 = 0.5 * REACH_LN_F;

/// Share of the misfit's variance that is rougher over frequency, by the factor `ROUGHNESS_FACTOR`. A perfectly smooth process would make
/// the deviations between and beside measured frequencies too small.
const ROUGH_SHARE: f64 = 1e-3;
const ROUGHNESS_FACTOR: f64 = 4.0;

/// Coordinate of a current's amplitude in ampere on the lookup's axis, in knots.
pub fn current_knots(i_a: f64) -> f64 {
    let bend_a = f64::from(I_BEND_MA) * 1e-3;
    let whole = (1.0 + f64::from(I_MAX_MA) * 1e-3 / bend_a).ln();
    (1.0 + i_a.max(0.0) / bend_a).ln() / whole * (CURRENTS - 1) as f64
}

/// Current's amplitude in ampere at a coordinate in knots.
pub fn current_of_knots(knots: f64) -> f64 {
    let bend_a = f64::from(I_BEND_MA) * 1e-3;
    let whole = (1.0 + f64::from(I_MAX_MA) * 1e-3 / bend_a).ln();
    bend_a * ((knots / (CURRENTS - 1) as f64 * whole).exp() - 1.0)
}

/// Place of the map: frequency, current and time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct MapPoint {
    pub ln_f: f64,
    pub knots: f64,
    /// Age in seconds.
    age_s: f64,
}

impl MapPoint {
    pub fn new(f_hz: f64, i_a: f64) -> Self {
        Self {
            ln_f: f_hz.ln(),
            knots: current_knots(i_a),
            age_s: 0.0,
        }
    }

    /// The same place at another time.
    pub fn aged(self, age_s: f64) -> Self {
        Self { age_s, ..self }
    }

    /// Correlation of the misfits at two places.
    pub fn correlation(self, other: Self) -> f64 {
        let f = (self.ln_f - other.ln_f) / REACH_LN_F;
        let i = (self.knots - other.knots) / REACH_KNOTS;
        let apart_s = self.age_s - other.age_s;
        let i = i * i + changes(apart_s, apart_s) / REACH_LN_S.powi(2);
        let rough = (ROUGHNESS_FACTOR * f).powi(2) + i;
        (1.0 - ROUGH_SHARE) * (-0.5 * (f * f + i)).exp() + ROUGH_SHARE * (-0.5 * rough).exp()
    }
}

#[cfg(test)]
mod tests {
    use ihd_shared::lookup::grid::{current_a, current_coordinate};

    use super::*;

    #[test]
    fn knots_are_the_lookups() {
        for k in 0..CURRENTS {
            assert!((current_knots(current_a(k)) - k as f64).abs() < 1e-9);
            assert!((current_of_knots(k as f64) - current_a(k)).abs() < 1e-9);
        }
        let fixed = current_coordinate(12_345) as f64 / 65_536.0;
        assert!((current_knots(12.345) - fixed).abs() < 1e-3);
        assert_eq!(current_knots(-1.0), 0.0);
    }
}
