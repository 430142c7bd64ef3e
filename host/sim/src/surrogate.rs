//! The field model's surrogate: a table of R and L over frequency and current.

use ihd_signal::Load;

use super::field::harmonic;
use super::field::{FieldError, FieldModel};

/// Frequencies of the table in hertz, evenly spaced in ln f.
const F_FROM_HZ: f64 = 30e3;
const F_TO_HZ: f64 = 85e3;
const F_POINTS: usize = 8;

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
}

/// Largest deviations of the table from the describing function, in percent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TableError {
    /// Of R.
    pub r_pct: f64,
    /// Of L.
    pub l_pct: f64,
}

fn f_hz(k: f64) -> f64 {
    F_FROM_HZ * libm::pow(F_TO_HZ / F_FROM_HZ, k / (F_POINTS - 1) as f64)
}

fn i_a(k: f64) -> f64 {
    I_KNEE_A * (libm::pow(1.0 + I_TO_A / I_KNEE_A, k / (I_POINTS - 1) as f64) - 1.0)
}

fn mix(a: Load, b: Load, w: f64) -> Load {
    Load {
        r_ohm: a.r_ohm + w * (b.r_ohm - a.r_ohm),
        l_h: a.l_h + w * (b.l_h - a.l_h),
    }
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

    /// A load of constant R and L, as the coil alone is.
    pub fn constant(r_ohm: f64, l_h: f64) -> Self {
        Self {
            grid: vec![[Load { r_ohm, l_h }; I_POINTS]; F_POINTS],
        }
    }

    /// The load at a switching frequency in hertz; beyond the table its edge counts.
    pub fn at(&self, f: f64) -> SurrogateLoad {
        let last = (F_POINTS - 1) as f64;
        let x = (libm::log(f / F_FROM_HZ) / libm::log(F_TO_HZ / F_FROM_HZ) * last).clamp(0.0, last);
        let k = (x as usize).min(F_POINTS - 2);
        let w = x - k as f64;
        let mut column = self.grid[k];
        for (cell, above) in column.iter_mut().zip(&self.grid[k + 1]) {
            *cell = mix(*cell, *above, w);
        }
        SurrogateLoad { column }
    }

    /// Compares with the models between the table's points.
    pub fn error(&self, models: &[(f64, FieldModel)]) -> Result<TableError, FieldError> {
        let mut worst = TableError::default();
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
        let scale = last / libm::log(1.0 + I_TO_A / I_KNEE_A);
        let x = (libm::log(1.0 + i / I_KNEE_A) * scale).clamp(0.0, last);
        let n = (x as usize).min(I_POINTS - 2);
        let z = mix(self.column[n], self.column[n + 1], x - n as f64);
        (z.r_ohm, z.l_h)
    }
}

#[cfg(test)]
mod tests {
    use super::super::pot::{Metal, Pot};
    use super::*;

    #[test]
    fn between_its_points_the_table_is_within_half_a_percent() {
        for pot in [
            Pot::new(Metal::Ferritic, 0.21),
            Pot::new(Metal::Stainless, 0.18),
        ] {
            let models: Vec<_> = pot
                .field_settings(0.1)
                .unwrap()
                .into_iter()
                .map(|(w, s)| (w, FieldModel::new(&s).unwrap()))
                .collect();
            let error = SurrogatePot::new(&models).unwrap().error(&models).unwrap();
            println!("{pot}: {error:?}");
            assert!(error.r_pct < 0.5 && error.l_pct < 0.5, "{error:?}");
        }
    }

    #[test]
    fn a_constant_load_is_constant() {
        assert_eq!(
            SurrogatePot::constant(0.1, 5e-5).at(52e3).r_l(17.0),
            (0.1, 5e-5)
        );
    }
}
