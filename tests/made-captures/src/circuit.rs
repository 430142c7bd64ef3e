//! Half-bridge, resonance capacitor, coil and pot in the time domain.
//!
//! ```text
//! u − v_C = v = L_s di/dt + R_s i + R_e (i − m),    L_m dm/dt = R_e (i − m),    C dv_C/dt = i
//! ```
//!
//! The pot is a resistance R_e in parallel with the inductance L_m: an eddy current i − m, so that R grows and L falls with the
//! frequency. All four elements follow the amplitude of the current's fundamental in the period before, linearly over a period: steps
//! at its ends would be a ripple in phase with the carrier, and .02 % of R and L. So R and L of the fundamental are known.

use std::f64::consts::TAU;

/// R and L of the fundamental as functions of the current's amplitude.
#[derive(Clone, Copy, Debug)]
pub struct LoadLaw {
    /// R at a large current, and its addition at a small one, in ohm.
    pub r_ohm: (f64, f64),
    /// L at a large current, and its addition at a small one, in henry.
    pub l_h: (f64, f64),
    /// Current in ampere at which half of the additions is left.
    pub bend_a: f64,
    /// Exponents with which R and L bend.
    pub power: (f64, f64),
    /// Share of R that is the pot's eddy current; 0: v = R i + L di/dt holds for every harmonic.
    pub eddy: f64,
}

impl LoadLaw {
    /// R in ohm and L in henry at an amplitude in ampere.
    pub fn at(&self, i_a: f64) -> (f64, f64) {
        let x = i_a / self.bend_a;
        let r = self.r_ohm.0 + self.r_ohm.1 / (1.0 + x.powf(self.power.0));
        let l = self.l_h.0 + self.l_h.1 / (1.0 + x.powf(self.power.1));
        (r, l)
    }
}

/// Bridge and mains.
#[derive(Clone, Copy, Debug)]
pub struct Bridge {
    /// Switching frequency in hertz.
    pub f_sw_hz: f64,
    /// Change of it in hertz, from a time in seconds on.
    pub step: Option<(f64, f64)>,
    /// Peak of the mains in volt.
    pub peak_v: f64,
    /// Mains frequency in hertz.
    pub mains_hz: f64,
    /// Phase of the mains at the start in radian.
    pub phase: f64,
    /// Third and fifth harmonic of the mains, as shares.
    pub distortion: (f64, f64),
    /// Lowest bus voltage as a share of the peak, which a capacitor holds.
    pub held: f64,
    /// Duration of an edge in seconds.
    pub edge_s: f64,
    /// On-time of the upper switch as a share of the period.
    pub duty: f64,
}

impl Bridge {
    /// Bus voltage in volt.
    pub fn bus_v(&self, t_s: f64) -> f64 {
        let x = TAU * self.mains_hz * t_s + self.phase;
        let wave =
            x.sin() + self.distortion.0 * (3.0 * x).sin() + self.distortion.1 * (5.0 * x).sin();
        self.peak_v * wave.abs().max(self.held)
    }

    /// Phase in periods.
    fn periods(&self, t_s: f64) -> f64 {
        let beyond = self
            .step
            .map_or(0.0, |(hz, from_s)| hz * (t_s - from_s).max(0.0));
        self.f_sw_hz * t_s + beyond
    }

    /// Switching frequency at a time in hertz.
    pub fn hz(&self, t_s: f64) -> f64 {
        let stepped = self.step.filter(|(_, from_s)| t_s >= *from_s);
        self.f_sw_hz + stepped.map_or(0.0, |(hz, _)| hz)
    }

    /// Share of the bus at the output: a trapezoid.
    fn level(&self, periods: f64, f_hz: f64) -> f64 {
        let x = periods.fract();
        let edge = self.edge_s * f_hz;
        let rising = (x / edge).clamp(0.0, 1.0);
        let falling = ((x - self.duty) / edge).clamp(0.0, 1.0);
        rising - falling
    }
}

/// Other hob whose field induces a voltage in this coil.
#[derive(Clone, Copy, Debug)]
pub struct Neighbour {
    /// Frequency less this hob's, in hertz.
    pub offset_hz: f64,
    /// Amplitude in volt at the crest.
    pub v: f64,
    /// Phase in radian.
    pub phase: f64,
    /// `true` if its bus follows the same mains, `false` for a constant amplitude.
    pub follows_mains: bool,
}

/// R and L of the fundamental over one switching period.
#[derive(Clone, Copy, Debug)]
pub struct Truth {
    /// Middle of the period in seconds.
    pub t_s: f64,
    /// R in ohm.
    pub r_ohm: f64,
    /// L in henry.
    pub l_h: f64,
    /// Amplitude of the current in ampere, in the period before, which R and L follow.
    pub i_a: f64,
}

/// Everything that is integrated.
#[derive(Clone, Debug)]
pub struct Circuit {
    /// Bridge and mains.
    pub bridge: Bridge,
    /// Load.
    pub load: LoadLaw,
    /// Resonance capacitor in farad.
    pub capacitance_f: f64,
    /// Resistance of bridge, shunt and cables in ohm, outside the voltage's probe.
    pub loop_r_ohm: f64,
    /// Neighbours.
    pub neighbours: Vec<Neighbour>,
    /// Factors on R and L from a time in seconds on.
    pub load_step: Option<(f64, f64, f64)>,
    /// Relative change of R and L per second.
    pub drift: (f64, f64),
    /// Sampling rate in hertz.
    pub rate_hz: f64,
    /// Duration in seconds.
    pub duration_s: f64,
}

/// Coil voltage and current at the samples, and the truth.
#[derive(Clone, Debug)]
pub struct Waves {
    /// Coil voltage in volt.
    pub v_v: Vec<f64>,
    /// Coil current in ampere.
    pub i_a: Vec<f64>,
    /// R and L at the middles of periods.
    pub truth: Vec<Truth>,
}

/// Longest step of the integration in seconds.
const STEP_S: f64 = 21e-9;

/// Time in seconds before the capture in which the circuit settles.
const SETTLES_S: f64 = 0.4e-3;

/// ω over the corner R_e/L_m of the pot's eddy current.
const CORNER: f64 = 1.2;

/// Elements of the circuit in one period.
#[derive(Clone, Copy)]
struct Elements {
    r_s: f64,
    l_s: f64,
    r_e: f64,
    per_l_m: f64,
}

/// R and L of the fundamental, and the elements that have them.
#[derive(Clone, Copy)]
struct LoadState {
    r_ohm: f64,
    l_h: f64,
    elements: Elements,
}

impl Elements {
    fn between(&self, other: &Self, share: f64) -> Self {
        let mix = |a: f64, b: f64| a + share * (b - a);
        Self {
            r_s: mix(self.r_s, other.r_s),
            l_s: mix(self.l_s, other.l_s),
            r_e: mix(self.r_e, other.r_e),
            per_l_m: mix(self.per_l_m, other.per_l_m),
        }
    }

    fn from_r_l(r: f64, l: f64, omega: f64, eddy: f64) -> Self {
        if eddy == 0.0 {
            return Self {
                r_s: r,
                l_s: l,
                r_e: 0.0,
                per_l_m: 0.0,
            };
        }
        // Z_e = R_e·jx/(1 + jx)
        let x = CORNER;
        let r_e = eddy * r * (1.0 + x * x) / (x * x);
        Self {
            r_s: (1.0 - eddy) * r,
            l_s: l - r_e * x / (1.0 + x * x) / omega,
            r_e,
            per_l_m: omega / (x * r_e),
        }
    }
}

impl Circuit {
    /// R in ohm and L in henry of the fundamental at a time and an amplitude.
    fn r_l(&self, t_s: f64, i_a: f64) -> (f64, f64) {
        let (mut r, mut l) = self.load.at(i_a);
        if let Some((from_s, by_r, by_l)) = self.load_step
            && t_s >= from_s
        {
            (r, l) = (r * by_r, l * by_l);
        }
        let at = t_s.max(0.0);
        (r * (1.0 + self.drift.0 * at), l * (1.0 + self.drift.1 * at))
    }

    /// Load at a time, after a period of this amplitude.
    fn state(&self, t_s: f64, i_a: f64) -> LoadState {
        let (r_ohm, l_h) = self.r_l(t_s, i_a);
        let omega = TAU * self.bridge.hz(t_s);
        LoadState {
            r_ohm,
            l_h,
            elements: Elements::from_r_l(r_ohm, l_h, omega, self.load.eddy),
        }
    }

    fn induced_v(&self, t_s: f64) -> f64 {
        if self.neighbours.is_empty() {
            return 0.0;
        }
        let bridge = &self.bridge;
        let of = |n: &Neighbour| {
            let angle = TAU * (bridge.f_sw_hz + n.offset_hz) * t_s + n.phase;
            let mains = (TAU * bridge.mains_hz * t_s + bridge.phase).sin().abs();
            let shape = if n.follows_mains { mains } else { 1.0 };
            n.v * shape * (angle.cos() + 0.03 * (3.0 * angle).cos())
        };
        self.neighbours.iter().map(of).sum()
    }

    /// Integrates by the classical Runge-Kutta method, and keeps the values at the samples.
    pub fn integrate(&self) -> Waves {
        let sample_s = 1.0 / self.rate_hz;
        let inside = (sample_s / STEP_S).ceil() as usize;
        let h = sample_s / inside as f64;
        let settling = (SETTLES_S / sample_s) as usize;
        let samples = (self.duration_s * self.rate_hz) as usize;
        let mut waves = Waves {
            v_v: Vec::with_capacity(samples),
            i_a: Vec::with_capacity(samples),
            truth: Vec::new(),
        };
        let mut x = [0.0; 3];
        let begin_s = -(settling as f64) * sample_s;
        let mut period = self.bridge.periods(begin_s).floor();
        let mut sums = (0.0, 0.0, 0usize);
        let mut from_s = begin_s;
        // At the beginning of the period and at its end.
        let mut old = self.state(begin_s, 0.0);
        let mut new = old;
        let mut i_a = 0.0;
        let mut input = self.input_v(begin_s);
        for k in 0..(settling + samples) * inside {
            let t_s = begin_s + k as f64 * h;
            if k % inside == 0 {
                if k >= settling * inside {
                    waves.v_v.push(input.0 - x[2] - self.loop_r_ohm * x[0]);
                    waves.i_a.push(x[0]);
                }
                let angle = TAU * self.bridge.periods(t_s);
                sums = (
                    sums.0 + x[0] * angle.cos(),
                    sums.1 - x[0] * angle.sin(),
                    sums.2 + 1,
                );
            }
            let (middle, end) = (self.input_v(t_s + 0.5 * h), self.input_v(t_s + h));
            let share = self.bridge.periods(t_s) - period;
            let elements = old.elements.between(&new.elements, share);
            x = self.step(x, elements, [input, middle, end], h);
            input = end;
            let now = self.bridge.periods(t_s + h).floor();
            if now > period {
                period = now;
                let to_s = t_s + h;
                if from_s >= 0.0 {
                    waves.truth.push(Truth {
                        t_s: 0.5 * (from_s + to_s),
                        r_ohm: 0.5 * (old.r_ohm + new.r_ohm),
                        l_h: 0.5 * (old.l_h + new.l_h),
                        i_a,
                    });
                }
                from_s = to_s;
                i_a = 2.0 * sums.0.hypot(sums.1) / sums.2 as f64;
                sums = (0.0, 0.0, 0);
                (old, new) = (new, self.state(to_s, i_a));
            }
        }
        waves
    }

    /// Voltage of the bridge and of the neighbours.
    fn input_v(&self, t_s: f64) -> (f64, f64) {
        let level = self
            .bridge
            .level(self.bridge.periods(t_s) + 1e3, self.bridge.hz(t_s));
        (self.bridge.bus_v(t_s) * level, self.induced_v(t_s))
    }

    fn step(&self, x: [f64; 3], e: Elements, inputs: [(f64, f64); 3], h: f64) -> [f64; 3] {
        let slope = |x: [f64; 3], (bridge_v, induced_v): (f64, f64)| {
            let eddy_v = e.r_e * (x[0] - x[1]);
            [
                (bridge_v - x[2] - induced_v - (e.r_s + self.loop_r_ohm) * x[0] - eddy_v) / e.l_s,
                eddy_v * e.per_l_m,
                x[0] / self.capacitance_f,
            ]
        };
        let ahead = |k: [f64; 3], by: f64| std::array::from_fn(|n| x[n] + by * k[n]);
        let a = slope(x, inputs[0]);
        let b = slope(ahead(a, 0.5 * h), inputs[1]);
        let c = slope(ahead(b, 0.5 * h), inputs[1]);
        let d = slope(ahead(c, h), inputs[2]);
        std::array::from_fn(|n| x[n] + h / 6.0 * (a[n] + 2.0 * b[n] + 2.0 * c[n] + d[n]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A steady bus and a steady load: the samples' own phasors give the R and L that were put in.
    #[test]
    fn the_truth_is_that_of_the_samples() {
        for eddy in [0.0, 0.7] {
            let f_sw_hz = 50e3;
            let circuit = Circuit {
                bridge: Bridge {
                    f_sw_hz,
                    step: None,
                    peak_v: 320.0,
                    mains_hz: 50.0,
                    phase: 0.0,
                    distortion: (0.0, 0.0),
                    held: 1.0,
                    edge_s: 0.2e-6,
                    duty: 0.5,
                },
                load: LoadLaw {
                    r_ohm: (3.0, 0.0),
                    l_h: (22e-6, 0.0),
                    bend_a: 10.0,
                    power: (1.0, 1.0),
                    eddy,
                },
                capacitance_f: 0.9e-6,
                loop_r_ohm: 0.0,
                neighbours: Vec::new(),
                load_step: None,
                drift: (0.0, 0.0),
                rate_hz: 12.5e6,
                duration_s: 1e-3,
            };
            let waves = circuit.integrate();
            // 40 whole periods of 250 samples.
            let phasor = |x: &[f64]| {
                let part = &x[2_000..12_000];
                let mut sum = (0.0, 0.0);
                for (k, x) in part.iter().enumerate() {
                    let angle = TAU * f_sw_hz * k as f64 / circuit.rate_hz;
                    sum = (sum.0 + x * angle.cos(), sum.1 - x * angle.sin());
                }
                sum
            };
            let (v, i) = (phasor(&waves.v_v), phasor(&waves.i_a));
            let norm = i.0 * i.0 + i.1 * i.1;
            let r = (v.0 * i.0 + v.1 * i.1) / norm;
            let l = (v.1 * i.0 - v.0 * i.1) / norm / (TAU * f_sw_hz);
            assert!((r / 3.0 - 1.0).abs() < 2e-3, "{eddy}: {r}");
            assert!((l / 22e-6 - 1.0).abs() < 1e-3, "{eddy}: {l}");
        }
    }

    #[test]
    fn the_bridge_is_a_trapezoid() {
        let bridge = Bridge {
            f_sw_hz: 50e3,
            step: None,
            peak_v: 300.0,
            mains_hz: 50.0,
            phase: 0.25 * TAU,
            distortion: (0.0, 0.0),
            held: 0.0,
            edge_s: 0.2e-6,
            duty: 0.5,
        };
        let mean = (0..1000)
            .map(|k| bridge.level(f64::from(k) / 1000.0, 50e3))
            .sum::<f64>()
            / 1000.0;
        assert!((mean - 0.5).abs() < 2e-3, "{mean}");
        assert!((bridge.bus_v(0.0) - 300.0).abs() < 1e-9);
    }
}
