//! Interpolation of R, L and P/I_rms² between the points of an estimate.

use super::Estimate;

/// R and L between an estimate's points, linear, and constant before the first and after the last. The cursor only moves
/// forward.
#[derive(Clone, Copy, Debug)]
pub struct TrajectoryCursor<'a> {
    estimate: &'a Estimate,
    at: usize,
    /// Reciprocal of the time from the point at `at` to the next in 1/s, computed at the first use; 0 if there is no next.
    per_s: Option<f64>,
}

impl<'a> TrajectoryCursor<'a> {
    /// Creates a trajectory of the points from `from_s` on; `None` if there are none.
    pub fn from(estimate: &'a Estimate, from_s: f64) -> Option<Self> {
        let at = estimate.t_s.partition_point(|t| *t < from_s);
        (at < estimate.t_s.len()).then_some(Self {
            estimate,
            at,
            per_s: None,
        })
    }

    /// R in ohm and L in henry; times must ascend from call to call.
    pub fn r_l(&mut self, t_s: f64) -> (f64, f64) {
        let place = self.place(t_s);
        (
            place.between(&self.estimate.r_ohm),
            place.between(&self.estimate.l_h),
        )
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

    fn place(&mut self, t_s: f64) -> Place {
        let times = &self.estimate.t_s;
        while self.at + 1 < times.len() && times[self.at + 1] <= t_s {
            self.at += 1;
            self.per_s = None;
        }
        let (a, b) = (self.at, (self.at + 1).min(times.len() - 1));
        let span = times[b] - times[a];
        let inverse = || if span > 0.0 { 1.0 / span } else { 0.0 };
        let per_s = *self.per_s.get_or_insert_with(inverse);
        let w = ((t_s - times[a]) * per_s).clamp(0.0, 1.0);
        Place { a, b, w }
    }
}

/// Two adjacent points, and the share of the way to the second.
#[derive(Clone, Copy)]
struct Place {
    a: usize,
    b: usize,
    w: f64,
}

impl Place {
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
