//! Search for faults that reach over the edges: a slow voltage, whose edges have tails, and a skew longer than the guards. The
//! capture is corrected and the rest estimated again, until nothing is left.

use std::cmp::Ordering;

use super::super::delay::delay;
use super::choose::{MIN_SKEW_GAIN, MODELS, ModelChoice, choose, choose_between, edges};
use super::correction::Correction;
use super::edges::{Edges, Stretch};
use super::error::BlindError;
use super::fit::Model;
use super::samples::StretchSamples;

/// Result after such a correction; both times are 0 if there was none.
pub(super) struct SettledChoice {
    pub chosen: ModelChoice,
    /// Time constant of the voltage in seconds.
    pub v_tau_s: f64,
    /// Skew that was corrected before, in seconds.
    pub skew_s: f64,
}

/// Least skew in seconds that may have another cause: a voltage bandwidth of 2.7 MHz.
const MIN_S: f64 = 60e-9;

/// Start values for the time constant of a slow voltage, as shares of the skew: the tails make it look slower.
const STARTS: [f64; 4] = [1.0, 0.75, 0.55, 0.4];

/// Largest residual of another explanation, as a share of a skew's residual.
const MAX_RESIDUAL_SHARE: f64 = 0.5;

/// Most rounds of a search; the second constant is the change in seconds that ends it.
const MAX_ROUNDS: usize = 6;
const ROUND_S: f64 = 0.2e-9;

/// Chooses a model, and searches for faults that reach over the edges if a skew explains too little.
pub(super) fn settle(
    stretches: &[Stretch<'_>],
    settling_s: Option<f64>,
) -> Result<SettledChoice, BlindError> {
    let edges = edges(stretches);
    let plain = choose_between(&edges, settling_s, &MODELS)?;
    let skew = plain.skew_s;
    let nothing = |chosen| SettledChoice {
        chosen,
        v_tau_s: 0.0,
        skew_s: 0.0,
    };
    let shared = match settling_s {
        None => shared_filter(&edges, &plain),
        Some(_) => None,
    };
    let shared = match shared {
        Some(shared) if !remains(&shared, &plain) => return Ok(nothing(shared)),
        other => other,
    };
    let is_long = skew.value.abs() >= MIN_S.max(10.0 * skew.sigma);
    let is_within_guards = !plain.is_late() && skew.value.abs() < plain.after_s;
    if !is_long || (plain.is_flat() && is_within_guards) {
        return Ok(nothing(shared.unwrap_or(plain)));
    }
    let skewed = skewed(stretches, skew.value, settling_s);
    // A slow voltage looks late; not searched if a shared filter is known.
    let slow = (skew.value > 0.0 && settling_s.is_none())
        .then(|| slow_voltage(stretches, skew.value))
        .flatten();
    let limit = MAX_RESIDUAL_SHARE * share(&plain);
    if plain.is_flat() {
        // Long guards leave out the tails of a slow voltage, and a current from before the edge: without the fault the plateaus are longer, or
        // as long and closer to the model.
        let known = shared.as_ref().unwrap_or(&plain);
        let explains = |c: &SettledChoice| {
            let is_longer = c.chosen.samples > known.samples.max(plain.samples);
            c.chosen.is_flat() && (is_longer || c.chosen.gain_over(known) > MIN_SKEW_GAIN)
        };
        // Ringing makes guards long, too.
        let skewed = skewed.filter(|c| share(&c.chosen) <= limit);
        let of_fault = slow.into_iter().chain(skewed).filter(explains);
        let best = of_fault.max_by(|a, b| better(&a.chosen, &b.chosen));
        return Ok(best.unwrap_or_else(|| nothing(shared.unwrap_or(plain))));
    }
    let good = |c: &SettledChoice| c.chosen.is_flat() || share(&c.chosen) < limit;
    let of = |c: &Option<SettledChoice>| c.as_ref().map_or(f64::INFINITY, |c| share(&c.chosen));
    let (of_slow, of_skew) = (of(&slow), of(&skewed));
    if let Some(shared) = shared.filter(|s| share(s) < of_slow.min(of_skew)) {
        return Ok(nothing(shared));
    }
    Ok(match (slow.filter(good), skewed.filter(good)) {
        (Some(slow), other) if of_slow < of_skew || other.is_none() => slow,
        (_, Some(skewed)) => skewed,
        _ => nothing(plain),
    })
}

/// Returns the model after a skew of about `skew_s` seconds.
fn skewed(
    stretches: &[Stretch<'_>],
    skew_s: f64,
    settling_s: Option<f64>,
) -> Option<SettledChoice> {
    let matched = |skew_s: f64| {
        let alike = Correction {
            skew_s,
            ..Correction::default()
        };
        choose_corrected(stretches, &alike, settling_s)
    };
    let (skew_s, chosen) = refined(skew_s, matched)?;
    Some(SettledChoice {
        chosen,
        v_tau_s: 0.0,
        skew_s,
    })
}

/// Returns the model with a slow voltage that looks like a skew of `skew_s` seconds.
fn slow_voltage(stretches: &[Stretch<'_>], skew_s: f64) -> Option<SettledChoice> {
    let matched = |v_tau_s: f64| {
        let alike = Correction {
            v_tau_s,
            ..Correction::default()
        };
        choose_corrected(stretches, &alike, Some(v_tau_s))
    };
    let tried = STARTS
        .into_iter()
        .filter_map(|share| Some((share * skew_s, matched(share * skew_s)?)));
    let best = tried.min_by(|a, b| share(&a.1).total_cmp(&share(&b.1)))?;
    let (v_tau_s, chosen) = refined(best.0, matched)?;
    (v_tau_s > 0.0).then_some(SettledChoice {
        chosen,
        v_tau_s,
        skew_s: 0.0,
    })
}

/// Least skew in seconds that may be the tail of a filter that both channels share, and its least ratio to its standard deviation.
const MIN_TAIL_S: f64 = 4e-9;
const MIN_TAIL_SIGMAS: f64 = 8.0;

/// Time constants in seconds of such a filter, tried first: 100 kHz to 800 kHz.
const SHARED_S: [f64; 7] = [0.2e-6, 0.28e-6, 0.4e-6, 0.57e-6, 0.8e-6, 1.1e-6, 1.6e-6];

/// Largest skew that remains with the filter, as a share of the skew without; with a true skew all of it does.
const MAX_REMAINING_SHARE: f64 = 0.3;

/// Share of the skew that the filter explains which stays unsure: it need not have one pole.
const UNSURE_SHARE: f64 = 0.05;

/// Share of the skew that remains with the filter which stays unsure: two unlike filters look so, too.
const REMAINING_UNSURE_SHARE: f64 = 0.1;

/// Returns the model with a filter that both channels share, if that explains a skew or a part of it: its tails after the edges look like
/// one, and it changes neither R nor L. A filter that explains more of the plateaus, but not clearly, makes the skew of `plain` unsure.
fn shared_filter(edges: &[(&Stretch<'_>, Edges)], plain: &ModelChoice) -> Option<ModelChoice> {
    let skew = plain.skew_s;
    let is_long = skew.value.abs() >= MIN_TAIL_S.max(MIN_TAIL_SIGMAS * skew.sigma);
    if !is_long && !plain.is_late() {
        return None;
    }
    // A droop bends a plateau much as a tail does.
    let models = [Model::Right, Model::Skew];
    let with = |tau_s: f64| choose_between(edges, Some(tau_s), &models).ok();
    let tried = SHARED_S
        .into_iter()
        .filter_map(|tau_s| Some((tau_s, with(tau_s)?)));
    let (mut tau_s, mut best) = tried.max_by(|a, b| better(&a.1, &b.1))?;
    for step in [1.2, 1.1, 1.05, 1.02] {
        for next_s in [tau_s * step, tau_s / step] {
            let next = with(next_s).filter(|next| better(next, &best).is_gt());
            if let Some(next) = next {
                (tau_s, best) = (next_s, next);
            }
        }
    }
    let shared_s = skew.value - best.skew_s.value;
    let mut unsure_s = UNSURE_SHARE * shared_s;
    let explains = best.is_flat() && (!plain.is_flat() || best.samples >= plain.samples);
    if explains && remains(&best, plain) {
        unsure_s = unsure_s.hypot(REMAINING_UNSURE_SHARE * best.skew_s.value);
        // Without a filter, no plateau is longer with one.
        if best.samples <= plain.samples || share(&best) >= share(plain) {
            return None;
        }
        if share(&best) > MAX_RESIDUAL_SHARE * share(plain) {
            (best, unsure_s) = (plain.clone(), shared_s);
        }
    }
    best.skew_s.sigma = best.skew_s.sigma.hypot(unsure_s);
    explains.then_some(best)
}

/// Returns `true` if most of a skew remains with a filter that both channels share.
fn remains(shared: &ModelChoice, plain: &ModelChoice) -> bool {
    shared.skew_s.value.abs() > MAX_REMAINING_SHARE * plain.skew_s.value.abs()
}

/// Order by how much of a plateau a model explains, then by how well.
fn better(a: &ModelChoice, b: &ModelChoice) -> Ordering {
    let flat = a.is_flat().cmp(&b.is_flat());
    flat.then(a.samples.total_cmp(&b.samples))
        .then(share(b).total_cmp(&share(a)))
}

fn share(chosen: &ModelChoice) -> f64 {
    chosen.fit.misfit.share
}

fn choose_corrected(
    stretches: &[Stretch<'_>],
    alike: &Correction,
    settling_s: Option<f64>,
) -> Option<ModelChoice> {
    let corrected: Vec<_> = stretches.iter().map(|s| s.corrected(alike)).collect();
    choose(&corrected, settling_s).ok()
}

/// Adds the remaining skew to the value as long as it becomes smaller.
fn refined(start: f64, look: impl Fn(f64) -> Option<ModelChoice>) -> Option<(f64, ModelChoice)> {
    let (mut number, mut now) = (start, look(start)?);
    for _ in 0..MAX_ROUNDS {
        let left = now.skew_s.value;
        if left.abs() < ROUND_S {
            break;
        }
        match look(number + left) {
            Some(next) if next.skew_s.value.abs() < left.abs() => {
                (number, now) = (number + left, next);
            }
            _ => break,
        }
    }
    Some((number, now))
}

impl Stretch<'_> {
    fn corrected(&self, correction: &Correction) -> Stretch<'static> {
        let (mut v_v, mut i_a) = (self.v_v.to_vec(), self.i_a.to_vec());
        correction.filter(&mut v_v, &mut i_a, self.dt_s);
        if correction.skew_s != 0.0 {
            let mut late: Vec<f32> = i_a.iter().map(|i| *i as f32).collect();
            delay(&mut late, correction.skew_s / self.dt_s);
            i_a = late.into_iter().map(f64::from).collect();
        }
        Stretch {
            v_v: StretchSamples::Doubles(v_v),
            i_a: StretchSamples::Doubles(i_a),
            dt_s: self.dt_s,
            f_sw_hz: self.f_sw_hz,
        }
    }
}
