//! Spikes: single samples far outside those around them. A sensor's fault that lasts one sample would otherwise be taken for
//! noise, and by the plateaus for a lag.

use std::borrow::Cow;
use std::ops::Range;

use ihd_signal::vectorised::vectorised;
use ihd_signal::{Capture, Remark, Severity};
use ihd_survey::Survey;

/// Fewest samples of a switching period: of fewer, a crest or an overshoot is a single sample, too.
const MIN_PER_PERIOD: f64 = 40.0;

/// Least height over the samples around it: a share of the channel's rms value, and standard deviations of its noise.
const MIN_SHARE: f64 = 0.25;
const MIN_SIGMAS: f64 = 8.0;

/// Most spikes of a channel per switching period: what comes at each edge is ringing.
const MAX_PER_PERIOD: f64 = 0.3;

/// Puts the mean of the neighbours in the place of each spike.
pub(super) fn repair(capture: &mut Cow<'_, Capture>, survey: &Survey) -> Option<Remark> {
    let mut counts = [0usize; 2];
    for channel in 0..2 {
        let numbers = [&survey.voltage, &survey.current][channel];
        let x = [&capture.v_v, &capture.i_a][channel];
        let height =
            (MIN_SHARE * numbers.rms).max(MIN_SIGMAS * numbers.noise.unwrap_or(0.0)) as f32;
        let mut found = Vec::new();
        for span in &survey.spans {
            let per_period = 1.0 / (span.f_sw_hz * span.dt_s);
            if per_period < MIN_PER_PERIOD {
                continue;
            }
            let of_span = find(x, span.first..span.first + span.samples, height);
            let most = MAX_PER_PERIOD * span.samples as f64 / per_period;
            if (of_span.len() as f64) < most {
                found.extend(of_span);
            }
        }
        if found.is_empty() {
            continue;
        }
        counts[channel] = found.len();
        let capture = capture.to_mut();
        let x = [&mut capture.v_v, &mut capture.i_a];
        let x = &mut *x.into_iter().nth(channel)?;
        for k in found {
            x[k] = 0.5 * (x[k - 1] + x[k + 1]);
        }
    }
    let all = counts[0] + counts[1];
    (all > 0).then(|| {
        let text = format!(
            "{} samples of the voltage and {} of the current stand far out of those around them: the mean of their neighbours \
             is taken; look at the cables and at what switches beside the hob",
            counts[0], counts[1]
        );
        Remark::new("spikes", Severity::Warning, text).with(all as f64, None)
    })
}

/// Samples that are tested together: most stretches of that length have no spike.
const BLOCK_SAMPLES: usize = 256;

/// Samples that exceed the two before and the two after by more than a height. An edge is monotonous and has none.
fn find(x: &[f32], range: Range<usize>, height: f32) -> Vec<usize> {
    let Some(x_of) = x.get(range.clone()) else {
        return Vec::new();
    };
    let stretch = |first: usize| &x_of[first..(first + BLOCK_SAMPLES + 4).min(x_of.len())];
    let has_any = |first: &usize| {
        vectorised(
            #[inline(always)]
            || any_stands_out(stretch(*first), height),
        )
    };
    let spikes_of = |first: usize| {
        let fives = stretch(first).array_windows().enumerate();
        let spikes = fives.filter(|(_, five)| stands_out(five, height));
        spikes.map(move |(k, _)| range.start + first + k + 2)
    };
    let firsts = (0..x_of.len().saturating_sub(4)).step_by(BLOCK_SAMPLES);
    firsts.filter(has_any).flat_map(spikes_of).collect()
}

/// Returns `true` if a sample of the stretch stands out; without a branch, for SIMD.
#[inline(always)]
fn any_stands_out(x: &[f32], height: f32) -> bool {
    let all = x
        .array_windows()
        .map(|five| u32::from(stands_out(five, height)));
    all.sum::<u32>() > 0
}

/// Returns `true` if the middle one of five samples is outside the others by more than a height.
#[inline(always)]
fn stands_out(&[a, b, middle, c, d]: &[f32; 5], height: f32) -> bool {
    let (low, high) = (a.min(b).min(c).min(d), a.max(b).max(c).max(d));
    (middle > high + height) | (middle < low - height)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spike_is_found_and_edges_and_crests_are_not() {
        // Square wave on a sine, 100 samples a period.
        let mut x: Vec<f32> = (0..1000)
            .map(|k| {
                let phase = std::f32::consts::TAU * k as f32 / 100.0;
                100.0 * phase.sin() + if k % 100 < 50 { 150.0 } else { -150.0 }
            })
            .collect();
        assert!(find(&x, 0..1000, 30.0).is_empty());
        x[333] += 80.0;
        x[700] -= 400.0;
        assert_eq!(find(&x, 0..1000, 30.0), [333, 700]);
    }
}
