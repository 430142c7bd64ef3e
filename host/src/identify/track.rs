//! R and L of an estimate between its points.

use super::Estimate;

/// R and L between an estimate's points, linear, and held before the first and after the last; a
/// cursor that only moves forward.
#[derive(Clone, Copy, Debug)]
pub struct Track<'a> {
    estimate: &'a Estimate,
    at: usize,
}

impl<'a> Track<'a> {
    /// The points from `from_s` on; `None` where there are none.
    pub fn from(estimate: &'a Estimate, from_s: f64) -> Option<Self> {
        let at = estimate.t_s.partition_point(|t| *t < from_s);
        (at < estimate.t_s.len()).then_some(Self { estimate, at })
    }

    /// R in ohm and L in henry at a time no earlier than the last one that was asked for.
    pub fn r_l(&mut self, t_s: f64) -> (f64, f64) {
        let e = self.estimate;
        while self.at + 1 < e.t_s.len() && e.t_s[self.at + 1] <= t_s {
            self.at += 1;
        }
        let (a, b) = (self.at, (self.at + 1).min(e.t_s.len() - 1));
        let span = e.t_s[b] - e.t_s[a];
        let w = if span > 0.0 {
            ((t_s - e.t_s[a]) / span).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let between = |x: &[f64]| x[a] + w * (x[b] - x[a]);
        (between(&e.r_ohm), between(&e.l_h))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::Method;

    #[test]
    fn between_the_points_it_is_linear_and_beyond_them_held() {
        let mut estimate = Estimate::new(Method::Lockin, 45e3);
        for (t, r) in [(1.0, 9.0), (2.0, 1.0), (3.0, 3.0)] {
            estimate.push(t, (r, 2.0 * r), (0.0, 0.0));
        }
        let mut track = Track::from(&estimate, 1.5).expect("two points");
        assert_eq!(track.r_l(1.5), (1.0, 2.0));
        assert_eq!(track.r_l(2.25), (1.5, 3.0));
        assert_eq!(track.r_l(9.0), (3.0, 6.0));
        assert!(Track::from(&estimate, 3.5).is_none());
    }
}
