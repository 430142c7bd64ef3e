//! Estimates against the truth of a simulated capture.

use ihd_signal::Segment;
use ihd_signal::truth::PeriodTruth;
use ihd_signal::truth::{Mre, Truth};

use super::Estimate;
use super::trajectory::Trajectory;

/// Current amplitude, as a share of the largest, below which the truth's own R and L are rounding.
const LEAST_CURRENT: f64 = 1e-3;

/// Mean relative errors of one estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Accuracy {
    /// Over all of the truth.
    pub whole: Mre,
    /// Over the middle 80 % of each mains half-cycle.
    pub middle: Mre,
    /// Weighted with the squared amplitude of the current: what counts for power.
    pub weighted: Mre,
}

impl Accuracy {
    /// Of an estimate from `from_s` on, against the fundamental's R and L, at the truth's times
    /// within the segment: the same for every estimator. Between its points the estimate is taken as linear, before the first
    /// and after the last as held; `None` where the two have no time in common. The mains phase is the
    /// segment's.
    pub fn of(
        estimate: &Estimate,
        segment: &Segment,
        truth: &[PeriodTruth],
        from_s: f64,
    ) -> Option<Self> {
        let truth = fundamental(truth);
        let half_s = segment.half_cycle_s();
        // Another half-cycle's estimate says nothing about this one.
        let mut trajectory = Trajectory::from(estimate, from_s)?;
        let inside = from_s.max(segment.t0_s)..=segment.t_s(segment.len());
        let times = truth.t_s.iter().filter(|t| inside.contains(t));
        let estimated: Vec<_> = times.map(|t| (*t, trajectory.r_l(*t))).collect();
        let points = || estimated.iter().map(|&(t, (r, l))| (t, r, l));
        let middle = |t: f64| (0.1..=0.9).contains(&(segment.since_crossing_s(t) / half_s));
        Some(Self {
            whole: Mre::weighted(&truth, points(), |_| 1.0)?,
            middle: Mre::weighted(&truth, points().filter(|p| middle(p.0)), |_| 1.0)?,
            weighted: Mre::weighted(&truth, points(), |t| amplitude(&truth, t).powi(2))?,
        })
    }
}

/// R, L and current of the fundamental, on the capture's clock.
pub fn fundamental(truth: &[PeriodTruth]) -> Truth {
    let largest = truth.iter().map(|t| t.i_a).fold(0.0, f64::max);
    let mut found = Truth::default();
    let known = truth.iter().filter(|t| t.i_a > LEAST_CURRENT * largest);
    for t in known.filter(|t| t.r_ohm[0] != 0.0 && t.l_h[0] != 0.0) {
        found.f_sw_hz = t.f_sw_hz;
        found.t_s.push(t.t_s);
        found.r_ohm.push(t.r_ohm[0]);
        found.l_h.push(t.l_h[0]);
        found.i_a.push(t.i_a);
    }
    found
}

/// The current's amplitude at the nearest time before.
fn amplitude(truth: &Truth, t_s: f64) -> f64 {
    let at = truth.t_s.partition_point(|&t| t <= t_s).saturating_sub(1);
    truth.i_a.get(at).copied().unwrap_or(0.0)
}
