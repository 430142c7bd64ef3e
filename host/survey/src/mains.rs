//! Mains frequency and zero crossings from the envelope of the coil's voltage.
//!
//! The bus follows |sin|, or stays above zero if a capacitor holds it, and the coil's voltage is a function of the bus that
//! depends on the load: E(t) = c0 + c1 s + c2 s² with s = |sin 2πf(t − t0)|. The coefficients belong to one piece, f and t0 to
//! all. Less than a few half-cycles cannot separate a constant from a lower frequency; the law is then c1 s + c2 s² + c3 s³.

mod fit;
mod time_base;

use std::ops::RangeInclusive;

use serde::Serialize;

pub use self::fit::PieceEnvelope;
use self::fit::{FIRST_LOOK_S, Fit, NOMINAL_HZ, Search, fit};
use super::finding::Finding;
use super::grid::MIN_MODULATION;
pub use super::grid::{MainsSource, RANGE_HZ};

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

/// Range of specified frequencies, in hertz, at which a crossing is searched; a capture cannot show one of any other.
pub const SPECIFIED_HZ: RangeInclusive<f64> = 1.0..=1e3;

/// Least share of the time that pieces cover for the search at any frequency.
const MIN_COVERED: f64 = 0.8;

/// Half-cycles of 50 Hz from which any frequency is possible.
const FREE_HALF_CYCLES: f64 = 1.5;

/// Half-cycles of 50 Hz below which nothing can be found.
const MIN_HALF_CYCLES: f64 = 0.4;

/// Difference of frequency in hertz that is reported: more than that of any grid.
const DIFFERS_HZ: f64 = 1.0;

/// Largest unexplained variance of another frequency, relative to the one specified, to be reported.
const MAX_UNEXPLAINED_RATIO: f64 = 0.5;

/// Share of the envelope's variance below which no other frequency can explain more.
const MAX_UNEXPLAINED_SHARE: f64 = 1e-3;

/// Half-cycles of 50 Hz from which 50 and 60 Hz are told apart.
const TOLD_APART_HALF_CYCLES: f64 = 0.9;

/// Difference in seconds of a zero crossing that is reported, and the largest unexplained variance of the envelope that shows it.
const CROSSING_DIFFERS_S: f64 = 0.2e-3;
const MAX_CROSSING_UNEXPLAINED: f64 = 0.01;

/// Spacing of the envelope's points that are used, in seconds.
const SPACING_S: f64 = 0.15e-3;

/// Determines frequency and zero crossing: as specified, else from the envelope, else assumed with a finding. `start_s` is the
/// time of the capture's first sample, `rate_hz` its sampling rate.
pub fn find(
    envelopes: &[PieceEnvelope],
    specified_hz: Option<f64>,
    specified_crossing_s: Option<f64>,
    start_s: f64,
    rate_hz: f64,
    findings: &mut Vec<Finding>,
) -> Mains {
    let view = View::of_pieces(envelopes);
    let specified_hz = specified_hz.filter(|f| f.is_finite() && *f > 0.0);
    let specified_crossing_s = specified_crossing_s.filter(|t| t.is_finite());
    let measured = view.measured(specified_hz);
    let better = specified_hz.and_then(|hz| Some((hz, view.better_hz(hz, measured)?)));
    findings.extend(
        better.map(|(specified_hz, measured_hz)| Finding::MainsDiffers {
            specified_hz,
            measured_hz,
        }),
    );
    if specified_hz.is_none() && view.shows(None) {
        let shown_hz = time_base::no_grids_hz(&view.envelopes, measured, &view.coverage);
        findings.extend(shown_hz.map(|shown_hz| Finding::TimeBase { shown_hz, rate_hz }));
    }
    if let (Some(specified_s), Some(measured), None) = (specified_crossing_s, measured, better) {
        findings.extend(crossing_differs(specified_s, measured));
    }
    let source = |specified: bool| match (specified, measured) {
        (true, _) => MainsSource::Specified,
        (false, Some(_)) => MainsSource::Measured,
        (false, None) => MainsSource::Assumed,
    };
    let crossing_s = specified_crossing_s.or(measured.map(|m| m.t0_s));
    let mut mains = Mains {
        hz: specified_hz
            .or(measured.map(|m| m.hz))
            .unwrap_or(NOMINAL_HZ[0]),
        hz_source: source(specified_hz.is_some()),
        zero_crossing_s: crossing_s.unwrap_or(start_s),
        zero_crossing_source: source(specified_crossing_s.is_some()),
        modulation: view.modulation,
    };
    if mains.zero_crossing_source == MainsSource::Measured {
        let within_s = mains.crossings_s(start_s, start_s + 0.5 / mains.hz);
        mains.zero_crossing_s = *within_s.first().unwrap_or(&mains.zero_crossing_s);
    }
    if [mains.hz_source, mains.zero_crossing_source].contains(&MainsSource::Assumed) {
        findings.push(Finding::MainsUnknown {
            assumed_hz: mains.hz,
            hz_source: mains.hz_source,
            half_cycles: view.half_cycles,
            modulation: view.modulation,
        });
    }
    mains
}

/// Envelopes of a capture, thinned, and the search that they allow.
struct View {
    envelopes: Vec<PieceEnvelope>,
    coverage: Coverage,
    /// Length in half-cycles of 50 Hz.
    half_cycles: f64,
    /// (Largest − smallest)/largest of the amplitude.
    modulation: f64,
    search: Search,
}

impl View {
    fn of_pieces(envelopes: &[PieceEnvelope]) -> Self {
        let envelopes: Vec<PieceEnvelope> = envelopes.iter().map(thinned).collect();
        let (coverage, modulation) = extent(&envelopes);
        let half_cycles = coverage.seen_s * 2.0 * NOMINAL_HZ[0];
        let search = match half_cycles >= FREE_HALF_CYCLES {
            _ if coverage.is_paused => Search::NearNominal,
            true => Search::Free(RANGE_HZ.0, RANGE_HZ.1),
            false => Search::Nominal,
        };
        Self {
            envelopes,
            coverage,
            half_cycles,
            modulation,
            search,
        }
    }

    /// Returns `true` if the envelopes can show a mains, of the frequency specified if there is one.
    fn shows(&self, specified_hz: Option<f64>) -> bool {
        self.half_cycles >= MIN_HALF_CYCLES
            && self.modulation >= MIN_MODULATION
            && specified_hz.is_none_or(|hz| SPECIFIED_HZ.contains(&hz))
    }

    /// Fit at the frequency specified, or at the best one if none is; `None` if the envelopes show none.
    fn measured(&self, specified_hz: Option<f64>) -> Option<Fit> {
        let search = specified_hz.map_or(self.search, |hz| Search::At(hz, self.search.law()));
        self.shows(specified_hz)
            .then(|| fit(&self.envelopes, search))
            .flatten()
    }

    /// Returns the frequency of the envelopes' own fit if it explains them better than `specified`, the fit at `specified_hz`.
    fn better_hz(&self, specified_hz: f64, specified: Option<Fit>) -> Option<f64> {
        if !self.shows(Some(specified_hz)) || self.half_cycles < TOLD_APART_HALF_CYCLES {
            return None;
        }
        let own = fit(&self.envelopes, self.search)?;
        let unexplained = specified.map_or(1.0, |fit| fit.unexplained);
        // Half-cycles with pauses between them fit several frequencies equally well.
        let is_better = unexplained > MAX_UNEXPLAINED_SHARE
            && own.unexplained < MAX_UNEXPLAINED_RATIO * unexplained;
        ((own.hz - specified_hz).abs() > DIFFERS_HZ && is_better).then_some(own.hz)
    }
}

/// Finding on a specified zero crossing that the envelope, fitted at the frequency used, shows elsewhere.
fn crossing_differs(specified_s: f64, measured: Fit) -> Option<Finding> {
    let half_s = 0.5 / measured.hz;
    let late_s = specified_s - measured.t0_s;
    let off_s = late_s - half_s * (late_s / half_s).round();
    let is_clear = measured.unexplained < MAX_CROSSING_UNEXPLAINED;
    (is_clear && off_s.abs() > CROSSING_DIFFERS_S).then_some(Finding::CrossingDiffers {
        specified_s,
        measured_s: specified_s - off_s,
    })
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

#[cfg(test)]
mod tests;
