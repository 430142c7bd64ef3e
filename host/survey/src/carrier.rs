//! Search for the parts of a run in which the hob switches, and for the frequency, by a short-time spectrum of voltage and current.

use std::f64::consts::TAU;
use std::ops::Range;

use ihd_signal::Capture;
use ihd_signal::carrier::{Carrier, Sweep};
use nalgebra::Complex;

use super::lines::{HOPS_PER_FRAME, Lines, MAX_HZ, MIN_HZ};
use super::time::Run;
use super::track;

/// Relative width of the search around a given frequency.
const HINT_WIDTH: f64 = 0.1;

/// Least power of a line over the median of the spectrum: noise of a thousand bins reaches 10.
const LINE_OVER_MEDIAN: f64 = 30.0;

/// Power of a line relative to the strongest, below which it does not determine the frequency: 1 % of amplitude.
const MIN_POWER_RATIO: f64 = 1e-4;

/// Share of the current's amplitude nearby above which the bridge is on: well above noise of 30 dB, and low enough for an
/// edge at a zero crossing.
const EDGE: f64 = 0.1;

/// Change of frequency that counts as a step, in hertz: an eighth of the spectrum's resolution.
const STEP_HZ: f64 = 150.0;

/// Time in seconds over which the carrier's tracking smooths a step of the frequency.
const SMOOTHED_S: f64 = 0.25e-3;

/// Frames without a line that count as switched off: 1 ms, longer than a zero crossing hides the line.
const OFF_HOPS: usize = 10;

/// Part of a run with one switching frequency.
#[derive(Clone, Debug, PartialEq)]
pub struct CarrierPiece {
    /// Samples and times of the piece.
    pub run: Run,
    /// Switching frequency in hertz, to some 20 Hz; the mean if it moves.
    pub f_hz: f64,
    /// Motion of the frequency; `None` if it is constant.
    pub sweep: Option<Sweep>,
}

/// Result of a search.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CarrierPieces {
    /// Pieces with a carrier, in order of time.
    pub pieces: Vec<CarrierPiece>,
    /// Intervals without a carrier: beginning and end in seconds.
    pub off_s: Vec<(f64, f64)>,
}

/// Range of frequencies to search, in hertz, around a frequency that was given.
pub fn band(hint_hz: Option<f64>) -> (f64, f64) {
    hint_hz.map_or((MIN_HZ, MAX_HZ), |f| {
        (f * (1.0 - HINT_WIDTH), f * (1.0 + HINT_WIDTH))
    })
}

/// Finds the pieces of a run in which the bridge switches at one frequency, within `band_hz`.
pub fn find_pieces(capture: &Capture, run: &Run, band_hz: (f64, f64)) -> CarrierPieces {
    let lines = Lines::compute(capture, run, band_hz);
    let strongest = lines.frames.iter().map(|l| l.power).fold(0.0, f64::max);
    let valid: Vec<bool> = lines
        .frames
        .iter()
        .map(|l| l.contrast > LINE_OVER_MEDIAN && l.power > MIN_POWER_RATIO * strongest)
        .collect();
    let mut result = CarrierPieces::default();
    let mut end = run.samples.start;
    let ranges = on_ranges(&valid);
    for on in &ranges {
        // The amplitude that marks an edge may reach into the stretch before.
        let part = switching(capture, run, &lines, on).part(end..run.samples.end);
        if on.off_before {
            result.off_s.push((run.t_s(end), part.t0_s));
        }
        end = end.max(part.samples.end);
        let within = lines.within(&part.samples, &on.frames);
        steps(capture, &part, &lines, &valid, within, &mut result.pieces);
    }
    if ranges.last().is_some_and(|on| on.off_after) {
        result.off_s.push((run.t_s(end), run.t_s(run.samples.end)));
    }
    result
}

/// Range of frames with a carrier.
struct SwitchingFrames {
    frames: Range<usize>,
    off_before: bool,
    off_after: bool,
}

/// Ranges of frames with a carrier; interruptions shorter than [`OFF_HOPS`] are zero crossings, also at the ends of the run.
fn on_ranges(valid: &[bool]) -> Vec<SwitchingFrames> {
    let mut out: Vec<SwitchingFrames> = Vec::new();
    for k in (0..valid.len()).filter(|&k| valid[k]) {
        if let Some(on) = out.last_mut().filter(|on| k - on.frames.end < OFF_HOPS) {
            on.frames.end = k + 1;
            continue;
        }
        if let Some(before) = out.last_mut() {
            before.off_after = true;
        }
        out.push(SwitchingFrames {
            frames: k..k + 1,
            off_before: k >= OFF_HOPS,
            off_after: false,
        });
    }
    if let Some(first) = out.first_mut().filter(|on| !on.off_before) {
        first.frames.start = 0;
    }
    if let Some(last) = out.last_mut() {
        last.off_after = valid.len() - last.frames.end >= OFF_HOPS;
        if !last.off_after {
            last.frames.end = valid.len();
        }
    }
    out
}

/// Part of a run in which the bridge switches. The frames' windows reach beyond the switching on or off; the current's amplitude
/// shows the exact place.
fn switching(capture: &Capture, run: &Run, lines: &Lines, on: &SwitchingFrames) -> Run {
    let window = lines.length * lines.every;
    let edge = |frame: usize, rising: bool| {
        let middle = lines.middle(frame);
        let zone = run.part(middle.saturating_sub(window)..middle + window);
        let f_hz = lines.frames[frame].f_hz;
        let track = track::fundamental(capture, &zone, f_hz);
        let amplitude: Vec<f64> = track.i_a.iter().map(|i| i.norm()).collect();
        let least = EDGE * amplitude.iter().copied().fold(0.0, f64::max);
        let strong = |a: &f64| *a >= least;
        let at = if rising {
            amplitude.iter().position(strong)
        } else {
            amplitude.iter().rposition(strong)
        };
        let at_s = at.map_or(run.t_s(middle), |k| track.t_s[k]);
        // The amplitude is that of two periods.
        let guard_s = if rising { 2.0 / f_hz } else { -2.0 / f_hz };
        run.samples.start + ((at_s + guard_s - run.t0_s) / run.dt_s).max(0.0) as usize
    };
    let (first, last) = (on.frames.start, on.frames.end - 1);
    let start = if on.off_before {
        edge(first, true)
    } else {
        lines.begin(first)
    };
    let end = if on.off_after {
        edge(last, false)
    } else {
        lines.end(last)
    };
    run.part(start..end)
}

/// Cuts a range of frames at steps of the frequency; a part whose frequency moves without steps is one piece.
fn steps(
    capture: &Capture,
    run: &Run,
    lines: &Lines,
    valid: &[bool],
    frames: Range<usize>,
    out: &mut Vec<CarrierPiece>,
) {
    let held = held(lines, valid, frames.clone());
    let cuts = steady(&held);
    let end = run.samples.end;
    let mut from = run.samples.start;
    let mut pieces = Vec::new();
    for (n, (range, f)) in cuts.iter().enumerate() {
        let (mut to, mut next) = (end, end);
        if let Some((after, f_after)) = cuts.get(n + 1) {
            let zone = lines.middle(frames.start + range.end - 1)
                ..lines.middle(frames.start + after.start) + 1;
            let boundary = boundary(capture, &run.part(zone), *f, *f_after);
            // The settling after the step, and the period that it cuts, belong to neither side.
            let guard = (2.0 / (f.min(*f_after) * run.dt_s)) as usize;
            (to, next) = (boundary.saturating_sub(guard), boundary + guard);
        }
        pieces.push(CarrierPiece {
            run: run.part(from..to),
            f_hz: *f,
            sweep: None,
        });
        from = next;
    }
    match moving(capture, run, &held, &pieces) {
        Some(whole) => out.push(whole),
        None => out.append(&mut pieces),
    }
}

/// Whole run as one piece if its frequency moves within the pieces that steps would give, else `None`; `held_hz` are the
/// frames' frequencies in hertz.
fn moving(
    capture: &Capture,
    run: &Run,
    held_hz: &[f64],
    pieces: &[CarrierPiece],
) -> Option<CarrierPiece> {
    let mean = held_hz.iter().sum::<f64>() / held_hz.len().max(1) as f64;
    let (v, i) = (&capture.v_v, &capture.i_a);
    let range = run.samples.clone();
    let carrier = Carrier::follow(&v[range.clone()], &i[range], run.t0_s, run.dt_s, mean)?;
    // The carrier's tracking smooths over the edges of a step.
    let inside = |p: &CarrierPiece, t_s: f64| {
        let (from_s, to_s) = (
            p.run.t0_s + SMOOTHED_S,
            p.run.t_s(p.run.samples.end) - SMOOTHED_S,
        );
        (from_s..to_s).contains(&t_s)
    };
    let of_piece: Vec<f64> = (pieces.iter())
        .map(|p| mean_hz(&carrier, |t_s| inside(p, t_s)).unwrap_or(p.f_hz))
        .collect();
    let expected = |t_s: f64| {
        let at = pieces.iter().position(|p| inside(p, t_s))?;
        of_piece.get(at).copied()
    };
    carrier.moves_from(expected).then(|| CarrierPiece {
        run: run.clone(),
        f_hz: carrier.mean_hz(),
        sweep: Some(carrier.sweep()),
    })
}

/// Mean frequency in hertz at the times chosen, weighted with the carrier's power.
fn mean_hz(carrier: &Carrier, chosen: impl Fn(f64) -> bool) -> Option<f64> {
    let of = carrier.values().filter(|v| chosen(v.0));
    let (sum, weights) = of.fold((0.0, 0.0), |(sum, all), (_, f, w)| (sum + f * w, all + w));
    (weights > 0.0).then(|| sum / weights)
}

/// Frequencies of frames in hertz; weak frames take that of the last strong one. Empty if none is strong.
fn held(lines: &Lines, valid: &[bool], frames: Range<usize>) -> Vec<f64> {
    let Some(first) = frames.clone().find(|&k| valid[k]) else {
        return Vec::new();
    };
    let mut last = lines.frames[first].f_hz;
    frames
        .map(|k| {
            if valid[k] {
                last = lines.frames[k].f_hz;
            }
            last
        })
        .collect()
}

/// Ranges of frames with a constant frequency, and the median frequency of each.
fn steady(f_hz: &[f64]) -> Vec<(Range<usize>, f64)> {
    let half = HOPS_PER_FRAME / 2;
    // Frames a whole frame apart share no sample.
    let steps = |k: usize| {
        k >= half && k + half < f_hz.len() && (f_hz[k + half] - f_hz[k - half]).abs() > STEP_HZ
    };
    let median = |range: Range<usize>| {
        let mut x = f_hz[range].to_vec();
        x.sort_by(f64::total_cmp);
        x[x.len() / 2]
    };
    let mut start = 0;
    let mut out: Vec<(Range<usize>, f64)> = Vec::new();
    for k in 0..=f_hz.len() {
        if k == f_hz.len() || steps(k) {
            if k > start {
                out.push((start..k, median(start..k)));
            }
            start = k + 1;
        }
    }
    // Ranges shorter than a frame are transitions.
    if out.iter().any(|(range, _)| range.len() >= HOPS_PER_FRAME) {
        out.retain(|(range, _)| range.len() >= HOPS_PER_FRAME);
    }
    // A step of the load turns the phase once; the frequency before and after is the same.
    out.dedup_by(|b, a| {
        let same = (a.1 - b.1).abs() < 0.5 * STEP_HZ && b.0.start - a.0.end <= 2 * HOPS_PER_FRAME;
        if same {
            *a = (a.0.start..b.0.end, median(a.0.start..b.0.end));
        }
        same
    });
    out
}

/// Sample at which the frequency changes from `before` to `after`, in hertz: the change in rotation of the current's phasor,
/// by least squares over its increments.
fn boundary(capture: &Capture, zone: &Run, before: f64, after: f64) -> usize {
    let track = track::fundamental(capture, zone, before);
    let n = track.i_a.len();
    if n < 3 {
        return zone.samples.start + zone.samples.len() / 2;
    }
    let hop_s = track.t_s[1] - track.t_s[0];
    let cost = |k: usize, f: f64| {
        let turn = track.i_a[k + 1] * track.i_a[k].conj();
        let expected = Complex::from_polar(1.0, TAU * (f - before) * hop_s);
        turn.norm() * (turn * expected.conj()).arg().powi(2)
    };
    let mut sum: f64 = (0..n - 1).map(|k| cost(k, after)).sum();
    let (mut best, mut least) = (0, sum);
    for k in 0..n - 1 {
        sum += cost(k, before) - cost(k, after);
        if sum < least {
            (best, least) = (k + 1, sum);
        }
    }
    let t_s = track.t_s[best];
    zone.samples.start + ((t_s - zone.t0_s) / zone.dt_s).round().max(0.0) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_interruptions_are_zero_crossings_and_long_ones_are_not() {
        let mut valid = vec![true; 100];
        valid[..3].fill(false);
        valid[40..45].fill(false);
        valid[60..80].fill(false);
        let on = on_ranges(&valid);
        let ranges: Vec<_> = on.iter().map(|on| on.frames.clone()).collect();
        assert_eq!(ranges, [0..60, 80..100]);
        let off: Vec<_> = on.iter().map(|on| (on.off_before, on.off_after)).collect();
        assert_eq!(off, [(false, true), (true, false)]);
        assert!(on_ranges(&[false; 50]).is_empty());
    }
}
