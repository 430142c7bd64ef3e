//! Aliasing: harmonics of the voltage's edges that the sampling rate folds onto the fundamental.
//!
//! At n samples per switching period harmonic h appears at |h − m n| f_sw for the nearest whole m. If that lies within what an
//! estimator passes around the fundamental, the harmonic is added to the voltage's phasor. Edges have odd harmonics
//! V_h = E/h · sinc(h f t_e), t_e their duration; the current has hardly any. With a whole even n the first such orders are
//! h = n ± 1, with 61/3 they are 121 and 123.
//!
//! Samples that meet the edges at few phases do not show t_e: of a foreign stage it is any from 50 to 400 ns, and the worst counts. A
//! rate of one sample an edge would else lie on a zero of the spectrum. The hob's own rate goes with the hob's rated edges.

use std::f64::consts::FRAC_1_SQRT_2;

use ihd_shared::hob::EDGE_NS;
use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q};
use nalgebra::Complex;
use serde::Serialize;

use super::track::Track;
use ihd_signal::fourier::sinc;
use ihd_signal::{Load, ORDERS};

/// Passband of an estimator: two boxcars of this length in seconds (the firmware's demodulator; longer ones pass less).
const BOXCAR_S: f64 = 0.2e-3;

/// Highest order that is considered, however low the frequency.
const MAX_ORDERS: u32 = 10_000;

/// Offset from the fundamental in hertz from which an alias is seen as a tone. Nearer, its sidebands of twice the mains frequency lie on
/// the load's own.
pub const SEEN_AS_TONE_HZ: f64 = 500.0;

/// Durations of edges in seconds: switches of hobs, from unsnubbed to snubbed.
const EDGES_S: [f64; 7] = [50e-9, 70e-9, 100e-9, 140e-9, 200e-9, 280e-9, 400e-9];

/// Relative difference up to which a rate is the hob's own.
const OWN_RATE: f64 = 1e-3;

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
/// The edges' strength is taken from the visible harmonics.
pub fn expected(track: &Track, dt_s: f64, z: Load) -> Option<Aliasing> {
    let n = 1.0 / (track.f_sw_hz * dt_s);
    let v1 = rms(track.v_v.first()?);
    let edge = edge_strength(track, v1) / v1;
    let rated = Folded::compute(track.f_sw_hz, n, f64::from(EDGE_NS) * 1e-9);
    let folded = match is_own_rate(n) {
        true => rated,
        false => {
            rated.with_worst_hidden(EDGES_S.map(|edge_s| Folded::compute(track.f_sw_hz, n, edge_s)))
        }
    };
    let order = folded.order()?;
    let level = edge * folded.hidden.hypot(folded.seen);
    let x = std::f64::consts::TAU * track.f_sw_hz * z.l_h;
    let part = FRAC_1_SQRT_2 * level * x.hypot(z.r_ohm);
    let aliasing = Aliasing {
        samples_per_period: n,
        order,
        v_pct: 100.0 * level,
        r_pct: 100.0 * part / z.r_ohm.abs(),
        l_pct: 100.0 * part / x.abs(),
    };
    // Without R and L there is no relative error.
    (aliasing.r_pct.is_finite() && aliasing.l_pct.is_finite()).then_some(aliasing)
}

/// Returns `true` for the samples per switching period of the hob's own board.
fn is_own_rate(per_period: f64) -> bool {
    let own = ADC_LOCK_P as f64 / f64::from(ADC_LOCK_Q);
    (per_period / own - 1.0).abs() < OWN_RATE
}

/// Harmonics of edges of one duration that fall on the fundamental, over the edges' own fundamental.
struct Folded {
    /// Root of the sum of squares of those that no estimator tells from the fundamental.
    hidden: f64,
    /// Root of the sum of squares of those further away than [`SEEN_AS_TONE_HZ`].
    seen: f64,
    first_hidden: Option<u32>,
    first_seen: Option<u32>,
}

impl Folded {
    fn compute(f_sw_hz: f64, per_period: f64, edge_s: f64) -> Self {
        let mut out = Self {
            hidden: 0.0,
            seen: 0.0,
            first_hidden: None,
            first_seen: None,
        };
        // Orders beyond the sixth null of an edge's spectrum do not matter: at 250 samples per period harmonic 249 still costs .2 % of R.
        let last = ((6.0 / (f_sw_hz * edge_s)) as u32).min(MAX_ORDERS);
        for h in (3..=last)
            .step_by(2)
            .filter(|&h| f64::from(h) > 0.5 * per_period)
        {
            let off = |shift: f64| {
                let turns = (f64::from(h) + shift) / per_period;
                (turns - turns.round()).abs() * per_period * f_sw_hz
            };
            let off_hz = off(1.0).min(off(-1.0));
            let passes = sinc(off_hz * BOXCAR_S).powi(2);
            let level = passes * sinc(f64::from(h) * f_sw_hz * edge_s) / f64::from(h);
            if off_hz < SEEN_AS_TONE_HZ {
                out.hidden = out.hidden.hypot(level);
                out.first_hidden = out.first_hidden.or(Some(h));
            } else {
                out.seen = out.seen.hypot(level);
                out.first_seen = out.first_seen.or((passes > 0.5).then_some(h));
            }
        }
        out
    }

    /// Returns these with the largest hidden part of some durations.
    fn with_worst_hidden(self, others: impl IntoIterator<Item = Self>) -> Self {
        others.into_iter().fold(self, |worst, other| Self {
            hidden: worst.hidden.max(other.hidden),
            first_hidden: worst.first_hidden.or(other.first_hidden),
            ..worst
        })
    }

    /// Lowest order of the part that costs more.
    fn order(&self) -> Option<u32> {
        match self.hidden >= self.seen {
            true => self.first_hidden.or(self.first_seen),
            false => self.first_seen.or(self.first_hidden),
        }
    }
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

    /// Samples between which an edge fits show it at an unknown place: ±half an interval is a phase of the bridge's voltage.
    #[test]
    fn a_rate_of_one_sample_an_edge_is_not_taken_for_free_of_aliases() {
        let z = Load {
            r_ohm: 2.7,
            l_h: 20e-6,
        };
        let (f_sw_hz, n) = (62.5e3, 80.0);
        let found = expected(&track(f_sw_hz), 1.0 / (f_sw_hz * n), z).unwrap();
        // Over all places the rms is a half interval over √3; of it R gets the share in phase with the current, on the average half.
        let turn = std::f64::consts::PI / n / 3f64.sqrt() * FRAC_1_SQRT_2;
        let x = std::f64::consts::TAU * f_sw_hz * z.l_h;
        let most = 100.0 * turn / 1.5 * x.hypot(z.r_ohm) / z.r_ohm;
        assert!(
            (0.6..1.0).contains(&(found.r_pct / most)),
            "{found:?} {most}"
        );
        assert_eq!(found.order, 79);
    }
}
