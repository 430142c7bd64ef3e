//! Comparison of two estimates of one segment over the middle 80 % of each mains half-cycle. Outside it the current is
//! small, and R and L depend on the method.

use std::f64::consts::TAU;

use ihd_identify::Estimate;
use ihd_identify::pooled::SharedSigma;
use ihd_identify::trajectory::TrajectoryCursor;
use ihd_signal::Segment;

use crate::limits::TOLERABLE_PCT;

/// Part of a half-cycle that is compared, from its zero crossing.
pub const MIDDLE: std::ops::Range<f64> = 0.1..0.9;

/// Least share of a half-cycle's middle that a segment must hold for a judgement beside whole half-cycles: near the end of a
/// stretch splines are free.
pub const MIN_SEEN: f64 = 0.5;

/// Times of a half-cycle's middle at which estimates are compared.
const POINTS: usize = 160;

/// Fewest of these times that both estimates must cover.
const MIN_POINTS: usize = 8;

/// A normal variable's mean magnitude, in standard deviations.
const MEAN_MAGNITUDE: f64 = 0.8;

/// Half-cycle of a segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfCycleSpan {
    /// Zero crossing in seconds, on the capture's clock.
    pub crossing_s: f64,
    /// Share of its middle that lies in the segment, 0 to 1.
    pub seen: f64,
}

impl HalfCycleSpan {
    /// Returns `true` if enough of the middle is there for a judgement of its own.
    pub fn is_whole(&self) -> bool {
        self.seen >= MIN_SEEN
    }
}

/// Half-cycles of a segment, stubs at its ends included that hold a switching period.
pub fn half_cycles(segment: &Segment) -> Vec<HalfCycleSpan> {
    let ranges = segment.half_cycles().into_iter();
    let period = segment.samples_per_period();
    let crossings = ranges
        .filter(|(from, to)| to.saturating_sub(*from) as f64 >= period)
        .map(|range| segment.crossing_of_s(range));
    let of = |crossing_s: f64| HalfCycleSpan {
        crossing_s,
        seen: times_s(segment, crossing_s, &[]).len() as f64 / POINTS as f64,
    };
    crossings.map(of).collect()
}

/// Half-cycles that are judged: the whole ones; of a segment without any the one of which most is there. Empty if no middle
/// of a half-cycle has points enough.
pub fn judged(segment: &Segment) -> Vec<HalfCycleSpan> {
    let all = half_cycles(segment);
    let whole: Vec<_> = all
        .iter()
        .copied()
        .filter(HalfCycleSpan::is_whole)
        .collect();
    if !whole.is_empty() {
        return whole;
    }
    let enough = |h: &HalfCycleSpan| h.seen * POINTS as f64 >= MIN_POINTS as f64;
    let longest = all.into_iter().max_by(|a, b| a.seen.total_cmp(&b.seen));
    longest.filter(enough).into_iter().collect()
}

/// Difference of two estimates in one half-cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// The half-cycle's zero crossing in seconds, on the capture's clock.
    pub crossing_s: f64,
    /// Mean of |ΔR|/R, and of |ΔL|/L, in percent.
    pub mean_pct: [f64; 2],
    /// Mean difference that the standard deviations of both estimates explain, in percent.
    pub expected_pct: [f64; 2],
}

impl Difference {
    /// Larger one of the means over what is tolerable.
    pub fn share(&self) -> f64 {
        (self.mean_pct[0] / TOLERABLE_PCT[0]).max(self.mean_pct[1] / TOLERABLE_PCT[1])
    }
}

/// Differences of `estimate` from `reference`, one per judged half-cycle.
pub fn differences(
    segment: &Segment,
    estimate: &Estimate,
    reference: &Estimate,
) -> Vec<Difference> {
    let each = judged(segment).into_iter().map(|half| {
        let crossing_s = half.crossing_s;
        let times = times_s(segment, crossing_s, &[estimate, reference]);
        let ours = Samples::from_estimate(estimate, &times)?;
        let theirs = Samples::from_estimate(reference, &times)?;
        let pair = |k: usize| {
            let n = times.len() as f64;
            let mut mean = 0.0;
            let mut expected = 0.0;
            for at in 0..times.len() {
                let right = theirs.value[k][at];
                mean += ((ours.value[k][at] - right) / right).abs() / n;
                expected += (ours.sigma[k][at].hypot(theirs.sigma[k][at]) / right).abs() / n;
            }
            (100.0 * mean, 100.0 * MEAN_MAGNITUDE * expected)
        };
        let (r, l) = (pair(0), pair(1));
        Some(Difference {
            crossing_s,
            mean_pct: [r.0, l.0],
            expected_pct: [r.1, l.1],
        })
    });
    each.flatten().collect()
}

/// Means of σ/R and of σ/L in percent, one pair per judged half-cycle with its zero crossing in seconds; empty if the
/// estimate states no deviations.
pub fn sigmas_pct(segment: &Segment, estimate: &Estimate) -> Vec<(f64, [f64; 2])> {
    if estimate.r_sigma_ohm.is_empty() {
        return Vec::new();
    }
    let each = judged(segment).into_iter().map(|half| {
        let crossing_s = half.crossing_s;
        let times = times_s(segment, crossing_s, &[estimate]);
        let samples = Samples::from_estimate(estimate, &times)?;
        let mean = |k: usize| {
            let shares = samples.sigma[k].iter().zip(&samples.value[k]);
            100.0 * shares.map(|(s, x)| (s / x).abs()).sum::<f64>() / times.len() as f64
        };
        Some((crossing_s, [mean(0), mean(1)]))
    });
    each.flatten().collect()
}

/// Standard deviations by the sensors in percent of the mean R and L, one pair per judged half-cycle with its zero crossing in seconds.
pub fn shared_pct(
    segment: &Segment,
    estimate: &Estimate,
    shared: &SharedSigma,
) -> Vec<(f64, [f64; 2])> {
    let omega = TAU * segment.f_sw_hz;
    let each = judged(segment).into_iter().map(|half| {
        let crossing_s = half.crossing_s;
        let times = times_s(segment, crossing_s, &[estimate]);
        let samples = Samples::from_estimate(estimate, &times)?;
        let mean = |k: usize| samples.value[k].iter().sum::<f64>() / times.len() as f64;
        let load = [mean(0), mean(1)];
        let sigma = shared.of(load, omega);
        let pct = std::array::from_fn(|k| 100.0 * (sigma[k] / load[k]).abs());
        Some((crossing_s, pct))
    });
    each.flatten().collect()
}

/// Share of the middles of the segment's judged half-cycles that the estimate's points cover, 0 to 1.
pub fn coverage(segment: &Segment, estimate: &Estimate) -> f64 {
    let (mut have, mut all) = (0usize, 0usize);
    let reach_s = 0.5 * (MIDDLE.end - MIDDLE.start) * segment.half_cycle_s() / 10.0;
    for half in judged(segment) {
        for t_s in times_s(segment, half.crossing_s, &[]) {
            all += 1;
            let at = estimate.t_s.partition_point(|t| *t < t_s);
            let near = [at.checked_sub(1), Some(at)];
            let near = near
                .into_iter()
                .flatten()
                .filter_map(|k| estimate.t_s.get(k));
            have += usize::from(near.into_iter().any(|t| (t - t_s).abs() <= reach_s));
        }
    }
    if all == 0 {
        1.0
    } else {
        have as f64 / all as f64
    }
}

/// Times in the middle of a half-cycle that the segment and all estimates span.
fn times_s(segment: &Segment, crossing_s: f64, estimates: &[&Estimate]) -> Vec<f64> {
    let half_s = segment.half_cycle_s();
    let mut from_s = segment.t0_s;
    let mut to_s = segment.t_s(segment.len());
    for estimate in estimates {
        from_s = from_s.max(estimate.t_s.first().copied().unwrap_or(f64::INFINITY));
        to_s = to_s.min(estimate.t_s.last().copied().unwrap_or(f64::NEG_INFINITY));
    }
    let step = (MIDDLE.end - MIDDLE.start) / POINTS as f64;
    (0..POINTS)
        .map(|k| crossing_s + (MIDDLE.start + (k as f64 + 0.5) * step) * half_s)
        .filter(|t| (from_s..=to_s).contains(t))
        .collect()
}

/// R and L of an estimate at given times.
struct Samples {
    value: [Vec<f64>; 2],
    sigma: [Vec<f64>; 2],
}

impl Samples {
    /// Samples an estimate at these times; `None` if they are too few to compare.
    fn from_estimate(estimate: &Estimate, times_s: &[f64]) -> Option<Self> {
        if times_s.len() < MIN_POINTS {
            return None;
        }
        let mut values = TrajectoryCursor::from(estimate, f64::NEG_INFINITY)?;
        let mut out = Self {
            value: Default::default(),
            sigma: Default::default(),
        };
        for &t_s in times_s {
            let (r, l) = values.r_l(t_s);
            out.value[0].push(r);
            out.value[1].push(l);
            let at = estimate.t_s.partition_point(|t| *t < t_s);
            let at = at.min(estimate.t_s.len().saturating_sub(1));
            let sigma = |x: &[f64]| x.get(at).copied().unwrap_or(0.0);
            out.sigma[0].push(sigma(&estimate.r_sigma_ohm));
            out.sigma[1].push(sigma(&estimate.l_sigma_h));
        }
        Some(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A capture that begins at a crossing begins some samples before it as it is measured: that is no half-cycle.
    #[test]
    fn a_stub_shorter_than_a_switching_period_is_no_half_cycle() {
        let crossings = |zero_crossing_s: f64| {
            let samples = || ihd_signal::Samples::singles(vec![1.0; 20_000]);
            let segment = Segment {
                f_sw_hz: 50e3,
                mains_hz: 50.0,
                zero_crossing_s,
                t0_s: 0.0,
                dt_s: 1e-6,
                v_v: samples(),
                i_a: samples(),
            };
            half_cycles(&segment).len()
        };
        assert_eq!([0.0, 15e-6, 25e-6].map(crossings), [2, 2, 3]);
    }
}
