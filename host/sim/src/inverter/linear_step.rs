//! A step with everything but current and voltages constant, as sums of products of the old ones: a processor forms them side by side,
//! where the equations one after the other wait for each other.

use super::bus::Charging;

/// State of the loop and the DC link between two steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LoopState {
    /// Coil current in ampere.
    pub i_a: f64,
    /// Coil current a step before, in ampere.
    pub before_a: f64,
    /// Voltage of the resonance capacitor in volt.
    pub v_c_v: f64,
    /// Voltage of the DC link in volt.
    pub bus_v: f64,
}

/// Loop around the bridge, constant over some steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct HeldLoop {
    /// Resistance of the load, in ohm.
    pub r_ohm: f64,
    /// Inductance of the load, in henry.
    pub l_h: f64,
    /// Resistance outside the coil, in ohm.
    pub bridge_r_ohm: f64,
    /// Voltage by which a step charges the capacitor for each ampere of the sum of both ends' currents.
    pub by_c: f64,
    /// Level of the node, 0 or 1.
    pub level: f64,
}

/// Step of a [`HeldLoop`]: `Circuit::step_flux` and the link's charge, solved for the new state.
#[derive(Clone, Copy, Debug)]
pub(super) struct LinearStep {
    held: HeldLoop,
    volt_per_ampere: f64,
    /// Mean voltage of the coil by its new current and by the old one: R i + L di/dt.
    coil_ohm: [f64; 2],
    /// Change of the new current for each volt of the new link.
    by_bus: f64,
    keep: f64,
    gain: f64,
    /// New link voltage by current, current before and link voltage; and its constant part.
    bus: [f64; 4],
    /// New current by the same, with the new link voltage inserted.
    current: [f64; 4],
}

impl LinearStep {
    /// Creates one of `dt_s`.
    pub fn new(held: &HeldLoop, dt_s: f64, link: &Charging) -> Self {
        let &HeldLoop {
            r_ohm, l_h, level, ..
        } = held;
        let drop = 0.5 * dt_s * (r_ohm + held.bridge_r_ohm + held.by_c);
        let per_l = 1.0 / (l_h + drop);
        let (keep, gain) = ((l_h - drop) * per_l, dt_s * per_l);
        let flux_ohm = l_h / dt_s;
        let drawn = link.volt_per_ampere * level;
        let bus = [
            -1.5 * drawn,
            0.5 * drawn,
            1.0 - link.volt_per_ampere * link.discharge_s,
            0.0,
        ];
        let by_bus = 0.5 * gain * level;
        let current = [
            keep + by_bus * bus[0],
            by_bus * bus[1],
            by_bus * (1.0 + bus[2]),
            0.0,
        ];
        Self {
            held: *held,
            volt_per_ampere: link.volt_per_ampere,
            coil_ohm: [0.5 * r_ohm + flux_ohm, 0.5 * r_ohm - flux_ohm],
            by_bus,
            keep,
            gain,
            bus,
            current,
        }
    }

    /// Sets the current of the rectifier, in ampere; it is 0 unless set.
    pub fn set_rectifier(&mut self, rectifier_a: f64) {
        self.bus[3] = self.volt_per_ampere * rectifier_a;
        self.current[3] = self.by_bus * self.bus[3];
    }

    /// Mean voltage of the coil between two states, in volt.
    #[inline(always)]
    pub fn coil_mean_v(&self, old: &LoopState, new: &LoopState) -> f64 {
        self.coil_ohm[0] * new.i_a + self.coil_ohm[1] * old.i_a
    }

    /// Voltage of the node, in volt.
    #[inline(always)]
    pub fn node_v(&self, now: &LoopState) -> f64 {
        now.bus_v * self.held.level - self.held.bridge_r_ohm * now.i_a
    }

    /// State a step later.
    #[inline(always)]
    pub fn advance(&self, old: &LoopState) -> LoopState {
        let sum = |[i, before, bus, constant]: [f64; 4]| {
            (i * old.i_a + before * old.before_a) + (bus * old.bus_v + constant)
        };
        let (mut bus_v, mut i_a) = (sum(self.bus), sum(self.current) - self.gain * old.v_c_v);
        if bus_v < 0.0 {
            // The lower diodes keep it from going negative.
            bus_v = 0.0;
            i_a = self.keep * old.i_a + self.gain * (0.5 * self.held.level * old.bus_v - old.v_c_v);
        }
        LoopState {
            i_a,
            before_a: old.i_a,
            v_c_v: old.v_c_v + self.held.by_c * (old.i_a + i_a),
            bus_v,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::circuit::Circuit;

    /// The circuit's own step, behind a link that is charged first.
    #[test]
    fn a_step_is_that_of_circuit_and_link() {
        let (r_ohm, l_h, dt_s) = (3.0, 20e-6, 45e-9);
        for (level, bus_v, i_a) in [(1.0, 310.0, 38.0), (0.0, 310.0, -38.0), (1.0, 0.1, 60.0)] {
            let link = Charging {
                steps: 6,
                volt_per_ampere: dt_s / 4.7e-6,
                discharge_s: 1.0 / 94e3,
            };
            let old = LoopState {
                i_a,
                before_a: 0.97 * i_a,
                v_c_v: -140.0,
                bus_v,
            };
            let mut circuit = Circuit {
                i_a,
                v_c_v: old.v_c_v,
                ..Circuit::default()
            };
            let drawn_a = level * (1.5 * i_a - 0.5 * old.before_a);
            let into_a = 7.0 - drawn_a - bus_v * link.discharge_s;
            let new_bus_v = (bus_v + link.volt_per_ampere * into_a).max(0.0);
            circuit.step(0.5 * (bus_v + new_bus_v) * level, r_ohm, l_h, dt_s);
            let held = HeldLoop {
                r_ohm,
                l_h,
                bridge_r_ohm: 0.0,
                by_c: circuit.volt_per_ampere(dt_s),
                level,
            };
            let mut step = LinearStep::new(&held, dt_s, &link);
            step.set_rectifier(7.0);
            let new = step.advance(&old);
            assert_eq!(new_bus_v == 0.0, bus_v < 1.0, "{level} {bus_v}");
            assert_eq!(new.before_a, i_a);
            let pairs = [
                (new.i_a, circuit.i_a),
                (new.v_c_v, circuit.v_c_v),
                (new.bus_v, new_bus_v),
            ];
            for (got, expected) in pairs {
                assert!((got - expected).abs() < 1e-12 * 310.0, "{got} {expected}");
            }
            let node_v = 0.5 * (bus_v + new_bus_v) * level;
            let coil_v = node_v - 0.5 * (old.v_c_v + new.v_c_v);
            let error_v = step.coil_mean_v(&old, &new) - coil_v;
            assert!(error_v.abs() < 1e-9, "{error_v}");
        }
    }
}
