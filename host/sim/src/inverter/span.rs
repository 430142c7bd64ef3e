//! Several steps in one go, between two changes of anything but current and voltages.
//!
//! While a switch is closed, or a diode conducts in the dead time, the mains' line and the load's law are held for a third of a
//! microsecond; what is left of a step is linear in current and voltages, with the same coefficients for all steps of the span.

use ihd_firmware::drive::bridge::Bridge;

use super::bridge::SteadyNode;
use super::linear_step::{HeldLoop, LinearStep, LoopState};
use super::load::LAW_STEPS;
use super::{Instant, Inverter};

/// Share of a step by which the end of a span may be missed: rounding of the times.
const STEP_SHARE: f64 = 1e-6;

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
        let steady = self.bridge.steady(on, period_s, from_s, self.circuit.i_a)?;
        let steps = steps
            .min(((steady.until_s - from_s) / dt_s + STEP_SHARE) as usize)
            .min(self.steps - self.step);
        if steps == 0 {
            return None;
        }
        let charging = self.bus.charging(dt_s)?;
        self.floating_v = None;
        let mut held = HeldLoop {
            r_ohm: 0.0,
            l_h: 0.0,
            bridge_r_ohm: self.bridge_r_ohm,
            by_c: self.circuit.volt_per_ampere(self.loop_dt_s),
            level: steady.level,
        };
        let mut step = None;
        let (mut done, mut goes_on) = (0, true);
        while goes_on && done < steps && steady.holds(self.circuit.i_a) {
            let number = charging.steps.min(steps - done).min(LAW_STEPS as usize);
            let (r_ohm, l_h) = self.load.hold(number)?;
            if (r_ohm, l_h) != (held.r_ohm, held.l_h) {
                (held.r_ohm, held.l_h) = (r_ohm, l_h);
                step = None;
            }
            let step =
                step.get_or_insert_with(|| LinearStep::new(&held, self.loop_dt_s, &charging));
            let (number, went_on) = self.held_steps(step, &steady, number, seen)?;
            (done, goes_on) = (done + number, went_on);
        }
        self.end_period();
        Some((done, goes_on))
    }

    /// Advances by up to `steps` steps with the line held, too; returns their number and the answer of `seen` to the last.
    #[inline]
    fn held_steps(
        &mut self,
        step: &mut LinearStep,
        steady: &SteadyNode,
        steps: usize,
        seen: &mut impl FnMut(&Instant) -> bool,
    ) -> Option<(usize, bool)> {
        let (dt_s, from_s, line) = (self.dt_s, self.now_s(), self.bus.line());
        step.set_rectifier(self.bus.hold(from_s, steps as f64 * dt_s));
        let before_a = self.before_a;
        let mut now = LoopState {
            i_a: self.circuit.i_a,
            before_a,
            v_c_v: self.circuit.v_c_v,
            bus_v: self.bus.v(),
        };
        let (mut sum_a, mut double_power_w) = (0.0, 0.0);
        let (from, period, start_s, step) = (self.step, self.steps, self.period_start_s, *step);
        let envelope = self.load.envelope()?;
        let (mut done, mut goes_on) = (0, true);
        while goes_on && done < steps && steady.holds(now.i_a) {
            let old = now;
            now = step.advance(&old);
            let coil_mean_v = step.coil_mean_v(&old, &now);
            sum_a += old.i_a;
            double_power_w += coil_mean_v * (old.i_a + now.i_a);
            done += 1;
            let n = from + done;
            envelope.push(if n == period { 0 } else { n }, now.i_a);
            let bridge_v = step.node_v(&now);
            goes_on = seen(&Instant {
                // Numbers of 32 bits become floating ones in a single instruction.
                t_s: start_s + f64::from(n as u32) * dt_s,
                bus_v: now.bus_v,
                bridge_v,
                coil_v: bridge_v - now.v_c_v,
                coil_mean_v,
                i_a: now.i_a,
                induced_v: 0.0,
            });
        }
        if done < steps {
            self.bus.hold_again(line, from_s, done as f64 * dt_s);
        }
        (self.circuit.i_a, self.circuit.v_c_v) = (now.i_a, now.v_c_v);
        self.before_a = now.before_a;
        self.bus.set_v(now.bus_v);
        // The sum of 1.5 i − 0.5 i(before).
        self.link_charge_c += steady.level * (sum_a + 0.5 * (now.before_a - before_a)) * dt_s;
        self.load_energy_j += 0.5 * double_power_w * dt_s;
        self.step += done;
        Some((done, goes_on))
    }
}
