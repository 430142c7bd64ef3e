//! Truth of a waveform: impedance of the fundamental and of harmonics, period by period.

use std::f64::consts::{PI, TAU};

use ihd_signal::ORDERS;
use ihd_signal::truth::PeriodTruth;
use nalgebra::Complex;

/// Sums over one switching period.
///
/// V_h = R_h I_h + L_h D_h with D_h the phasor of di/dt. Over a whole period
/// D_h = jhω I_h + (2/T)(i(end) − i(start)), exactly: a growing or falling envelope does not
/// disturb R and L where one R and one L hold for all harmonics.
///
/// Where they do not, the growth of the other harmonics leaks into the fundamental of a single period:
/// .3 % of R half a millisecond after a zero crossing of a field model. Two periods under a
/// triangle, [`PeriodSums::across`], leave none of a linear growth.
#[derive(Clone, Debug)]
pub struct HarmonicAnalyser {
    turn: Vec<Complex<f64>>,
    sums: PeriodSums,
    i_start_a: f64,
    i_before_a: f64,
    /// Phasor of each order by that of its steps' means at their ends' mean turn: 1/cos²(hπ/N).
    mean_factor: [f64; ORDERS.len()],
}

/// Sums over a period, each plain and with a weight that rises from 0 to 1.
#[derive(Clone, Debug, PartialEq)]
pub struct PeriodSums {
    steps: usize,
    plain: Sums,
    rising: Sums,
}

#[derive(Clone, Copy, Debug, PartialEq, Default)]
struct Sums {
    v: [Complex<f64>; ORDERS.len()],
    i: [Complex<f64>; ORDERS.len()],
    power: f64,
    square: f64,
}

impl Sums {
    /// Linear combination: `a` times these and `b` times the others.
    fn mixed(&self, a: f64, other: &Self, b: f64) -> Self {
        let phasors = |x: &[Complex<f64>; ORDERS.len()], y: &[Complex<f64>; ORDERS.len()]| {
            core::array::from_fn(|k| x[k] * a + y[k] * b)
        };
        Self {
            v: phasors(&self.v, &other.v),
            i: phasors(&self.i, &other.i),
            power: self.power * a + other.power * b,
            square: self.square * a + other.square * b,
        }
    }

    /// Truth from the sums of a period of `steps`; `growth` is the part of D_h beside jhω I_h.
    fn truth(
        &self,
        t_s: f64,
        f_sw_hz: f64,
        steps: f64,
        growth: impl Fn(usize) -> Complex<f64>,
    ) -> PeriodTruth {
        self.truth_of_rate(t_s, f_sw_hz, steps, |k| {
            let i = self.i[k] * (2.0 / steps);
            Complex::new(0.0, TAU * f_sw_hz * f64::from(ORDERS[k])) * i + growth(k)
        })
    }

    /// Truth from the phasors D_h themselves.
    fn truth_of_rate(
        &self,
        t_s: f64,
        f_sw_hz: f64,
        steps: f64,
        rate: impl Fn(usize) -> Complex<f64>,
    ) -> PeriodTruth {
        let mut out = PeriodTruth {
            t_s,
            f_sw_hz,
            r_ohm: [0.0; ORDERS.len()],
            l_h: [0.0; ORDERS.len()],
            i_a: self.i[0].norm_sqr().sqrt() * 2.0 / steps,
            r_power_ohm: self.power / self.square,
            p_w: self.power / steps,
        };
        for k in 0..ORDERS.len() {
            let (v, i) = (self.v[k] * (2.0 / steps), self.i[k] * (2.0 / steps));
            let rate = rate(k);
            // Two real equations in R and L.
            let determinant = i.re * rate.im - i.im * rate.re;
            out.r_ohm[k] = (v.re * rate.im - v.im * rate.re) / determinant;
            out.l_h[k] = (i.re * v.im - i.im * v.re) / determinant;
        }
        out
    }
}

impl PeriodSums {
    /// The truth under the triangle over a period and the `next` one of the same length; `t_s` is the
    /// boundary between them.
    ///
    /// With weights w from 0 over 1 back to 0 the phasor of di/dt is jhω I_h − Σ i w' exp(−jhωt), and w'
    /// is ±1/T: the growth of I_h from one period to the next over T.
    pub fn across(&self, next: &Self, t_s: f64, f_sw_hz: f64) -> PeriodTruth {
        let steps = self.steps as f64;
        let falling = next.plain.mixed(1.0, &next.rising, -1.0);
        let growth = |k: usize| (next.plain.i[k] - self.plain.i[k]) * (2.0 / steps * f_sw_hz);
        let triangle = self.rising.mixed(1.0, &falling, 1.0);
        triangle.truth(t_s, f_sw_hz, steps, growth)
    }

    /// Truth like [`PeriodSums::across`] for periods of the frequencies `f_hz`, with `i_a` the current between them: a carrier that
    /// moves from period to period.
    ///
    /// The sums run over the carrier's phase, in which di/dt is f · di/dτ. Each period thus contributes its own frequency to jhω
    /// I_h and to the growth; the triangle's top leaves (f1 − f2) times `i_a`.
    pub fn across_change(&self, next: &Self, t_s: f64, f_hz: [f64; 2], i_a: f64) -> PeriodTruth {
        let scale = 2.0 / self.steps as f64;
        let falling = next.plain.mixed(1.0, &next.rising, -1.0);
        let top = Complex::new(2.0 * (f_hz[0] - f_hz[1]) * i_a, 0.0);
        let rate = |k: usize| {
            let turning = self.rising.i[k] * f_hz[0] + falling.i[k] * f_hz[1];
            let growth = next.plain.i[k] * f_hz[1] - self.plain.i[k] * f_hz[0];
            (Complex::new(0.0, TAU * f64::from(ORDERS[k])) * turning + growth) * scale + top
        };
        let triangle = self.rising.mixed(1.0, &falling, 1.0);
        let f_sw_hz = 0.5 * (f_hz[0] + f_hz[1]);
        triangle.truth_of_rate(t_s, f_sw_hz, self.steps as f64, rate)
    }

    /// Returns `true` if both periods have the same number of steps.
    pub fn fits(&self, other: &Self) -> bool {
        self.steps == other.steps
    }
}

impl HarmonicAnalyser {
    /// Creates one for a period of `steps` integration steps.
    pub fn new(steps: usize) -> Self {
        let turn = (0..=steps)
            .map(|n| {
                let angle = TAU * (n % steps) as f64 / steps as f64;
                Complex::new(libm::cos(angle), -libm::sin(angle))
            })
            .collect();
        let sums = PeriodSums {
            steps,
            plain: Sums::default(),
            rising: Sums::default(),
        };
        Self {
            turn,
            sums,
            i_start_a: 0.0,
            i_before_a: 0.0,
            mean_factor: ORDERS.map(|h| libm::cos(PI * f64::from(h) / steps as f64).powi(-2)),
        }
    }

    /// Adds coil voltage and current at boundary `n` of the period, 0 and `steps` included: the sum is the trapezoidal rule.
    pub fn push(&mut self, n: usize, v_v: f64, i_a: f64) {
        let steps = self.sums.steps;
        let weight = if n == 0 || n == steps { 0.5 } else { 1.0 };
        if n == 0 {
            (self.sums.plain, self.sums.rising) = Default::default();
            self.i_start_a = i_a;
        }
        let (v, i) = (v_v * weight, i_a * weight);
        let add = |sums: &mut Sums, share: f64| {
            for (k, order) in ORDERS.into_iter().enumerate() {
                let turn = self.turn[order as usize * n % steps] * share;
                sums.v[k] += turn * v;
                sums.i[k] += turn * i;
            }
            sums.power += share * v * i_a;
            sums.square += share * i * i_a;
        };
        add(&mut self.sums.plain, 1.0);
        add(&mut self.sums.rising, n as f64 / steps as f64);
    }

    /// Adds the coil voltage's mean over the step that ends at boundary `n`, and the current there; [`HarmonicAnalyser::start`] first.
    /// An edge inside the step has its full effect, where samples at the boundaries would shift it by up to half a step.
    pub fn push_mean(&mut self, n: usize, v_mean_v: f64, i_a: f64) {
        let steps = self.sums.steps;
        // Currents at the boundaries, as in `push`.
        let i_before_a = std::mem::replace(&mut self.i_before_a, i_a);
        let i_mean_a = 0.5 * (i_before_a + i_a);
        let add = |sums: &mut Sums, [before, now]: [f64; 2]| {
            for (k, order) in ORDERS.into_iter().enumerate() {
                let (from, to) = (
                    self.turn[order as usize * (n - 1) % steps],
                    self.turn[order as usize * n % steps],
                );
                sums.v[k] += (from * before + to * now) * (0.5 * self.mean_factor[k] * v_mean_v);
                sums.i[k] += (from * (before * i_before_a) + to * (now * i_a)) * 0.5;
            }
            let middle = 0.5 * (before + now);
            sums.power += middle * v_mean_v * i_mean_a;
            sums.square += 0.5 * (before * i_before_a * i_before_a + now * i_a * i_a);
        };
        add(&mut self.sums.plain, [1.0, 1.0]);
        add(
            &mut self.sums.rising,
            [n - 1, n].map(|n| n as f64 / steps as f64),
        );
    }

    /// Begins a period at a current in ampere, for [`HarmonicAnalyser::push_mean`].
    pub fn start(&mut self, i_a: f64) {
        (self.sums.plain, self.sums.rising) = Default::default();
        (self.i_start_a, self.i_before_a) = (i_a, i_a);
    }

    /// Truth of the period, after its last boundary; `t_s` is its middle.
    pub fn truth(&self, t_s: f64, f_sw_hz: f64, i_end_a: f64) -> PeriodTruth {
        let jump = Complex::new((i_end_a - self.i_start_a) * 2.0 * f_sw_hz, 0.0);
        let steps = self.sums.steps as f64;
        self.sums.plain.truth(t_s, f_sw_hz, steps, |_| jump)
    }

    /// Sums of the period, after its last boundary.
    pub fn sums(&self) -> &PeriodSums {
        &self.sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growing_current_through_a_constant_r_and_l_gives_both_back() {
        let (r, l, f, steps) = (3.0, 22e-6, 45e3, 1111);
        let mut analyser = HarmonicAnalyser::new(steps);
        let period = 1.0 / f;
        // i = a t sin ωt + b t cos 3ωt, 20 % growth within the period.
        let (w, t0) = (TAU * f, 4.0 * period);
        let (a, b) = (10.0 / t0, 2.0 / t0);
        let current = |t: f64| a * t * (w * t).sin() + b * t * (3.0 * w * t).cos();
        let rate = |t: f64| {
            a * (w * t).sin() + a * t * w * (w * t).cos() + b * (3.0 * w * t).cos()
                - 3.0 * b * t * w * (3.0 * w * t).sin()
        };
        for n in 0..=steps {
            let t = t0 + period * n as f64 / steps as f64;
            analyser.push(n, r * current(t) + l * rate(t), current(t));
        }
        let truth = analyser.truth(t0 + period / 2.0, f, current(t0 + period));
        for k in [0, 1] {
            assert!(
                (truth.r_ohm[k] / r - 1.0).abs() < 1e-4,
                "R {}",
                truth.r_ohm[k]
            );
            assert!((truth.l_h[k] / l - 1.0).abs() < 1e-4, "L {}", truth.l_h[k]);
        }
        assert!((truth.i_a - 10.0 * 4.5 / 4.0).abs() < 0.3);
    }

    /// Voltages of trapezoidal steps, prewarped to the fundamental: its R and L come back, whatever the number of steps.
    #[test]
    fn means_over_coarse_steps_give_the_circuits_r_and_l_back() {
        let (r, l, f, steps) = (3.0, 22e-6, 45e3, 61);
        let dt_s = libm::tan(PI / steps as f64) / (PI * f);
        let current = |n: usize| {
            let angle = TAU * n as f64 / steps as f64;
            20.0 * (angle + 0.4).sin() + 0.8 * (3.0 * angle).cos()
        };
        let mut analyser = HarmonicAnalyser::new(steps);
        analyser.start(current(0));
        for n in 1..=steps {
            let (from, to) = (current(n - 1), current(n));
            analyser.push_mean(n, 0.5 * r * (from + to) + l * (to - from) / dt_s, to);
        }
        let truth = analyser.truth(0.0, f, current(steps));
        assert!((truth.r_ohm[0] / r - 1.0).abs() < 1e-9, "{truth:?}");
        assert!((truth.l_h[0] / l - 1.0).abs() < 1e-9, "{truth:?}");
        assert!((truth.i_a / 20.0 - 1.0).abs() < 1e-9, "{truth:?}");
        // The third harmonic's reactance is warped: tan 3θ for 3 tan θ.
        let theta = PI / steps as f64;
        let warped = libm::tan(3.0 * theta) / (3.0 * libm::tan(theta));
        assert!((truth.l_h[1] / l / warped - 1.0).abs() < 1e-9, "{truth:?}");
    }

    /// The carrier's phase runs on through a step of its frequency by 1 %, a hundred times what a sweep does.
    #[test]
    fn a_carrier_that_moves_leaves_r_and_l_as_they_are() {
        let (r, l, steps) = (3.0, 22e-6, 1111);
        let f_hz = [45e3, 45.45e3];
        let current =
            |tau: f64| (10.0 + 0.3 * tau) * (TAU * tau + 0.7).sin() + 0.8 * (3.0 * TAU * tau).cos();
        let slope = |tau: f64| {
            0.3 * (TAU * tau + 0.7).sin() + TAU * (10.0 + 0.3 * tau) * (TAU * tau + 0.7).cos()
                - 3.0 * TAU * 0.8 * (3.0 * TAU * tau).sin()
        };
        let sums: Vec<_> = (0..2)
            .map(|p| {
                let mut analyser = HarmonicAnalyser::new(steps);
                for n in 0..=steps {
                    let tau = f64::from(p) + n as f64 / steps as f64;
                    let v = r * current(tau) + l * f_hz[p as usize] * slope(tau);
                    analyser.push(n, v, current(tau));
                }
                analyser.sums().clone()
            })
            .collect();
        let truth = sums[0].across_change(&sums[1], 0.0, f_hz, current(1.0));
        for k in [0, 1] {
            assert!((truth.r_ohm[k] / r - 1.0).abs() < 1e-4, "{truth:?}");
            assert!((truth.l_h[k] / l - 1.0).abs() < 1e-4, "{truth:?}");
        }
    }

    /// A load whose L is half as large for the third harmonic: what a growing third harmonic leaks
    /// into one period's fundamental is gone from two.
    #[test]
    fn two_periods_see_the_fundamental_alone() {
        let (f, steps) = (45e3, 1111);
        let (r, l) = ([3.0, 8.0], [22e-6, 11e-6]);
        let (period, w) = (1.0 / f, TAU * f);
        // Half a millisecond after a zero crossing.
        let (t0, growth) = (0.5e-3, [2e4, 1.5e3]);
        let current = |t: f64| growth[0] * t * (w * t).sin() + growth[1] * t * (3.0 * w * t).cos();
        let voltage = |t: f64| {
            let [a, b] = growth;
            let (i_1, i_3) = (a * t * (w * t).sin(), b * t * (3.0 * w * t).cos());
            let d_1 = a * (w * t).sin() + a * t * w * (w * t).cos();
            let d_3 = b * (3.0 * w * t).cos() - 3.0 * b * t * w * (3.0 * w * t).sin();
            r[0] * i_1 + l[0] * d_1 + r[1] * i_3 + l[1] * d_3
        };
        let mut sums = Vec::new();
        let mut single = None;
        for k in 0..2 {
            let mut analyser = HarmonicAnalyser::new(steps);
            let from = t0 + f64::from(k) * period;
            for n in 0..=steps {
                let t = from + period * n as f64 / steps as f64;
                analyser.push(n, voltage(t), current(t));
            }
            single = Some(analyser.truth(from + 0.5 * period, f, current(from + period)));
            sums.push(analyser.sums().clone());
        }
        assert!(sums[0].fits(&sums[1]));
        let truth = sums[0].across(&sums[1], t0 + period, f);
        for (k, right) in r.into_iter().enumerate() {
            assert!((truth.r_ohm[k] / right - 1.0).abs() < 2e-4, "{truth:?}");
            assert!((truth.l_h[k] / l[k] - 1.0).abs() < 2e-4, "{truth:?}");
        }
        assert!((truth.i_a / (growth[0] * (t0 + period)) - 1.0).abs() < 1e-4);
        let single = single.expect("two periods");
        assert!((single.r_ohm[1] / r[1] - 1.0).abs() > 1e-2, "{single:?}");
    }
}
