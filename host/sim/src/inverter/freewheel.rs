//! Both switches open: the current continues through a diode, then the coil floats.
//!
//! A current out of the node flows from ground through the lower diode, a current into the node through the upper one back into the
//! bus. Either way the tank loses energy until the current reaches zero; the diode then blocks. The coil's voltage is then what its
//! flux still induces (zero for a law), and the node differs by that from the capacitor's voltage.
//!
//! When the bus falls below the node, or the capacitor is below ground, a diode conducts again: so the capacitor follows the mains
//! to its next zero. The ringing of the coil with the node's few nanofarad is not modelled.

use super::load::FluxStep;
use super::{Instant, Inverter};
use crate::circuit::Circuit;
use crate::front_end::{COIL_CHAIN_OHM, MID_SCALE_V};
use crate::low_pass::without_decayed;

/// Margin of the capacitor below the bus with which the upper diode blocks for a microsecond, in volt: the steepest mains falls by
/// 0.15 V.
const REST_MARGIN_V: f64 = 1.0;

impl Inverter {
    /// Advances one step with both switches open.
    pub(super) fn freewheel(&mut self) {
        let (dt_s, i_a) = (self.dt_s(), self.circuit.i_a);
        let to_s = self.period_start_s + (self.step + 1) as f64 * dt_s;
        let flux = self.load.predict(i_a);
        let induced_v = self.induced_v(to_s);
        let open_v = self.circuit.v_c_v + flux.change0_wb / self.loop_dt_s + induced_v;
        let bus_v = self.bus.v();
        let upper = match i_a {
            i if i > 0.0 => Some(false),
            i if i < 0.0 => Some(true),
            _ if open_v > bus_v => Some(true),
            _ if open_v < 0.0 => Some(false),
            _ => None,
        };
        match upper {
            Some(upper) => self.conduct(&flux, upper, to_s),
            None => self.float(open_v, to_s, dt_s),
        }
        self.finish(&flux, i_a);
    }

    /// Returns `true` if the power stage is at rest and stays so for a microsecond: both switches open, no current within the last
    /// period, and a capacitor voltage at which no diode conducts. Only for a law: a field continues to move.
    pub fn is_at_rest(&self) -> bool {
        let v_c_v = self.circuit.v_c_v;
        let blocks = (0.0..self.bus.v() - REST_MARGIN_V).contains(&v_c_v);
        self.floating_v.is_some() && self.circuit.i_a == 0.0 && blocks && self.load.is_at_rest()
    }

    /// Advances several steps at rest at once; only while [`Inverter::is_at_rest`].
    pub fn rest(&mut self, steps: usize) -> Instant {
        let to_s = self.period_start_s + (self.step + steps) as f64 * self.dt_s;
        self.float(self.circuit.v_c_v, to_s, steps as f64 * self.dt_s);
        self.step += steps;
        while self.step >= self.steps {
            self.period_start_s += self.steps as f64 * self.dt_s;
            self.step -= self.steps;
        }
        self.instant()
    }

    /// Ends currents and voltages that have decayed. A subnormal voltage of the capacitor would keep a diode conducting for ever: its
    /// current is rounded to none.
    pub fn end_decay(&mut self) {
        self.bus.end_decay();
        let Circuit { i_a, v_c_v, .. } = &mut self.circuit;
        for quantity in [i_a, v_c_v, &mut self.before_a] {
            *quantity = without_decayed(*quantity);
        }
    }

    fn conduct(&mut self, flux: &FluxStep, upper: bool, to_s: f64) {
        let (dt_s, before) = (self.dt_s(), self.circuit);
        let bus_before_v = self.bus.v();
        self.floating_v = None;
        if before.i_a == 0.0 {
            // The node has floated to the rail.
            self.bridge.float_at(f64::from(u8::from(upper)));
        }
        let level = self.bridge.freewheel(upper, dt_s, before.i_a, bus_before_v);
        let drawn_a = level * self.mean_a();
        self.link_charge_c += drawn_a * dt_s;
        let bus_v = self.bus.advance(to_s, dt_s, drawn_a);
        let mean_v = 0.5 * (bus_before_v + bus_v) * level;
        self.step_loop(mean_v, flux);
        let circuit = &mut self.circuit;
        if (circuit.i_a < 0.0) != upper {
            // The diode blocks: the current ends within this step.
            *circuit = before;
            circuit.end_current(self.loop_dt_s);
        }
        self.meter(mean_v, before, dt_s);
    }

    fn float(&mut self, open_v: f64, to_s: f64, dt_s: f64) {
        // Both chains of the coil voltage's divider discharge the capacitor and the node, which the coil joins, towards mid-scale; a
        // capacitor that each zero of the mains empties does not get there.
        let end_v = match self.bus.holds() {
            true => MID_SCALE_V,
            false => 0.0,
        };
        let discharge_s =
            0.5 * COIL_CHAIN_OHM * (self.circuit.c_f + self.bridge.node_capacitance_f());
        let lost_v = (self.circuit.v_c_v - end_v) * (dt_s / discharge_s);
        self.circuit.v_c_v -= lost_v;
        let open_v = open_v - lost_v;
        let bus_v = self.bus.advance(to_s, dt_s, 0.0);
        self.floating_v = Some(open_v);
        self.coil_mean_v = open_v - self.circuit.v_c_v;
        // The next edge begins here.
        self.bridge
            .float_at(if bus_v > 0.0 { open_v / bus_v } else { 0.0 });
    }
}

#[cfg(test)]
mod tests {
    use ihd_firmware::drive::bridge::Bridge;
    use ihd_shared::hob::RESONANCE_CAPACITANCE_NF;

    use crate::behavioural::{BehaviouralLoad, PotKind};
    use crate::inverter::bridge::SwitchedHalfBridge;
    use crate::inverter::bus::Bus;
    use crate::inverter::load::{AmplitudeLaw, LoadState};
    use crate::inverter::supply::SupplyParts;
    use crate::inverter::{Instant, Inverter};
    use crate::mains::SimulatedMains;
    use ihd_field::FieldModel;
    use ihd_field::model::FieldSettings;

    const F_HZ: f64 = 50e3;
    const STEPS: usize = 488;

    fn behavioural(pot: PotKind) -> LoadState {
        let law = BehaviouralLoad::new(pot, F_HZ);
        LoadState::law(AmplitudeLaw::Behavioural(law), STEPS)
    }

    /// Switching since the zero crossing, `at_s` into the half-cycle.
    fn running(load: LoadState, at_s: f64) -> Inverter {
        let bus = Bus::new(SimulatedMains::new(50.0), SupplyParts::NONE, 0.0).unwrap();
        let bridge = SwitchedHalfBridge::new(0.4e-6, 0.2e-6).unwrap();
        let mut inverter = Inverter::new(bus, bridge, load, F_HZ, STEPS, 0.0);
        while inverter.now_s() < at_s {
            inverter.advance(Bridge::Switching);
        }
        inverter
    }

    /// Energy in coil and capacitor by the law's present inductance, in joule.
    fn energy_j(inverter: &Inverter, l_h: f64) -> f64 {
        let c_f = f64::from(RESONANCE_CAPACITANCE_NF) * 1e-9;
        let circuit = inverter.circuit;
        0.5 * l_h * circuit.i_a * circuit.i_a + 0.5 * c_f * circuit.v_c_v * circuit.v_c_v
    }

    /// At whatever phase the switches open, near the crest of the mains.
    fn opened(load: impl Fn() -> LoadState, mut seen: impl FnMut(&Inverter, Instant, f64)) {
        for phase in 0..16 {
            let mut inverter = running(load(), 4.6e-3);
            for _ in 0..phase * STEPS / 16 {
                inverter.advance(Bridge::Switching);
            }
            let opened_s = inverter.now_s();
            for _ in 0..10 * STEPS {
                let now = inverter.advance(Bridge::Open);
                seen(&inverter, now, (now.t_s - opened_s) * F_HZ);
            }
        }
    }

    #[test]
    fn the_current_ends_within_three_periods_and_stays_away() {
        for pot in [PotKind::Ferromagnetic, PotKind::Aluminium, PotKind::None] {
            opened(
                || behavioural(pot),
                |_, now, periods| {
                    if periods > 3.0 {
                        assert_eq!((now.i_a, now.coil_v), (0.0, 0.0), "{pot} {now:?}");
                    }
                },
            );
        }
        let field = || {
            let model = FieldModel::new(&FieldSettings::paper()).unwrap();
            LoadState::field(&[(1.0, model)], 1.0 / (F_HZ * STEPS as f64)).unwrap()
        };
        opened(field, |_, now, periods| {
            if periods > 3.0 {
                assert!(now.i_a == 0.0 && now.coil_v.abs() < 20.0, "{now:?}");
            }
        });
    }

    /// No switch puts energy in, the node stays between the rails, and the capacitor never exceeds
    /// what the tank held or the bus lends.
    #[test]
    fn energy_only_decays_and_no_voltage_leaves_the_rails() {
        for pot in [PotKind::Ferromagnetic, PotKind::Aluminium, PotKind::None] {
            let mut last_j = f64::INFINITY;
            let mut limit_v = 0.0;
            opened(
                || behavioural(pot),
                |inverter, now, periods| {
                    // The law's L moves with the envelope: that of the least current bounds it.
                    let l_h = BehaviouralLoad::new(pot, F_HZ).r_l(0.0).1;
                    let c_f = f64::from(RESONANCE_CAPACITANCE_NF) * 1e-9;
                    if periods < 1.5 / STEPS as f64 {
                        last_j = f64::INFINITY;
                        limit_v = (2.0 * energy_j(inverter, l_h) / c_f).sqrt().max(now.bus_v);
                    }
                    assert!(
                        (-1e-9..=now.bus_v * 1.000_1).contains(&now.bridge_v),
                        "{now:?}"
                    );
                    assert!(inverter.circuit.v_c_v.abs() <= limit_v * 1.001, "{now:?}");
                    if now.i_a == 0.0 {
                        let held_j = energy_j(inverter, l_h);
                        assert!(held_j <= last_j, "{pot} {now:?} {held_j} {last_j}");
                        last_j = held_j;
                    }
                },
            );
        }
    }

    #[test]
    fn out_of_rest_no_current_flows_whatever_the_mains_does() {
        let mut inverter = running(behavioural(PotKind::Ferromagnetic), 0.0);
        while inverter.now_s() < 21e-3 {
            let now = inverter.advance(Bridge::Open);
            assert_eq!((now.i_a, now.bridge_v, now.coil_v), (0.0, 0.0, 0.0));
        }
    }

    /// With the lower switch on for 60 ms the tank decays below what a number of 64 bits can hold.
    #[test]
    fn what_decayed_before_the_switches_open_is_at_rest_a_period_later() {
        let mut inverter = running(behavioural(PotKind::Ferromagnetic), 4.6e-3);
        while inverter.now_s() < 0.065 {
            inverter.end_decay();
            inverter.advance(Bridge::LowerOn);
        }
        for _ in 0..STEPS {
            inverter.end_decay();
            inverter.advance(Bridge::Open);
        }
        let circuit = inverter.circuit;
        assert_eq!((circuit.i_a, circuit.v_c_v), (0.0, 0.0));
    }

    /// From 160 V, by ngspice with both chains of 258.1 kΩ and 665 Ω around the amplifier at 1.65 V, and 15 nF at the node: 40.2 V
    /// after 0.2 s.
    #[test]
    fn both_chains_discharge_the_capacitor() {
        let mut bus = Bus::new(SimulatedMains::new(50.0), SupplyParts::SCHEMATIC, 0.0).unwrap();
        bus.set_supply(325.0);
        let bridge = SwitchedHalfBridge::with_node(1e-6, 15e-9).unwrap();
        let load = behavioural(PotKind::Ferromagnetic);
        let mut inverter = Inverter::new(bus, bridge, load, F_HZ, STEPS, 0.0);
        inverter.circuit.v_c_v = 160.0;
        while inverter.now_s() < 0.2 {
            match inverter.is_at_rest() {
                true => inverter.rest(100),
                false => inverter.advance(Bridge::Open),
            };
        }
        let v_c_v = inverter.circuit.v_c_v;
        assert!((v_c_v - 40.2).abs() < 0.1, "{v_c_v}");
    }

    /// The upper diode lets the capacitor follow the falling bus, and holds it at zero from then on.
    #[test]
    fn the_capacitor_is_empty_after_the_next_zero_crossing_of_the_mains() {
        let mut inverter = running(behavioural(PotKind::Ferromagnetic), 5e-3);
        let mut most_a: f64 = 0.0;
        while inverter.now_s() < 15e-3 {
            let now = inverter.advance(Bridge::Open);
            if now.t_s > 5.1e-3 {
                most_a = most_a.max(now.i_a.abs());
            }
        }
        assert!(
            inverter.circuit.v_c_v.abs() < 2.0,
            "{}",
            inverter.circuit.v_c_v
        );
        // C dv/dt of the steepest mains is 0.11 A; the diode rings that up to twice and a bit.
        assert!(most_a < 0.5, "{most_a}");
    }
}
