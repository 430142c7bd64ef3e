//! Errors of estimates against the truth of a simulated capture.

use ihd_signal::Segment;
use ihd_signal::truth::PeriodTruth;
use ihd_signal::truth::{Mre, Truth};

use super::Estimate;
use super::trajectory::TrajectoryCursor;

/// Share of the largest current amplitude below which the truth's own R and L are rounding errors.
const MIN_CURRENT: f64 = 1e-3;

/// Mean relative errors of one estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Accuracy {
    /// Errors over all of the truth.
    pub whole: Mre,
    /// Errors over the middle 80 % of each mains half-cycle.
    pub middle: Mre,
    /// Errors weighted with the squared amplitude of the current, which determines the power.
    pub weighted: Mre,
}

impl Accuracy {
    /// Compares an estimate from `from_s` on with the fundamental's R and L, at the truth's times within the segment, which are the
    /// same for every estimator. The estimate is linear between its points, and constant before the first and after the last.
    /// `None` if estimate and truth have no time in common. The mains phase is the segment's.
    pub fn measure(
        estimate: &Estimate,
        segment: &Segment,
        truth: &[PeriodTruth],
        from_s: f64,
    ) -> Option<Self> {
        let truth = fundamental(truth);
        let half_s = segment.half_cycle_s();
        // Points of another half-cycle's estimate must not be used here.
        let mut trajectory = TrajectoryCursor::from(estimate, from_s)?;
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
    let mut fundamental = Truth::default();
    let known = truth.iter().filter(|t| t.i_a > MIN_CURRENT * largest);
    for t in known.filter(|t| t.r_ohm[0] != 0.0 && t.l_h[0] != 0.0) {
        fundamental.f_sw_hz = t.f_sw_hz;
        fundamental.t_s.push(t.t_s);
        fundamental.r_ohm.push(t.r_ohm[0]);
        fundamental.l_h.push(t.l_h[0]);
        fundamental.i_a.push(t.i_a);
    }
    fundamental
}

/// Current amplitude at the nearest earlier time.
fn amplitude(truth: &Truth, t_s: f64) -> f64 {
    let at = truth.t_s.partition_point(|&t| t <= t_s).saturating_sub(1);
    truth.i_a.get(at).copied().unwrap_or(0.0)
}
