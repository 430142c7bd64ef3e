//! Survey of a capture: switching frequency, mains, noise, clipping, wiring, aliasing, gaps, and the spans that an estimator
//! can work on. [`calibration`] estimates and corrects skew, gain, offset and bandwidth of the sensors.
//!
//! ```text
//! Capture ─► time: runs ─► carrier: pieces of one f_sw ─► track: phasors ─► mains, impedance, aliasing
//!                └────────────► noise, clipping                   └─► Span ─► Segment
//! ```

pub mod aliasing;
pub mod calibration;
pub mod carrier;
pub mod channel;
pub mod clipping;
pub mod error;
pub mod finding;
mod grid;
mod hints;
pub mod impedance;
mod lines;
pub mod mains;
mod pieces;
pub mod spectrum;
mod subharmonic;
pub mod time;
pub mod track;

use std::borrow::Cow;
use std::sync::Arc;

use ihd_signal::noise::WhiteNoise;
use ihd_signal::segment::Segment;
use ihd_signal::{Capture, Load, Samples, TimeBase};
use serde::Serialize;

use self::aliasing::Aliasing;
use self::carrier::CarrierPiece;
pub use self::channel::ChannelSurvey;
pub use self::error::SurveyError;
pub use self::finding::{Channel, Finding, Severity};
pub use self::hints::{Hints, OutOfRange, StatedRange};
use self::impedance::{SkewCost, Wiring};
use self::mains::Mains;
use self::time::Run;
use self::track::Track;

/// Part of a capture that an estimator can work on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Span {
    /// Index of the first sample.
    pub first: usize,
    /// Number of samples.
    pub samples: usize,
    /// Time of the first sample in seconds.
    pub t0_s: f64,
    /// Time from one sample to the next in seconds.
    pub dt_s: f64,
    /// Switching frequency in hertz.
    pub f_sw_hz: f64,
    /// Mean R and L of the fundamental, weighted by the square of the current, with corrected wiring; `None` if unknown.
    pub load: Option<Load>,
}

impl Span {
    /// Indices and times of its samples.
    pub fn run(&self) -> Run {
        Run {
            samples: self.first..self.first + self.samples,
            t0_s: self.t0_s,
            dt_s: self.dt_s,
        }
    }

    /// Time after the last sample in seconds.
    pub fn end_s(&self) -> f64 {
        self.t0_s + self.samples as f64 * self.dt_s
    }
}

/// Result of a survey.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Survey {
    /// Name of the capture.
    pub name: String,
    /// Number of samples of each channel.
    pub samples: usize,
    /// Time of the first sample in seconds.
    pub start_s: f64,
    /// Time from first to last sample in seconds.
    pub duration_s: f64,
    /// Sampling rate of the longest run in hertz.
    pub rate_hz: f64,
    /// Spans for estimators, in order of time.
    pub spans: Vec<Span>,
    /// Frequency and zero crossings of the mains.
    pub mains: Mains,
    /// Whole half-cycles within a span: beginning and end in seconds.
    pub half_cycles_s: Vec<(f64, f64)>,
    /// Numbers of the voltage channel.
    pub voltage: ChannelSurvey,
    /// Numbers of the current channel.
    pub current: ChannelSurvey,
    /// Connection of the probes.
    pub wiring: Wiring,
    /// Errors that a skew between the channels would cause.
    pub skew: Vec<SkewCost>,
    /// Expected effect of aliasing; `None` if no harmonic falls on the fundamental.
    pub aliasing: Option<Aliasing>,
    /// Findings, worst first.
    #[serde(skip)]
    pub findings: Vec<Finding>,
}

/// Samples per switching period below which it is reported: filters in the time domain degrade (1 MS/s at the paper's
/// frequencies: 14 to 22 samples).
const COARSE_SAMPLES_PER_PERIOD: f64 = 12.0;

impl Survey {
    /// Surveys a capture.
    ///
    /// # Errors
    /// [`SurveyError`] if the capture cannot be used: channels of different length, too few
    /// samples, no switching frequency.
    pub fn from_capture(capture: &Capture, hints: &Hints) -> Result<Self, SurveyError> {
        check(capture)?;
        let mut findings = Vec::new();
        let runs = time::runs(capture, &mut findings);
        let (pieces, tracks) = pieces::find(capture, hints, &runs, &mut findings)?;
        pieces::frequency_findings(capture, hints, &pieces, &mut findings);
        let strongest = strongest(&tracks);
        let wiring = tracks
            .get(strongest)
            .map(impedance::wiring)
            .unwrap_or_default();
        let voltage = channel::survey(Channel::Voltage, capture, &pieces, &tracks, &mut findings);
        let current = channel::survey(Channel::Current, capture, &pieces, &tracks, &mut findings);
        let alive = !findings.iter().any(|f| matches!(f, Finding::Dead { .. }));
        let (wiring, loads) = if alive {
            findings.extend(subharmonic::find(capture, &pieces));
            wiring_findings(&tracks, strongest, wiring, hints, &mut findings);
            let load = |t: &Track| impedance::load_of_order(t, 0, wiring);
            (wiring, tracks.iter().map(load).collect())
        } else {
            (Wiring::default(), vec![None; tracks.len()])
        };
        let (start_s, end_s) = extent_s(capture, &runs);
        let longest = runs.iter().max_by_key(|r| r.samples.len());
        let rate_hz = longest.map_or(0.0, |r| 1.0 / r.dt_s);
        let mains = mains::find(
            &envelopes(&tracks, wiring),
            hints.mains_hz.or(capture.mains_hz),
            hints.zero_crossing_s.or(capture.zero_crossing_s),
            start_s,
            rate_hz,
            &mut findings,
        );
        let spans: Vec<Span> = (pieces.iter().zip(&loads)).map(span).collect();
        let aliasing = (alive && !wiring.swapped)
            .then(|| expected_aliasing(&pieces, &tracks, &loads, strongest, &mut findings))
            .flatten();
        let skew = if alive {
            impedance::skew_costs(&tracks, wiring)
        } else {
            Vec::new()
        };
        findings.sort_by_key(|f| std::cmp::Reverse(f.severity()));
        Ok(Self {
            name: capture.name.clone(),
            samples: capture.len(),
            start_s,
            duration_s: end_s - start_s,
            rate_hz,
            half_cycles_s: half_cycles(&mains, &spans),
            spans,
            mains,
            voltage,
            current,
            wiring,
            skew,
            aliasing,
            findings,
        })
    }

    /// Severity of the worst finding; `None` if there are no findings.
    pub fn worst(&self) -> Option<Severity> {
        self.findings.first().map(Finding::severity)
    }

    /// Sentence on the errors that an uncalibrated skew would cause in this capture; `None` if R and L could not be measured.
    pub fn skew_note(&self) -> Option<String> {
        let list = |value: fn(&SkewCost) -> f64| {
            let words: Vec<_> = self
                .skew
                .iter()
                .map(|c| format!("{:.1}", value(c)))
                .collect();
            words.join("/")
        };
        (!self.skew.is_empty()).then(|| {
            format!(
                "{} ns between the channels would be {} % of R, {} % of L",
                self.skew
                    .iter()
                    .map(|c| format!("{:.0}", c.skew_s * 1e9))
                    .collect::<Vec<_>>()
                    .join("/"),
                list(|c| c.r_pct),
                list(|c| c.l_pct)
            )
        })
    }

    /// White noise of the longest span; 0 on a channel where it could not be measured.
    fn noise(&self) -> WhiteNoise {
        WhiteNoise {
            v_v: self.voltage.noise.unwrap_or(0.0),
            i_a: self.current.noise.unwrap_or(0.0),
        }
    }

    /// White noise of a span, whose samples are `segment`: measured on it, but that of the longest span for a channel that is too short to
    /// show its own.
    pub fn noise_on(&self, span: usize, segment: &Segment) -> WhiteNoise {
        let spans = self.spans.iter().enumerate();
        let longest = spans.max_by_key(|(_, s)| s.samples);
        match longest.is_some_and(|(k, _)| k == span) {
            true => self.noise(),
            false => WhiteNoise::measure(segment).or_else(|| self.noise()),
        }
    }

    /// Copies all spans out of the capture that was surveyed.
    pub fn segments(&self, capture: &Capture) -> Vec<Segment> {
        self.spans
            .iter()
            .map(|s| self.segment(capture, s))
            .collect()
    }

    /// Calls `each` with every span of the capture that was surveyed. The samples of an owned capture are not copied.
    pub fn for_segments(
        &self,
        capture: &mut Cow<'_, Capture>,
        mut each: impl FnMut(usize, &Segment),
    ) {
        let capture = match capture {
            Cow::Owned(capture) => capture,
            Cow::Borrowed(capture) => {
                let segments = self.spans.iter().map(|span| self.segment(capture, span));
                return segments.enumerate().for_each(|(k, s)| each(k, &s));
            }
        };
        let [v_v, i_a] = [&mut capture.v_v, &mut capture.i_a].map(|x| Arc::new(std::mem::take(x)));
        for (k, span) in self.spans.iter().enumerate() {
            let range = span.first..span.first + span.samples;
            let part = |x: &Arc<Vec<f32>>| Samples::shared(Arc::clone(x)).part(range.clone());
            each(k, &self.with_samples(span, part(&v_v), part(&i_a)));
        }
        [capture.v_v, capture.i_a] = [v_v, i_a].map(Arc::unwrap_or_clone);
    }

    /// Moves all spans out of the capture that was surveyed, which keeps everything but its samples.
    pub fn take_segments(&self, capture: &mut Capture) -> Vec<Segment> {
        let v_v = Samples::singles(std::mem::take(&mut capture.v_v));
        let i_a = Samples::singles(std::mem::take(&mut capture.i_a));
        let of = |span: &Span| {
            let range = span.first..span.first + span.samples;
            self.with_samples(span, v_v.part(range.clone()), i_a.part(range))
        };
        self.spans.iter().map(of).collect()
    }

    /// Copies one span out of the capture that was surveyed.
    pub fn segment(&self, capture: &Capture, span: &Span) -> Segment {
        let range = span.first..span.first + span.samples;
        let copied = |x: &[f32]| Samples::singles(x.get(range.clone()).unwrap_or(&[]).to_vec());
        self.with_samples(span, copied(&capture.v_v), copied(&capture.i_a))
    }

    fn with_samples(&self, span: &Span, v_v: Samples, i_a: Samples) -> Segment {
        Segment {
            f_sw_hz: span.f_sw_hz,
            mains_hz: self.mains.hz,
            zero_crossing_s: self.mains.zero_crossing_s,
            t0_s: span.t0_s,
            dt_s: span.dt_s,
            v_v,
            i_a,
        }
    }
}

fn check(capture: &Capture) -> Result<(), SurveyError> {
    let stamps = match &capture.time {
        TimeBase::Even { .. } => capture.v_v.len(),
        TimeBase::Stamps(t_s) => t_s.len(),
    };
    let name = || capture.name.clone();
    if capture.v_v.len() != capture.i_a.len() || capture.v_v.len() != stamps {
        return Err(SurveyError::Lengths {
            name: name(),
            v: capture.v_v.len(),
            i: capture.i_a.len(),
            stamps,
        });
    }
    if capture.is_empty() {
        return Err(SurveyError::Empty { name: name() });
    }
    match capture.time {
        // Far from zero, time has too few digits for its steps: 1e9 s for steps of 0.1 µs.
        TimeBase::Even { t0_s, dt_s }
            if !(dt_s > 0.0 && dt_s.is_finite() && t0_s.is_finite() && t0_s + dt_s > t0_s) =>
        {
            Err(SurveyError::TimeStep {
                name: name(),
                t0_s,
                dt_s,
            })
        }
        _ => Ok(()),
    }
}

/// Times of the first and the last sample in seconds; if those are not finite, of the first and the last sample in a run.
fn extent_s(capture: &Capture, runs: &[Run]) -> (f64, f64) {
    let stamp = |k| capture.time.at(k).filter(|t_s| t_s.is_finite());
    let first = stamp(0).or(runs.first().map(|r| r.t0_s));
    let last = stamp(capture.len().saturating_sub(1));
    let last = last.or(runs.last().map(|r| r.t_s(r.samples.end.saturating_sub(1))));
    let start_s = first.unwrap_or(0.0);
    (start_s, last.unwrap_or(start_s))
}

/// Index of the track with the largest current.
fn strongest(tracks: &[Track]) -> usize {
    let energy = |t: &Track| -> f64 {
        t.i_a
            .first()
            .map_or(0.0, |i| i.iter().map(|i| i.norm_sqr()).sum())
    };
    let by_energy = |a: &usize, b: &usize| energy(&tracks[*a]).total_cmp(&energy(&tracks[*b]));
    (0..tracks.len()).max_by(by_energy).unwrap_or(0)
}

/// Adds findings on the wiring from the impedance of the strongest track.
fn wiring_findings(
    tracks: &[Track],
    strongest: usize,
    wiring: Wiring,
    hints: &Hints,
    findings: &mut Vec<Finding>,
) {
    if wiring.swapped {
        findings.push(Finding::Swapped {
            by_user: hints.swapped,
        });
    }
    let Some(track) = tracks.get(strongest) else {
        return;
    };
    let unturned = Wiring {
        inverted: false,
        ..wiring
    };
    let Some(z) = impedance::load_of_order(track, 0, unturned) else {
        return;
    };
    if wiring.inverted {
        findings.push(Finding::Inverted {
            r_ohm: z.r_ohm,
            by_user: hints.inverted,
        });
    } else if z.r_ohm < 0.0 {
        let omega = std::f64::consts::TAU * track.f_sw_hz;
        findings.push(Finding::NegativeResistance {
            r_ohm: z.r_ohm,
            skew_s: (z.r_ohm / (omega * z.l_h)).atan() / omega,
        });
    }
}

/// Amplitudes of the voltage's fundamental, piece by piece.
fn envelopes(tracks: &[Track], wiring: Wiring) -> Vec<mains::PieceEnvelope> {
    tracks
        .iter()
        .filter_map(|t| {
            let v = if wiring.swapped {
                t.i_a.first()
            } else {
                t.v_v.first()
            };
            Some(mains::PieceEnvelope {
                t_s: t.t_s.clone(),
                level: v?.iter().map(|v| v.norm()).collect(),
            })
        })
        .collect()
}

/// Expected effect of aliasing on the strongest piece; adds findings on it and on coarse sampling.
fn expected_aliasing(
    pieces: &[CarrierPiece],
    tracks: &[Track],
    loads: &[Option<Load>],
    strongest: usize,
    findings: &mut Vec<Finding>,
) -> Option<Aliasing> {
    let (piece, track) = (pieces.get(strongest)?, tracks.get(strongest)?);
    let samples_per_period = 1.0 / (piece.f_hz * piece.run.dt_s);
    if samples_per_period < COARSE_SAMPLES_PER_PERIOD {
        findings.push(Finding::CoarselySampled { samples_per_period });
    }
    let aliasing = aliasing::expected(track, piece.run.dt_s, (*loads.get(strongest)?)?)?;
    if aliasing.r_pct > ALIASING_PCT {
        findings.push(Finding::Aliasing {
            samples_per_period,
            order: aliasing.order,
            r_pct: aliasing.r_pct,
            l_pct: aliasing.l_pct,
        });
    }
    Some(aliasing)
}

/// Error of R by aliasing in percent above which it is reported.
const ALIASING_PCT: f64 = 0.1;

fn span((piece, load): (&CarrierPiece, &Option<Load>)) -> Span {
    Span {
        first: piece.run.samples.start,
        samples: piece.run.samples.len(),
        t0_s: piece.run.t0_s,
        dt_s: piece.run.dt_s,
        f_sw_hz: piece.f_hz,
        load: *load,
    }
}

/// Half-cycles that lie within one span; a fiftieth may be missing at either end, where the current is close to zero.
fn half_cycles(mains: &Mains, spans: &[Span]) -> Vec<(f64, f64)> {
    let mut out = Vec::new();
    for span in spans {
        let slack_s = 0.02 * 0.5 / mains.hz;
        let crossings = mains.crossings_s(span.t0_s - slack_s, span.end_s() + slack_s);
        let pairs = crossings.windows(2).map(|w| (w[0], w[1]));
        // An impossible mains frequency may be too high for the clock's digits.
        out.extend(pairs.filter(|(from_s, to_s)| from_s < to_s));
    }
    out
}

#[cfg(test)]
mod tests;
