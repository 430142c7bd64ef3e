//! Regression of v = level − (1/C) ∫ (current behind its sensor) between edges, with several models of the sensor.

use nalgebra::{DMatrix, DVector};

use super::plateau::Plateau;

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

/// Selection of plateaus, and terms beside the model.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scope<'a> {
    pub plateaus: &'a [Plateau],
    /// Side of the plateaus; `None` for both.
    pub side: Option<usize>,
    /// Set to fit the integral of the cubed current, too.
    pub cubic: bool,
    /// Time constant in seconds of a filter's tail after each edge; `None` if there is none.
    pub settling_s: Option<f64>,
}

/// Steps of the Gauss-Newton iteration, which is nearly linear.
const STEPS: usize = 6;

impl Scope<'_> {
    fn of(&self) -> impl Iterator<Item = &Plateau> {
        let side = self.side;
        self.plateaus
            .iter()
            .filter(move |p| side.is_none_or(|s| s == p.side))
    }

    /// Number of columns: 1/C, those of the model, the cubed current; for each side the slope, the bus, the tail.
    fn columns(&self, model: Model) -> usize {
        1 + model.parameters() + usize::from(self.cubic) + 2 * self.of_a_side()
    }

    fn of_a_side(&self) -> usize {
        2 + usize::from(self.settling_s.is_some())
    }

    /// Rows of one plateau: regressors in columns, the voltage last.
    fn rows(&self, p: &Plateau, model: Model, e: f64, t_s: f64, droop: f64) -> DMatrix<f64> {
        let columns = self.columns(model);
        let mut rows = DMatrix::zeros(p.v.len(), columns + 1);
        let shares = model.expansion(t_s);
        let droop = if model.has_droop() { droop } else { 0.0 };
        let first = columns - 2 * self.of_a_side() + p.side * self.of_a_side();
        let tail = self.settling_s.map(|tau_s| p.settling(tau_s));
        for j in 0..p.v.len() {
            let parts = [p.current[j], p.slopes[0][j], p.slopes[1][j]];
            let sum = |of: fn(&(f64, f64)) -> f64| -> f64 {
                shares.iter().zip(parts).map(|(s, x)| of(s) * x).sum()
            };
            let mut column = 0;
            let mut put = |x: f64| {
                rows[(j, column)] = x;
                column += 1;
            };
            put(-(p.charge[j] + sum(|s| s.0) + droop * p.area[j]));
            if model.has_time() {
                put(-e * sum(|s| s.1));
            }
            if model.has_droop() {
                put(-e * p.area[j]);
            }
            if self.cubic {
                put(-e * p.cubed[j]);
            }
            rows[(j, first)] = p.time[j];
            rows[(j, first + 1)] = p.time[j] * p.carrier.v_per_s;
            if let Some(tail) = &tail {
                rows[(j, first + 2)] = tail[j] * p.carrier.v_v;
            }
            rows[(j, columns)] = p.v[j];
        }
        rows
    }

    /// Fits a model; `None` if the plateaus do not determine it.
    pub fn fit(&self, model: Model) -> Option<Fit> {
        let columns = self.columns(model);
        let (mut e, mut t_s, mut droop) = (1e6, 0.0, 0.0);
        let mut solved = None;
        for step in 0..STEPS {
            // The first step fits 1/C with a sensor without fault.
            let model = if step == 0 { Model::Right } else { model };
            let normal = self.normal(model, e, t_s, droop)?;
            let x = normal.solution()?;
            e = x[0];
            let mut next = 1;
            if model.has_time() {
                t_s = (t_s + x[next]).clamp(-MOST_S, MOST_S);
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

    fn normal(&self, model: Model, e: f64, t_s: f64, droop: f64) -> Option<Normal> {
        let columns = self.columns(model);
        let mut all = DMatrix::zeros(columns + 1, columns + 1);
        for p in self.of() {
            let rows = self.rows(p, model, e, t_s, droop);
            all.gemm_tr(1.0, &rows, &rows, 1.0);
        }
        Normal::of(&all)
    }

    /// Covariance from the residuals plateau by plateau, whatever their spectrum; the residuals; and their common shape.
    fn spread(
        &self,
        model: Model,
        (e, t_s, droop): (f64, f64, f64),
        normal: &Normal,
        x: &DVector<f64>,
    ) -> Option<(DMatrix<f64>, (f64, usize), Misfit)> {
        let columns = self.columns(model);
        let mut meat = DMatrix::zeros(columns, columns);
        let (mut left, mut numbers) = (0.0, 0);
        let most = self.of().map(|p| p.v.len()).max()?;
        let mut shape = vec![(0.0, 0.0); 2 * most];
        let mut capacitor = 0.0;
        for p in self.of() {
            let rows = self.rows(p, model, e, t_s, droop);
            let design = rows.columns(0, columns);
            let r = rows.column(columns) - design * x;
            let score = design.transpose() * &r;
            meat.ger(1.0, &score, &score, 1.0);
            left += r.norm_squared();
            numbers += r.len();
            for (j, r) in r.iter().enumerate() {
                let sums = &mut shape[p.side * most + j];
                *sums = (
                    sums.0 + r * p.carrier.v_v,
                    sums.1 + p.carrier.v_v * p.carrier.v_v,
                );
            }
            capacitor += e * e * rows.column(0).norm_squared();
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
const MOST_S: f64 = 4e-6;

/// Normal equations with columns scaled to one.
struct Normal {
    scale: DVector<f64>,
    matrix: DMatrix<f64>,
    right: DVector<f64>,
}

impl Normal {
    fn of(all: &DMatrix<f64>) -> Option<Self> {
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
