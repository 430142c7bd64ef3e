//! Choice of plateaus, guards and sensor model, by the capture itself.

use super::basis::Bases;
use super::edges::{Edges, Stretch};
use super::error::BlindError;
use super::fit::{Fit, FittedValue, Model, Scope, moments};
use super::plateau::{Guards, Plateau, of_stretch};

/// Chosen model and its results.
#[derive(Clone, Debug)]
pub(super) struct ModelChoice {
    pub fit: Fit,
    /// Side of the plateaus that were used: the one whose level is ground; `None` for both.
    pub side: Option<usize>,
    /// Relative change of the charge at the largest current, proportional to the cubed current.
    pub bend: FittedValue,
    /// Squared deviations that the chosen model explains beyond a skew.
    pub beyond_skew: f64,
    pub plateaus: usize,
    /// Mean number of samples per plateau.
    pub samples: f64,
    /// Largest amplitude of the current in ampere.
    pub i_a: f64,
    /// Lag expressed as a skew, whatever its cause.
    pub skew_s: FittedValue,
    /// Guard after an edge in seconds.
    pub after_s: f64,
}

/// All models.
pub(super) const MODELS: [Model; 6] = [
    Model::Right,
    Model::Skew,
    Model::SlowCurrent,
    Model::Droop,
    Model::SkewAndDroop,
    Model::SlowCurrentAndDroop,
];

/// Guards after an edge in seconds, tried in order: an edge of 0.2 µs with ringing; a filter of 500 kHz; the slowest that
/// leaves half a plateau.
const AFTER_S: [f64; 5] = [0.3e-6, 0.7e-6, 1.2e-6, 1.8e-6, 2.6e-6];

/// Guard before an edge in seconds: the uncertainty of the phase.
const BEFORE_S: f64 = 0.1e-6;

/// Fewest plateaus per side.
const MIN_PLATEAUS: usize = 20;

/// Least gain in squared deviations over a skew, for a model of equal freedom, to distinguish it from a skew.
pub(super) const MIN_SKEW_GAIN: f64 = 12.0;

/// Chooses a model for the plateaus of the stretches. `settling_s` is the time constant of a filter that both channels
/// share, which leaves a tail after each edge.
pub(super) fn choose(
    stretches: &[Stretch<'_>],
    settling_s: Option<f64>,
) -> Result<ModelChoice, BlindError> {
    choose_between(&edges(stretches), settling_s, &MODELS)
}

/// Finds the edges of the stretches; those without are left out.
pub(super) fn edges<'s, 'c>(stretches: &'s [Stretch<'c>]) -> Vec<(&'s Stretch<'c>, Edges)> {
    let with_edges = stretches.iter().map(|s| Some((s, s.edges()?)));
    with_edges.flatten().collect()
}

/// Chooses one of these models, as [`choose`], between edges that are known.
pub(super) fn choose_between(
    edges: &[(&Stretch<'_>, Edges)],
    settling_s: Option<f64>,
    models: &[Model],
) -> Result<ModelChoice, BlindError> {
    let mut best: Option<ModelChoice> = None;
    let mut bases = Bases::default();
    let mut most = 0;
    for after_s in AFTER_S {
        // Edges are located to a third of a sample.
        let of = |s: &Stretch<'_>| Guards {
            before_s: BEFORE_S + 0.4 * s.dt_s,
            after_s,
        };
        let plateaus: Vec<Plateau> = edges
            .iter()
            .flat_map(|(s, edges)| of_stretch(s, edges, of(s), settling_s, &mut bases))
            .collect();
        most = most.max(plateaus.len());
        let Some(now) = judge(&plateaus, settling_s.is_some(), models) else {
            continue;
        };
        let now = ModelChoice { after_s, ..now };
        let fits = now.is_flat();
        let better = |b: &ModelChoice| now.fit.misfit.share < 0.7 * b.fit.misfit.share;
        if fits || best.as_ref().is_none_or(better) {
            best = Some(now);
        }
        if fits {
            break;
        }
    }
    best.ok_or(match most {
        0 => BlindError::NoEdges,
        plateaus => BlindError::TooFew { plateaus },
    })
}

/// Largest share of the capacitor's voltage that may remain with the same shape in every plateau.
const MAX_MISFIT_SHARE: f64 = 2e-3;

impl ModelChoice {
    /// Returns `true` if the plateaus begin later than an edge with ringing needs, so that a filter may have tails there.
    pub fn is_late(&self) -> bool {
        self.after_s > AFTER_S[0]
    }

    /// Squared deviations that this model explains beyond another one of the same plateaus; 0 of other plateaus.
    pub fn gain_over(&self, other: &Self) -> f64 {
        let ((own, numbers), (others, others_numbers)) = (self.fit.left, other.fit.left);
        match numbers == others_numbers && own > 0.0 {
            true => (others / own - 1.0) * numbers as f64,
            false => 0.0,
        }
    }

    /// Returns `true` if the plateaus are flat except for noise and a small misfit.
    pub fn is_flat(&self) -> bool {
        let (chi_square, kinds) = self.fit.misfit.chi_square;
        let usual = kinds as f64 + 5.0 * (2.0 * kinds as f64).sqrt();
        chi_square < usual || self.fit.misfit.share < MAX_MISFIT_SHARE
    }
}

/// Largest difference of the two sides in standard deviations: of 1/C relatively, and of the time in seconds.
const SIDES_SIGMAS: f64 = 3.5;
const SIDES_SHARE: f64 = 2e-3;
const SIDES_S: f64 = 1.5e-9;

fn judge(plateaus: &[Plateau], tail: bool, models: &[Model]) -> Option<ModelChoice> {
    let moments = moments(plateaus);
    let scope = |side| Scope {
        plateaus,
        moments: &moments,
        side,
        cubic: false,
        tail,
    };
    let of_side = |side: usize| {
        let enough = plateaus.iter().filter(|p| p.side == side).count() >= MIN_PLATEAUS;
        let fit = scope(Some(side)).fit(Model::Skew);
        fit.filter(|_| enough)
    };
    let sides = [of_side(0), of_side(1)];
    let side = match &sides {
        [Some(a), Some(b)] if agree(a, b) => None,
        // The level that does not follow the mains is ground; a bus sags under the current that it feeds.
        [Some(a), Some(b)] => {
            let still = |f: &Fit, side: usize| f.follows_bus[side].abs();
            Some(usize::from(still(b, 1) < still(a, 0)))
        }
        [Some(_), None] => Some(0),
        [None, Some(_)] => Some(1),
        [None, None] => return None,
    };
    let mut scope = scope(side);
    let (fit, skew_s, beyond_skew) = best_model(&scope, models)?;
    scope.cubic = true;
    let used = || plateaus.iter().filter(|p| side.is_none_or(|s| s == p.side));
    let i_a = used().map(|p| p.carrier.i_a).fold(0.0, f64::max);
    let bend = scope
        .fit(fit.model)
        .map_or(FittedValue::default(), |f| FittedValue {
            value: 0.75 * f.cubic.value * i_a * i_a,
            sigma: 0.75 * f.cubic.sigma * i_a * i_a,
        });
    let count = used().count();
    Some(ModelChoice {
        fit,
        side,
        bend,
        beyond_skew,
        plateaus: count,
        samples: used().map(|p| p.samples as f64).sum::<f64>() / count as f64,
        i_a,
        skew_s,
        after_s: 0.0,
    })
}

fn agree(a: &Fit, b: &Fit) -> bool {
    let within = |a: FittedValue, b: FittedValue, least: f64| {
        let apart = (a.value - b.value).abs();
        apart <= least.max(SIDES_SIGMAS * a.sigma.hypot(b.sigma))
    };
    within(a.elastance, b.elastance, SIDES_SHARE * a.elastance.value)
        && within(a.time_s, b.time_s, SIDES_S)
}

/// Model with the least Bayesian information criterion; the equivalent skew; and the squared deviations that the model
/// explains beyond a skew.
fn best_model(scope: &Scope, models: &[Model]) -> Option<(Fit, FittedValue, f64)> {
    let fits = models.iter().filter_map(|model| scope.fit(*model));
    let all: Vec<Fit> = fits.filter(is_physical).collect();
    let skew = scope.fit(Model::Skew)?;
    let least = all.iter().map(|f| f.left.0).fold(f64::INFINITY, f64::min);
    let numbers = skew.left.1 as f64;
    let variance = least / numbers;
    let criterion =
        |fit: &Fit| fit.left.0 / variance + fit.model.parameters() as f64 * numbers.ln();
    let fit = all
        .into_iter()
        .min_by(|a, b| criterion(a).total_cmp(&criterion(b)))?;
    let beyond = (skew.left.0 - fit.left.0) / variance;
    Some((fit, skew.time_s, beyond))
}

/// Returns `true` if time constant and corner are positive, and the corner is far below the carrier: 10 Hz to 8 kHz. A current
/// transformer's is at some hundred hertz; beyond, it was another hob's tone that was "corrected".
fn is_physical(fit: &Fit) -> bool {
    let tau = matches!(fit.model, Model::SlowCurrent | Model::SlowCurrentAndDroop);
    let droop = fit.droop.value == 0.0 || (60.0..5e4).contains(&fit.droop.value);
    droop && (!tau || fit.time_s.value > 0.0)
}
