//! Aliasing: harmonics of the voltage's edges that the sampling rate folds onto the fundamental.
//!
//! At n samples per switching period harmonic h appears at |h − m n| f_sw for the nearest whole m. If that lies within what an
//! estimator passes around the fundamental, the harmonic is added to the voltage's phasor. Edges have odd harmonics
//! V_h = E/h · sinc(h f t_e), t_e their duration; the current has hardly any. With a whole even n the first such orders are
//! h = n ± 1, with 61/3 they are 121 and 123.

use std::f64::consts::FRAC_1_SQRT_2;

use ihd_shared::hob::EDGE_NS;
use nalgebra::Complex;
use serde::Serialize;

use super::track::{ORDERS, Track};
use ihd_signal::Load;
use ihd_signal::fourier::sinc;

/// Passband of an estimator: two boxcars of this length in seconds (the firmware's demodulator; longer ones pass less).
const BOXCAR_S: f64 = 0.2e-3;

/// Highest order that is considered, however low the frequency.
const MAX_ORDERS: u32 = 10_000;

/// Expected effect of aliasing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Aliasing {
    /// Samples per switching period.
    pub samples_per_period: f64,
    /// Lowest order that falls on the fundamental.
    pub order: u32,
    /// Error of the voltage's fundamental in percent: root of the sum of squares of all that falls on it.
    pub v_pct: f64,
    /// Error of R in percent, the part in phase with the current, for a random position of the samples relative to the edges.
    pub r_pct: f64,
    /// Error of L in percent, for a random position of the samples relative to the edges.
    pub l_pct: f64,
}

/// Expected errors without an anti-alias filter; `None` if nothing falls on the fundamental, or R or L is zero.
///
/// The edges' strength is taken from the visible harmonics, their duration from the hob's ratings.
pub fn expected(track: &Track, dt_s: f64, z: Load) -> Option<Aliasing> {
    let n = 1.0 / (track.f_sw_hz * dt_s);
    let v1 = rms(track.v_v.first()?);
    let edge = edge_strength(track, v1);
    let t_e_s = f64::from(EDGE_NS) * 1e-9;
    // Orders beyond the sixth null of an edge's spectrum do not matter: at 250 samples per period harmonic 249 still costs .2 % of R.
    let last = ((6.0 / (track.f_sw_hz * t_e_s)) as u32).min(MAX_ORDERS);
    let (mut power, mut first) = (0.0, None);
    for h in (3..=last).step_by(2).filter(|&h| f64::from(h) > 0.5 * n) {
        let m = |shift: f64| {
            let x = (f64::from(h) + shift) / n;
            (x - x.round()).abs() * n * track.f_sw_hz
        };
        let off_hz = m(1.0).min(m(-1.0));
        let passes = sinc(off_hz * BOXCAR_S).powi(2);
        let level = edge / f64::from(h) * sinc(f64::from(h) * track.f_sw_hz * t_e_s) * passes / v1;
        power += level * level;
        if passes > 0.5 && first.is_none() {
            first = Some(h);
        }
    }
    let order = first?;
    let x = std::f64::consts::TAU * track.f_sw_hz * z.l_h;
    let part = FRAC_1_SQRT_2 * power.sqrt() * x.hypot(z.r_ohm);
    let aliasing = Aliasing {
        samples_per_period: n,
        order,
        v_pct: 100.0 * power.sqrt(),
        r_pct: 100.0 * part / z.r_ohm.abs(),
        l_pct: 100.0 * part / x.abs(),
    };
    // Without R and L there is no relative error.
    (aliasing.r_pct.is_finite() && aliasing.l_pct.is_finite()).then_some(aliasing)
}

/// h |V_h| of the edges: the largest of the visible harmonics, but at least that of a square wave with this voltage's
/// fundamental.
fn edge_strength(track: &Track, v1: f64) -> f64 {
    let seen = ORDERS.iter().zip(&track.v_v).skip(1);
    seen.map(|(h, v)| f64::from(*h) * rms(v))
        .fold(0.5 * v1, f64::max)
}

fn rms(x: &[Complex<f64>]) -> f64 {
    (x.iter().map(|x| x.norm_sqr()).sum::<f64>() / x.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn track(f_sw_hz: f64) -> Track {
        // |Z_total|/|Z_coil| = 2/3: a square wave of fundamental 1 gives 1.5 at the coil.
        let v = [1.5, 1.0 / 3.0, 0.2, 1.0 / 7.0];
        Track {
            f_sw_hz,
            t_s: vec![0.0],
            v_v: v.iter().map(|v| vec![Complex::new(*v, 0.0)]).collect(),
            i_a: Vec::new(),
            frame: 1,
        }
    }

    #[test]
    fn whole_ratios_alias_and_61_to_3_hardly_does() {
        let z = Load {
            r_ohm: 4.0,
            l_h: 25e-6,
        };
        let at = |n: f64| expected(&track(45e3), 1.0 / (45e3 * n), z);
        let twenty = at(20.0).unwrap();
        assert_eq!(twenty.order, 19);
        assert!((3.0..12.0).contains(&twenty.r_pct), "{twenty:?}");
        let locked = at(61.0 / 3.0).unwrap();
        assert_eq!(locked.order, 121);
        assert!((0.01..0.3).contains(&locked.v_pct), "{locked:?}");
        // An odd whole ratio folds only even orders first: 2n ± 1 are odd.
        assert_eq!(at(21.0).unwrap().order, 41);
        // 22.2: 110 folds at 5 n - 1, even; 5 n ± 1 with n = 22.2 are 110 and 112, 10 n ± 1 are odd.
        assert_eq!(at(22.2).unwrap().order, 221);
        assert!(at(1111.1).is_none_or(|a| a.r_pct < 0.02));
    }
}
