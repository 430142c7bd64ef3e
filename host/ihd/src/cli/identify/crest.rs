//! Choice of the estimates that stand for a half-cycle: at the crest of the current, and means weighted by its square.

use ihd_identify::Estimate;
use ihd_signal::vectorised::{self, dot, vectorised};
use ihd_signal::{Samples, Segment};

/// Largest distance from the crest, in half-cycles.
const AT_CREST: f64 = 0.02;

/// Mean square of the current over a switching period around each time, in A²: the weights of means over a half-cycle. The
/// current's mean, a sensor's offset, is taken off: the resonance capacitor blocks direct current.
pub fn squared_current(segment: &Segment, t_s: &[f64]) -> Vec<f64> {
    let reach = (0.5 * segment.samples_per_period()).ceil() as usize;
    let last = segment.len();
    let range = |t: &f64| {
        let at = (((t - segment.t0_s) / segment.dt_s).max(0.0) as usize).min(last);
        (at.saturating_sub(reach), (at + reach).min(last))
    };
    let ranges: Vec<(usize, usize)> = t_s.iter().map(range).collect();
    let mut ends: Vec<usize> = ranges.iter().flat_map(|r| [r.0, r.1]).collect();
    ends.push(segment.len());
    ends.sort_unstable();
    ends.dedup();
    let sums = sums(segment, &ends);
    let sum_to = |end: usize| ends.binary_search(&end).map_or((0.0, 0.0), |k| sums[k]);
    let offset_a = sum_to(segment.len()).0 / segment.len().max(1) as f64;
    let mean = |(from, to): (usize, usize)| {
        let ((i_from, ii_from), (i_to, ii_to)) = (sum_to(from), sum_to(to));
        let count = (to - from).max(1) as f64;
        (ii_to - ii_from - 2.0 * offset_a * (i_to - i_from)) / count + offset_a * offset_a
    };
    ranges.into_iter().map(mean).collect()
}

/// Sums of the current in ampere, and of its square, up to each of these indices, which ascend.
fn sums(segment: &Segment, ends: &[usize]) -> Vec<(f64, f64)> {
    let (mut from, mut sum, mut buffer) = (0, (0.0, 0.0), Vec::new());
    let up_to = |end: &usize| {
        for first in (from..*end).step_by(Samples::CHUNK) {
            let block = first..(first + Samples::CHUNK).min(*end);
            let i_a = segment.i_a.block(block, &mut buffer);
            let [of_block, squares] = vectorised(
                #[inline(always)]
                || [vectorised::sum(i_a), dot(i_a, i_a)],
            );
            sum = (sum.0 + of_block, sum.1 + squares);
        }
        from = *end;
        sum
    };
    ends.iter().map(up_to).collect()
}

/// Least distance of the crest from the segment's ends, in half-cycles: an estimate at an end has samples on one side only.
const INSIDE: f64 = 0.05;

/// Estimate nearest to the last middle of a half-cycle that lies inside the segment: the current's crest.
pub fn crest(segment: &Segment, estimate: &Estimate) -> Option<usize> {
    let half_s = segment.half_cycle_s();
    let off = |t: f64| (segment.since_crossing_s(t) - 0.5 * half_s).abs();
    let (from_s, to_s) = (segment.t0_s, segment.t_s(segment.len()));
    let is_inside = |t: f64| (t - from_s).min(to_s - t) > INSIDE * half_s;
    let near = (estimate.t_s.iter().enumerate())
        .filter(|(_, t)| off(**t) < AT_CREST * half_s && is_inside(**t));
    let last = near.clone().next_back().map(|(_, t)| *t)?;
    let of_last = near.filter(|(_, t)| last - **t < 0.5 * half_s);
    of_last
        .min_by(|a, b| off(*a.1).total_cmp(&off(*b.1)))
        .map(|(k, _)| k)
}

/// Estimate nearest to the middle of the half-cycle that begins at `from_s`.
pub fn crest_of(segment: &Segment, estimate: &Estimate, from_s: f64) -> Option<usize> {
    let half_s = segment.half_cycle_s();
    let off = |t: f64| (t - from_s - 0.5 * half_s).abs();
    let all = estimate.t_s.iter().enumerate();
    let near = all.filter(|(_, t)| off(**t) < AT_CREST * half_s);
    near.min_by(|a, b| off(*a.1).total_cmp(&off(*b.1)))
        .map(|(k, _)| k)
}

#[cfg(test)]
mod tests {
    use ihd_identify::Method;

    use super::*;

    /// A capture triggered at the crest, for a whole half-cycle or more.
    #[test]
    fn a_crest_at_an_end_of_the_capture_is_none() {
        let crest_s = |from_s: f64, to_s: f64| {
            let dt_s = 1e-5;
            let zero = Samples::singles(vec![0.0; ((to_s - from_s) / dt_s).round() as usize]);
            let segment = Segment {
                t0_s: from_s,
                dt_s,
                v_v: zero.clone(),
                i_a: zero,
                f_sw_hz: 50e3,
                mains_hz: 50.0,
                zero_crossing_s: 0.0,
            };
            let mut estimate = Estimate::new(Method::Lockin, 50e3);
            let points = (0..segment.len()).step_by(10);
            estimate.t_s = points.map(|k| segment.t_s(k)).collect();
            crest(&segment, &estimate).map(|k| estimate.t_s[k])
        };
        assert_eq!(crest_s(5e-3, 15e-3), None);
        let near = |found: Option<f64>, t_s: f64| found.is_some_and(|t| (t - t_s).abs() < 1e-9);
        assert!(near(crest_s(0.0, 15.1e-3), 5e-3));
        assert!(near(crest_s(0.0, 20e-3), 15e-3));
    }

    /// A current clamp's offset of 20 A weighs the weak current beside the crossings no more than its true square does.
    #[test]
    fn a_sensors_offset_changes_no_weight() {
        let (dt_s, f_sw_hz) = (1e-6, 50e3);
        let with = |offset_a: f64| {
            let current = |k: usize| {
                let t_s = k as f64 * dt_s;
                let envelope = (std::f64::consts::PI * t_s / 10e-3).sin();
                let carrier = (std::f64::consts::TAU * f_sw_hz * t_s).sin();
                (30.0 * envelope * carrier + offset_a) as f32
            };
            let i_a: Vec<f32> = (0..10_000).map(current).collect();
            let segment = Segment {
                t0_s: 0.0,
                dt_s,
                v_v: Samples::singles(i_a.clone()),
                i_a: Samples::singles(i_a),
                f_sw_hz,
                mains_hz: 50.0,
                zero_crossing_s: 0.0,
            };
            squared_current(&segment, &[0.1e-3, 2e-3, 5e-3])
        };
        let (right, offset) = (with(0.0), with(20.0));
        for (right, offset) in right.iter().zip(&offset) {
            assert!((offset - right).abs() < 1e-3 * 450.0, "{right} {offset}");
        }
        assert!((right[2] / 450.0 - 1.0).abs() < 0.01, "{right:?}");
    }
}
