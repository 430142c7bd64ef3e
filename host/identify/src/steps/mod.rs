//! Steps of the load inside a half-cycle: a pot that is lifted or put down. Estimators with smooth R and L would bend
//! them over a step. The segment is therefore cut there, and the pieces are identified separately and joined.

mod detect;

use std::ops::Range;

use ihd_signal::carrier::HannFrames;
use ihd_signal::segment::MIN_PERIODS;
use ihd_signal::{Remark, Segment, Severity};

use self::detect::Step;
use super::{Estimate, IdentifyError, IdentifyOptions, Method};

/// Switching periods that are left out on either side of a step; its time is known to half a period.
const GUARD_PERIODS: f64 = 2.0;

/// Switching periods that are left out beside a short piece.
const MIN_GUARD_PERIODS: f64 = 1.0;

/// Steps of the load in a segment, in order of time.
#[derive(Clone, Debug)]
pub(super) struct Steps(Vec<Step>);

impl Steps {
    pub(super) fn detect(segment: &Segment, frames: Option<&HannFrames>) -> Self {
        Self(frames.map_or(Vec::new(), |frames| detect::steps(segment, frames)))
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

/// Identifies a segment with steps of the load, at `known` steps or detected ones. If the method's R and L are smooth, `identify`
/// runs on each piece. `clock` converts the segment's time to the capture's, in seconds.
///
/// # Errors
/// Error of `identify` for a segment without steps; that of the last piece if none could be identified.
pub(super) fn identify(
    method: Method,
    segment: &Segment,
    known: Option<&Steps>,
    settings: &IdentifyOptions,
    clock: &dyn Fn(f64) -> f64,
    mut identify: impl FnMut(&Segment, &IdentifyOptions) -> Result<Estimate, IdentifyError>,
) -> Result<Estimate, IdentifyError> {
    // These methods reproduce the firmware, or the paper as printed.
    if matches!(method, Method::Firmware | Method::EkfPaper) {
        return identify(segment, settings);
    }
    let detected;
    let Steps(steps) = match known {
        Some(known) => known,
        None => {
            detected = Steps::detect(segment, HannFrames::compute(segment).as_ref());
            &detected
        }
    };
    if steps.is_empty() {
        return identify(segment, settings);
    }
    if !matches!(method, Method::LeastSquares | Method::Lockin | Method::Pinn) {
        let mut whole = identify(segment, settings)?;
        let remarks = steps.iter().map(|s| remark(s, clock(s.t_s), FOLLOWS));
        whole.remarks.extend(remarks);
        return Ok(whole);
    }
    joined(method, segment, settings, steps, clock, identify)
}

/// Remark on filters that pass a step.
const FOLLOWS: &str = "this filter takes its time to follow";

/// Identifies the pieces between the steps and joins them in order of time.
fn joined(
    method: Method,
    segment: &Segment,
    settings: &IdentifyOptions,
    steps: &[Step],
    clock: &dyn Fn(f64) -> f64,
    mut identify: impl FnMut(&Segment, &IdentifyOptions) -> Result<Estimate, IdentifyError>,
) -> Result<Estimate, IdentifyError> {
    let mut whole = Estimate::new(method, segment.f_sw_hz);
    let mut failed = None;
    for piece in pieces(segment, steps) {
        let (from_s, to_s) = piece.between_s;
        let part = segment.part(piece.samples.start, piece.samples.end);
        let result = if part.periods() < MIN_PERIODS {
            Err(part.too_short(MIN_PERIODS).into())
        } else {
            identify(&part, &shortened(settings, &part))
        };
        match result {
            Ok(result) => append(&mut whole, result, from_s, to_s),
            Err(e) => {
                let between_s = (clock(from_s), clock(to_s));
                let remark = piece_left_out("steps of the load", between_s, &part, &e);
                whole.remarks.push(remark);
                failed = Some(e);
            }
        }
    }
    if let (true, Some(e)) = (whole.t_s.is_empty(), failed) {
        return Err(e);
    }
    let cut = "before and after it were identified for themselves, and two periods on either side are held";
    let remarks = steps.iter().map(|s| remark(s, clock(s.t_s), cut));
    whole.remarks.extend(remarks);
    Ok(whole)
}

/// Remark on a piece without R and L; `bounds` says what it lies between, at these times on the capture's clock in seconds.
pub(super) fn piece_left_out(
    bounds: &str,
    (from_s, to_s): (f64, f64),
    piece: &Segment,
    why: &IdentifyError,
) -> Remark {
    let text = format!(
        "between {bounds}, {:.3} to {:.3} ms, there is no R and L: {why}",
        from_s * 1e3,
        to_s * 1e3
    );
    let remark = Remark::new("piece_left_out", Severity::Warning, text);
    remark.with(piece.periods(), Some(MIN_PERIODS))
}

/// Part of a segment between two steps, or between a step and an end.
struct Piece {
    /// Samples of the piece, without those left out beside the steps.
    samples: Range<usize>,
    /// Beginning and end in seconds, up to the steps.
    between_s: (f64, f64),
}

fn pieces(segment: &Segment, steps: &[Step]) -> Vec<Piece> {
    let per_period = segment.samples_per_period();
    let mut bounds_s = vec![segment.t0_s];
    bounds_s.extend(steps.iter().map(|s| s.t_s));
    bounds_s.push(segment.t_s(segment.len()));
    let last = bounds_s.len() - 2;
    bounds_s
        .windows(2)
        .enumerate()
        .map(|(k, between)| {
            let (from, to) = (
                segment.index_at(between[0]),
                segment.index_at(between[1]).min(segment.len()),
            );
            let sides = usize::from(k > 0) + usize::from(k < last);
            let periods = (to - from) as f64 / per_period;
            // One sample more on either side for rounding.
            let needed = MIN_PERIODS + 2.0 / per_period;
            let spare = (periods - needed) / sides.max(1) as f64;
            let guard = spare.clamp(MIN_GUARD_PERIODS, GUARD_PERIODS) * per_period;
            let inner = |side: bool| if side { guard.round() as usize } else { 0 };
            let start = (from + inner(k > 0)).min(to);
            Piece {
                samples: start..to.saturating_sub(inner(k < last)).max(start),
                between_s: (between[0], between[1]),
            }
        })
        .collect()
}

/// Options for a piece: boxcars that fit into it, and phasors that follow the current's settling after a step.
fn shortened(settings: &IdentifyOptions, piece: &Segment) -> IdentifyOptions {
    let mut settings = settings.clone();
    let periods = piece.len() as f64 / piece.samples_per_period();
    // Two boxcars, which may become a quarter longer, and three periods.
    let longest_s = (periods - 4.0) / 2.5 / piece.f_sw_hz;
    settings.least_squares.phasor_intervals *= 2;
    settings.lockin.boxcar_s = settings.lockin.boxcar_s.min(longest_s);
    settings
}

/// Appends the estimate of a piece; its first and last values are held up to the steps.
fn append(whole: &mut Estimate, piece: Estimate, from_s: f64, to_s: f64) {
    let (Some(first), Some(last)) = (piece.t_s.first(), piece.t_s.last()) else {
        return;
    };
    // Steps take no time, but the times of an estimate must ascend.
    let apart_s = 1e-9;
    let before = (from_s + apart_s < *first).then_some((from_s + apart_s, 0));
    let after = (to_s - apart_s > *last).then_some((to_s - apart_s, piece.t_s.len() - 1));
    let copies = |x: &[f64]| -> Vec<f64> {
        if x.len() != piece.t_s.len() {
            return Vec::new();
        }
        let at = |end: Option<(f64, usize)>| end.map(|(_, k)| x[k]);
        at(before)
            .into_iter()
            .chain(x.iter().copied())
            .chain(at(after))
            .collect()
    };
    whole.t_s.extend(before.map(|b| b.0));
    whole.t_s.extend(&piece.t_s);
    whole.t_s.extend(after.map(|a| a.0));
    whole.r_ohm.extend(copies(&piece.r_ohm));
    whole.l_h.extend(copies(&piece.l_h));
    whole.r_sigma_ohm.extend(copies(&piece.r_sigma_ohm));
    whole.l_sigma_h.extend(copies(&piece.l_sigma_h));
    whole.r_power_ohm.extend(copies(&piece.r_power_ohm));
    whole.elapsed += piece.elapsed;
    whole.notes.extend(piece.notes);
    whole.remarks.extend(piece.remarks);
}

/// Remark on a step at a time on the capture's clock in seconds; `how` describes its treatment.
fn remark(step: &Step, t_s: f64, how: &str) -> Remark {
    let times = |(before, after): (f64, f64)| match after / before {
        factor if factor > 0.0 => format!("{factor:.2}"),
        factor => format!("{factor:.2} (implausible)"),
    };
    let text = format!(
        "the load steps at {:.3} ms: R × {}, L × {}; {how}",
        t_s * 1e3,
        times(step.r_ohm),
        times(step.l_h)
    );
    Remark::new("load_step", Severity::Warning, text).with(t_s, None)
}

#[cfg(test)]
mod tests;
