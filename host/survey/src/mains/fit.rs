//! Fit of frequency and crossing of the mains to the envelopes of pieces.

use std::f64::consts::PI;
use std::ops::{Range, RangeInclusive};

use nalgebra::{Matrix3, Vector3};

/// Envelope of one piece: times in seconds and amplitudes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PieceEnvelope {
    /// Times in seconds.
    pub t_s: Vec<f64>,
    /// Amplitudes in any unit.
    pub level: Vec<f64>,
}

/// Nominal frequencies in hertz, between which a short capture can decide.
pub(super) const NOMINAL_HZ: [f64; 2] = [50.0, 60.0];

/// Largest difference in hertz from the nominal frequency that is searched where pauses leave several frequencies possible.
const PAUSED_REACH_HZ: f64 = 1.0;

/// Share of the envelope's variance that the model must explain.
const MIN_EXPLAINED: f64 = 0.8;

/// Most doublings of the view during the search: 60 ms to 30 000 years.
const MAX_VIEWS: u32 = 64;

/// Most moves of one pattern search, so that rounding cannot keep it going. The captures of this crate's tests take 23 at
/// most.
const MAX_MOVES: usize = 300;

/// Initial view of the search in seconds, which is doubled.
pub(super) const FIRST_LOOK_S: f64 = 60e-3;

/// Fit of the envelope.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit {
    pub hz: f64,
    /// Zero crossing near the middle of the fitted part, in seconds.
    pub t0_s: f64,
    /// Sum of squared residuals over that about the pieces' means.
    pub unexplained: f64,
}

/// Frequencies among which the fit chooses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Search {
    /// One frequency in hertz.
    At(f64, Law),
    /// The nominal ones.
    Nominal,
    /// Those within [`PAUSED_REACH_HZ`] of a nominal one.
    NearNominal,
    /// All from one to another, in hertz.
    Free(f64, f64),
}

impl Search {
    pub(super) fn law(self) -> Law {
        match self {
            Self::At(_, law) => law,
            Self::Nominal => Law::ThroughZero,
            Self::NearNominal | Self::Free(..) => Law::Held,
        }
    }

    /// Frequencies in hertz from which to begin, for a view of this time in seconds; those of each list compete over that view alone.
    fn candidates_hz(self, look_s: f64) -> Vec<Vec<f64>> {
        match self {
            Self::At(hz, _) => vec![vec![hz]],
            Self::Nominal => vec![NOMINAL_HZ.to_vec()],
            Self::NearNominal => NOMINAL_HZ.map(|hz| vec![hz]).to_vec(),
            Self::Free(low_hz, high_hz) => {
                let n = ((high_hz - low_hz) * look_s * 8.0).ceil().max(1.0) as usize;
                let step = (high_hz - low_hz) / n as f64;
                vec![(0..=n).map(|k| low_hz + step * k as f64).collect()]
            }
        }
    }

    /// Range in hertz that is searched from there on.
    fn range_hz(self, from_hz: f64) -> RangeInclusive<f64> {
        match self {
            Self::At(..) | Self::Nominal => from_hz..=from_hz,
            Self::NearNominal => from_hz - PAUSED_REACH_HZ..=from_hz + PAUSED_REACH_HZ,
            Self::Free(low_hz, high_hz) => low_hz..=high_hz,
        }
    }
}

/// Fits by a grid over the beginning, then by a search with a doubling view.
pub(super) fn fit(envelopes: &[PieceEnvelope], search: Search) -> Option<Fit> {
    let start_s = envelopes.iter().find_map(|e| e.t_s.first()).copied()?;
    let end_s = envelopes.iter().rev().find_map(|e| e.t_s.last()).copied()?;
    // With pauses, two pieces: one alone does not hold the frequency.
    let second_s = envelopes.get(1).and_then(|e| e.t_s.last());
    let first_look_s = match (search, second_s) {
        (Search::NearNominal, Some(second_s)) => (second_s - start_s).max(FIRST_LOOK_S),
        _ => FIRST_LOOK_S,
    };
    let first_look_s = first_look_s.min(end_s - start_s);
    let law = search.law();
    let middle_s = start_s + 0.5 * first_look_s;
    let from = |candidates: Vec<f64>| {
        let crossings = candidates
            .iter()
            .flat_map(|hz| (0..24).map(move |k| (*hz, k)));
        let fits = crossings.map(|(hz, k)| {
            let t0_s = middle_s + 0.5 / hz * f64::from(k) / 24.0;
            let unexplained = residual(envelopes, start_s + first_look_s, hz, t0_s, law);
            Fit {
                hz,
                t0_s,
                unexplained,
            }
        });
        let mut best = fits.min_by(|a, b| a.unexplained.total_cmp(&b.unexplained))?;
        let range_hz = search.range_hz(best.hz);
        let mut look_s = first_look_s;
        for _ in 0..MAX_VIEWS {
            best = refined(envelopes, start_s..start_s + look_s, best, &range_hz, law);
            // Not `start_s + look_s >= end_s`, which may never hold after rounding.
            if look_s >= end_s - start_s {
                break;
            }
            look_s = (2.0 * look_s).min(end_s - start_s);
        }
        Some(best)
    };
    let all = search.candidates_hz(first_look_s).into_iter();
    let best = all
        .filter_map(from)
        .min_by(|a, b| a.unexplained.total_cmp(&b.unexplained))?;
    (best.unexplained < 1.0 - MIN_EXPLAINED).then_some(best)
}

/// Pattern search in frequency and crossing over a view in seconds.
fn refined(
    envelopes: &[PieceEnvelope],
    view: Range<f64>,
    from: Fit,
    range_hz: &RangeInclusive<f64>,
    law: Law,
) -> Fit {
    let free = range_hz.start() < range_hz.end();
    let half_s = 0.5 / from.hz;
    let (look_s, end_s) = (view.end - view.start, view.end);
    // The crossing nearest to the middle does not depend on the frequency.
    let middle_s = view.start + 0.5 * look_s;
    let t0_s = from.t0_s + ((middle_s - from.t0_s) / half_s).round() * half_s;
    let mut best = Fit {
        t0_s,
        unexplained: residual(envelopes, end_s, from.hz, t0_s, law),
        ..from
    };
    let mut step = (if free { 0.1 / look_s } else { 0.0 }, half_s / 24.0);
    // Down to a microsecond of the crossing.
    let mut moves = 0;
    while step.1 > 1e-6 && moves < MAX_MOVES {
        let mut moved = false;
        for (df, dt) in [(step.0, 0.0), (-step.0, 0.0), (0.0, step.1), (0.0, -step.1)] {
            let (hz, t0_s) = (best.hz + df, best.t0_s + dt);
            if df == 0.0 && dt == 0.0 || free && !range_hz.contains(&hz) {
                continue;
            }
            let unexplained = residual(envelopes, end_s, hz, t0_s, law);
            if unexplained < best.unexplained {
                best = Fit {
                    hz,
                    t0_s,
                    unexplained,
                };
                moved = true;
                moves += 1;
            }
        }
        if !moved {
            step = (0.5 * step.0, 0.5 * step.1);
        }
    }
    best
}

/// Law of the amplitude over the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Law {
    /// c0 + c1 s + c2 s².
    Held,
    /// c1 s + c2 s² + c3 s³.
    ThroughZero,
}

/// Share of the envelopes' variance that the model leaves, without points after `end_s`.
fn residual(envelopes: &[PieceEnvelope], end_s: f64, hz: f64, t0_s: f64, law: Law) -> f64 {
    let (mut left, mut all) = (0.0, 0.0);
    for envelope in envelopes {
        let n = envelope.t_s.partition_point(|t| *t <= end_s);
        if n < 6 {
            continue;
        }
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        let (mut square, mut sum) = (0.0, 0.0);
        for (t, e) in envelope.t_s[..n].iter().zip(&envelope.level) {
            // |sin| repeats with the half-cycle, so that the angle can be kept small.
            let angle = PI * ((t - t0_s) * 2.0 * hz).rem_euclid(1.0);
            let s = libm::sin(angle);
            let row = match law {
                Law::Held => Vector3::new(1.0, s, s * s),
                Law::ThroughZero => Vector3::new(s, s * s, s * s * s),
            };
            normal += row * row.transpose();
            right += row * *e;
            square += e * e;
            sum += e;
        }
        let variance = square - sum * sum / n as f64;
        all += variance;
        let explained = normal.cholesky().map(|c| c.solve(&right).dot(&right));
        left += explained.map_or(variance, |x| (square - x).max(0.0));
    }
    if all > 0.0 { left / all } else { 1.0 }
}
