//! Surrogate of the field model: a table of R and L over frequency and current.

use ihd_signal::Load;

use ihd_field::harmonic;
use ihd_field::{FieldError, FieldModel};

/// Frequencies of the table in hertz, evenly spaced in ln f: eight from 30 to 85 kHz, and three to either side for
/// hot loads, which are cold ones at another frequency.
const F_FROM_HZ: f64 = 30e3;
const F_TO_HZ: f64 = 85e3;
const F_STEPS: f64 = 7.0;
const F_BELOW: f64 = 3.0;
const F_POINTS: usize = 14;

/// Currents of the table, evenly spaced in log(1 + I/5 A).
const I_TO_A: f64 = 120.0;
const I_KNEE_A: f64 = 5.0;
const I_POINTS: usize = 17;

/// Fundamental impedance of a pot over frequency and current, from the describing function.
#[derive(Clone, Debug, PartialEq)]
pub struct SurrogatePot {
    grid: Vec<[Load; I_POINTS]>,
}

/// One frequency's column.
#[derive(Clone, Debug, PartialEq)]
pub struct SurrogateLoad {
    column: [Load; I_POINTS],
    /// Points of the column for each unit of ln(1 + I/5 A).
    per_log: f64,
}

/// Largest deviations of the table from the describing function, in percent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SurrogateError {
    /// Deviation of R.
    pub r_pct: f64,
    /// Deviation of L.
    pub l_pct: f64,
}

fn f_hz(k: f64) -> f64 {
    F_FROM_HZ * libm::pow(F_TO_HZ / F_FROM_HZ, (k - F_BELOW) / F_STEPS)
}

fn i_a(k: f64) -> f64 {
    I_KNEE_A * (libm::pow(1.0 + I_TO_A / I_KNEE_A, k / (I_POINTS - 1) as f64) - 1.0)
}

/// Cubic interpolation between four neighbours, evenly spaced; `x` counts from the first.
fn cubic(points: [Load; 4], x: f64) -> Load {
    let (a, b, c) = (x - 1.0, x - 2.0, x - 3.0);
    let weights = [
        -a * b * c / 6.0,
        x * b * c / 2.0,
        -x * a * c / 2.0,
        x * a * b / 6.0,
    ];
    let mut sum = Load {
        r_ohm: 0.0,
        l_h: 0.0,
    };
    for (point, weight) in points.iter().zip(weights) {
        sum.r_ohm += weight * point.r_ohm;
        sum.l_h += weight * point.l_h;
    }
    sum
}

/// Index of the first of the four neighbours of `x` among `count` points.
fn first(x: f64, count: usize) -> usize {
    (x as usize).clamp(1, count - 3) - 1
}

/// Weighted mean of the models' impedances: sectors of one pot carry the same current.
pub fn exact(models: &[(f64, FieldModel)], f: f64, i: f64) -> Result<Load, FieldError> {
    let mut sum = Load {
        r_ohm: 0.0,
        l_h: 0.0,
    };
    for (weight, model) in models {
        let z = harmonic::impedance(model, f, i)?;
        sum.r_ohm += weight * z.r_ohm;
        sum.l_h += weight * z.l_h;
    }
    Ok(sum)
}

impl SurrogatePot {
    /// Fills the table from the models and their weights.
    pub fn new(models: &[(f64, FieldModel)]) -> Result<Self, FieldError> {
        let mut grid = Vec::with_capacity(F_POINTS);
        for k in 0..F_POINTS {
            let mut column = [Load {
                r_ohm: 0.0,
                l_h: 0.0,
            }; I_POINTS];
            for (n, cell) in column.iter_mut().enumerate() {
                *cell = exact(models, f_hz(k as f64), i_a(n as f64))?;
            }
            grid.push(column);
        }
        Ok(Self { grid })
    }

    /// Load at a switching frequency in hertz; beyond the table its edge is used.
    pub fn at(&self, f: f64) -> SurrogateLoad {
        let last = (F_POINTS - 1) as f64;
        let x = libm::log(f / F_FROM_HZ) / libm::log(F_TO_HZ / F_FROM_HZ) * F_STEPS + F_BELOW;
        let x = x.clamp(0.0, last);
        let k = first(x, F_POINTS);
        let mut column = self.grid[k];
        for (n, cell) in column.iter_mut().enumerate() {
            *cell = cubic(std::array::from_fn(|m| self.grid[k + m][n]), x - k as f64);
        }
        let per_log = (I_POINTS - 1) as f64 / libm::log(1.0 + I_TO_A / I_KNEE_A);
        SurrogateLoad { column, per_log }
    }

    /// Compares the table with the models between its points.
    pub fn error(&self, models: &[(f64, FieldModel)]) -> Result<SurrogateError, FieldError> {
        let mut worst = SurrogateError::default();
        for k in 0..F_POINTS - 1 {
            let f = f_hz(k as f64 + 0.5);
            let load = self.at(f);
            for n in 0..I_POINTS - 1 {
                let i = i_a(n as f64 + 0.5);
                let z = exact(models, f, i)?;
                let (r, l) = load.r_l(i);
                worst.r_pct = worst.r_pct.max(100.0 * (r / z.r_ohm - 1.0).abs());
                worst.l_pct = worst.l_pct.max(100.0 * (l / z.l_h - 1.0).abs());
            }
        }
        Ok(worst)
    }
}

impl SurrogateLoad {
    /// R in ohm and L in henry at a current amplitude in ampere.
    pub fn r_l(&self, i: f64) -> (f64, f64) {
        let last = (I_POINTS - 1) as f64;
        let x = (libm::log(1.0 + i / I_KNEE_A) * self.per_log).clamp(0.0, last);
        let n = first(x, I_POINTS);
        let z = cubic(std::array::from_fn(|m| self.column[n + m]), x - n as f64);
        (z.r_ohm, z.l_h)
    }
}

#[cfg(test)]
mod tests {
    use super::super::pot::{PotBase, SimulatedPot};
    use super::*;

    #[test]
    fn between_its_points_the_table_is_within_a_thousandth() {
        for pot in [
            SimulatedPot::new(PotBase::Ferritic, 0.21),
            SimulatedPot::new(PotBase::Stainless, 0.18),
        ] {
            let models: Vec<_> = pot
                .field_settings(0.1)
                .unwrap()
                .into_iter()
                .map(|(w, s)| (w, FieldModel::new(&s).unwrap()))
                .collect();
            let error = SurrogatePot::new(&models).unwrap().error(&models).unwrap();
            println!("{pot}: {error:?}");
            assert!(error.r_pct < 0.1 && error.l_pct < 0.1, "{error:?}");
        }
    }
}
