//! Commutation with the capacitance of the bridge's node, on which zero-voltage switching depends.
//!
//! In the dead time the coil's current charges the capacitance of both switches, dv/dt = −i/C, until a
//! diode conducts. When it reverses or is too small, a voltage is left when the next gate comes, and that
//! switch closes onto it: a hard edge.

/// Voltage above which a closing switch counts as a hard edge: 30 V on 15 nF are 7 µJ.
pub const HARD_EDGE_V: f64 = 30.0;

/// Conducting switch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Gate {
    /// To the bus.
    Upper,
    /// To ground.
    Lower,
}

impl Gate {
    fn level(self) -> f64 {
        match self {
            Self::Upper => 1.0,
            Self::Lower => 0.0,
        }
    }
}

/// Observations at the switches' edges.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Commutations {
    /// Number of switches that closed onto more than [`HARD_EDGE_V`].
    pub hard_edges: u32,
    /// Smallest current when a switch opened, in ampere, positive in the direction that moves the node
    /// to the other rail; of edges at a bus above [`HARD_EDGE_V`]. `None` without any.
    pub turn_off_min_a: Option<f64>,
}

/// Gate signals of a switching period.
pub(super) struct GateTimes {
    /// `true` while the bridge switches; otherwise the lower switch is on.
    pub on: bool,
    /// Dead time in seconds.
    pub dead_s: f64,
    /// End of the upper switch's part of the period, in seconds.
    pub half_s: f64,
    /// Period in seconds.
    pub period_s: f64,
}

/// Node of the bridge: its capacitance, the conducting switch, and the observations of the edges.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct SwitchNode {
    capacitance_f: f64,
    gate: Option<Gate>,
    commutations: Commutations,
}

impl SwitchNode {
    /// Creates a node with a capacitance in farad, both switches open.
    pub fn new(capacitance_f: f64) -> Self {
        Self {
            capacitance_f,
            gate: None,
            commutations: Commutations::default(),
        }
    }

    /// Capacitance in farad.
    pub fn capacitance_f(&self) -> f64 {
        self.capacitance_f
    }

    /// Returns `true` if the upper or the lower switch is closed.
    pub fn is_closed(&self, upper: bool) -> bool {
        self.gate == Some(if upper { Gate::Upper } else { Gate::Lower })
    }

    /// Returns `true` if both switches are open.
    pub fn is_open(&self) -> bool {
        self.gate.is_none()
    }

    /// Opens both switches.
    pub fn open_gates(&mut self) {
        self.gate = None;
    }

    /// Returns and resets the observations of the edges.
    pub fn take_commutations(&mut self) -> Commutations {
        std::mem::take(&mut self.commutations)
    }

    /// Moves the node's `level` from `from_s` to `to_s` after the start of a period; returns its mean on the way.
    pub fn advance(
        &mut self,
        level: &mut f64,
        gates: &GateTimes,
        (from_s, to_s): (f64, f64),
        i_a: f64,
        bus_v: f64,
    ) -> f64 {
        let &GateTimes {
            on,
            dead_s,
            half_s,
            period_s,
        } = gates;
        let charge_c = self.capacitance_f * bus_v;
        let lower_s = half_s + dead_s;
        match self.gate {
            Some(Gate::Upper) if on && from_s >= dead_s && to_s <= half_s => return 1.0,
            Some(Gate::Lower) if !on || (from_s >= lower_s && to_s <= period_s) => return 0.0,
            _ => {}
        }
        let (mut at_s, mut sum) = (from_s, 0.0);
        for change_s in [dead_s, half_s, lower_s, f64::INFINITY] {
            let end_s = change_s.min(to_s);
            if end_s <= at_s {
                continue;
            }
            let middle_s = 0.5 * (at_s + end_s);
            let gate = match middle_s {
                _ if !on => Some(Gate::Lower),
                t if t < dead_s || (half_s..lower_s).contains(&t) => None,
                t if t < half_s => Some(Gate::Upper),
                _ => Some(Gate::Lower),
            };
            self.set_gate(level, gate, i_a, charge_c);
            sum += match gate {
                Some(_) => *level * (end_s - at_s),
                None => slew(level, i_a, charge_c, end_s - at_s),
            };
            at_s = end_s;
        }
        sum / (to_s - from_s)
    }

    fn set_gate(&mut self, level: &mut f64, gate: Option<Gate>, i_a: f64, charge_c: f64) {
        if gate == self.gate {
            return;
        }
        let volts = charge_c / self.capacitance_f;
        if let Some(opens) = self.gate
            && volts > HARD_EDGE_V
        {
            let commutating_a = match opens {
                Gate::Upper => i_a,
                Gate::Lower => -i_a,
            };
            let least_a = self.commutations.turn_off_min_a.unwrap_or(f64::INFINITY);
            self.commutations.turn_off_min_a = Some(least_a.min(commutating_a));
        }
        if let Some(closes) = gate {
            if (closes.level() - *level).abs() * volts > HARD_EDGE_V {
                self.commutations.hard_edges += 1;
            }
            *level = closes.level();
        }
        self.gate = gate;
    }
}

/// Moves the level with both switches open for a duration; returns the integral of the level.
fn slew(level: &mut f64, i_a: f64, charge_c: f64, duration_s: f64) -> f64 {
    let before = *level;
    // Without a bus the charge is 0.
    let change = -i_a * duration_s / charge_c.max(1e-12);
    *level = (before + change).clamp(0.0, 1.0);
    let moved = *level - before;
    let moving_s = match change {
        0.0 => 0.0,
        _ => duration_s * moved / change,
    };
    0.5 * (before + *level) * moving_s + *level * (duration_s - moving_s)
}

#[cfg(test)]
mod tests {
    use super::super::bridge::SwitchedHalfBridge;
    use super::*;

    const T: f64 = 20e-6;
    const DEAD_S: f64 = 1e-6;
    const C_F: f64 = 15e-9;
    const BUS_V: f64 = 325.0;

    /// One period in steps of 20 ns with a square current of an amplitude, lagging or leading.
    fn period(i_a: f64) -> (Vec<f64>, Commutations) {
        let mut bridge = SwitchedHalfBridge::with_node(DEAD_S, C_F).unwrap();
        let mut levels = Vec::new();
        for _ in 0..2 {
            bridge.take_commutations();
            levels = (0..1000)
                .map(|n| {
                    let (from, to) = (f64::from(n) * 20e-9, f64::from(n + 1) * 20e-9);
                    // Negative around the period's start, positive around its middle.
                    let i = if (250..750).contains(&n) { i_a } else { -i_a };
                    bridge.advance(true, T, (from, to), i, BUS_V);
                    bridge.level()
                })
                .collect();
        }
        (levels, bridge.take_commutations())
    }

    #[test]
    fn the_node_moves_by_the_charge_of_its_capacitance() {
        // Q = C V: 15 nF × 325 V = 4.875 µC take 10 A 0.4875 µs, and 24 A 0.2 µs.
        for (i_a, full_s) in [(10.0, 0.4875e-6), (24.0, 0.203e-6)] {
            let (levels, seen) = period(i_a);
            for n in 0..30 {
                let expected = ((n + 1) as f64 * 20e-9 / full_s).min(1.0);
                assert!((levels[n] - expected).abs() < 2e-3, "{i_a} A, step {n}");
                assert!((levels[500 + n] - (1.0 - expected)).abs() < 2e-3);
            }
            assert_eq!((seen.hard_edges, seen.turn_off_min_a), (0, Some(i_a)));
        }
    }

    #[test]
    fn too_small_a_current_leaves_a_voltage_that_is_switched_hard() {
        // In 1 µs, 4.42 A move 295 V: 30 V are left. More is soft, less is hard.
        let just_enough_a = C_F * (BUS_V - HARD_EDGE_V) / DEAD_S;
        assert_eq!(period(1.01 * just_enough_a).1.hard_edges, 0);
        let (levels, seen) = period(0.99 * just_enough_a);
        assert_eq!(seen.hard_edges, 2);
        let left_v = (1.0 - levels[49]) * BUS_V;
        assert!((left_v - 33.0).abs() < 0.5, "{left_v}");
        assert_eq!(levels[50], 1.0, "the gate closes it");
    }

    #[test]
    fn a_leading_current_holds_the_node_back_and_counts_as_negative() {
        let (levels, seen) = period(-5.0);
        assert_eq!(levels[49], 0.0);
        assert_eq!(seen.hard_edges, 2);
        assert_eq!(seen.turn_off_min_a, Some(-5.0));
    }
}
