//! Mains frequency and zero crossings from the envelope of the coil's voltage.
//!
//! The bus follows |sin|, or stays above zero if a capacitor holds it, and the coil's voltage is a function of the bus that
//! depends on the load: E(t) = c0 + c1 s + c2 s² with s = |sin 2πf(t − t0)|. The coefficients belong to one piece, f and t0 to
//! all. Less than a few half-cycles cannot separate a constant from a lower frequency; the law is then c1 s + c2 s² + c3 s³.

use std::f64::consts::PI;
use std::ops::Range;

use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

use super::finding::Finding;

/// Origin of a number of the mains.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum MainsSource {
    /// Given by the user or stated by the capture.
    #[serde(rename = "told")]
    Specified,
    /// Measured from the envelope.
    Measured,
    /// Assumed, because it is neither specified nor measurable.
    Assumed,
}

/// Frequency and phase of the mains.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Mains {
    /// Frequency in hertz.
    pub hz: f64,
    /// Origin of the frequency.
    pub hz_source: MainsSource,
    /// Time of one zero crossing in seconds: the first of the capture unless one is specified.
    pub zero_crossing_s: f64,
    /// Origin of the zero crossing.
    pub zero_crossing_source: MainsSource,
    /// (Largest − smallest)/largest of the voltage's amplitude.
    pub modulation: f64,
}

impl Mains {
    /// Zero crossings from `from_s` to `to_s`, in seconds; a million at most.
    pub fn crossings_s(&self, from_s: f64, to_s: f64) -> Vec<f64> {
        let half_s = 0.5 / self.hz;
        let first = ((from_s - self.zero_crossing_s) / half_s).ceil();
        let count = ((to_s - self.zero_crossing_s) / half_s - first).floor() + 1.0;
        (0..(count.max(0.0) as usize).min(MOST_CROSSINGS))
            .map(|k| self.zero_crossing_s + (first + k as f64) * half_s)
            .collect()
    }
}

/// Most zero crossings of a list: three hours.
const MOST_CROSSINGS: usize = 1_000_000;

/// Envelope of one piece: times in seconds and amplitudes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PieceEnvelope {
    /// Times in seconds.
    pub t_s: Vec<f64>,
    /// Amplitudes in any unit.
    pub level: Vec<f64>,
}

/// Lowest and highest frequency of the search, in hertz.
pub const RANGE_HZ: (f64, f64) = (45.0, 65.0);

/// Range of specified frequencies, in hertz, at which a crossing is searched; a capture cannot show one of any other.
const SPECIFIED_HZ: (f64, f64) = (1.0, 1e3);

/// Nominal frequencies in hertz, between which a short capture can decide.
const NOMINAL_HZ: [f64; 2] = [50.0, 60.0];

/// Half-cycles of 50 Hz from which any frequency is possible.
const FREE_HALF_CYCLES: f64 = 1.5;

/// Half-cycles of 50 Hz below which nothing can be found.
const LEAST_HALF_CYCLES: f64 = 0.4;

/// Depth of modulation below which the bus counts as constant.
const LEAST_MODULATION: f64 = 0.3;

/// Share of the envelope's variance that the model must explain.
const LEAST_EXPLAINED: f64 = 0.8;

/// Difference of frequency in hertz that is reported: more than that of any grid.
const DIFFERS_HZ: f64 = 1.0;

/// Largest unexplained variance of another frequency, relative to the one specified, to be reported.
const MAX_UNEXPLAINED_RATIO: f64 = 0.5;

/// Share of the envelope's variance below which no other frequency can explain more.
const MAX_UNEXPLAINED_SHARE: f64 = 1e-3;

/// Most doublings of the view during the search: 60 ms to 30 000 years.
const MOST_VIEWS: u32 = 64;

/// Spacing of the envelope's points that are used, in seconds.
const SPACING_S: f64 = 0.15e-3;

/// Most moves of one pattern search, so that rounding cannot keep it going. The captures of this crate's tests take 23 at
/// most.
const MOST_MOVES: usize = 300;

/// Initial view of the search in seconds, which is doubled.
const FIRST_LOOK_S: f64 = 60e-3;

/// Determines frequency and zero crossing: as specified, else from the envelope, else assumed with a finding. `start_s` is the
/// time of the capture's first sample.
pub fn find(
    envelopes: &[PieceEnvelope],
    specified_hz: Option<f64>,
    specified_crossing_s: Option<f64>,
    start_s: f64,
    findings: &mut Vec<Finding>,
) -> Mains {
    let envelopes: Vec<PieceEnvelope> = envelopes.iter().map(thinned).collect();
    let (span_s, modulation) = extent(&envelopes);
    let half_cycles = span_s * 2.0 * NOMINAL_HZ[0];
    let specified_hz = specified_hz.filter(|f| f.is_finite() && *f > 0.0);
    let specified_crossing_s = specified_crossing_s.filter(|t| t.is_finite());
    let seen = half_cycles >= LEAST_HALF_CYCLES
        && modulation >= LEAST_MODULATION
        && specified_hz.is_none_or(|hz| (SPECIFIED_HZ.0..=SPECIFIED_HZ.1).contains(&hz));
    let free = half_cycles >= FREE_HALF_CYCLES;
    let measured = seen.then(|| fit(&envelopes, specified_hz, free)).flatten();
    if let (Some(specified_hz), true) = (specified_hz, free && seen) {
        let own = fit(&envelopes, None, true);
        // Half-cycles with pauses between them fit several frequencies equally well.
        let as_told = measured.map_or(1.0, |told| told.unexplained);
        let better = |own: &Fit| {
            as_told > MAX_UNEXPLAINED_SHARE && own.unexplained < MAX_UNEXPLAINED_RATIO * as_told
        };
        let differs = |own: &Fit| (own.hz - specified_hz).abs() > DIFFERS_HZ && better(own);
        if let Some(own) = own.filter(differs) {
            findings.push(Finding::MainsDiffers {
                specified_hz,
                measured_hz: own.hz,
            });
        }
    }
    if seen && specified_hz.is_none() {
        findings.extend(wrong_time_base(&envelopes, measured, span_s));
    }
    let hz = specified_hz
        .or(measured.map(|m| m.hz))
        .unwrap_or(NOMINAL_HZ[0]);
    let crossing_s = specified_crossing_s.or(measured.map(|m| m.t0_s));
    let source = |specified: bool| match (specified, measured) {
        (true, _) => MainsSource::Specified,
        (false, Some(_)) => MainsSource::Measured,
        (false, None) => MainsSource::Assumed,
    };
    let mut mains = Mains {
        hz,
        hz_source: source(specified_hz.is_some()),
        zero_crossing_s: crossing_s.unwrap_or(start_s),
        zero_crossing_source: source(specified_crossing_s.is_some()),
        modulation,
    };
    if specified_crossing_s.is_none() && measured.is_some() {
        let first = mains
            .crossings_s(start_s, start_s + 0.5 / hz)
            .first()
            .copied();
        mains.zero_crossing_s = first.unwrap_or(mains.zero_crossing_s);
    }
    if mains.hz_source == MainsSource::Assumed || mains.zero_crossing_source == MainsSource::Assumed
    {
        findings.push(Finding::MainsUnknown {
            assumed_hz: hz,
            half_cycles,
            modulation,
        });
    }
    mains
}

/// Mains frequencies in hertz that no grid has, and the usual ones that a rate wrong by two turns into them.
const UNUSUAL_HZ: [(f64, f64); 4] = [(25.0, 50.0), (30.0, 60.0), (100.0, 50.0), (120.0, 60.0)];

/// Largest unexplained variance of an unusual frequency, and relative to that of the usual range.
const MAX_UNUSUAL_UNEXPLAINED: f64 = 0.02;
const UNUSUAL_BETTER: f64 = 0.1;

/// Finding that the envelope shows a mains of half or twice a usual frequency, and by far not one of the usual range.
fn wrong_time_base(
    envelopes: &[PieceEnvelope],
    usual: Option<Fit>,
    span_s: f64,
) -> Option<Finding> {
    let of = |(shown_hz, usual_hz): (f64, f64)| {
        // Shorter ones cannot separate a constant from a lower frequency.
        let enough = 2.0 * span_s * shown_hz >= FREE_HALF_CYCLES;
        let fit = enough
            .then(|| fit(envelopes, Some(shown_hz), true))
            .flatten()?;
        Some((fit.unexplained, shown_hz, usual_hz))
    };
    let all = UNUSUAL_HZ.into_iter().filter_map(of);
    let (left, shown_hz, usual_hz) = all.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let of_usual = usual.map_or(1.0, |fit| fit.unexplained);
    (left < MAX_UNUSUAL_UNEXPLAINED.min(UNUSUAL_BETTER * of_usual))
        .then_some(Finding::TimeBase { shown_hz, usual_hz })
}

/// Means of an envelope over [`SPACING_S`].
fn thinned(envelope: &PieceEnvelope) -> PieceEnvelope {
    let n = envelope.t_s.len().min(envelope.level.len());
    let every = match (envelope.t_s.first(), envelope.t_s.get(1)) {
        (Some(a), Some(b)) => ((SPACING_S / (b - a)) as usize).max(1),
        _ => 1,
    };
    let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
    PieceEnvelope {
        t_s: envelope.t_s[..n].chunks(every).map(mean).collect(),
        level: envelope.level[..n].chunks(every).map(mean).collect(),
    }
}

/// Time from first to last point in seconds, and depth of modulation.
fn extent(envelopes: &[PieceEnvelope]) -> (f64, f64) {
    let all = || envelopes.iter().flat_map(|e| &e.t_s);
    let (from, to) = all().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), &t| {
        (a.min(t), b.max(t))
    });
    // The deepest piece counts, because others may be short.
    let depth = envelopes.iter().map(|e| {
        let (low, high) = e
            .level
            .iter()
            .fold((f64::INFINITY, 0.0f64), |(a, b), &x| (a.min(x), b.max(x)));
        if high > 0.0 { (high - low) / high } else { 0.0 }
    });
    ((to - from).max(0.0), depth.fold(0.0, f64::max))
}

/// Fit of the envelope.
#[derive(Clone, Copy, Debug)]
struct Fit {
    hz: f64,
    /// Zero crossing near the middle of the fitted part, in seconds.
    t0_s: f64,
    /// Sum of squared residuals over that about the pieces' means.
    unexplained: f64,
}

/// Fits by a grid over the beginning, then by a search with a doubling view; `free` allows any frequency in range.
fn fit(envelopes: &[PieceEnvelope], specified_hz: Option<f64>, free: bool) -> Option<Fit> {
    let start_s = envelopes.iter().find_map(|e| e.t_s.first()).copied()?;
    let end_s = envelopes.iter().rev().find_map(|e| e.t_s.last()).copied()?;
    let mut look_s = FIRST_LOOK_S.min(end_s - start_s);
    let candidates: Vec<f64> = match (specified_hz, free) {
        (Some(f), _) => vec![f],
        (None, false) => NOMINAL_HZ.to_vec(),
        (None, true) => {
            let n = ((RANGE_HZ.1 - RANGE_HZ.0) * look_s * 8.0).ceil() as usize;
            let step = (RANGE_HZ.1 - RANGE_HZ.0) / n as f64;
            (0..=n).map(|k| RANGE_HZ.0 + step * k as f64).collect()
        }
    };
    let law = if free { Law::Held } else { Law::ThroughZero };
    let free = free && specified_hz.is_none();
    let middle_s = start_s + 0.5 * look_s;
    let mut best: Option<Fit> = None;
    for hz in candidates {
        for k in 0..24 {
            let t0_s = middle_s + 0.5 / hz * f64::from(k) / 24.0;
            let unexplained = residual(envelopes, start_s + look_s, hz, t0_s, law);
            if best.is_none_or(|b| unexplained < b.unexplained) {
                best = Some(Fit {
                    hz,
                    t0_s,
                    unexplained,
                });
            }
        }
    }
    let mut best = best?;
    for _ in 0..MOST_VIEWS {
        best = refined(envelopes, start_s..start_s + look_s, best, free, law);
        // Not `start_s + look_s >= end_s`, which may never hold after rounding.
        if look_s >= end_s - start_s {
            break;
        }
        look_s = (2.0 * look_s).min(end_s - start_s);
    }
    (best.unexplained < 1.0 - LEAST_EXPLAINED).then_some(best)
}

/// Pattern search in frequency and crossing over a view in seconds.
fn refined(envelopes: &[PieceEnvelope], view: Range<f64>, from: Fit, free: bool, law: Law) -> Fit {
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
    while step.1 > 1e-6 && moves < MOST_MOVES {
        let mut moved = false;
        for (df, dt) in [(step.0, 0.0), (-step.0, 0.0), (0.0, step.1), (0.0, -step.1)] {
            let (hz, t0_s) = (best.hz + df, best.t0_s + dt);
            if df == 0.0 && dt == 0.0 || !(RANGE_HZ.0..=RANGE_HZ.1).contains(&hz) && free {
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
enum Law {
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

#[cfg(test)]
mod tests;
