//! Interpolation of R, L and P/I_rms² between the points of an estimate.

use ihd_signal::vectorised::vectorised;

use super::Estimate;

/// R and L between an estimate's points, linear, and constant before the first and after the last. The cursor only moves
/// forward.
#[derive(Clone, Copy, Debug)]
pub struct TrajectoryCursor<'a> {
    estimate: &'a Estimate,
    at: usize,
    /// R and L from the point at `at` to the next, computed at the first use.
    between: Option<TrajectoryPiece>,
}

/// R and L between two points.
#[derive(Clone, Copy, Debug)]
struct TrajectoryPiece {
    /// Time of the first point in seconds, and of the next; infinite if there is none.
    from_s: f64,
    until_s: f64,
    /// Reciprocal of the time between them in 1/s; 0 if there is no next.
    per_s: f64,
    /// R in ohm of the first point, and its change to the next.
    r_ohm: (f64, f64),
    /// L in henry of the first point, and its change to the next.
    l_h: (f64, f64),
}

impl<'a> TrajectoryCursor<'a> {
    /// Creates a trajectory of the points from `from_s` on; `None` if there are none.
    pub fn from(estimate: &'a Estimate, from_s: f64) -> Option<Self> {
        let at = estimate.t_s.partition_point(|t| *t < from_s);
        (at < estimate.t_s.len()).then_some(Self {
            estimate,
            at,
            between: None,
        })
    }

    /// R in ohm and L in henry; times must ascend from call to call.
    #[inline]
    pub fn r_l(&mut self, t_s: f64) -> (f64, f64) {
        let known = self.between.filter(|between| t_s < between.until_s);
        let between = known.unwrap_or_else(|| self.between_at(t_s));
        let w = ((t_s - between.from_s) * between.per_s).clamp(0.0, 1.0);
        let at = |(first, change): (f64, f64)| first + w * change;
        (at(between.r_ohm), at(between.l_h))
    }

    /// Writes R in ohm and L in henry at times that are `step_s` seconds apart from `from_s` on, up to the estimate's next point, and
    /// returns for how many; both slices have one length, and times must ascend from call to call.
    pub fn fill(&mut self, from_s: f64, step_s: f64, [r_ohm, l_h]: [&mut [f64]; 2]) -> usize {
        let known = self.between.filter(|between| from_s < between.until_s);
        let between = known.unwrap_or_else(|| self.between_at(from_s));
        let before_next = ((between.until_s - from_s) / step_s).ceil() as usize;
        let count = before_next.clamp(1, r_ohm.len());
        let (first, per_step) = (
            (from_s - between.from_s) * between.per_s,
            step_s * between.per_s,
        );
        vectorised(
            #[inline(always)]
            || {
                let loads = r_ohm[..count].iter_mut().zip(&mut l_h[..count]);
                for (k, (r, l)) in (0..count as u32).zip(loads) {
                    let w = (first + f64::from(k) * per_step).clamp(0.0, 1.0);
                    *r = between.r_ohm.0 + w * between.r_ohm.1;
                    *l = between.l_h.0 + w * between.l_h.1;
                }
            },
        );
        count
    }

    /// R and L about a time, kept for the following ones.
    fn between_at(&mut self, t_s: f64) -> TrajectoryPiece {
        let Interpolation { a, b, per_s, .. } = self.place(t_s);
        let times = &self.estimate.t_s;
        let of = |x: &[f64]| (x[a], x[b] - x[a]);
        *self.between.insert(TrajectoryPiece {
            from_s: times[a],
            until_s: if b > a { times[b] } else { f64::INFINITY },
            per_s,
            r_ohm: of(&self.estimate.r_ohm),
            l_h: of(&self.estimate.l_h),
        })
    }

    /// P/I_rms² in ohm; times must ascend from call to call. `None` if the estimate has none.
    pub fn r_power_ohm(&mut self, t_s: f64) -> Option<f64> {
        let place = self.place(t_s);
        let power = &self.estimate.r_power_ohm;
        (!power.is_empty()).then(|| place.between(power))
    }

    /// Standard deviations of R in ohm and L in henry; times must ascend from call to call. `None` if the estimate has none.
    pub fn sigma(&mut self, t_s: f64) -> Option<(f64, f64)> {
        let place = self.place(t_s);
        let (r, l) = (&self.estimate.r_sigma_ohm, &self.estimate.l_sigma_h);
        (!r.is_empty() && !l.is_empty()).then(|| (place.between(r), place.between(l)))
    }

    fn place(&mut self, t_s: f64) -> Interpolation {
        let times = &self.estimate.t_s;
        while self.at + 1 < times.len() && times[self.at + 1] <= t_s {
            self.at += 1;
        }
        let (a, b) = (self.at, (self.at + 1).min(times.len() - 1));
        let span = times[b] - times[a];
        let per_s = if span > 0.0 { 1.0 / span } else { 0.0 };
        let w = ((t_s - times[a]) * per_s).clamp(0.0, 1.0);
        Interpolation { a, b, per_s, w }
    }
}

/// Two adjacent points, the reciprocal of the time between them in 1/s, and the share of the way to the second.
#[derive(Clone, Copy)]
struct Interpolation {
    a: usize,
    b: usize,
    per_s: f64,
    w: f64,
}

impl Interpolation {
    fn between(self, x: &[f64]) -> f64 {
        x[self.a] + self.w * (x[self.b] - x[self.a])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Method;

    #[test]
    fn between_the_points_it_is_linear_and_beyond_them_held() {
        let mut estimate = Estimate::new(Method::Lockin, 45e3);
        for (t, r) in [(1.0, 9.0), (2.0, 1.0), (3.0, 3.0)] {
            estimate.push(t, (r, 2.0 * r), (0.0, 0.0));
        }
        let mut trajectory = TrajectoryCursor::from(&estimate, 1.5).expect("two points");
        assert_eq!(trajectory.r_l(1.5), (1.0, 2.0));
        assert_eq!(trajectory.r_l(2.25), (1.5, 3.0));
        assert_eq!(trajectory.r_l(9.0), (3.0, 6.0));
        assert!(TrajectoryCursor::from(&estimate, 3.5).is_none());
        assert_eq!(trajectory.r_power_ohm(9.0), None);
        estimate.r_power_ohm = vec![8.0, 2.0, 4.0];
        let mut trajectory = TrajectoryCursor::from(&estimate, 1.5).expect("two points");
        assert_eq!(trajectory.r_power_ohm(2.25), Some(2.5));
    }
}
