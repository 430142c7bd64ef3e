//! Detection of boiling: two physical models of the contents are fitted to the curve of ΔT and compared.
//!
//! Both have a base, contents above it, and losses. In the first the contents boil: once the base's face is above the boiling point,
//! bubbles carry its heat (Rohsenow: flux ∝ superheat³), and the bulk stays at that point. In the second nothing boils, and the losses
//! may grow with temperature: oil, food, an empty pot, a simmer that comes to rest. Boiling is reported only if the second model
//! explains the curve much worse.

use crate::least_squares::{FitResult, Prior, fit};

/// Initial step of the models in seconds; doubled when there are too many steps.
const STEP_S: f64 = 2.0;

/// Most steps: half an hour of initial ones. A fit takes some milliseconds with them.
const MAX_STEPS: usize = 900;

/// Standard deviation of a step's ΔT against its model, in kelvin. Noise of ΔT at 2 s is below 1 K; the rest stands for errors
/// that last for many steps.
const SIGMA_K: f64 = 2.0;

/// χ² by which the model without boiling must be worse. By Wilks' theorem an excess beyond 25 of two more parameters has a
/// probability of 4e-6 per evaluation; evaluations of one pot share their data.
const MIN_BOILING_CHI2: f64 = 25.0;

/// χ² per step above which a model does not explain the curve: it is fitted from other starts, and boiling is not reported.
const MAX_CHI2_PER_STEP: f64 = 1.0;

/// Additional starts of the model without boiling, in J/K and W/m²K^(4/3): empty pot, oil, soup.
const OTHER_STARTS: [(f64, f64); 3] = [(150.0, 10.0), (1e3, 40.0), (1e4, 200.0)];

/// Distance in kelvin below the fitted boiling point from which the bulk counts as boiling. The boiling point is no more precise, so
/// that reports are early as often as late.
const NEAR_BOIL_K: f64 = 2.0;

/// Steps between two fits.
const STEPS_PER_FIT: usize = 3;

/// Steps after placement in which no boiling is reported: only bases heat so quickly.
const FIRST_BOILING_STEP: usize = 15;

/// Nucleate boiling, W/m²K³ (Rohsenow, water on polished steel).
const NUCLEATE: f64 = 131.0;

/// Heat capacity of the base in J/m²K: 5 mm of steel.
pub(crate) const BASE_J_PER_M2K: f64 = 17.5e3;

/// Heat capacity of the lower wall, which heats with the base, in J/K.
pub(crate) const WALL_J_PER_K: f64 = 100.0;

/// Conductance from the base to the glass in W/K, which belongs to the hob and is known. Then the glass's heat capacity in J/K and
/// its losses in W/K.
const BELOW_W_PER_K: f64 = 8.0;
const GLASS_J_PER_K: f64 = 280.0;
const GLASS_W_PER_K: f64 = 1.5;

/// Losses of wall and lid to the room over the base's area, in W/m²K: a pot 0.6 times as high as wide, 10 W/m²K. The fit scales them.
const AROUND_W_PER_M2K: f64 = 34.0;

/// Losses of a base that is not covered to the air in it, in W/m²K: convection and radiation, about half each. They grow with
/// temperature as the wall's do.
const DRY_W_PER_M2K: f64 = 10.0;

/// Parameters of a model, at the same index in both: ln of the contents' J/K, ln of the convection's factor in W/m²K^(4/3), ln of
/// the losses' factor, ln of the base's J/K. The model with boiling adds the boiling point's rise in K and ln of the resistance
/// through the base in m²K/W; the other adds growth of the losses in 1/K and the same resistance.
type Parameters = [f64; 6];

/// State of the contents.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContentsState {
    /// Set if bubbles carry most of the heat: the base is on its plateau.
    pub bubbles: bool,
    /// Set if all of the contents boil.
    pub boils: bool,
    /// Beginning of boiling in seconds on the clock of the half-cycles; `None` if they do not boil.
    pub boils_since_s: Option<f64>,
}

/// One step of the curve.
#[derive(Clone, Copy, Debug)]
struct Step {
    power_w: f64,
    /// Mean of ΔT in kelvin; `None` if it is unknown.
    rise_k: Option<f64>,
}

/// Curve of ΔT since placement, and the fits of both models.
#[derive(Clone, Debug)]
pub struct ContentsFit {
    area_m2: f64,
    began_s: f64,
    step_s: f64,
    steps: Vec<Step>,
    energy_j: f64,
    /// Sum of ΔT in kelvin since the last whole step, and its number.
    sums: (f64, usize),
    boiling: Option<Parameters>,
    dry: Option<Parameters>,
    state: ContentsState,
    agreed: u32,
}

/// State of a model at one step.
#[derive(Clone, Copy, Debug, Default)]
struct State {
    base_k: f64,
    face_k: f64,
    bulk_k: f64,
    glass_k: f64,
    bubbles: f64,
}

impl ContentsFit {
    /// Creates the curve of a pot with a base of this radius in metre, put on at `t_s`.
    pub fn new(radius_m: f64, t_s: f64) -> Self {
        Self {
            area_m2: std::f64::consts::PI * radius_m * radius_m,
            began_s: t_s,
            step_s: STEP_S,
            steps: Vec::new(),
            energy_j: 0.0,
            sums: (0.0, 0),
            boiling: None,
            dry: None,
            state: ContentsState::default(),
            agreed: 0,
        }
    }

    /// State of the contents as of the last evaluation.
    pub fn state(&self) -> ContentsState {
        self.state
    }

    /// Rise of the boiling point in kelvin; `None` if the contents do not boil.
    pub fn boiling_point_k(&self) -> Option<f64> {
        self.boiling.filter(|_| self.state.boils).map(|x| x[4])
    }

    /// Adds energy in joule until `t_s`, and ΔT in kelvin at that time if it is known. Energy over more than one step's end, as after
    /// lost half-cycles, is spread evenly; ΔT is that of the last step.
    pub fn push(&mut self, t_s: f64, energy_j: f64, mut rise_k: Option<f64>) {
        self.energy_j += energy_j;
        let mean_w = self.energy_j / (t_s - self.end_s(0));
        let spread_w = (t_s >= self.end_s(2)).then_some(mean_w);
        while t_s >= self.end_s(1) {
            if self.steps.len() >= MAX_STEPS {
                self.halve();
                continue;
            }
            if t_s < self.end_s(2) {
                self.add_rise(rise_k.take());
            }
            let energy_j = spread_w.map_or(self.energy_j, |power_w| power_w * self.step_s);
            let (sum_k, count) = std::mem::take(&mut self.sums);
            self.steps.push(Step {
                power_w: energy_j / self.step_s,
                rise_k: (count > 0).then(|| sum_k / count as f64),
            });
            self.energy_j -= energy_j;
            if self.steps.len() >= FIRST_BOILING_STEP
                && self.steps.len().is_multiple_of(STEPS_PER_FIT)
            {
                self.evaluate();
            }
        }
        self.add_rise(rise_k);
    }

    /// Adds ΔT in kelvin to the mean of the step that is not whole yet.
    fn add_rise(&mut self, rise_k: Option<f64>) {
        if let Some(rise_k) = rise_k {
            self.sums.0 += rise_k;
            self.sums.1 += 1;
        }
    }

    /// End in seconds of the step that is `n` steps after the last whole one.
    fn end_s(&self, n: usize) -> f64 {
        self.began_s + (self.steps.len() + n) as f64 * self.step_s
    }

    /// Doubles the steps' length and halves their number.
    fn halve(&mut self) {
        let pairs = self.steps.chunks(2).map(|pair| {
            let known: Vec<f64> = pair.iter().filter_map(|s| s.rise_k).collect();
            let n = known.len() as f64;
            Step {
                power_w: pair.iter().map(|s| s.power_w).sum::<f64>() / pair.len() as f64,
                rise_k: (n > 0.0).then(|| known.iter().sum::<f64>() / n),
            }
        });
        self.steps = pairs.collect();
        self.step_s *= 2.0;
    }

    fn evaluate(&mut self) {
        let boiling = self.fitted(true);
        let dry = self.fitted(false);
        (self.boiling, self.dry) = (Some(boiling.x), Some(dry.x));
        // χ² by which the model without boiling explains the curve worse.
        let evidence = dry.chi2 - boiling.chi2;
        let mut boils_at = None;
        let mut state = State::default();
        self.run(&boiling.x, true, |k, s| {
            state = s;
            if boils_at.is_none() && s.bulk_k >= boiling.x[4] - NEAR_BOIL_K {
                boils_at = Some(k);
            }
        });
        let explained = boiling.chi2 < MAX_CHI2_PER_STEP * self.known();
        let sure = explained && evidence > MIN_BOILING_CHI2;
        let (bubbles, boils) = (sure && state.bubbles > 0.5, sure && boils_at.is_some());
        // Reported only after two evaluations agree.
        self.agreed = if bubbles { self.agreed + 1 } else { 0 };
        let agreed = self.agreed >= 2;
        self.state = ContentsState {
            bubbles: bubbles && agreed,
            boils: boils && agreed,
            boils_since_s: boils_at
                .filter(|_| boils && agreed)
                .map(|k| self.began_s + (k + 1) as f64 * self.step_s),
        };
    }

    fn fitted(&self, boils: bool) -> FitResult<6> {
        let prior = |mean, sigma| Prior { mean, sigma };
        let base = (BASE_J_PER_M2K * self.area_m2 + WALL_J_PER_K).ln();
        // 5 mm of steel; cores of aluminium and copper conduct ten times better.
        let through = prior(1.5e-4f64.ln(), 0.7);
        let priors = match boils {
            true => [
                // 0.2 to 6 litre of water.
                prior(6e3f64.ln(), 0.9),
                // Water at 20 °C (Nu = 0.15 Ra^1/3); the factor covers stirring.
                prior(218f64.ln(), 0.3),
                prior(0.0, 0.25),
                prior(base, 0.25),
                // From 5 to 35 °C, with a metal's coefficient that is wrong by a tenth.
                prior(80.0, 12.0),
                through,
            ],
            false => [
                prior(2e3f64.ln(), 1.5),
                prior(60f64.ln(), 1.2),
                prior(0.3, 1.0),
                prior(base, 0.3),
                prior(0.004, 0.01),
                through,
            ],
        };
        let before = match boils {
            true => self.boiling,
            false => self.dry,
        };
        let from = |start| {
            fit(&priors, start, 12, |x, out| {
                self.run(x, boils, |k, state| {
                    if let Some(rise_k) = self.steps[k].rise_k {
                        out.push((rise_k - state.base_k) / SIGMA_K);
                    }
                });
            })
        };
        let fresh = priors.map(|p| p.mean);
        let mut best = from(before.unwrap_or(fresh));
        // The minimum of the last evaluation may be the wrong one.
        let mut starts = vec![fresh];
        if !boils {
            starts.extend(OTHER_STARTS.map(|(contents, factor)| {
                let mut x = fresh;
                (x[0], x[1]) = (f64::ln(contents), f64::ln(factor));
                x
            }));
        }
        for start in starts {
            if best.chi2 > MAX_CHI2_PER_STEP * self.known() {
                let other = from(start);
                if other.chi2 < best.chi2 {
                    best = other;
                }
            }
        }
        best
    }

    /// Number of steps with a known ΔT.
    fn known(&self) -> f64 {
        self.steps.iter().filter(|s| s.rise_k.is_some()).count() as f64
    }

    /// Runs a model over the powers; `each` receives its state after each step.
    fn run(&self, x: &Parameters, boils: bool, mut each: impl FnMut(usize, State)) {
        let (contents, factor, losses) = (x[0].exp(), x[1].exp(), x[2].exp());
        let (base, through) = (x[3].exp(), self.area_m2 / x[5].exp());
        let (below, around) = (BELOW_W_PER_K, losses * AROUND_W_PER_M2K * self.area_m2);
        let boil_k = if boils { x[4] } else { f64::INFINITY };
        let growth = if boils { 0.0 } else { x[4].max(0.0) };
        // Losses to the air beside the contents, in W/K².
        let dry = losses * DRY_W_PER_M2K * self.area_m2 * growth;
        let mut s = State::default();
        for (k, step) in self.steps.iter().enumerate() {
            let (up_w, slope) = self.settle(&mut s, factor, through, boil_k);
            let down_w = below * (s.base_k - s.glass_k);
            let glass = GLASS_J_PER_K + self.step_s * (below + GLASS_W_PER_K);
            s.glass_k += (down_w - GLASS_W_PER_K * s.glass_k) * self.step_s / glass;
            let out_w = up_w + down_w + dry * s.base_k * s.base_k.max(0.0);
            // Linearly implicit, which is stable for all parameters.
            let stiff = slope + below + 2.0 * dry * s.base_k.max(0.0);
            s.base_k += (step.power_w - out_w) * self.step_s / (base + self.step_s * stiff);
            let lost_w = around * (1.0 + growth * s.bulk_k.max(0.0)) * s.bulk_k;
            let bulk_k =
                s.bulk_k + (up_w - lost_w) * self.step_s / (contents + self.step_s * slope);
            s.bulk_k = bulk_k.min(boil_k);
            each(k, s);
        }
    }

    /// Iterates the base's inner face to equilibrium; returns heat into the contents in W, and its slope over the base's temperature
    /// in W/K.
    fn settle(&self, s: &mut State, factor: f64, through: f64, boil_k: f64) -> (f64, f64) {
        let (mut q, mut slope, mut bubbles) = (0.0, 1.0, 0.0);
        for _ in 0..4 {
            let rise = s.face_k - s.bulk_k;
            let over = (s.face_k - boil_k).max(0.0);
            bubbles = self.area_m2 * NUCLEATE * over * over * over;
            // Natural convection of water, better when it is warm: viscosity falls.
            let warm = 1.0 + 0.0093 * (s.face_k + s.bulk_k).clamp(0.0, 300.0);
            let root = rise.abs().cbrt().max(0.3);
            let convection = self.area_m2 * factor * warm * root;
            q = convection * rise + bubbles;
            slope = 4.0 / 3.0 * convection + 3.0 * self.area_m2 * NUCLEATE * over * over;
            s.face_k += (through * (s.base_k - s.face_k) - q) / (through + slope);
        }
        s.bubbles = if q > 0.0 { bubbles / q } else { 0.0 };
        let up_w = through * (s.base_k - s.face_k);
        (up_w, through * slope / (through + slope))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A link that is silent for ten seconds, while the hob heats with 1 kW.
    #[test]
    fn heat_of_a_gap_is_spread_over_its_steps_and_its_temperature_is_the_last_ones() {
        let mut pot = ContentsFit::new(0.09, 0.0);
        pot.push(1.0, 1_000.0, Some(2.0));
        pot.push(11.0, 10_000.0, Some(8.0));
        // What is left of it belongs to the next step.
        pot.push(12.0, 1_000.0, None);
        let powers_w: Vec<f64> = pot.steps.iter().map(|s| s.power_w).collect();
        assert_eq!(powers_w.len(), 6);
        assert!(
            powers_w.iter().all(|w| (w - 1_000.0).abs() < 1e-9),
            "{powers_w:?}"
        );
        let rises_k: Vec<_> = pot.steps.iter().map(|s| s.rise_k).collect();
        assert_eq!(rises_k, [Some(2.0), None, None, None, Some(8.0), None]);
    }

    #[test]
    fn an_uncovered_base_settles_where_its_losses_are_its_power() {
        for radius_m in [0.06, 0.12] {
            let mut pot = ContentsFit::new(radius_m, 0.0);
            for k in 1..=600 {
                pot.push(10.0 * f64::from(k), 10.0 * 250.0, None);
            }
            // Hardly any convection into the contents, losses that grow by 2 % a kelvin.
            let parameters = [6e3f64.ln(), -30.0, 0.0, 500f64.ln(), 0.02, 1.5e-4f64.ln()];
            let mut base_k = 0.0;
            pot.run(&parameters, false, |_, state| base_k = state.base_k);
            let to_glass = BELOW_W_PER_K * GLASS_W_PER_K / (BELOW_W_PER_K + GLASS_W_PER_K);
            let to_air = DRY_W_PER_M2K * std::f64::consts::PI * radius_m * radius_m;
            let lost_w = to_glass * base_k + to_air * 0.02 * base_k * base_k;
            assert!(
                (lost_w - 250.0).abs() < 10.0,
                "{radius_m}: {base_k} K, {lost_w} W"
            );
        }
    }
}
