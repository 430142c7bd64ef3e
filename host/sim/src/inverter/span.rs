//! Several steps in one go, between two changes of anything but current and voltages.
//!
//! While a switch is closed, the mains' line and the load's law are held for a third of a microsecond; what is left of a step is
//! linear in current and voltages, with the same coefficients for all steps of the span.

use ihd_firmware::drive::bridge::Bridge;

use super::linear_step::{LinearStep, LoopState};
use super::load::LAW_STEPS;
use super::{Instant, Inverter};

impl Inverter {
    /// Advances by up to `steps` steps; `seen` gets the quantities after each and returns `false` to end there. Returns the number
    /// of steps done.
    pub fn run(
        &mut self,
        bridge: Bridge,
        steps: usize,
        mut seen: impl FnMut(&Instant) -> bool,
    ) -> usize {
        let (mut done, mut goes_on) = (0, true);
        while goes_on && done < steps {
            let span = self.span(bridge, steps - done, &mut seen);
            (done, goes_on) = match span {
                Some((number, goes_on)) => (done + number, goes_on),
                None => (done + 1, seen(&self.advance(bridge))),
            };
        }
        done
    }

    /// Advances by a span of at most `steps` steps; returns their number and the answer of `seen` to the last, or `None` where only a
    /// single step is possible.
    fn span(
        &mut self,
        bridge: Bridge,
        steps: usize,
        seen: &mut impl FnMut(&Instant) -> bool,
    ) -> Option<(usize, bool)> {
        let on = match bridge {
            Bridge::Open => return None,
            Bridge::LowerOn => false,
            Bridge::Switching => true,
        };
        if self.induced.is_some() || self.load.is_field() {
            return None;
        }
        let dt_s = self.dt_s;
        let from_s = self.step as f64 * dt_s;
        let period_s = self.steps as f64 * dt_s;
        let (level, until_s) = self.bridge.steady(on, period_s, from_s)?;
        let steps = steps
            .min(((until_s - from_s) / dt_s) as usize)
            .min(self.steps - self.step)
            .min(LAW_STEPS as usize);
        if steps < 2 {
            return None;
        }
        let charging = self.bus.hold(self.now_s(), dt_s, steps)?;
        let (r_ohm, l_h, envelope) = self.load.hold(charging.steps)?;
        self.floating_v = None;
        let by_c = self.circuit.volt_per_ampere(self.loop_dt_s);
        let of_loop = (r_ohm + self.bridge_r_ohm, l_h, by_c);
        let step = LinearStep::new(of_loop, self.loop_dt_s, level, &charging);
        let mut now = LoopState {
            i_a: self.circuit.i_a,
            before_a: self.before_a,
            v_c_v: self.circuit.v_c_v,
            bus_v: self.bus.v(),
        };
        let (mut charge_a, mut power_w) = (0.0, 0.0);
        let (mut done, mut goes_on) = (0, true);
        while goes_on && done < charging.steps {
            let old = now;
            now = step.advance(&old);
            charge_a += 1.5 * old.i_a - 0.5 * old.before_a;
            let node_v = 0.5 * level * (old.bus_v + now.bus_v);
            let mean_a = 0.5 * (old.i_a + now.i_a);
            let coil_mean_v = node_v - self.bridge_r_ohm * mean_a - 0.5 * (old.v_c_v + now.v_c_v);
            power_w += coil_mean_v * mean_a;
            done += 1;
            let n = self.step + done;
            envelope.push(if n == self.steps { 0 } else { n }, now.i_a);
            let bridge_v = now.bus_v * level - self.bridge_r_ohm * now.i_a;
            goes_on = seen(&Instant {
                t_s: self.period_start_s + n as f64 * dt_s,
                bus_v: now.bus_v,
                bridge_v,
                coil_v: bridge_v - now.v_c_v,
                coil_mean_v,
                i_a: now.i_a,
                induced_v: 0.0,
            });
        }
        (self.circuit.i_a, self.circuit.v_c_v) = (now.i_a, now.v_c_v);
        self.before_a = now.before_a;
        self.bus.set_v(now.bus_v);
        self.link_charge_c += level * charge_a * dt_s;
        self.load_energy_j += power_w * dt_s;
        self.step += done;
        self.end_period();
        Some((done, goes_on))
    }
}
