//! What reaches over the edges: a slow voltage, whose edges have tails, and a skew longer than the guards. The capture gets the
//! correction, and what is left is looked for again, until nothing is.

use super::super::delay::delay;
use super::choose::{Chosen, choose};
use super::edges::Stretch;
use super::{BlindError, Correction};

/// What is left when that has been matched, and what it was: both 0 where there is none.
pub(super) struct Settled {
    pub chosen: Chosen,
    /// Time constant of the voltage in seconds.
    pub v_tau_s: f64,
    /// Skew that was taken out before, in seconds.
    pub skew_s: f64,
}

/// Least skew that may be something else, in seconds: a voltage's bandwidth of 2.7 MHz.
const LEAST_S: f64 = 60e-9;

/// Shares of the skew that a slow voltage's search begins with: the tails make it look slower.
const STARTS: [f64; 4] = [1.0, 0.75, 0.55, 0.4];

/// Share of what a skew leaves that another explanation may leave at most.
const BETTER: f64 = 0.5;

/// Rounds of a search, and the change in seconds that ends it.
const ROUNDS: usize = 6;
const ROUND_S: f64 = 0.2e-9;

/// Chooses, and where a skew explains too little, looks for what reaches over the edges.
pub(super) fn settle(
    stretches: &[Stretch],
    settling_s: Option<f64>,
) -> Result<Settled, BlindError> {
    let plain = choose(stretches, settling_s)?;
    let found = plain.skew_s;
    let nothing = |chosen| Settled {
        chosen,
        v_tau_s: 0.0,
        skew_s: 0.0,
    };
    // Where it explains everything, it is as good.
    if plain.is_flat() || found.value.abs() < LEAST_S.max(10.0 * found.sigma) {
        return Ok(nothing(plain));
    }
    let skewed = refined(found.value, |skew_s| {
        let alike = Correction {
            skew_s,
            ..Correction::default()
        };
        looked(stretches, &alike, settling_s)
    });
    // A slow voltage seems to be behind; a filter that both share has been told of.
    let slow = (found.value > 0.0 && settling_s.is_none()).then(|| {
        let matched = |v_tau_s: f64| {
            let alike = Correction {
                v_tau_s,
                ..Correction::default()
            };
            looked(stretches, &alike, Some(v_tau_s))
        };
        let tried = STARTS
            .into_iter()
            .filter_map(|share| Some((share * found.value, matched(share * found.value)?)));
        let best = tried.min_by(|a, b| share(&a.1).total_cmp(&share(&b.1)))?;
        refined(best.0, matched)
    });
    let slow = slow.flatten().filter(|(tau_s, _)| *tau_s > 0.0);
    let limit = BETTER * share(&plain);
    let good = |found: &(f64, Chosen)| found.1.is_flat() || share(&found.1) < limit;
    let of_slow = slow.as_ref().map_or(f64::INFINITY, |s| share(&s.1));
    let of_skew = skewed.as_ref().map_or(f64::INFINITY, |s| share(&s.1));
    Ok(match (slow.filter(good), skewed.filter(good)) {
        (Some((v_tau_s, chosen)), other) if of_slow < of_skew || other.is_none() => Settled {
            chosen,
            v_tau_s,
            skew_s: 0.0,
        },
        (_, Some((skew_s, chosen))) => Settled {
            chosen,
            v_tau_s: 0.0,
            skew_s,
        },
        _ => nothing(plain),
    })
}

fn share(chosen: &Chosen) -> f64 {
    chosen.fit.misfit.share
}

fn looked(stretches: &[Stretch], alike: &Correction, settling_s: Option<f64>) -> Option<Chosen> {
    let corrected: Vec<Stretch> = stretches.iter().map(|s| s.corrected(alike)).collect();
    choose(&corrected, settling_s).ok()
}

/// Adds the skew that is left to the number, for as long as that becomes smaller.
fn refined(start: f64, look: impl Fn(f64) -> Option<Chosen>) -> Option<(f64, Chosen)> {
    let (mut number, mut now) = (start, look(start)?);
    for _ in 0..ROUNDS {
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

impl Stretch {
    fn corrected(&self, correction: &Correction) -> Self {
        let mut out = self.clone();
        correction.filter(&mut out.v_v, &mut out.i_a, self.dt_s);
        if correction.skew_s != 0.0 {
            let mut late: Vec<f32> = out.i_a.iter().map(|i| *i as f32).collect();
            delay(&mut late, correction.skew_s / self.dt_s);
            out.i_a = late.into_iter().map(f64::from).collect();
        }
        out
    }
}
