//! Mains frequency and zero crossings from the envelope of the coil's voltage.
//!
//! The bus follows |sin|, or stays above zero if a capacitor holds it, and the coil's voltage is a function of the bus that
//! depends on the load: E(t) = c0 + c1 s + c2 s² with s = |sin 2πf(t − t0)|. The coefficients belong to one piece, f and t0 to
//! all. Less than a few half-cycles cannot separate a constant from a lower frequency; the law is then c1 s + c2 s² + c3 s³.

use std::f64::consts::PI;
use std::ops::{Range, RangeInclusive};

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
        (0..(count.max(0.0) as usize).min(MAX_CROSSINGS))
            .map(|k| self.zero_crossing_s + (first + k as f64) * half_s)
            .collect()
    }
}

/// Most zero crossings of a list: three hours.
const MAX_CROSSINGS: usize = 1_000_000;

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

/// Largest difference in hertz from the nominal frequency that is searched where pauses leave several frequencies possible.
const PAUSED_REACH_HZ: f64 = 1.0;

/// Least share of the time that pieces cover for the search at any frequency.
const MIN_COVERED: f64 = 0.8;

/// Half-cycles of 50 Hz from which any frequency is possible.
const FREE_HALF_CYCLES: f64 = 1.5;

/// Half-cycles of 50 Hz below which nothing can be found.
const MIN_HALF_CYCLES: f64 = 0.4;

/// Depth of modulation below which the bus counts as constant.
const MIN_MODULATION: f64 = 0.3;

/// Share of the envelope's variance that the model must explain.
const MIN_EXPLAINED: f64 = 0.8;

/// Difference of frequency in hertz that is reported: more than that of any grid.
const DIFFERS_HZ: f64 = 1.0;

/// Largest unexplained variance of another frequency, relative to the one specified, to be reported.
const MAX_UNEXPLAINED_RATIO: f64 = 0.5;

/// Share of the envelope's variance below which no other frequency can explain more.
const MAX_UNEXPLAINED_SHARE: f64 = 1e-3;

/// Most doublings of the view during the search: 60 ms to 30 000 years.
const MAX_VIEWS: u32 = 64;

/// Spacing of the envelope's points that are used, in seconds.
const SPACING_S: f64 = 0.15e-3;

/// Most moves of one pattern search, so that rounding cannot keep it going. The captures of this crate's tests take 23 at
/// most.
const MAX_MOVES: usize = 300;

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
    let (coverage, modulation) = extent(&envelopes);
    let half_cycles = coverage.seen_s * 2.0 * NOMINAL_HZ[0];
    let specified_hz = specified_hz.filter(|f| f.is_finite() && *f > 0.0);
    let specified_crossing_s = specified_crossing_s.filter(|t| t.is_finite());
    let seen = half_cycles >= MIN_HALF_CYCLES
        && modulation >= MIN_MODULATION
        && specified_hz.is_none_or(|hz| (SPECIFIED_HZ.0..=SPECIFIED_HZ.1).contains(&hz));
    let search = match half_cycles >= FREE_HALF_CYCLES {
        _ if coverage.is_paused => Search::NearNominal,
        true => Search::Free,
        false => Search::Nominal,
    };
    let of_hz = |hz: Option<f64>| match hz {
        Some(hz) => Search::At(hz, search.law()),
        None => search,
    };
    let measured = seen.then(|| fit(&envelopes, of_hz(specified_hz))).flatten();
    if let (Some(specified_hz), true) = (specified_hz, seen && search != Search::Nominal) {
        let own = fit(&envelopes, search);
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
        findings.extend(wrong_time_base(&envelopes, measured, coverage.seen_s));
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
    seen_s: f64,
) -> Option<Finding> {
    let of = |(shown_hz, usual_hz): (f64, f64)| {
        // Shorter ones cannot separate a constant from a lower frequency.
        let enough = 2.0 * seen_s * shown_hz >= FREE_HALF_CYCLES;
        let fit = enough
            .then(|| fit(envelopes, Search::At(shown_hz, Law::Held)))
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

/// Time that a capture's pieces cover.
struct Coverage {
    /// Pauses leave so much out that several frequencies are possible.
    is_paused: bool,
    /// Time in seconds that shows the mains at one go: from the first to the last point, of the longest piece where there are pauses.
    seen_s: f64,
}

/// Coverage, and depth of modulation.
fn extent(envelopes: &[PieceEnvelope]) -> (Coverage, f64) {
    let all = || envelopes.iter().flat_map(|e| &e.t_s);
    let (from, to) = all().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), &t| {
        (a.min(t), b.max(t))
    });
    let span_s = (to - from).max(0.0);
    let lasts_s = |e: &PieceEnvelope| e.t_s.last().zip(e.t_s.first()).map_or(0.0, |(b, a)| b - a);
    let covered_s: f64 = envelopes.iter().map(lasts_s).sum();
    let longest_s = envelopes.iter().map(lasts_s).fold(0.0, f64::max);
    let is_paused = longest_s < FIRST_LOOK_S && covered_s < MIN_COVERED * span_s;
    let coverage = Coverage {
        is_paused,
        seen_s: if is_paused { longest_s } else { span_s },
    };
    // The deepest piece counts, because others may be short.
    let depth = envelopes.iter().map(|e| {
        let (low, high) = e
            .level
            .iter()
            .fold((f64::INFINITY, 0.0f64), |(a, b), &x| (a.min(x), b.max(x)));
        if high > 0.0 { (high - low) / high } else { 0.0 }
    });
    (coverage, depth.fold(0.0, f64::max))
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

/// Frequencies among which the fit chooses.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Search {
    /// One frequency in hertz.
    At(f64, Law),
    /// The nominal ones.
    Nominal,
    /// Those within [`PAUSED_REACH_HZ`] of a nominal one.
    NearNominal,
    /// All of [`RANGE_HZ`].
    Free,
}

impl Search {
    fn law(self) -> Law {
        match self {
            Self::At(_, law) => law,
            Self::Nominal => Law::ThroughZero,
            Self::NearNominal | Self::Free => Law::Held,
        }
    }

    /// Frequencies in hertz from which to begin, for a view of this time in seconds; those of each list compete over that view alone.
    fn candidates_hz(self, look_s: f64) -> Vec<Vec<f64>> {
        match self {
            Self::At(hz, _) => vec![vec![hz]],
            Self::Nominal => vec![NOMINAL_HZ.to_vec()],
            Self::NearNominal => NOMINAL_HZ.map(|hz| vec![hz]).to_vec(),
            Self::Free => {
                let n = ((RANGE_HZ.1 - RANGE_HZ.0) * look_s * 8.0).ceil() as usize;
                let step = (RANGE_HZ.1 - RANGE_HZ.0) / n as f64;
                vec![(0..=n).map(|k| RANGE_HZ.0 + step * k as f64).collect()]
            }
        }
    }

    /// Range in hertz that is searched from there on.
    fn range_hz(self, from_hz: f64) -> RangeInclusive<f64> {
        match self {
            Self::At(..) | Self::Nominal => from_hz..=from_hz,
            Self::NearNominal => from_hz - PAUSED_REACH_HZ..=from_hz + PAUSED_REACH_HZ,
            Self::Free => RANGE_HZ.0..=RANGE_HZ.1,
        }
    }
}

/// Fits by a grid over the beginning, then by a search with a doubling view.
fn fit(envelopes: &[PieceEnvelope], search: Search) -> Option<Fit> {
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
