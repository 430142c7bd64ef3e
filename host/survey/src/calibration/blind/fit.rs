//! Regression of v = level − (1/C) ∫ (current behind its sensor) between edges, with several models of the sensor.

use nalgebra::{DMatrix, DVector, SMatrix, SVector};

use super::plateau::{Plateau, REGRESSORS, Regressor};

/// Fault of a sensor that plateaus can show.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Model {
    /// No fault.
    Right,
    /// The current is sampled later.
    Skew,
    /// The current goes through a first-order low-pass.
    SlowCurrent,
    /// The current goes through a first-order high-pass.
    Droop,
    /// Skew and droop.
    SkewAndDroop,
    /// Low-pass and droop of the current.
    SlowCurrentAndDroop,
}

impl Model {
    /// Number of parameters beside 1/C: a time in seconds first, then a corner in radian per second.
    pub fn parameters(self) -> usize {
        match self {
            Self::Right => 0,
            Self::Skew | Self::SlowCurrent | Self::Droop => 1,
            Self::SkewAndDroop | Self::SlowCurrentAndDroop => 2,
        }
    }

    fn has_time(self) -> bool {
        !matches!(self, Self::Right | Self::Droop)
    }

    fn has_droop(self) -> bool {
        matches!(
            self,
            Self::Droop | Self::SkewAndDroop | Self::SlowCurrentAndDroop
        )
    }

    /// Coefficients of current and its derivatives in the charge, for a time constant or skew; and the coefficients' derivatives.
    fn expansion(self, t_s: f64) -> [(f64, f64); 3] {
        match self {
            Self::Right | Self::Droop => [(0.0, 0.0); 3],
            // i(t − s)
            Self::Skew | Self::SkewAndDroop => [
                (-t_s, -1.0),
                (0.5 * t_s * t_s, t_s),
                (-t_s.powi(3) / 6.0, -0.5 * t_s * t_s),
            ],
            Self::SlowCurrent | Self::SlowCurrentAndDroop => [(t_s, 1.0), (0.0, 0.0), (0.0, 0.0)],
        }
    }
}

/// Value and its standard deviation.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct FittedValue {
    /// Estimated value.
    pub value: f64,
    /// Standard deviation of the value.
    pub sigma: f64,
}

/// Fit of a model to the plateaus.
#[derive(Clone, Debug)]
pub(super) struct Fit {
    pub model: Model,
    /// 1/C in 1/farad.
    pub elastance: FittedValue,
    /// Skew or time constant in seconds.
    pub time_s: FittedValue,
    /// Corner of the high-pass in radian per second.
    pub droop: FittedValue,
    /// Coefficient of the integral of the cubed current over 1/C; zero unless it was fitted.
    pub cubic: FittedValue,
    /// Change of each side's level per change of the bridge's amplitude.
    pub follows_bus: [f64; 2],
    /// Sum of squared residuals, and their number.
    pub left: (f64, usize),
    /// Residual with the same shape in every plateau.
    pub misfit: Misfit,
}

/// Residual with the same shape in plateau after plateau.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Misfit {
    /// Chi square of the shape's coefficients, and how many there are.
    pub chi_square: (f64, usize),
    /// Root mean square of the shape beyond noise, over that of the capacitor's share in the plateau.
    pub share: f64,
}

/// Sums of products of the regressors over the plateaus of one side: every model's normal equations follow from them.
pub(super) type Moments = SMatrix<f64, REGRESSORS, REGRESSORS>;

/// Moments of both sides.
pub(super) fn moments(plateaus: &[Plateau]) -> [Moments; 2] {
    let mut sums = [[[0.0; REGRESSORS]; REGRESSORS]; 2];
    for p in plateaus {
        let sums = &mut sums[p.side];
        for row in &p.rows {
            for (sums, x) in sums.iter_mut().zip(row) {
                sums.iter_mut().zip(row).for_each(|(s, y)| *s += x * y);
            }
        }
    }
    sums.map(|sums| Moments::from_fn(|a, b| sums[a][b]))
}

/// Selection of plateaus, and terms beside the model.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scope<'a> {
    pub plateaus: &'a [Plateau],
    pub moments: &'a [Moments; 2],
    /// Side of the plateaus; `None` for both.
    pub side: Option<usize>,
    /// Set to fit the integral of the cubed current, too.
    pub cubic: bool,
    /// Set to fit a filter's tail after each edge, too.
    pub tail: bool,
}

/// Steps of the Gauss-Newton iteration, which is nearly linear.
const STEPS: usize = 6;

impl Scope<'_> {
    fn selected_plateaus(&self) -> impl Iterator<Item = &Plateau> {
        let side = self.side;
        self.plateaus
            .iter()
            .filter(move |p| side.is_none_or(|s| s == p.side))
    }

    fn sides(&self) -> impl Iterator<Item = usize> {
        (0..2).filter(|side| self.side.is_none_or(|s| s == *side))
    }

    /// Number of columns: 1/C, those of the model, the cubed current; for each side the slope, the bus, the tail.
    fn columns(&self, model: Model) -> usize {
        1 + model.parameters() + usize::from(self.cubic) + 2 * self.of_a_side()
    }

    fn of_a_side(&self) -> usize {
        2 + usize::from(self.tail)
    }

    /// Columns of one side's plateaus as shares of the regressors: those of the design, the voltage last.
    fn shares(&self, model: Model, side: usize, (e, t_s, droop): (f64, f64, f64)) -> DMatrix<f64> {
        let columns = self.columns(model);
        let mut shares = DMatrix::zeros(REGRESSORS, columns + 1);
        let of_current = model.expansion(t_s);
        let parts = [Regressor::Current, Regressor::Slope, Regressor::Bend];
        shares[(Regressor::Charge as usize, 0)] = -1.0;
        for (part, share) in parts.into_iter().zip(of_current) {
            shares[(part as usize, 0)] = -share.0;
        }
        let mut column = 1;
        if model.has_time() {
            for (part, share) in parts.into_iter().zip(of_current) {
                shares[(part as usize, column)] = -e * share.1;
            }
            column += 1;
        }
        if model.has_droop() {
            shares[(Regressor::Area as usize, 0)] = -droop;
            shares[(Regressor::Area as usize, column)] = -e;
            column += 1;
        }
        if self.cubic {
            shares[(Regressor::Cubed as usize, column)] = -e;
        }
        let first = columns - 2 * self.of_a_side() + side * self.of_a_side();
        let of_side = [Regressor::Time, Regressor::Bus, Regressor::Tail];
        for (k, regressor) in of_side.into_iter().take(self.of_a_side()).enumerate() {
            shares[(regressor as usize, first + k)] = 1.0;
        }
        shares[(Regressor::Voltage as usize, columns)] = 1.0;
        shares
    }

    /// Fits a model; `None` if the plateaus do not determine it.
    pub fn fit(&self, model: Model) -> Option<Fit> {
        let columns = self.columns(model);
        let (mut e, mut t_s, mut droop) = (1e6, 0.0, 0.0);
        let mut solved = None;
        for step in 0..STEPS {
            // The first step fits 1/C with a sensor without fault.
            let model = if step == 0 { Model::Right } else { model };
            let normal = self.normal(model, (e, t_s, droop))?;
            let x = normal.solution()?;
            e = x[0];
            let mut next = 1;
            if model.has_time() {
                t_s = (t_s + x[next]).clamp(-MAX_S, MAX_S);
                next += 1;
            }
            if model.has_droop() {
                droop += x[next];
            }
            solved = Some((normal, x));
        }
        let (normal, mut x) = solved?;
        // The last change of the parameters was applied, so that it is no residual.
        (1..=model.parameters()).for_each(|k| x[k] = 0.0);
        let (cov, left, misfit) = self.spread(model, (e, t_s, droop), &normal, &x)?;
        let sigma = |k: usize| cov[(k, k)].max(0.0).sqrt();
        let estimate = |has: bool, k: usize, value: f64| match has {
            true => FittedValue {
                value,
                sigma: sigma(k),
            },
            false => FittedValue::default(),
        };
        let nuisance = columns - 2 * self.of_a_side();
        Some(Fit {
            model,
            elastance: estimate(true, 0, e),
            time_s: estimate(model.has_time(), 1, t_s),
            droop: estimate(model.has_droop(), 1 + usize::from(model.has_time()), droop),
            cubic: match self.cubic {
                true => estimate(true, nuisance - 1, x[nuisance - 1]),
                false => FittedValue::default(),
            },
            follows_bus: [x[nuisance + 1], x[nuisance + self.of_a_side() + 1]],
            left,
            misfit,
        })
    }

    fn normal(&self, model: Model, at: (f64, f64, f64)) -> Option<Normal> {
        let columns = self.columns(model);
        let mut all = DMatrix::zeros(columns + 1, columns + 1);
        for side in self.sides() {
            let shares = self.shares(model, side, at);
            all += shares.tr_mul(&(self.moments[side] * &shares));
        }
        Normal::from_products(&all)
    }

    /// Covariance from the residuals plateau by plateau, whatever their spectrum; the residuals; and their common shape.
    fn spread(
        &self,
        model: Model,
        at: (f64, f64, f64),
        normal: &Normal,
        x: &DVector<f64>,
    ) -> Option<(DMatrix<f64>, (f64, usize), Misfit)> {
        let columns = self.columns(model);
        let mut meat = DMatrix::zeros(columns, columns);
        let (mut left, mut numbers) = (0.0, 0);
        let most = self.selected_plateaus().map(|p| p.rows.len()).max()?;
        let mut shape = vec![(0.0, 0.0); 2 * most];
        let mut capacitor = 0.0;
        for side in self.sides() {
            let shares = self.shares(model, side, at);
            let design = shares.columns(0, columns);
            let of_residual = shares.column(columns) - design * x;
            let charge = design.column(0);
            capacitor += at.0 * at.0 * charge.dot(&(self.moments[side] * charge));
            let mut scores = Moments::zeros();
            for p in self.selected_plateaus().filter(|p| p.side == side) {
                let mut score = SVector::<f64, REGRESSORS>::zeros();
                for (row, sums) in p.rows.iter().zip(&mut shape[side * most..]) {
                    let row = SVector::from(*row);
                    let r = of_residual.dot(&row);
                    score.axpy(r, &row, 1.0);
                    left += r * r;
                    *sums = (
                        sums.0 + r * p.carrier.v_v,
                        sums.1 + p.carrier.v_v * p.carrier.v_v,
                    );
                }
                scores.ger(1.0, &score, &score, 1.0);
                numbers += p.rows.len();
            }
            meat += design.tr_mul(&(scores * design));
        }
        let free = numbers.checked_sub(columns).filter(|n| *n > 0)?;
        let variance = left / free as f64;
        let inverse = normal.inverse()?;
        let cov = &inverse * meat * &inverse;
        let seen = shape.iter().filter(|s| s.1 > 0.0);
        let chi_square = seen.clone().map(|(r, w)| r * r / w / variance).sum();
        let kinds = seen.count();
        // The part of the shape's square per squared volt that noise does not explain.
        let beyond: f64 = shape
            .iter()
            .filter(|s| s.1 > 0.0)
            .map(|(r, w)| ((r / w).powi(2) - variance / w) * w)
            .sum();
        let share = (beyond.max(0.0) / capacitor).sqrt();
        Some((
            cov,
            (left, numbers),
            Misfit {
                chi_square: (chi_square, kinds),
                share,
            },
        ))
    }
}

/// Largest time constant or skew in seconds for which the expansion holds.
const MAX_S: f64 = 4e-6;

/// Normal equations with columns scaled to one.
struct Normal {
    scale: DVector<f64>,
    matrix: DMatrix<f64>,
    right: DVector<f64>,
}

impl Normal {
    fn from_products(all: &DMatrix<f64>) -> Option<Self> {
        let n = all.nrows() - 1;
        // A column without content, such as the slope of a steady bus, stays unscaled.
        let scale = DVector::from_fn(n, |k, _| match all[(k, k)].sqrt() {
            s if s > 0.0 => 1.0 / s,
            _ => 0.0,
        });
        let matrix = DMatrix::from_fn(n, n, |a, b| {
            let ridge = if a == b { RIDGE } else { 0.0 };
            let empty = a == b && scale[a] == 0.0;
            all[(a, b)] * scale[a] * scale[b] + ridge + f64::from(u8::from(empty))
        });
        let right = DVector::from_fn(n, |k, _| all[(k, n)] * scale[k]);
        let sound = matrix.iter().chain(right.iter()).all(|x| x.is_finite());
        (sound && scale[0] > 0.0).then_some(Self {
            scale,
            matrix,
            right,
        })
    }

    fn solution(&self) -> Option<DVector<f64>> {
        let x = self.matrix.clone().cholesky()?.solve(&self.right);
        Some(x.component_mul(&self.scale))
    }

    fn inverse(&self) -> Option<DMatrix<f64>> {
        let inner = self.matrix.clone().cholesky()?.inverse();
        let n = inner.nrows();
        Some(DMatrix::from_fn(n, n, |a, b| {
            inner[(a, b)] * self.scale[a] * self.scale[b]
        }))
    }
}

/// Regularisation that separates equal columns, in units of a column.
const RIDGE: f64 = 1e-12;
