//! Resonance capacitor and load: the two state equations, integrated in time.

use ihd_shared::hob::RESONANCE_CAPACITANCE_NF;

/// Coil current, and voltage of the capacitor with its capacitance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Circuit {
    /// Coil current in ampere.
    pub i_a: f64,
    /// Voltage of the resonance capacitor in volt.
    pub v_c_v: f64,
    /// Capacitance of the resonance capacitor in farad.
    pub c_f: f64,
}

/// At rest, with the schematic's capacitor.
impl Default for Circuit {
    fn default() -> Self {
        Self {
            i_a: 0.0,
            v_c_v: 0.0,
            c_f: f64::from(RESONANCE_CAPACITANCE_NF) * 1e-9,
        }
    }
}

impl Circuit {
    /// Advances one trapezoidal step of L di/dt = v − v_C − R i, C dv_C/dt = i. It uses R and L constant over
    /// the step and `v_mean_v` the bridge's mean voltage over it.
    ///
    /// Stable for any step. It warps the frequency: (ω dt)²/12 of X. The inverter's step is prewarped to the switching frequency.
    pub fn step(&mut self, v_mean_v: f64, r_ohm: f64, l_h: f64, dt_s: f64) {
        let change0_wb = -l_h * self.i_a;
        self.step_flux(v_mean_v, r_ohm, change0_wb, l_h, dt_s);
    }

    /// The same step for a load whose flux linkage changes by `change0_wb` + `l_h` · i(new), as
    /// the field model's does.
    pub fn step_flux(&mut self, v_mean_v: f64, r_ohm: f64, change0_wb: f64, l_h: f64, dt_s: f64) {
        let by_c = self.volt_per_ampere(dt_s);
        let drop = 0.5 * dt_s * (r_ohm + by_c);
        let i = (dt_s * (v_mean_v - self.v_c_v) - change0_wb - drop * self.i_a) / (l_h + drop);
        self.v_c_v += by_c * (self.i_a + i);
        self.i_a = i;
    }

    /// Change of the capacitor's voltage in a step for each ampere of the sum of both ends' currents.
    pub(crate) fn volt_per_ampere(&self, dt_s: f64) -> f64 {
        dt_s / (2.0 * self.c_f)
    }

    /// Advances one step in which the current ends.
    pub fn end_current(&mut self, dt_s: f64) {
        self.v_c_v += self.volt_per_ampere(dt_s) * self.i_a;
        self.i_a = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, TAU};

    use super::*;
    use crate::inverter::bridge::SwitchedHalfBridge;

    /// Against the phasor solution of the series circuit, harmonic by harmonic.
    #[test]
    fn steady_state_has_the_phasors_of_the_series_circuit() {
        phasors_of_the_series_circuit(1080e-9);
    }

    #[test]
    fn a_capacitor_that_has_aged_has_its_own_phasors() {
        phasors_of_the_series_circuit(864e-9);
    }

    fn phasors_of_the_series_circuit(c_f: f64) {
        let (f, r, l, bus) = (45e3, 3.0, 20e-6, 100.0);
        let steps = 488;
        let dt_s = 1.0 / (f * steps as f64);
        let mut bridge = SwitchedHalfBridge::new(0.0, 200e-9).unwrap();
        let mut circuit = Circuit {
            c_f,
            ..Circuit::default()
        };
        let mut phasor = [(0.0, 0.0); 2];
        let periods = 400;
        for p in 0..periods {
            for n in 0..steps {
                if p == periods - 1 {
                    for (h, sum) in [1.0, 3.0].into_iter().zip(&mut phasor) {
                        let a = TAU * h * n as f64 / steps as f64;
                        sum.0 += circuit.i_a * a.cos() * 2.0 / steps as f64;
                        sum.1 -= circuit.i_a * a.sin() * 2.0 / steps as f64;
                    }
                }
                let (from, to) = (n as f64 * dt_s, (n + 1) as f64 * dt_s);
                let mean = bridge.advance(true, 1.0 / f, (from, to), 0.0, bus) * bus;
                circuit.step(mean, r, l, dt_s);
            }
        }
        for (h, sum) in [1.0, 3.0].into_iter().zip(phasor) {
            // Trapezoid of edge τ: 2/(πh) · sinc(h f τ).
            let edge = PI * h * f * 200e-9;
            let v = 2.0 / (PI * h) * bus * edge.sin() / edge;
            let x = TAU * h * f * l - 1.0 / (TAU * h * f * c_f);
            let expected = v / r.hypot(x);
            let got: f64 = f64::hypot(sum.0, sum.1);
            assert!(
                (got / expected - 1.0).abs() < 2e-4,
                "h {h}: {got} {expected}"
            );
        }
    }
}
