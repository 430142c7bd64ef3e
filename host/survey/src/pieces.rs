//! Division of a capture into pieces of one switching frequency.

use ihd_signal::segment::MIN_PERIODS;
use ihd_signal::{Capture, FrequencyStep};

use super::Hints;
use super::carrier::{self, CarrierPiece};
use super::error::SurveyError;
use super::finding::Finding;
use super::lines::MAX_HZ;
use super::time::Run;
use super::track::{self, Track};

/// Relative difference of frequencies that is reported.
const MAX_RELATIVE_DIFFERENCE: f64 = 5e-3;

/// Total length in seconds below which left-out pieces are not reported.
const SCRAPS_S: f64 = 0.5e-3;

/// Difference of frequency between neighbouring spans that counts as a step, in hertz.
const STEP_HZ: f64 = 50.0;

/// Finds the pieces of one switching frequency, with refined frequency and phasors.
pub(super) fn find(
    capture: &Capture,
    hints: &Hints,
    runs: &[Run],
    findings: &mut Vec<Finding>,
) -> Result<(Vec<CarrierPiece>, Vec<Track>), SurveyError> {
    let band = carrier::band(hints.f_sw_hz);
    let longest = runs
        .iter()
        .max_by(|a, b| a.duration_s().total_cmp(&b.duration_s()));
    let needed_s = MIN_PERIODS / hints.f_sw_hz.unwrap_or(MAX_HZ);
    let Some(longest) = longest.filter(|r| r.duration_s() >= needed_s) else {
        return Err(SurveyError::TooShort {
            name: capture.name.clone(),
            samples: longest.map_or(0, |r| r.samples.len()),
            ms: longest.map_or(0.0, Run::duration_s) * 1e3,
            needed: needed_s * 1e3,
        });
    };
    if 2.0 * band.0 * longest.dt_s >= 1.0 {
        return Err(SurveyError::TooSlow {
            name: capture.name.clone(),
            rate_hz: 1.0 / longest.dt_s,
            least_hz: band.0,
        });
    }
    let (mut pieces, mut tracks) = (Vec::new(), Vec::new());
    let mut scraps = (0, 0.0);
    let shows = |run: &Run| 2.0 * band.0 * run.dt_s < 1.0;
    for run in specified_parts(capture, runs).into_iter().filter(shows) {
        let carrier_pieces = carrier::find_pieces(capture, &run, band);
        for (from_s, to_s) in carrier_pieces.off_s {
            findings.push(Finding::CarrierAbsent { from_s, to_s });
        }
        for piece in carrier_pieces.pieces {
            if piece.run.duration_s() * piece.f_hz < MIN_PERIODS {
                scraps = (scraps.0 + 1, scraps.1 + piece.run.duration_s());
                continue;
            }
            let (piece, track) = refined(capture, piece);
            pieces.push(piece);
            tracks.push(track);
        }
    }
    if scraps.1 > SCRAPS_S {
        findings.push(Finding::PieceTooShort {
            pieces: scraps.0,
            total_s: scraps.1,
        });
    }
    if pieces.is_empty() {
        return Err(no_carrier(capture, hints, longest, band));
    }
    Ok((pieces, tracks))
}

/// Switching frequencies that the capture states, in order of time; a file may list them in any order.
fn stated_steps(capture: &Capture) -> Vec<FrequencyStep> {
    let mut steps = capture.f_sw.clone();
    steps.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    steps
}

/// Cuts runs where the capture states another switching frequency.
fn specified_parts(capture: &Capture, runs: &[Run]) -> Vec<Run> {
    let mut out = Vec::new();
    let steps = lone_steps(&stated_steps(capture));
    for run in runs {
        let mut start = run.samples.start;
        for step in &steps {
            let at = (step.t_s - run.t0_s) / run.dt_s;
            // The period that the step cuts belongs to neither side.
            let guard = (1.0 / (step.f_sw_hz * run.dt_s)).clamp(0.0, run.samples.len() as f64);
            if at > guard && at + guard < run.samples.len() as f64 {
                let (at, guard) = (run.samples.start + at as usize, guard as usize);
                out.push(run.part(start..at.saturating_sub(guard)));
                start = start.max(at + guard);
            }
        }
        out.push(run.part(start..run.samples.end));
    }
    out.retain(|run| run.samples.len() > 1);
    out
}

/// Steps, in order of time, after which the frequency stays; steps in quick succession are a motion and are left out.
fn lone_steps(stated: &[FrequencyStep]) -> Vec<FrequencyStep> {
    let near = |a: &FrequencyStep, b: &FrequencyStep| {
        (b.t_s - a.t_s).abs() < MIN_PERIODS / a.f_sw_hz.max(b.f_sw_hz)
    };
    (1..stated.len())
        .filter(|&k| {
            let after = stated.get(k + 1);
            !near(&stated[k - 1], &stated[k]) && !after.is_some_and(|after| near(&stated[k], after))
        })
        .map(|k| stated[k])
        .collect()
}

/// Error for a capture without pieces.
fn no_carrier(capture: &Capture, hints: &Hints, run: &Run, band: (f64, f64)) -> SurveyError {
    let name = capture.name.clone();
    if let Some(specified_hz) = hints.f_sw_hz {
        let elsewhere = carrier::find_pieces(capture, run, carrier::band(None));
        if let Some(piece) = elsewhere.pieces.first() {
            return SurveyError::NotAtHint {
                name,
                specified_khz: specified_hz * 1e-3,
                found_khz: piece.f_hz * 1e-3,
            };
        }
    }
    SurveyError::NoCarrier {
        name,
        from_khz: band.0 * 1e-3,
        to_khz: band.1 * 1e-3,
        what: "voltage and current",
    }
}

/// Refines a piece's frequency by the slope of the phase, and computes its phasors.
fn refined(capture: &Capture, piece: CarrierPiece) -> (CarrierPiece, Track) {
    if piece.sweep.is_some() {
        let track = track::track(capture, &piece.run, piece.f_hz);
        return (piece, track);
    }
    // Rounded to hertz, to remove rounding of the spectrum, which differs between machines.
    let f_hz = piece.f_hz.round();
    let rough = track::of_current(capture, &piece.run, f_hz);
    // Frames are at least one and a half periods apart: a faster rotation is ambiguous and therefore noise.
    let off_hz = rough.frequency_error_hz();
    let f_hz = if off_hz.abs() < f_hz / 3.0 {
        f_hz + off_hz
    } else {
        f_hz
    };
    let track = track::track(capture, &piece.run, f_hz);
    (CarrierPiece { f_hz, ..piece }, track)
}

/// Adds findings on sweeps and steps of the frequency, and on differences from the one specified.
pub(super) fn frequency_findings(
    capture: &Capture,
    hints: &Hints,
    pieces: &[CarrierPiece],
    findings: &mut Vec<Finding>,
) {
    for piece in pieces {
        if let Some(sweep) = piece.sweep {
            findings.push(Finding::FrequencySweep {
                mean_hz: sweep.mean_hz,
                deviation_hz: sweep.deviation_hz,
                rate_hz: sweep.rate_hz,
            });
        }
    }
    for pair in pieces.windows(2) {
        let [a, b] = pair else { continue };
        if (a.f_hz - b.f_hz).abs() > STEP_HZ {
            findings.push(Finding::FrequencyStep {
                t_s: 0.5 * (a.run.t_s(a.run.samples.end) + b.run.t0_s),
                from_hz: a.f_hz,
                to_hz: b.f_hz,
            });
        }
    }
    let steps = stated_steps(capture);
    let specified_at = |t_s: f64| {
        let before = steps.partition_point(|s| s.t_s <= t_s).max(1);
        hints.f_sw_hz.or(steps.get(before - 1).map(|s| s.f_sw_hz))
    };
    let differs = pieces.iter().find_map(|p| {
        let specified_hz = specified_at(p.run.t_s((p.run.samples.start + p.run.samples.end) / 2))?;
        ((p.f_hz / specified_hz - 1.0).abs() > MAX_RELATIVE_DIFFERENCE)
            .then_some((specified_hz, p.f_hz))
    });
    if let Some((specified_hz, measured_hz)) = differs {
        findings.push(Finding::FrequencyDiffers {
            specified_hz,
            measured_hz,
        });
    }
}
