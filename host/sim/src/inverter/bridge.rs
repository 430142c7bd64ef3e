//! The half-bridge's output node: gates, dead time, edges.

use super::InverterError;
use super::node::{Commutations, GateTimes, SwitchNode};

/// Motion of the node.
#[derive(Clone, Debug, PartialEq)]
enum Edge {
    /// Linear, with this duration in seconds, independent of the current.
    Fixed(f64),
    /// By the current into the node's capacitance.
    Node(SwitchNode),
}

/// Node that stays where it is for a while.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SteadyNode {
    /// Level of the node, 0 or 1.
    pub level: f64,
    /// Time after the start of the period until when it stays there, in seconds.
    pub until_s: f64,
    /// `true` while only the current's direction holds it, through a diode in the dead time.
    pub by_diode: bool,
}

impl SteadyNode {
    /// Returns `true` while it stays there with this coil current, in ampere.
    #[inline(always)]
    pub fn holds(&self, i_a: f64) -> bool {
        !self.by_diode || (i_a != 0.0 && rail(i_a) == self.level)
    }
}

/// Half-bridge; its level is the node voltage as a share of the bus, 0 to 1.
///
/// In a period T the upper gate is on from the dead time to duty · T, the lower gate from duty · T + dead time to T; the duty is
/// one half unless set. With both off, the coil current moves the node: out of the node (positive) it pulls to 0, into the node it
/// lifts to 1. Without current the node stays until the next gate switches hard.
///
/// There are two models of an edge. Either it is linear with a given duration (paper: 0.2 µs), and a current too small to finish it
/// within the dead time is not modelled; or the current charges the node's capacitance.
#[derive(Clone, Debug, PartialEq)]
pub struct SwitchedHalfBridge {
    dead_s: f64,
    duty: f64,
    edge: Edge,
    level: f64,
}

impl SwitchedHalfBridge {
    /// Creates a bridge at rest, low. Durations in seconds: dead time 0 to 2 µs, edge 10 ns to 2 µs.
    pub fn new(dead_s: f64, edge_s: f64) -> Result<Self, InverterError> {
        super::in_range("dead_s", dead_s, 0.0, 2e-6, "0 to 2 µs")?;
        super::in_range("edge_s", edge_s, 10e-9, 2e-6, "10 ns to 2 µs")?;
        Ok(Self::at_rest(dead_s, Edge::Fixed(edge_s)))
    }

    /// Creates a bridge at rest, low, whose node has a capacitance in farad, 1 to 100 nF; dead time 0 to 2 µs.
    pub fn with_node(dead_s: f64, capacitance_f: f64) -> Result<Self, InverterError> {
        super::in_range("dead_s", dead_s, 0.0, 2e-6, "0 to 2 µs")?;
        super::in_range(
            "node capacitance_f",
            capacitance_f,
            1e-9,
            100e-9,
            "1 to 100 nF",
        )?;
        let node = SwitchNode::new(capacitance_f);
        Ok(Self::at_rest(dead_s, Edge::Node(node)))
    }

    /// Sets the share of the period in which the upper switch is on, 0.2 to 0.8, dead time included.
    pub fn with_duty(self, duty: f64) -> Result<Self, InverterError> {
        super::in_range("duty", duty, 0.2, 0.8, "0.2 to 0.8")?;
        Ok(Self { duty, ..self })
    }

    /// Sets the share of the period in which the upper switch is on, dead time included, from now on.
    pub fn set_duty(&mut self, duty: f64) {
        self.duty = duty;
    }

    fn at_rest(dead_s: f64, edge: Edge) -> Self {
        Self {
            dead_s,
            duty: 0.5,
            edge,
            level: 0.0,
        }
    }

    /// Returns and resets the observations of the switches' edges; empty for edges of fixed duration.
    pub fn take_commutations(&mut self) -> Commutations {
        match &mut self.edge {
            Edge::Fixed(_) => Commutations::default(),
            Edge::Node(node) => node.take_commutations(),
        }
    }

    /// Capacitance of the node, in farad; 0 if its edges are of fixed duration.
    pub fn node_capacitance_f(&self) -> f64 {
        match &self.edge {
            Edge::Fixed(_) => 0.0,
            Edge::Node(node) => node.capacitance_f(),
        }
    }

    /// Node voltage as a share of the bus.
    pub fn level(&self) -> f64 {
        self.level
    }

    /// Node from `from_s` after the start of a period of `period_s` on, with coil current `i_a`; `None` while it moves or a gate is due.
    pub(super) fn steady(
        &self,
        on: bool,
        period_s: f64,
        from_s: f64,
        i_a: f64,
    ) -> Option<SteadyNode> {
        let half_s = self.duty * period_s;
        let (level, until_s, by_diode) = match from_s {
            _ if !on => (0.0, period_s, false),
            t if t >= half_s + self.dead_s => (0.0, period_s, false),
            t if t < self.dead_s => (rail(i_a), self.dead_s, true),
            t if t < half_s => (1.0, half_s, false),
            _ => (rail(i_a), half_s + self.dead_s, true),
        };
        let as_due = match &self.edge {
            Edge::Fixed(_) => !by_diode,
            Edge::Node(node) if by_diode => node.is_open(),
            Edge::Node(node) => node.is_closed(level == 1.0),
        };
        let node = SteadyNode {
            level,
            until_s,
            by_diode,
        };
        (as_due && self.level == level && node.holds(i_a)).then_some(node)
    }

    /// Advances from `from_s` to `to_s` after the start of a period of `period_s` with coil current `i_a` and bus voltage `bus_v`;
    /// returns the mean level. With `on` unset the lower switch is on.
    pub fn advance(
        &mut self,
        on: bool,
        period_s: f64,
        (from_s, to_s): (f64, f64),
        i_a: f64,
        bus_v: f64,
    ) -> f64 {
        let half_s = self.duty * period_s;
        let edge_s = match &mut self.edge {
            Edge::Fixed(edge_s) => *edge_s,
            Edge::Node(node) => {
                let gates = GateTimes {
                    on,
                    dead_s: self.dead_s,
                    half_s,
                    period_s,
                };
                return node.advance(&mut self.level, &gates, (from_s, to_s), i_a, bus_v);
            }
        };
        if on && self.level == 1.0 && from_s >= self.dead_s && to_s <= half_s {
            return 1.0;
        }
        if on && self.level == 0.0 && from_s >= half_s + self.dead_s && to_s <= period_s {
            return 0.0;
        }
        let changes = [self.dead_s, half_s, half_s + self.dead_s, f64::INFINITY];
        let mut at_s = from_s;
        let mut sum = 0.0;
        for change_s in changes {
            let end_s = change_s.min(to_s);
            if end_s <= at_s {
                continue;
            }
            let middle_s = 0.5 * (at_s + end_s);
            let target = if !on {
                Some(0.0)
            } else if middle_s < self.dead_s || (half_s..half_s + self.dead_s).contains(&middle_s) {
                match i_a {
                    i if i > 0.0 => Some(0.0),
                    i if i < 0.0 => Some(1.0),
                    _ => None,
                }
            } else if middle_s < half_s {
                Some(1.0)
            } else {
                Some(0.0)
            };
            sum += self.ramp(target.unwrap_or(self.level), end_s - at_s, edge_s);
            at_s = end_s;
        }
        sum / (to_s - from_s)
    }

    /// Advances by a duration with both switches open, towards the side whose diode conducts; returns the mean level. `i_a` is the
    /// coil's current, `bus_v` the bus voltage.
    pub(super) fn freewheel(&mut self, upper: bool, duration_s: f64, i_a: f64, bus_v: f64) -> f64 {
        let edge_s = match &mut self.edge {
            Edge::Fixed(edge_s) => *edge_s,
            // At the smallest currents the diode conducts, and its current decays.
            Edge::Node(node) => {
                node.open_gates();
                (node.capacitance_f() * bus_v / i_a.abs().max(0.1)).max(1e-12)
            }
        };
        self.ramp(f64::from(u8::from(upper)), duration_s, edge_s) / duration_s
    }

    /// Sets the level at which the node floats with both switches open and without current.
    pub(super) fn float_at(&mut self, level: f64) {
        if let Edge::Node(node) = &mut self.edge {
            node.open_gates();
        }
        self.level = level.clamp(0.0, 1.0);
    }

    /// Advances towards `target` for a duration; returns the integral of the level.
    fn ramp(&mut self, target: f64, duration_s: f64, edge_s: f64) -> f64 {
        let distance = target - self.level;
        let moving_s = (distance.abs() * edge_s).min(duration_s);
        let end = if moving_s < duration_s {
            target
        } else {
            self.level + distance.signum() * moving_s / edge_s
        };
        let integral = 0.5 * (self.level + end) * moving_s + end * (duration_s - moving_s);
        self.level = end;
        integral
    }
}

/// Level to which a current moves the node with both switches open.
fn rail(i_a: f64) -> f64 {
    match i_a < 0.0 {
        true => 1.0,
        false => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const T: f64 = 20e-6;

    /// Levels at the ends of 20 ns steps over one period, and their mean.
    fn period(bridge: &mut SwitchedHalfBridge, current_a: impl Fn(f64) -> f64) -> (Vec<f64>, f64) {
        let mut mean = 0.0;
        let levels = (0..1000)
            .map(|n| {
                let (from, to) = (n as f64 * 20e-9, (n + 1) as f64 * 20e-9);
                mean += bridge.advance(true, T, (from, to), current_a(from), 325.0) / 1000.0;
                bridge.level()
            })
            .collect();
        (levels, mean)
    }

    #[test]
    fn lagging_current_commutates_at_once_and_hides_the_dead_time() {
        // Inductive load: negative at the start of the period, positive at its middle.
        let lagging = |t: f64| {
            if (0.2 * T..0.7 * T).contains(&t) {
                5.0
            } else {
                -5.0
            }
        };
        let mut bridge = SwitchedHalfBridge::new(1e-6, 0.2e-6).unwrap();
        let (levels, mean) = period(&mut bridge, lagging);
        assert!(
            (levels[4] - 0.5).abs() < 1e-9,
            "half the edge after 0.1 µs: {}",
            levels[4]
        );
        assert_eq!(levels[9], 1.0);
        assert!((levels[504] - 0.5).abs() < 1e-9);
        assert!((mean - 0.5).abs() < 1e-9);
    }

    #[test]
    fn leading_current_waits_for_the_gate() {
        let leading = |t: f64| {
            if (0.3 * T..0.8 * T).contains(&t) {
                -5.0
            } else {
                5.0
            }
        };
        let mut bridge = SwitchedHalfBridge::new(1e-6, 0.2e-6).unwrap();
        let (levels, _) = period(&mut bridge, leading);
        assert_eq!(levels[48], 0.0, "still in the dead time");
        assert!((levels[54] - 0.5).abs() < 1e-9, "0.1 µs after the gate");
        assert_eq!(levels[548], 1.0);
        assert!((levels[554] - 0.5).abs() < 1e-9);
    }

    #[test]
    fn an_edge_off_the_step_grid_keeps_its_area() {
        // Rising edge from 0 to 150 ns in one step of 1 µs: mean = 1 − 0.075.
        let mut bridge = SwitchedHalfBridge::new(0.0, 150e-9).unwrap();
        let mean = bridge.advance(true, T, (0.0, 1e-6), 0.0, 325.0);
        assert!((mean - 0.925).abs() < 1e-12, "{mean}");
    }

    #[test]
    fn the_lower_switch_pulls_the_node_down() {
        let mut bridge = SwitchedHalfBridge::new(1e-6, 0.2e-6).unwrap();
        bridge.advance(true, T, (2e-6, 3e-6), 0.0, 325.0);
        assert_eq!(bridge.level(), 1.0);
        bridge.advance(false, T, (3e-6, 4e-6), 10.0, 325.0);
        assert_eq!(bridge.level(), 0.0);
    }

    #[test]
    fn the_duty_is_the_nodes_mean() {
        let lagging = |t: f64| {
            if (0.1 * T..0.5 * T).contains(&t) {
                5.0
            } else {
                -5.0
            }
        };
        let bridge = SwitchedHalfBridge::new(0.5e-6, 0.2e-6).unwrap();
        assert!(bridge.clone().with_duty(0.05).is_err());
        let mut bridge = bridge.with_duty(0.35).unwrap();
        let (levels, mean) = period(&mut bridge, lagging);
        assert!((mean - 0.35).abs() < 1e-9, "{mean}");
        assert_eq!((levels[340], levels[370]), (1.0, 0.0));
    }

    #[test]
    fn a_dead_time_that_is_not_a_number_is_refused() {
        let e = SwitchedHalfBridge::new(f64::NAN, 0.2e-6).unwrap_err();
        assert!(e.to_string().contains("dead_s"));
    }
}
