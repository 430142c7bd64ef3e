//! One switching period, averaged from many: 61 pairs cover three periods, so pair k has phase 3k/61 of a period. A window's pairs
//! are thus 61 phases of one period, each some two hundred times.

use std::f64::consts::TAU;

use ihd_link::Window;
use ihd_shared::hob::RESONANCE_CAPACITANCE_NF;
use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q, ANTI_ALIAS_HZ};

/// Number of phases in a period.
pub(crate) const PHASES: usize = ADC_LOCK_P;

/// Time constant of the channels' anti-alias filter in seconds.
fn filter_s() -> f64 {
    1.0 / (TAU * f64::from(ANTI_ALIAS_HZ))
}

/// Duration from 10 to 90 % of a step after that filter, in time constants: ln 9.
const STEP_10_90: f64 = 2.197_224_577;

/// Distance in samples from an edge at which its levels are taken: more than five time constants of the filter, and well before the
/// next edge.
const LEVEL_FROM: usize = 8;
const LEVEL_TO: usize = 11;

/// Smallest current for which an impedance is computed, in ampere: a code is 0.04 A.
const MIN_A: f64 = 0.05;

/// Averaged period.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Period {
    /// Duration in seconds.
    pub(crate) period_s: f64,
    /// Coil voltage at each phase in volt.
    pub(crate) v_v: [f64; PHASES],
    /// Coil current at each phase in ampere.
    pub(crate) i_a: [f64; PHASES],
}

/// Edge of the bridge's node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Edge {
    /// Position of its middle, as a fraction of the period from the first sample.
    pub(crate) at: f64,
    /// Height in volt; negative if it falls.
    pub(crate) step_v: f64,
    /// Duration at the bridge in seconds, without the filter's share; 0 if it is too short to be resolved.
    pub(crate) own_s: f64,
}

/// Impedance of the fundamental.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Impedance {
    /// R in ohm.
    pub(crate) r_ohm: f64,
    /// L in henry.
    pub(crate) l_h: f64,
    /// Amplitude of the current in ampere.
    pub(crate) i_a: f64,
}

impl Period {
    /// Averages the pairs of a window; `None` if a phase has no pair, or the window has no frequency.
    pub(crate) fn from_window(window: &Window) -> Option<Self> {
        if window.f_sw_hz == 0 {
            return None;
        }
        let (v_v, i_a) = (window.v_volt(), window.i_ampere());
        let mut sums = [(0.0, 0.0, 0u32); PHASES];
        for (k, (v, i)) in v_v.iter().zip(&i_a).enumerate() {
            let phase = k * ADC_LOCK_Q as usize % PHASES;
            if let Some((v_sum, i_sum, n)) = sums.get_mut(phase) {
                *v_sum += v;
                *i_sum += i;
                *n += 1;
            }
        }
        if sums.iter().any(|(_, _, n)| *n == 0) {
            return None;
        }
        Some(Self {
            period_s: 1.0 / f64::from(window.f_sw_hz),
            v_v: sums.map(|(v, _, n)| v / f64::from(n)),
            i_a: sums.map(|(_, i, n)| i / f64::from(n)),
        })
    }

    /// Time between two phases in seconds: the resolution of an edge.
    pub(crate) fn resolution_s(&self) -> f64 {
        self.period_s / PHASES as f64
    }

    /// Means of coil voltage and current.
    pub(crate) fn means(&self) -> (f64, f64) {
        let mean = |x: &[f64; PHASES]| x.iter().sum::<f64>() / PHASES as f64;
        (mean(&self.v_v), mean(&self.i_a))
    }

    /// Steepest rise and steepest fall of the bridge's node; `None` if there is no clear edge.
    pub(crate) fn edges(&self) -> Option<[Edge; 2]> {
        let node = self.node_v();
        let slope = |k: usize| at(&node, k + 1) - at(&node, k);
        let steepest = |sign: f64| {
            (0..PHASES).max_by(|&a, &b| (sign * slope(a)).total_cmp(&(sign * slope(b))))
        };
        Some([
            self.edge(&node, steepest(1.0)?)?,
            self.edge(&node, steepest(-1.0)?)?,
        ])
    }

    /// Voltage of the bridge's node about its mean: the coil's, plus the resonance capacitor's as the current's integral. The
    /// latter moves by more between two edges than an edge's level may.
    fn node_v(&self) -> [f64; PHASES] {
        let c_f = f64::from(RESONANCE_CAPACITANCE_NF) * 1e-9;
        let volt_per_ampere = self.resolution_s() / c_f;
        let (_, mean_a) = self.means();
        let mut capacitor_v = 0.0;
        let mut before_a = at(&self.i_a, PHASES - 1) - mean_a;
        std::array::from_fn(|k| {
            let now_a = at(&self.i_a, k) - mean_a;
            capacitor_v += 0.5 * (before_a + now_a) * volt_per_ampere;
            before_a = now_a;
            at(&self.v_v, k) + capacitor_v
        })
    }

    /// Edge of the node that is steepest between samples `k` and `k` + 1.
    fn edge(&self, node: &[f64; PHASES], k: usize) -> Option<Edge> {
        let k = k + PHASES;
        let level = |from: usize, to: usize| {
            (from..=to).map(|n| at(node, n)).sum::<f64>() / (to + 1 - from) as f64
        };
        let before = level(k - LEVEL_TO, k - LEVEL_FROM);
        let after = level(k + 1 + LEVEL_FROM, k + 1 + LEVEL_TO);
        let step_v = after - before;
        // Fraction of the step at a sample.
        let share = |n: usize| (at(node, n) - before) / step_v;
        // Position at which a fraction is passed, between two samples around the edge.
        let passed = |level: f64| {
            let mut around = k - LEVEL_FROM..k + 1 + LEVEL_FROM;
            let n = around.find(|&n| share(n) < level && share(n + 1) >= level)?;
            let near = [n - 1, n, n + 1, n + 2].map(share);
            Some(n as f64 + between(near, level))
        };
        let (from, middle, to) = (passed(0.1)?, passed(0.5)?, passed(0.9)?);
        let sampled_s = (to - from) * self.resolution_s();
        let of_filter_s = STEP_10_90 * filter_s();
        let own_s = (sampled_s.powi(2) - of_filter_s.powi(2)).max(0.0).sqrt() / 0.8;
        let edge = Edge {
            at: (middle / PHASES as f64).fract(),
            step_v,
            own_s,
        };
        edge.own_s.is_finite().then_some(edge)
    }

    /// R and L of the fundamental; `None` without a current. Both channels have the same filter, which leaves their ratio
    /// unchanged.
    pub(crate) fn impedance(&self) -> Option<Impedance> {
        // Sum of x e^(-j phi), as real and imaginary part.
        let phasor = |x: &[f64; PHASES]| {
            x.iter().enumerate().fold((0.0, 0.0), |(re, im), (k, x)| {
                let phi = TAU * k as f64 / PHASES as f64;
                (re + x * phi.cos(), im - x * phi.sin())
            })
        };
        let ((v_re, v_im), (i_re, i_im)) = (phasor(&self.v_v), phasor(&self.i_a));
        let i_square = i_re * i_re + i_im * i_im;
        let i_a = 2.0 * i_square.sqrt() / PHASES as f64;
        let omega = TAU / self.period_s;
        (i_a > MIN_A).then(|| Impedance {
            r_ohm: (v_re * i_re + v_im * i_im) / i_square,
            l_h: (v_im * i_re - v_re * i_im) / i_square / omega,
            i_a,
        })
    }
}

/// Position, 0 to 1, at which the cubic through four equidistant values (Catmull-Rom) passes a value between the second, which is
/// below it, and the third. Linear interpolation would be late on an edge rounded by a filter.
fn between([a, b, c, d]: [f64; 4], level: f64) -> f64 {
    let cubic = |x: f64| {
        let (p, q) = (3.0 * (b - c) + d - a, 2.0 * a - 5.0 * b + 4.0 * c - d);
        b + 0.5 * x * (c - a + x * (q + x * p))
    };
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..32 {
        let middle = 0.5 * (low + high);
        match cubic(middle) < level {
            true => low = middle,
            false => high = middle,
        }
    }
    0.5 * (low + high)
}

/// Value at a phase, periodically continued.
fn at(of: &[f64; PHASES], k: usize) -> f64 {
    of.get(k % PHASES).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    const T_S: f64 = 1.0 / 79.911e3;

    /// Coil voltage at a share of the period: half a bus up and down, edges of a duration, behind the filter: the answer
    /// of a first-order low-pass to a ramp.
    fn voltage(at: f64, high: f64, edge_s: f64, bus_v: f64) -> f64 {
        let tau = filter_s();
        let answer = |t: f64| match t > 0.0 {
            true => t - tau * (1.0 - (-t / tau).exp()),
            false => 0.0,
        };
        let ramp = |t: f64| (answer(t) - answer(t - edge_s)) / edge_s;
        let mut level = 0.0;
        for turn in [-2.0, -1.0, 0.0, 1.0] {
            let t = (at - turn) * T_S;
            level += ramp(t - 0.1 * T_S) - ramp(t - (0.1 + high) * T_S);
        }
        bus_v * (level - 0.5)
    }

    fn period(high: f64, edge_s: f64) -> Period {
        let v = |k: usize| voltage(k as f64 / PHASES as f64, high, edge_s, 40.0);
        Period {
            period_s: T_S,
            v_v: std::array::from_fn(v),
            i_a: [0.0; PHASES],
        }
    }

    #[test]
    fn the_duration_of_an_edge_comes_back_to_a_sample() {
        for edge_s in [0.2e-6, 0.316e-6, 0.6e-6, 1.0e-6] {
            let p = period(0.5, edge_s);
            let [rise, fall] = p.edges().unwrap();
            for edge in [rise, fall] {
                let off_s = (edge.own_s - edge_s).abs();
                assert!(off_s < p.resolution_s(), "{edge_s}: {}", edge.own_s);
                assert!((edge.step_v.abs() - 40.0).abs() < 0.4, "{}", edge.step_v);
            }
            assert!(rise.step_v > 0.0 && fall.step_v < 0.0);
        }
    }

    #[test]
    fn a_cubic_is_passed_where_it_is() {
        let f = |x: f64| x * x + 3.0 * x + 1.0;
        let values = [-1.0, 0.0, 1.0, 2.0].map(f);
        for x in [0.1, 0.5, 0.99] {
            assert!((between(values, f(x)) - x).abs() < 1e-6);
        }
    }

    /// A current that swings the capacitor by 3.2 V takes nothing from an edge's height and time.
    #[test]
    fn the_capacitor_s_swing_is_no_part_of_an_edge() {
        let (i_a, omega) = (1.73, TAU / T_S);
        let c_f = f64::from(RESONANCE_CAPACITANCE_NF) * 1e-9;
        let phi = |k: usize| TAU * k as f64 / PHASES as f64 - 1.0;
        let alone = period(0.5, 0.4e-6);
        let with = Period {
            v_v: std::array::from_fn(|k| at(&alone.v_v, k) - i_a / (omega * c_f) * phi(k).sin()),
            i_a: std::array::from_fn(|k| i_a * phi(k).cos()),
            ..alone
        };
        for edge in with.edges().unwrap() {
            assert!((edge.step_v.abs() - 40.0).abs() < 0.4, "{}", edge.step_v);
            assert!((edge.own_s - 0.4e-6).abs() < with.resolution_s());
        }
    }

    #[test]
    fn a_slow_edge_is_told_from_one_within_a_dead_time() {
        let slow = period(0.5, 1.6e-6);
        let own_s = slow.edges().unwrap()[0].own_s;
        assert!(own_s > 1.0e-6 + slow.resolution_s(), "{own_s}");
    }

    #[test]
    fn the_share_of_a_period_that_is_high_is_seen() {
        for high in [0.5, 0.45, 0.53] {
            let [rise, fall] = period(high, 0.3e-6).edges().unwrap();
            let seen = (fall.at - rise.at).rem_euclid(1.0);
            assert!((seen - high).abs() < 3e-3, "{high}: {seen}");
        }
    }

    #[test]
    fn no_voltage_has_no_edge_and_no_current_no_impedance() {
        let flat = Period {
            period_s: T_S,
            v_v: [0.0; PHASES],
            i_a: [0.0; PHASES],
        };
        assert_eq!(flat.edges(), None);
        assert_eq!(flat.impedance(), None);
    }

    #[test]
    fn r_and_l_are_those_of_sines() {
        let (r_ohm, l_h, i_a) = (7.1, 28.9e-6, 1.75);
        let x_ohm = TAU / T_S * l_h;
        let at = |k: usize| TAU * k as f64 / PHASES as f64 + 0.7;
        let p = Period {
            period_s: T_S,
            v_v: std::array::from_fn(|k| 0.3 + i_a * (r_ohm * at(k).cos() - x_ohm * at(k).sin())),
            i_a: std::array::from_fn(|k| -0.1 + i_a * at(k).cos()),
        };
        let z = p.impedance().unwrap();
        assert!((z.r_ohm - r_ohm).abs() < 1e-9, "{}", z.r_ohm);
        assert!((z.l_h - l_h).abs() < 1e-15, "{}", z.l_h);
        assert!((z.i_a - i_a).abs() < 1e-12);
        let (v, i) = p.means();
        assert!((v - 0.3).abs() < 1e-9 && (i + 0.1).abs() < 1e-9);
    }
}
