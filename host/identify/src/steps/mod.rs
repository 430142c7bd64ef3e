//! Steps of the load inside a half-cycle: a pot that is lifted or put down. Estimators whose R and L are smooth would bend
//! them over a step, so the segment is cut there, the pieces are identified for themselves and joined.

mod detect;

use std::ops::Range;

use ihd_signal::{Remark, Segment, Severity};

use self::detect::Step;
use super::{Estimate, IdentifyError, Method, Settings};

/// Switching periods that are left out on either side of a step: what is known of its time is half a period.
const GUARD_PERIODS: f64 = 2.0;

/// The same beside a piece that is short.
const LEAST_GUARD_PERIODS: f64 = 1.0;

/// Fewest switching periods of a piece that is identified.
const LEAST_PERIODS: f64 = ihd_signal::segment::MIN_PERIODS;

/// Steps of the load in a segment, in order of time.
#[derive(Clone, Debug)]
pub(super) struct Steps(Vec<Step>);

impl Steps {
    pub(super) fn of(segment: &Segment) -> Self {
        Self(detect::steps(segment))
    }
}

/// Identifies a segment in which the load may step, at `known` steps or where they are found, piece by piece with `identify` where the method's R and L are smooth;
/// `clock` tells the capture's time, in seconds, at one of the segment's.
///
/// # Errors
/// What `identify` gives for a segment without steps; the last piece's where none could be identified.
pub(super) fn identify(
    method: Method,
    segment: &Segment,
    known: Option<&Steps>,
    settings: &Settings,
    clock: &dyn Fn(f64) -> f64,
    mut identify: impl FnMut(&Segment, &Settings) -> Result<Estimate, IdentifyError>,
) -> Result<Estimate, IdentifyError> {
    // These follow what the firmware follows, or what the paper prints.
    if matches!(method, Method::Firmware | Method::EkfPaper) {
        return identify(segment, settings);
    }
    let found;
    let Steps(steps) = match known {
        Some(known) => known,
        None => {
            found = Steps::of(segment);
            &found
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

/// What a filter makes of a step.
const FOLLOWS: &str = "this filter takes its time to follow";

/// The pieces between the steps, identified and put together in order of time.
fn joined(
    method: Method,
    segment: &Segment,
    settings: &Settings,
    steps: &[Step],
    clock: &dyn Fn(f64) -> f64,
    mut identify: impl FnMut(&Segment, &Settings) -> Result<Estimate, IdentifyError>,
) -> Result<Estimate, IdentifyError> {
    let mut whole = Estimate::new(method, segment.f_sw_hz);
    let mut failed = None;
    for piece in pieces(segment, steps) {
        let (from_s, to_s) = piece.between_s;
        let part = segment.part(piece.samples.start, piece.samples.end);
        let periods = part.len() as f64 / part.samples_per_period();
        let found = if periods < LEAST_PERIODS {
            Err(ihd_signal::SegmentError::TooShort {
                periods,
                needed: LEAST_PERIODS,
            }
            .into())
        } else {
            identify(&part, &shortened(settings, &part))
        };
        match found {
            Ok(found) => append(&mut whole, found, from_s, to_s),
            Err(e) => {
                let text = format!(
                    "between steps of the load, {:.3} to {:.3} ms, there is no R and L: {e}",
                    clock(from_s) * 1e3,
                    clock(to_s) * 1e3
                );
                let left_out = Remark::new("piece_left_out", Severity::Warning, text);
                whole
                    .remarks
                    .push(left_out.with(periods, Some(LEAST_PERIODS)));
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

/// A stretch between two steps, or between a step and an end.
struct Piece {
    /// Its samples, without what is left out beside the steps.
    samples: Range<usize>,
    /// From and to in seconds, up to the steps.
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
            let at = |t_s: f64| ((t_s - segment.t0_s) / segment.dt_s).round().max(0.0) as usize;
            let (from, to) = (at(between[0]), at(between[1]).min(segment.len()));
            let sides = usize::from(k > 0) + usize::from(k < last);
            let periods = (to - from) as f64 / per_period;
            // A sample a side for rounding.
            let needed = LEAST_PERIODS + 2.0 / per_period;
            let spare = (periods - needed) / sides.max(1) as f64;
            let guard = spare.clamp(LEAST_GUARD_PERIODS, GUARD_PERIODS) * per_period;
            let inner = |side: bool| if side { guard.round() as usize } else { 0 };
            let start = (from + inner(k > 0)).min(to);
            Piece {
                samples: start..to.saturating_sub(inner(k < last)).max(start),
                between_s: (between[0], between[1]),
            }
        })
        .collect()
}

/// Settings for a piece: boxcars that fit into it, and phasors that follow the current while it settles after a step.
fn shortened(settings: &Settings, piece: &Segment) -> Settings {
    let mut settings = settings.clone();
    let periods = piece.len() as f64 / piece.samples_per_period();
    // Two boxcars, which may become a quarter longer, and three periods.
    let longest_s = (periods - 4.0) / 2.5 / piece.f_sw_hz;
    settings.least_squares.phasor_intervals *= 2;
    settings.lockin.boxcar_s = settings.lockin.boxcar_s.min(longest_s);
    settings
}

/// Appends what was found in a piece; its first and last values hold up to the steps.
fn append(whole: &mut Estimate, found: Estimate, from_s: f64, to_s: f64) {
    let (Some(first), Some(last)) = (found.t_s.first(), found.t_s.last()) else {
        return;
    };
    // Steps take no time, but times ascend.
    let apart_s = 1e-9;
    let before = (from_s + apart_s < *first).then_some((from_s + apart_s, 0));
    let after = (to_s - apart_s > *last).then_some((to_s - apart_s, found.t_s.len() - 1));
    let copies = |x: &[f64]| -> Vec<f64> {
        if x.len() != found.t_s.len() {
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
    whole.t_s.extend(&found.t_s);
    whole.t_s.extend(after.map(|a| a.0));
    whole.r_ohm.extend(copies(&found.r_ohm));
    whole.l_h.extend(copies(&found.l_h));
    whole.r_sigma_ohm.extend(copies(&found.r_sigma_ohm));
    whole.l_sigma_h.extend(copies(&found.l_sigma_h));
    whole.r_power_ohm.extend(copies(&found.r_power_ohm));
    whole.elapsed += found.elapsed;
    whole.notes.extend(found.notes);
    whole.remarks.extend(found.remarks);
}

/// The step in words, at its time on the capture's clock in seconds; `how` says what was made of it.
fn remark(step: &Step, t_s: f64, how: &str) -> Remark {
    let times = |(before, after): (f64, f64)| after / before;
    let text = format!(
        "the load steps at {:.3} ms: R to {:.2} and L to {:.2} times what they were; {how}",
        t_s * 1e3,
        times(step.r_ohm),
        times(step.l_h)
    );
    Remark::new("load_step", Severity::Warning, text).with(t_s, None)
}

#[cfg(test)]
mod tests;
