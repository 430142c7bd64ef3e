//! Kalman filter for ΔT and lift, from R and L and the pot's physics at the operating point.
//!
//! State: rise in K, its rate in K/s, lift since placement in mm, error of the pot's model in ln R and ln L in ‰, and the slope of
//! that error over ln f (the current follows the frequency). The last four change with the operating point alone, while heat changes
//! the rise by some kelvin a second at most. At a step of power the rise is therefore kept, and the model's error at the new point
//! is learned.

use ihd_map::PotModel;
use nalgebra::{SMatrix, SVector};

use crate::batch::HalfCycleBatch;
use crate::metal::MetalLaw;

type Vector = SVector<f64, 7>;
type Matrix = SMatrix<f64, 7, 7>;

/// Standard deviation of the rate: 2.2 kW on a base of 600 J/K are 3.7 K/s at first, some tenths once the contents take the heat.
const RATE_K_PER_S: f64 = 0.8;

/// Correlation time of the rate in seconds.
const RATE_LASTS_S: f64 = 30.0;

/// Relative change of power that changes the rate at once, by the change over the base's heat capacity; and that capacity's
/// relative error.
const POWER_STEP: (f64, f64) = (0.05, 0.4);

/// Random walk of lift by a base that bows, in mm per root of a second: 0.2 mm in two minutes.
const BOWING_MM: f64 = 0.02;

/// Random walk of the model's error in ln R and ln L beside its slope, in ‰ per root of an e-fold of frequency or current. The
/// device's own bias varies by as much (docs/accuracy.md, aliasing).
const MODEL: (f64, f64) = (3.0, 1.5);

/// Slope of the model's error in ‰ per e-fold of frequency: describing function against waveform, or physics fitted to a pot of
/// another kind.
const SLOPE: (f64, f64) = (20.0, 10.0);

/// Initial error of the model in ‰.
const MODEL_AT_FIRST: f64 = 30.0;

/// Deviation of a rise after a change of side at the turn, as a share of the distance between both sides.
const SIDE_CHANGE_SHARE: f64 = 0.3;

/// Limit of χ² of two residuals, which chance exceeds in 3e-7 of batches.
const MAX_CHI2: f64 = 30.0;

/// Changes of lift in mm and of the model in ‰ that a move may cause.
const MOVE_MM_PERMILLE: (f64, f64) = (2.0, 30.0);

/// Least changes in mm and ‰ that are reported as a move.
const MIN_MOVE_MM_PERMILLE: (f64, f64) = (0.15, 8.0);

/// Motion of the pot that a batch shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PotMotion {
    /// Not moved.
    Same,
    /// Moved.
    Moved {
        /// Change of lift in mm.
        lift_mm: f64,
        /// Set if lift alone explains R and L; else the pot was shifted, too.
        straight: bool,
    },
}

/// Kalman filter of one pot.
#[derive(Clone, Debug)]
pub struct ThermalFilter {
    pot: PotModel,
    metal: MetalLaw,
    x: Vector,
    p: Matrix,
    t_s: f64,
    power_w: f64,
    /// ln f and ln I of the last batch.
    at: Option<(f64, f64)>,
    /// ln f of the first batch.
    first_ln_f: Option<f64>,
    /// Heat capacity of the base in J/K.
    base_j_per_k: f64,
}

/// Residuals and their derivatives.
struct Innovation {
    r: SVector<f64, 2>,
    h: SMatrix<f64, 2, 7>,
    noise: SMatrix<f64, 2, 2>,
}

impl Innovation {
    fn covariance(&self, p: &Matrix) -> SMatrix<f64, 2, 2> {
        self.h * p * self.h.transpose() + self.noise
    }

    fn chi2(&self, p: &Matrix) -> f64 {
        let s = self.covariance(p);
        s.cholesky()
            .map_or(f64::INFINITY, |c| self.r.dot(&c.solve(&self.r)))
    }
}

impl ThermalFilter {
    /// Creates the filter of a pot put on at `t_s`, with its estimated rise in K and rate in K/s since, and its base's heat
    /// capacity in J/K.
    pub fn new(
        pot: PotModel,
        metal: MetalLaw,
        t_s: f64,
        (rise_k, rate): (f64, f64),
        base_j_per_k: f64,
    ) -> Self {
        let sigma = [
            0.5 + 0.3 * rise_k.abs(),
            0.1 + 0.4 * rate.abs(),
            0.01,
            MODEL_AT_FIRST,
            MODEL_AT_FIRST,
            SLOPE.0,
            SLOPE.1,
        ];
        Self {
            pot,
            metal,
            x: Vector::from([rise_k, rate, 0.0, 0.0, 0.0, 0.0, 0.0]),
            p: Matrix::from_diagonal(&Vector::from(sigma.map(|s| s * s))),
            t_s,
            power_w: f64::NAN,
            at: None,
            first_ln_f: None,
            base_j_per_k,
        }
    }

    /// Rise since placement in kelvin and its standard deviation, for the metal's class.
    pub fn rise_k(&self) -> (f64, f64) {
        (self.x[0], self.p[(0, 0)].max(0.0).sqrt())
    }

    /// Lift since placement in mm and its standard deviation.
    pub fn lift_mm(&self) -> (f64, f64) {
        (self.x[2], self.p[(2, 2)].max(0.0).sqrt())
    }

    /// Heat capacity of the base in J/K.
    pub fn base_j_per_k(&self) -> f64 {
        self.base_j_per_k
    }

    /// Law of the metal.
    pub fn metal(&self) -> &MetalLaw {
        &self.metal
    }

    /// Sets the rise to the one with the same R and L on the other side of the turn, and the alloy's effect that the turn has shown.
    pub fn change_side(&mut self, rise_k: f64, metal: MetalLaw) {
        self.metal = metal;
        let off = rise_k - self.x[0];
        self.x[0] = rise_k;
        self.x[1] = -self.x[1];
        // The rise meanwhile is unknown.
        self.p[(0, 0)] += (SIDE_CHANGE_SHARE * off) * (SIDE_CHANGE_SHARE * off);
    }

    /// Predicts the state at a time, with the present mean power in watt.
    pub fn advance(&mut self, t_s: f64, power_w: f64) {
        let dt_s = (t_s - self.t_s).clamp(0.0, 3600.0);
        self.t_s = self.t_s.max(t_s);
        let decay = (-dt_s / RATE_LASTS_S).exp();
        let lasted_s = RATE_LASTS_S * (1.0 - decay);
        let mut f = Matrix::identity();
        f[(0, 1)] = lasted_s;
        f[(1, 1)] = decay;
        self.x = f * self.x;
        self.p = f * self.p * f.transpose();
        let rate_var = RATE_K_PER_S * RATE_K_PER_S * (1.0 - decay * decay);
        self.p[(1, 1)] += rate_var;
        self.p[(0, 0)] += rate_var * dt_s * dt_s / 3.0;
        self.p[(2, 2)] += BOWING_MM * BOWING_MM * dt_s;
        if self.power_w.is_nan() {
            self.power_w = power_w;
        }
        let (share, unsure) = POWER_STEP;
        let step_w = power_w - self.power_w;
        if step_w.abs() > share * self.power_w.max(power_w).max(100.0) {
            let change = step_w / self.base_j_per_k;
            self.x[1] += change;
            self.p[(1, 1)] += (unsure * change) * (unsure * change);
            self.power_w = power_w;
        }
    }

    /// Updates the state with a batch; [`ThermalFilter::advance`] must be called first.
    pub fn update(&mut self, batch: &HalfCycleBatch) -> PotMotion {
        let at = (batch.f_hz.ln(), batch.i_a.ln());
        let moved = self
            .at
            .replace(at)
            .map_or(0.0, |(f, i)| (at.0 - f).abs() + (at.1 - i).abs());
        self.p[(3, 3)] += MODEL.0 * MODEL.0 * moved;
        self.p[(4, 4)] += MODEL.1 * MODEL.1 * moved;
        let first = *self.first_ln_f.get_or_insert(at.0);
        let innovation = self.innovation(batch, at.0 - first);
        if !innovation.r.iter().all(|r| r.is_finite()) {
            return PotMotion::Same;
        }
        if innovation.chi2(&self.p) < MAX_CHI2 {
            self.correct(&innovation);
            return PotMotion::Same;
        }
        // Faster than heat can be: the pot was moved.
        let before = self.x;
        self.p[(2, 2)] += MOVE_MM_PERMILLE.0 * MOVE_MM_PERMILLE.0;
        let straight = innovation.chi2(&self.p) < MAX_CHI2;
        if !straight {
            self.p[(3, 3)] += MOVE_MM_PERMILLE.1 * MOVE_MM_PERMILLE.1;
            self.p[(4, 4)] += MOVE_MM_PERMILLE.1 * MOVE_MM_PERMILLE.1;
        }
        self.correct(&innovation);
        let change = self.x - before;
        let reported = change[2].abs() > MIN_MOVE_MM_PERMILLE.0
            || change[3].abs().max(change[4].abs()) > MIN_MOVE_MM_PERMILLE.1;
        match reported {
            true => PotMotion::Moved {
                lift_mm: change[2],
                straight,
            },
            false => PotMotion::Same,
        }
    }

    fn innovation(&self, batch: &HalfCycleBatch, ln_f: f64) -> Innovation {
        let (change, slope) = self.metal.ln_s_change(self.x[0]);
        let pot = PotModel {
            ln_s: self.pot.ln_s + change,
            lift_m: self.pot.lift_m + 1e-3 * self.x[2],
            ..self.pot
        };
        let (z, by) = pot.sensitivities(batch.f_hz, batch.i_a);
        let (heat, lift) = (by.ln_s, by.lift);
        let permille = 1e3;
        let mut h = SMatrix::<f64, 2, 7>::zeros();
        h[(0, 0)] = permille * heat.ln_r * slope;
        h[(1, 0)] = permille * heat.ln_l * slope;
        // Per metre equals ‰ per mm.
        h[(0, 2)] = lift.ln_r;
        h[(1, 2)] = lift.ln_l;
        h[(0, 3)] = 1.0;
        h[(1, 4)] = 1.0;
        h[(0, 5)] = ln_f;
        h[(1, 6)] = ln_f;
        let r = [
            permille * (batch.ln_r - z.r_ohm.ln()) - self.x[3] - ln_f * self.x[5],
            permille * (batch.ln_l - z.l_h.ln()) - self.x[4] - ln_f * self.x[6],
        ];
        let variance = |sigma: f64| (permille * sigma) * (permille * sigma);
        Innovation {
            r: r.into(),
            h,
            noise: SMatrix::<f64, 2, 2>::new(
                variance(batch.r_sigma),
                0.0,
                0.0,
                variance(batch.l_sigma),
            ),
        }
    }

    fn correct(&mut self, innovation: &Innovation) {
        let Innovation { r, h, noise } = innovation;
        let Some(inverse) = innovation.covariance(&self.p).try_inverse() else {
            return;
        };
        let gain = self.p * h.transpose() * inverse;
        self.x += gain * r;
        // Joseph's form keeps it a covariance.
        let left = Matrix::identity() - gain * h;
        self.p = left * self.p * left.transpose() + gain * noise * gain.transpose();
    }
}
