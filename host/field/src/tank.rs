//! Field model in the resonant circuit: bridge voltage, winding, load, series capacitor.

use nalgebra::Complex;

use super::error::{FieldError, in_range};
use super::load::FieldLoad;
use super::model::FieldModel;

/// Resonant circuit with a field load: v = R_w i + dλ/dt + v_C, C dv_C/dt = i, in the same BDF2 step as the field.
#[derive(Clone, Debug)]
pub struct FieldTank<const N: usize> {
    load: FieldLoad<N>,
    dt_s: f64,
    series_r_ohm: f64,
    capacitance_f: f64,
    lambda_wb: [f64; 2],
    v_c_v: [f64; 2],
}

/// Coil quantities at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TankSample {
    /// Coil current in ampere.
    pub i_a: f64,
    /// Voltage across the coil (winding included), in volt.
    pub v_coil_v: f64,
}

impl<const N: usize> FieldTank<N> {
    /// Creates a circuit at rest.
    pub fn new(model: &FieldModel, capacitance_f: f64, dt_s: f64) -> Result<Self, FieldError> {
        in_range("capacitance_f", capacitance_f, 1e-9, 1e-3, "1 nF to 1 mF")?;
        let load = FieldLoad::new(model, dt_s)?;
        Ok(Self {
            dt_s,
            series_r_ohm: model.winding_r_ohm + load.shield_r_ohm(),
            load,
            capacitance_f,
            lambda_wb: [0.0; 2],
            v_c_v: [0.0; 2],
        })
    }

    /// Advances one step to the instant at which the bridge gives `v_bridge_v`.
    pub fn step(&mut self, v_bridge_v: f64) -> TankSample {
        let flux = self.load.predict();
        let rate = 1.5 / self.dt_s;
        let [lambda, lambda_before] = self.lambda_wb;
        let [v_c, v_c_before] = self.v_c_v;
        let lambda_known = (4.0 * lambda - lambda_before) / 3.0;
        let v_c_known = (4.0 * v_c - v_c_before) / 3.0;
        let emf_known = rate * (flux.lambda0_wb - lambda_known);
        let elastance = 1.0 / (rate * self.capacitance_f);
        let i_a = (v_bridge_v - v_c_known - emf_known)
            / (self.series_r_ohm + rate * flux.l_h + elastance);
        self.load.commit(i_a);
        let lambda_new = flux.lambda0_wb + flux.l_h * i_a;
        self.lambda_wb = [lambda_new, lambda];
        self.v_c_v = [v_c_known + elastance * i_a, v_c];
        let v_coil_v = self.series_r_ohm * i_a + rate * (lambda_new - lambda_known);
        TankSample { i_a, v_coil_v }
    }
}

/// Load with an impressed current, as in the paper's frequency-domain runs.
#[derive(Clone, Debug)]
pub struct ImpressedCurrent<const N: usize> {
    load: FieldLoad<N>,
    dt_s: f64,
    series_r_ohm: f64,
    lambda_wb: [f64; 2],
}

impl<const N: usize> ImpressedCurrent<N> {
    /// Creates a load at rest.
    pub fn new(model: &FieldModel, dt_s: f64) -> Result<Self, FieldError> {
        let load = FieldLoad::new(model, dt_s)?;
        Ok(Self {
            dt_s,
            series_r_ohm: model.winding_r_ohm + load.shield_r_ohm(),
            load,
            lambda_wb: [0.0; 2],
        })
    }

    /// Coil voltage at the next instant, whose current is `i_a`.
    pub fn step(&mut self, i_a: f64) -> f64 {
        let flux = self.load.predict();
        self.load.commit(i_a);
        let [now, before] = self.lambda_wb;
        let new = flux.lambda0_wb + flux.l_h * i_a;
        self.lambda_wb = [new, now];
        self.series_r_ohm * i_a + (1.5 * new - 2.0 * now + 0.5 * before) / self.dt_s
    }

    /// Fundamental impedance in the last of `periods` periods of i = Î sin ωt: (R in ohm, L in henry). `steps` is the number of
    /// time steps per period.
    pub fn fundamental(
        model: &FieldModel,
        f_hz: f64,
        i_a: f64,
        steps: usize,
        periods: usize,
    ) -> Result<(f64, f64), FieldError> {
        let sine = [Complex::new(0.0, -i_a)];
        Self::fundamental_of(model, f_hz, &sine, steps, periods)
    }

    /// Fundamental impedance under i = Σ Re{I_h exp(jhωt)}; `phasors` are I_1, I_3, I_5 and so on in ampere.
    pub fn fundamental_of(
        model: &FieldModel,
        f_hz: f64,
        phasors: &[Complex<f64>],
        steps: usize,
        periods: usize,
    ) -> Result<(f64, f64), FieldError> {
        let mut load = Self::new(model, 1.0 / (f_hz * steps as f64))?;
        let mut analyser = Fundamental::new(steps);
        for k in 1..=periods * steps {
            let i_a: f64 = phasors
                .iter()
                .enumerate()
                .map(|(n, i)| (i * turn((2 * n + 1) * k, steps)).re)
                .sum();
            let v = load.step(i_a);
            if k > (periods - 1) * steps {
                analyser.push(k, v, i_a);
            }
        }
        Ok(analyser.r_l(f_hz))
    }
}

/// exp(j2πk/steps).
fn turn(k: usize, steps: usize) -> Complex<f64> {
    let angle = 2.0 * core::f64::consts::PI * (k % steps) as f64 / steps as f64;
    Complex::new(libm::cos(angle), libm::sin(angle))
}

/// Fundamental of voltage and current over one period of the steady state.
struct Fundamental {
    steps: usize,
    v: Complex<f64>,
    i: Complex<f64>,
}

impl Fundamental {
    fn new(steps: usize) -> Self {
        let zero = Complex::new(0.0, 0.0);
        Self {
            steps,
            v: zero,
            i: zero,
        }
    }

    fn push(&mut self, k: usize, v: f64, i: f64) {
        let turn = turn(k, self.steps).conj();
        self.v += turn * v;
        self.i += turn * i;
    }

    /// R in ohm, L in henry.
    fn r_l(&self, f_hz: f64) -> (f64, f64) {
        // As a product: a quotient of complex numbers takes the platform's hypot.
        let z = self.v * self.i.conj() / self.i.norm_sqr();
        (z.re, z.im / (2.0 * core::f64::consts::PI * f_hz))
    }
}

/// Steady state of a load at a half-bridge.
#[derive(Clone, Debug, PartialEq)]
pub struct HalfBridge {
    /// Phasors I_1, I_3, I_5 and so on in ampere, i = Σ Re{I_h exp(jhωt)}.
    pub current: Vec<Complex<f64>>,
    /// R of the fundamental in ohm.
    pub r_ohm: f64,
    /// L of the fundamental in henry.
    pub l_h: f64,
}

impl HalfBridge {
    /// Simulates a square wave of `bus_v` through `capacitance_f` for `periods` periods of `steps` steps; returns `orders` odd
    /// harmonics of the current.
    pub fn steady<const N: usize>(
        model: &FieldModel,
        (f_hz, bus_v): (f64, f64),
        capacitance_f: f64,
        (steps, periods): (usize, usize),
        orders: usize,
    ) -> Result<Self, FieldError> {
        let mut tank = FieldTank::<N>::new(model, capacitance_f, 1.0 / (f_hz * steps as f64))?;
        let mut current = vec![Complex::new(0.0, 0.0); orders];
        let mut analyser = Fundamental::new(steps);
        for k in 1..=periods * steps {
            // The capacitor takes the mean: half the bus voltage either way is the same.
            let high = k % steps < steps / 2;
            let at = tank.step(if high { 0.5 * bus_v } else { -0.5 * bus_v });
            if k > (periods - 1) * steps {
                analyser.push(k, at.v_coil_v, at.i_a);
                for (n, i) in current.iter_mut().enumerate() {
                    *i += turn((2 * n + 1) * k, steps).conj() * (2.0 * at.i_a / steps as f64);
                }
            }
        }
        let (r_ohm, l_h) = analyser.r_l(f_hz);
        Ok(Self {
            current,
            r_ohm,
            l_h,
        })
    }
}
