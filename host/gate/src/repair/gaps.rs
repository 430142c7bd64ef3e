//! Samples that are missing without a mark: the phases of voltage and current jump together, and the impedance does not. The stamps
//! then get the gap, at which the survey cuts.
//!
//! A step of the load turns one against the other, one of the frequency bends both.

use std::borrow::Cow;
use std::f64::consts::{PI, TAU};

use ihd_identify::lockin::{Boxcar, LockInPhasors, demodulate};
use ihd_signal::carrier::Carrier;
use ihd_signal::noise::median;
use ihd_signal::{Capture, Remark, Segment, Severity, TimeBase};
use ihd_survey::Survey;
use nalgebra::Complex;

/// Switching periods of each of the two boxcars, from a place to the phasors that are compared, and to the comparisons that show
/// the usual change beside it.
const BOXCAR_PERIODS: f64 = 2.0;
const REACH_PERIODS: f64 = 3.0;
const BESIDE_PERIODS: f64 = 12.0;

/// Least jump in radian (five samples of 350 a period are .09), and in medians of what is usual in the stretch.
const MIN_RAD: f64 = 0.06;
const MIN_MEDIANS: f64 = 12.0;

/// Largest difference of the channels' jumps as a share of the jump, and largest change of their amplitudes.
const MAX_JUMP_DIFFERENCE: f64 = 0.15;
const SAME_AMPLITUDE: f64 = 0.1;

/// Least current as a share of the largest one.
const MIN_CURRENT: f64 = 0.12;

/// Periods that are left out on either side of a jump.
const LEFT_OUT_PERIODS: f64 = 1.5;

/// Most jumps of a stretch: more are noise, or a carrier that moves.
const MAX_JUMPS: usize = 8;

/// Jump of the phase.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Jump {
    /// Sample of the segment.
    at: f64,
    /// Missing samples, less than a switching period.
    missing: usize,
}

/// Stamps the samples of a capture with even times if some are missing.
pub(super) fn repair(capture: &mut Cow<'_, Capture>, survey: &Survey) -> Option<Remark> {
    let TimeBase::Even { t0_s, dt_s } = capture.time else {
        return None;
    };
    let mut jumps: Vec<(f64, usize, f64)> = Vec::new();
    survey.for_segments(capture, |span, segment| {
        let (first, per_period) = (
            survey.spans[span].first as f64,
            segment.samples_per_period(),
        );
        let of_span = find(segment).into_iter();
        jumps.extend(of_span.map(|jump| (first + jump.at, jump.missing, per_period)));
    });
    let (first, ..) = *jumps.first()?;
    let mut steps: Vec<usize> = (0..capture.len()).collect();
    let capture = capture.to_mut();
    let mut missing = 0;
    for (at, samples, per_period) in jumps.iter().rev() {
        let (from, to) = (
            at - LEFT_OUT_PERIODS * per_period,
            at + LEFT_OUT_PERIODS * per_period,
        );
        let range = from.max(0.0) as usize..(to as usize).min(steps.len());
        steps[range.end..].iter_mut().for_each(|k| *k += samples);
        steps.drain(range.clone());
        capture.v_v.drain(range.clone());
        capture.i_a.drain(range);
        missing += samples;
    }
    let stamps = steps.into_iter().map(|k| t0_s + k as f64 * dt_s);
    capture.time = TimeBase::Stamps(stamps.collect());
    let text = format!(
        "the phases of voltage and current jump together at {} places, first at {:.6} s, and the impedance does not: {missing} \
         samples or whole periods more are missing without a mark; the capture is cut there",
        jumps.len(),
        t0_s + first * dt_s
    );
    let remark = Remark::new("phase_step", Severity::Warning, text);
    Some(remark.with(missing as f64, None))
}

/// Difference of two phases beside what is usual around it, from −π to π.
fn wrapped(x: f64) -> f64 {
    (x + PI).rem_euclid(TAU) - PI
}

/// Jumps of a segment, in order of time.
fn find(segment: &Segment) -> Vec<Jump> {
    let (per_period, f_sw_hz) = (segment.samples_per_period(), segment.f_sw_hz);
    let boxcar = Boxcar::fitting(per_period, f_sw_hz, BOXCAR_PERIODS / f_sw_hz);
    let phasors = demodulate(segment, boxcar);
    let Some([a, b]) = phasors.first_chunk() else {
        return Vec::new();
    };
    let stride = b.centre - a.centre;
    let hops = |periods: f64| (periods * per_period / stride).ceil() as usize;
    let (reach, beside) = (hops(REACH_PERIODS), hops(BESIDE_PERIODS));
    let margin = reach + beside;
    if phasors.len() < 4 * margin {
        return Vec::new();
    }
    let largest_a = phasors.iter().map(|p| p.i.norm()).fold(0.0, f64::max);
    let places = margin..phasors.len() - margin;
    let turns: Vec<Option<[f64; 2]>> = places
        .clone()
        .map(|k| turn(&phasors, k, reach, beside, MIN_CURRENT * largest_a))
        .collect();
    // Noise turns a phase the more, the smaller the current is.
    let share = |k: usize| phasors[places.start + k].i.norm() / largest_a;
    let noise = turns.iter().enumerate().filter_map(|(k, turn)| {
        let [v, i] = (*turn)?;
        Some(v.abs().max(i.abs()) * share(k))
    });
    let Some(usual) = median(&mut noise.collect::<Vec<_>>()) else {
        return Vec::new();
    };
    let size_at = |k: usize| {
        let size = turns[k].as_ref().map_or(0.0, size);
        match size * share(k) > MIN_MEDIANS * usual {
            true => size,
            false => 0.0,
        }
    };
    let mut sizes: Vec<f64> = (0..turns.len()).map(size_at).collect();
    let mut jumps = Vec::new();
    // The largest first: what lies beside it compares with it, and seems to jump by half of it.
    while jumps.len() <= MAX_JUMPS
        && let Some(top) = (0..sizes.len()).max_by(|a, b| sizes[*a].total_cmp(&sizes[*b]))
        && sizes[top] >= MIN_RAD
        && let Some([v, i]) = turns[top]
    {
        let around = |hops: usize| top.saturating_sub(hops)..(top + hops + 1).min(turns.len());
        // The middle of what exceeds half of it.
        let high = around(2 * reach).filter(|n| sizes[*n] > 0.5 * sizes[top]);
        let (sum, count) = high.fold((0, 0), |(sum, count), n| (sum + n, count + 1));
        let periods = (0.5 * (v + i) / TAU).rem_euclid(1.0);
        // A jump is seen over the reach on both of its sides; a bend of the phases for longer, a place beside a weak current alone.
        if (2..=3 * reach).contains(&(count as usize)) {
            jumps.push(Jump {
                at: phasors[0].centre
                    + (places.start as f64 + sum as f64 / f64::from(count)) * stride,
                missing: ((periods * per_period).round() as usize).max(1),
            });
        }
        let near = around(beside + 2 * reach);
        sizes[near].fill(0.0);
    }
    jumps.sort_by(|a, b| a.at.total_cmp(&b.at));
    // A carrier that moves turns both phases, too.
    let moves = || Carrier::from_segment(segment).is_some_and(|carrier| carrier.moves());
    if jumps.is_empty() || jumps.len() > MAX_JUMPS || moves() {
        return Vec::new();
    }
    jumps
}

/// Common size of the turns of voltage and current; 0 if they differ.
fn size([v, i]: &[f64; 2]) -> f64 {
    let mean = 0.5 * (v + i).abs();
    match (v - i).abs() <= MAX_JUMP_DIFFERENCE * mean {
        true => mean,
        false => 0.0,
    }
}

/// Turn of voltage and of current about a phasor; `None` where the current is small or an amplitude changes.
fn turn(
    phasors: &[LockInPhasors],
    k: usize,
    reach: usize,
    beside: usize,
    least_a: f64,
) -> Option<[f64; 2]> {
    let weak = |n: usize| phasors[n].i.norm() < least_a;
    if weak(k - reach) || weak(k + reach) {
        return None;
    }
    let ratio = |of: fn(&LockInPhasors) -> Complex<f64>, n: usize| {
        of(&phasors[n + reach]) / of(&phasors[n - reach])
    };
    let one = |of: fn(&LockInPhasors) -> Complex<f64>| {
        let (before, here, after) = (ratio(of, k - beside), ratio(of, k), ratio(of, k + beside));
        // Relative to the mean of both sides.
        let usual = 0.5 * (wrapped(before.arg()) + wrapped(after.arg()));
        let amplitude = here.norm().ln() - 0.5 * (before.norm().ln() + after.norm().ln());
        (amplitude.abs() < SAME_AMPLITUDE).then(|| wrapped(here.arg() - usual))
    };
    Some([one(|p| p.v)?, one(|p| p.i)?])
}
