//! R and L of the phasors' fundamental, and their conclusions on wiring and skew.

use std::f64::consts::TAU;

use ihd_signal::{Load, ORDERS};
use nalgebra::Complex;
use serde::Serialize;

use super::track::Track;

/// Connection of the probes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Wiring {
    /// `true` if voltage and current are exchanged.
    pub swapped: bool,
    /// `true` if one of the probes is reversed.
    pub inverted: bool,
}

/// Errors that a skew between the channels would cause.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SkewCost {
    /// Time by which the current is sampled later than the voltage, in seconds.
    pub skew_s: f64,
    /// Mean relative error of R in percent.
    pub r_pct: f64,
    /// Mean relative error of L in percent.
    pub l_pct: f64,
}

/// Skews whose cost is reported, in seconds.
pub const SKEWS_S: [f64; 3] = [10e-9, 20e-9, 100e-9];

/// Share of the largest current below which frames do not count for the skew's cost.
const MIN_CURRENT_SHARE: f64 = 0.05;

/// Ratio of a harmonic's impedance to the fundamental's below which the impedance falls with frequency; that of an ohmic and
/// inductive coil grows.
const FALLING_BELOW_RATIO: f64 = 0.75;

/// Ratio above which the impedance grows.
const GROWING_ABOVE_RATIO: f64 = 1.0 / FALLING_BELOW_RATIO;

/// Energy of a harmonic relative to the fundamental below which it is not used: 0.3 % of amplitude.
const MIN_HARMONIC_ENERGY: f64 = 1e-5;

/// Phasors of a channel's harmonic over time.
type Phasors<'a> = &'a [Complex<f64>];

/// The two factors in V = R I + L (jhω I + dI/dt) at frame `k`: I, and the factor of L. The derivative is that of the
/// phasor, from its neighbours.
fn row(i: &[Complex<f64>], k: usize, hop_s: f64, omega: f64) -> Option<[Complex<f64>; 2]> {
    let (before, here, after) = (i.get(k.checked_sub(1)?)?, i.get(k)?, i.get(k + 1)?);
    let slope = (after - before) / (2.0 * hop_s);
    Some([*here, Complex::new(0.0, omega) * here + slope])
}

/// Sums of the normal equations.
#[derive(Clone, Copy, Debug, Default)]
struct Normal {
    n: [f64; 3],
    right: [f64; 2],
}

impl Normal {
    fn add(&mut self, [a, b]: [Complex<f64>; 2], v: Complex<f64>) {
        let product = |x: Complex<f64>, y: Complex<f64>| x.re * y.re + x.im * y.im;
        self.n[0] += product(a, a);
        self.n[1] += product(a, b);
        self.n[2] += product(b, b);
        self.right[0] += product(a, v);
        self.right[1] += product(b, v);
    }

    fn solve(&self) -> Option<Load> {
        let [aa, ab, bb] = self.n;
        let determinant = aa * bb - ab * ab;
        let load = Load {
            r_ohm: (bb * self.right[0] - ab * self.right[1]) / determinant,
            l_h: (aa * self.right[1] - ab * self.right[0]) / determinant,
        };
        (load.r_ohm.is_finite() && load.l_h.is_finite()).then_some(load)
    }
}

/// R and L of the harmonic at index `order` of [`ORDERS`], by least squares over a track; `None` if the sampling rate or the
/// length is too small.
pub fn load_of_order(track: &Track, order: usize, wiring: Wiring) -> Option<Load> {
    let (v, i) = channels(track, order, wiring)?;
    let hop_s = track.t_s.get(1)? - track.t_s[0];
    let omega = TAU * track.f_sw_hz * f64::from(*ORDERS.get(order)?);
    let sign = if wiring.inverted { -1.0 } else { 1.0 };
    let mut normal = Normal::default();
    for (k, v) in v.iter().enumerate() {
        if let Some(row) = row(i, k, hop_s, omega) {
            normal.add(row, v * sign);
        }
    }
    normal.solve()
}

/// Voltage and current of a harmonic, exchanged and inverted as the wiring requires.
fn channels(track: &Track, order: usize, wiring: Wiring) -> Option<(Phasors<'_>, Phasors<'_>)> {
    let (v, i) = (track.v_v.get(order)?, track.i_a.get(order)?);
    Some(if wiring.swapped { (i, v) } else { (v, i) })
}

/// Determines the connection of the probes from the strongest track.
///
/// A coil's impedance grows with the frequency and its L is positive. If no harmonic is visible, a
/// capacitive impedance with positive R means exchanged channels.
pub fn wiring(track: &Track) -> Wiring {
    let ratio = |order: usize| {
        let energy = |x: &[Vec<Complex<f64>>], order: usize| {
            x.get(order)
                .map_or(0.0, |x| x.iter().map(|x| x.norm_sqr()).sum::<f64>())
        };
        let (v, i) = (
            energy(&track.v_v, order) / energy(&track.v_v, 0),
            energy(&track.i_a, order) / energy(&track.i_a, 0),
        );
        (v > MIN_HARMONIC_ENERGY && i > MIN_HARMONIC_ENERGY).then(|| (v / i).sqrt())
    };
    let straight = Wiring::default();
    let falls = (1..ORDERS.len()).find_map(|order| match ratio(order)? {
        x if x < FALLING_BELOW_RATIO => Some(true),
        x if x > GROWING_ABOVE_RATIO => Some(false),
        _ => None,
    });
    let swapped = falls.unwrap_or_else(|| {
        load_of_order(track, 0, straight).is_some_and(|z| z.l_h < 0.0 && z.r_ohm > 0.0)
    });
    let unswapped = Wiring {
        swapped,
        inverted: false,
    };
    Wiring {
        inverted: load_of_order(track, 0, unswapped).is_some_and(|z| z.l_h < 0.0),
        ..unswapped
    }
}

/// Errors of R and L of this capture for each of [`SKEWS_S`].
///
/// A current sampled later by s turns the impedance by −ωs: R' = R cos ωs + X sin ωs and
/// X' = X cos ωs − R sin ωs, in every frame with its own R and X. Means over the frames with current.
pub fn skew_costs(tracks: &[Track], wiring: Wiring) -> Vec<SkewCost> {
    let largest = tracks
        .iter()
        .filter_map(|t| channels(t, 0, wiring))
        .flat_map(|(_, i)| i.iter().map(|i| i.norm()))
        .fold(0.0, f64::max);
    let mut loads: Vec<(f64, f64, f64)> = Vec::new();
    for track in tracks {
        let (Some((v, i)), Some(hop_s)) = (
            channels(track, 0, wiring),
            track.t_s.get(1).map(|t| t - track.t_s[0]),
        ) else {
            continue;
        };
        let omega = TAU * track.f_sw_hz;
        let sign = if wiring.inverted { -1.0 } else { 1.0 };
        for k in (0..i.len()).filter(|&k| i[k].norm() > MIN_CURRENT_SHARE * largest) {
            let mut normal = Normal::default();
            if let Some(row) = row(i, k, hop_s, omega) {
                normal.add(row, v[k] * sign);
                loads.extend(normal.solve().map(|z| (omega, z.r_ohm, z.l_h)));
            }
        }
    }
    let mean = |error: &dyn Fn(&(f64, f64, f64)) -> f64| {
        100.0 * loads.iter().map(error).sum::<f64>() / loads.len().max(1) as f64
    };
    SKEWS_S
        .into_iter()
        .map(|skew_s| SkewCost {
            skew_s,
            r_pct: mean(&|(w, r, l)| {
                let (c, s) = (libm::cos(w * skew_s), libm::sin(w * skew_s));
                (c - 1.0 + w * l / r * s).abs()
            }),
            l_pct: mean(&|(w, r, l)| {
                let (c, s) = (libm::cos(w * skew_s), libm::sin(w * skew_s));
                (c - 1.0 - r / (w * l) * s).abs()
            }),
        })
        // Without R and L there is no relative error.
        .filter(|cost| cost.r_pct.is_finite() && cost.l_pct.is_finite())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Phasors of a coil of R and L at 45 kHz whose current swells and turns; amplitudes of the
    /// harmonics fall as 1/h².
    fn coil(r_ohm: f64, l_h: f64) -> Track {
        let (f, hop_s) = (45e3, 40e-6);
        let omega = TAU * f;
        let mut track = Track {
            f_sw_hz: f,
            t_s: (0..200).map(|k| f64::from(k) * hop_s).collect(),
            v_v: Vec::new(),
            i_a: Vec::new(),
            frame: 100,
        };
        for h in ORDERS.map(f64::from) {
            let swell = Complex::new(-30.0, 200.0);
            let i = |t: &f64| (swell * *t).exp() * (10.0 / (h * h));
            let v = |t: &f64| i(t) * (r_ohm + (Complex::new(0.0, h * omega) + swell) * l_h);
            track.i_a.push(track.t_s.iter().map(i).collect());
            track.v_v.push(track.t_s.iter().map(v).collect());
        }
        track
    }

    fn swap(mut track: Track) -> Track {
        std::mem::swap(&mut track.v_v, &mut track.i_a);
        track
    }

    fn invert(mut track: Track) -> Track {
        track.i_a.iter_mut().flatten().for_each(|i| *i = -*i);
        track
    }

    #[test]
    fn a_swelling_and_turning_current_does_not_disturb_r_and_l() {
        for order in 0..ORDERS.len() {
            let z = load_of_order(&coil(0.1, 70e-6), order, Wiring::default()).unwrap();
            assert!((z.r_ohm / 0.1 - 1.0).abs() < 1e-2, "{z:?}");
            assert!((z.l_h / 70e-6 - 1.0).abs() < 1e-4, "{z:?}");
        }
    }

    #[test]
    fn exchanged_and_reversed_probes_are_distinguished() {
        for (r_ohm, l_h) in [(4.0, 22e-6), (0.1, 70e-6), (0.8, 18e-6), (9.0, 20e-6)] {
            for swapped in [false, true] {
                for inverted in [false, true] {
                    let mut track = coil(r_ohm, l_h);
                    if inverted {
                        track = invert(track);
                    }
                    if swapped {
                        track = swap(track);
                    }
                    let got = wiring(&track);
                    assert_eq!(got, Wiring { swapped, inverted }, "{r_ohm} {l_h}");
                    let z = load_of_order(&track, 0, got).unwrap();
                    assert!((z.l_h / l_h - 1.0).abs() < 1e-3);
                    // Without harmonics the sign alone has to do.
                    track.v_v.truncate(1);
                    track.i_a.truncate(1);
                    if !(swapped && inverted) {
                        assert_eq!(wiring(&track), got, "fundamental only, {r_ohm} {l_h}");
                    }
                }
            }
        }
    }

    #[test]
    fn the_cost_of_a_skew_is_that_of_a_turned_impedance() {
        let (r_ohm, l_h) = (4.0, 22e-6);
        let costs = skew_costs(&[coil(r_ohm, l_h)], Wiring::default());
        let x = TAU * 45e3 * l_h;
        for cost in costs {
            let z = Complex::new(r_ohm, x) * Complex::from_polar(1.0, -TAU * 45e3 * cost.skew_s);
            assert!(
                (cost.r_pct - 100.0 * (z.re / r_ohm - 1.0).abs()).abs() < 0.01,
                "{cost:?}"
            );
            assert!(
                (cost.l_pct - 100.0 * (z.im / x - 1.0).abs()).abs() < 0.01,
                "{cost:?}"
            );
        }
    }
}
