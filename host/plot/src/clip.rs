//! Cut of a polyline at the frame, with its course outside.

use crate::Scale;

/// Edge of the frame through which a curve leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameEdge {
    /// Above the frame.
    Top,
    /// Below it.
    Bottom,
}

/// Part of a curve beyond the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutsidePart {
    /// Place at which it leaves, in the units of the x axis.
    pub from: f64,
    /// Place at which it returns or ends.
    pub to: f64,
    /// Edge.
    pub edge: FrameEdge,
    /// Outermost value; infinite if the curve is.
    pub extreme: f64,
}

/// Parts of a curve inside and outside of the frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClippedCurve {
    /// Polylines within the frame, cut at its edge.
    pub inside: Vec<Vec<(f64, f64)>>,
    /// Parts beyond the frame.
    pub outside: Vec<OutsidePart>,
}

/// Cuts a polyline at the upper and lower edge of its frame. Points beyond its left or right edge, and points that are not finite,
/// break it.
pub fn clip(points: &[(f64, f64)], x: &Scale, y: &Scale) -> ClippedCurve {
    let mut cut = Cut {
        y,
        clipped: ClippedCurve::default(),
        run: Vec::new(),
        away: None,
        last: None,
    };
    let ends = x.ends();
    for &point in points {
        if point.1.is_nan() || !(ends.start..=ends.end).contains(&point.0) {
            cut.end();
        } else {
            cut.go_to(point);
        }
    }
    cut.end();
    cut.clipped
}

/// State of the cut.
struct Cut<'a> {
    y: &'a Scale,
    clipped: ClippedCurve,
    run: Vec<(f64, f64)>,
    away: Option<OutsidePart>,
    last: Option<(f64, f64)>,
}

impl Cut<'_> {
    fn edge_of(&self, value: f64) -> Option<FrameEdge> {
        let ends = self.y.ends();
        if value > ends.end {
            Some(FrameEdge::Top)
        } else if value < ends.start {
            Some(FrameEdge::Bottom)
        } else {
            None
        }
    }

    fn go_to(&mut self, point: (f64, f64)) {
        let now = self.edge_of(point.1);
        if let Some(last) = self.last {
            let before = self.edge_of(last.1);
            if before != now {
                if let Some(edge) = before {
                    let at = self.crossing(last, point, edge);
                    self.close(at.0);
                    self.run.push(at);
                }
                if let Some(edge) = now {
                    let at = self.crossing(last, point, edge);
                    self.run.push(at);
                    self.lift();
                    self.leave(at.0, edge);
                }
            }
        } else if let Some(edge) = now {
            self.leave(point.0, edge);
        }
        match (now, &mut self.away) {
            (None, _) => self.run.push(point),
            (Some(FrameEdge::Top), Some(away)) => away.extreme = away.extreme.max(point.1),
            (Some(FrameEdge::Bottom), Some(away)) => away.extreme = away.extreme.min(point.1),
            (Some(_), None) => {}
        }
        self.last = Some(point);
    }

    /// Place at which the line between two points meets an edge, along the axis as drawn.
    fn crossing(&self, a: (f64, f64), b: (f64, f64), edge: FrameEdge) -> (f64, f64) {
        let ends = self.y.ends();
        let (unit, value) = match edge {
            FrameEdge::Top => (1.0, ends.end),
            FrameEdge::Bottom => (0.0, ends.start),
        };
        let (from, to) = (self.y.unit(a.1), self.y.unit(b.1));
        let share = match (from.is_finite(), to.is_finite()) {
            (true, true) => ((unit - from) / (to - from)).clamp(0.0, 1.0),
            // A line to infinity is vertical.
            (true, false) => 0.0,
            (false, _) => 1.0,
        };
        (a.0 + share * (b.0 - a.0), value)
    }

    fn leave(&mut self, x: f64, edge: FrameEdge) {
        let ends = self.y.ends();
        let extreme = match edge {
            FrameEdge::Top => ends.end,
            FrameEdge::Bottom => ends.start,
        };
        self.away = Some(OutsidePart {
            from: x,
            to: x,
            edge,
            extreme,
        });
    }

    fn close(&mut self, x: f64) {
        if let Some(mut away) = self.away.take() {
            away.to = x;
            self.clipped.outside.push(away);
        }
    }

    fn lift(&mut self) {
        let run = std::mem::take(&mut self.run);
        if !run.is_empty() {
            self.clipped.inside.push(run);
        }
    }

    fn end(&mut self) {
        self.lift();
        if let Some(last) = self.last.take() {
            self.close(last.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn frame() -> (Scale, Scale) {
        (Scale::linear(0.0..10.0), Scale::linear(-1.0..1.0))
    }

    #[test]
    fn a_curve_ends_at_the_frame_and_is_marked_there() {
        let (x, y) = frame();
        let clipped = clip(&[(0.0, 0.0), (1.0, 2.0), (2.0, 5.0), (3.0, 0.0)], &x, &y);
        assert_eq!(
            clipped.inside,
            [vec![(0.0, 0.0), (0.5, 1.0)], vec![(2.8, 1.0), (3.0, 0.0)]]
        );
        let outside = OutsidePart {
            from: 0.5,
            to: 2.8,
            edge: FrameEdge::Top,
            extreme: 5.0,
        };
        assert_eq!(clipped.outside, [outside]);
    }

    #[test]
    fn a_curve_that_is_never_inside_draws_no_line() {
        let (x, y) = frame();
        let clipped = clip(&[(0.0, -3.0), (10.0, -4.0)], &x, &y);
        assert!(clipped.inside.is_empty());
        let outside = OutsidePart {
            from: 0.0,
            to: 10.0,
            edge: FrameEdge::Bottom,
            extreme: -4.0,
        };
        assert_eq!(clipped.outside, [outside]);
    }

    #[test]
    fn a_jump_from_below_to_above_crosses_the_frame() {
        let (x, y) = frame();
        let clipped = clip(&[(0.0, -3.0), (1.0, 3.0)], &x, &y);
        assert_eq!(clipped.inside.len(), 1);
        let ends = &clipped.inside[0];
        assert!((ends[0].0 - 1.0 / 3.0).abs() < 1e-12 && ends[0].1 == -1.0);
        assert!((ends[1].0 - 2.0 / 3.0).abs() < 1e-12 && ends[1].1 == 1.0);
        let edges: Vec<FrameEdge> = clipped.outside.iter().map(|o| o.edge).collect();
        assert_eq!(edges, [FrameEdge::Bottom, FrameEdge::Top]);
    }

    #[test]
    fn on_decades_it_is_cut_where_it_is_drawn_and_zero_is_below() {
        let y = Scale::decades(1.0..100.0);
        let x = Scale::linear(0.0..10.0);
        let clipped = clip(&[(0.0, 10.0), (1.0, 1000.0), (2.0, 0.0)], &x, &y);
        // Half of two decades, not a tenth of 990.
        assert_eq!(clipped.inside[0], [(0.0, 10.0), (0.5, 100.0)]);
        assert_eq!(clipped.outside.last().unwrap().edge, FrameEdge::Bottom);
        assert_eq!(clipped.outside.last().unwrap().extreme, 0.0);
    }

    #[test]
    fn what_is_no_number_breaks_the_line() {
        let (x, y) = frame();
        let points = [(0.0, 0.0), (1.0, f64::NAN), (2.0, 0.5), (11.0, 0.5)];
        let clipped = clip(&points, &x, &y);
        assert_eq!(clipped.inside, [vec![(0.0, 0.0)], vec![(2.0, 0.5)]]);
        let clipped = clip(&[(0.0, 0.0), (1.0, f64::INFINITY), (2.0, 0.5)], &x, &y);
        assert_eq!(clipped.outside[0].extreme, f64::INFINITY);
    }

    proptest! {
        #[test]
        fn nothing_inside_is_outside(ys in prop::collection::vec(-5.0..5.0f64, 0..40)) {
            let (x, y) = frame();
            let points: Vec<_> = ys.iter().enumerate().map(|(k, y)| (0.2 * k as f64, *y)).collect();
            let clipped = clip(&points, &x, &y);
            for point in clipped.inside.iter().flatten() {
                prop_assert!((-1.0..=1.0).contains(&point.1) && (0.0..=10.0).contains(&point.0));
            }
            // Every point is drawn, or lies in a stretch that is marked.
            for (t, v) in points {
                let drawn = clipped.inside.iter().flatten().any(|p| *p == (t, v));
                let marked = clipped.outside.iter().any(|o| o.from <= t && t <= o.to);
                prop_assert!(drawn || marked);
            }
        }
    }
}
