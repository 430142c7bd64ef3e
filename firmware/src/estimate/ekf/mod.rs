//! Extended Kalman filter for R and L in the frame that rotates at f_sw, in fixed point.
//!
//! State (I_re, I_im, R, X) with X = ωL, input V, measurement I, one step per block of q = 3
//! switching periods, dt = q/f_sw. The paper's equation (1) in that frame is
//!
//! ```text
//! L dI/dt = V − (R + jωL)·I
//! ```
//!
//! The load settles within L/R ≈ 5-10 µs, a tenth of dt, so an explicit step would explode. The
//! backward difference is stable for any step and exact to (ω_env·dt)²/2 ≈ 2e-4 of the small
//! L dI/dt term. With κ = 1/(2πq), L/dt = κX, whatever the frequency:
//!
//! ```text
//! I' = (κX·I + V) / D,   D = R + κX + jX
//! ```
//!
//! R and X are random walks ([`Noise`]). Where |I| is too small to observe them they are held.
//!
//! The covariance is that of the two *complex* states I and Z = R + jX: three numbers, of which one
//! is complex, instead of the ten of four real states. I' is an analytic function of I and Z, and
//! the noise is the same in the real and the imaginary part, so the real covariance stays circular
//! (each 2×2 block a scaled rotation) but for one term: L/dt = κX follows X alone, which adds
//! κ(I − I')/D to ∂I'/∂X. The filter leaves it out: L/dt is taken as known where I' is
//! differentiated, never where it is predicted. The exact Jacobian estimates no better
//! (`the_exact_jacobian_is_no_better` of tests/it/estimator.rs) and costs twice the instructions. Joseph's form is not needed: measured
//! variances are formed without a subtraction, and P_ZZ has a floor (module `update`).
//!
//! Z is the load as the current transformer shows it; [`Ekf::r`] takes off what that adds.
//!
//! Formats: states carry 26 fractional bits in the units of [`crate::sense::demodulator`], covariances 29 in
//! products of these units (±4, so ±1024 A² and ±16 ohm²). The f64 twin of this filter is in
//! `tests/`, written from the equations above in real 4×4 matrices; the two agree within 0.1 %.

mod predict;
mod update;

use ihd_shared::units::{MicroOhm, PicoHenry};

use crate::fixed::{Complex, narrow, narrow_within, quotient, saturate, short_quotient, wide};
use crate::sense::current_transformer::apparent_r;
use crate::sense::demodulator::{Phasors, STATE_BITS};

/// Fractional bits of covariances.
pub const COVARIANCE_BITS: u32 = 29;

/// κ = 1/(2πq), the ratio of L/dt to ωL, in 31 fractional bits; a test compares with the formula.
pub const KAPPA_Q31: i32 = 113_927_546;

/// Bounds of R: 10 mohm to 20 ohm.
const R_BOUNDS: (i32, i32) = (335_544, 10 << STATE_BITS);

/// Bounds of X: 0.5 to 60 ohm; below lies no coil, above the format ends.
const X_BOUNDS: (i32, i32) = (1 << (STATE_BITS - 2), 30 << STATE_BITS);

/// Noise model. Covariances in [`COVARIANCE_BITS`].
///
/// The paper's process noise grows with |I|. Measured over 45-70 kHz, noiseless
/// and at 30 dB, the other way round is better by a factor of 3 to 8 over the whole half-cycle:
/// R and L change fastest where the current is small (dR/dt = dR/dI · dI/dt, and both factors are
/// largest near the zero crossing), while the gain there is limited by S anyway.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Noise {
    /// Variance of one current component: (50 mA)², what 30 dB of white noise leaves after the
    /// boxcars.
    pub measurement: i32,
    /// Process variance of one current component per step: (20 mA)², the noise of V through 1/D.
    pub current: i32,
    /// Process variance of R and X per step at large current: (10 mohm)².
    pub impedance: i32,
    /// Process variance of R and X per step times |I|²: (0.6 V)²; the share that grows as the
    /// current falls.
    pub impedance_by_current: i32,
}

impl Noise {
    /// The tuning described at the type.
    pub const TUNED: Self = Self {
        measurement: 5_243,
        current: 839,
        impedance: 13_422,
        impedance_by_current: 188_744,
    };
}

/// |I| below which R and X are held: 1 A, squared, in 52 fractional bits.
const HOLD_BELOW: u64 = 1 << (2 * STATE_BITS - 8);

/// Largest variance of R or X: (1 ohm)². It is the initial one, and keeps S inside its format.
const VARIANCE_CEILING: i32 = 1 << (COVARIANCE_BITS - 2);

/// Smallest variance of R or X: 1e-5 ohm², below what the process noise adds in a step.
const VARIANCE_FLOOR: i32 = 1_342;

/// Bits of what is multiplied with a saturated mantissa: two such products stay below 2^62. They are
/// 128 A/ohm for a sensitivity, far beyond any load.
const WITHIN_BITS: u32 = 31;

#[inline(always)]
fn within(x: i32) -> i32 {
    const BOUND: i32 = 1 << (WITHIN_BITS - 1);
    x.clamp(-BOUND, BOUND - 1)
}

/// Covariance of the complex states I and Z = R + jX, as that of one component: E(δa δb*)/2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Covariance {
    ii: i32,
    iz: Complex,
    zz: i32,
}

impl Covariance {
    /// I as uncertain as one measurement, and nothing to do with Z.
    const fn of_first(measurement: i32, zz: i32) -> Self {
        Self {
            ii: measurement,
            iz: Complex { re: 0, im: 0 },
            zz,
        }
    }
}

/// The filter.
#[derive(Clone, Debug)]
pub struct Ekf {
    i: Complex,
    r: i32,
    x: i32,
    p: Covariance,
    noise: Noise,
    f_sw_hz: u32,
    /// Picohenry per unit of X, 33 − 26 fractional bits folded in: see [`Ekf::l`].
    henry_gain: i64,
    held: bool,
    at_bound: bool,
}

impl Ekf {
    /// All bits zero; of use only to be replaced.
    pub(crate) const fn blank() -> Self {
        Self {
            i: Complex { re: 0, im: 0 },
            r: 0,
            x: 0,
            p: Covariance::of_first(0, 0),
            noise: Noise {
                measurement: 0,
                current: 0,
                impedance: 0,
                impedance_by_current: 0,
            },
            f_sw_hz: 0,
            henry_gain: 0,
            held: false,
            at_bound: false,
        }
    }

    /// A filter that expects the given load at a switching frequency.
    pub fn new(f_sw_hz: u32, r: MicroOhm, l: PicoHenry, noise: Noise) -> Self {
        let mut filter = Self {
            i: Complex::default(),
            r: 0,
            x: 0,
            p: Covariance::of_first(noise.measurement, VARIANCE_CEILING),
            noise,
            f_sw_hz,
            henry_gain: 1,
            held: true,
            at_bound: false,
        };
        // 2^26 per 2 ohm: 33.554432 per µΩ.
        let apparent = i64::from(r.0) + i64::from(apparent_r(l).0);
        filter.r = saturate((apparent * 33_554_432) / 1_000_000).clamp(R_BOUNDS.0, R_BOUNDS.1);
        filter.tune(f_sw_hz);
        filter.x = filter.x_of(l);
        filter
    }

    fn tune(&mut self, f_sw_hz: u32) {
        self.f_sw_hz = f_sw_hz.max(1);
        // L = X·2 ohm / (2π f) per 2^26, in pH, 33 fractional bits: 2e12·2^7 / 2π = 4.0743665e13.
        self.henry_gain = short_quotient(40_743_665_431_525, self.f_sw_hz) as i64;
    }

    fn x_of(&self, l: PicoHenry) -> i32 {
        // Beyond 2^30 pH, 1 mH, X is at its bound whatever the frequency.
        let l_ph = l.0.clamp(0, (1 << 30) - 1) as u64;
        saturate(quotient(l_ph << 33, self.henry_gain as u64)).clamp(X_BOUNDS.0, X_BOUNDS.1)
    }

    /// Takes the switching frequency to another value: L stays, X = ωL follows, and the current,
    /// which starts anew, is forgotten.
    pub fn set_frequency(&mut self, f_sw_hz: u32) {
        let l = self.l();
        self.tune(f_sw_hz);
        self.x = self.x_of(l);
        self.forget_current();
    }

    /// Makes R and L uncertain again, for a load that may have been exchanged.
    pub fn restart(&mut self) {
        self.p.zz = VARIANCE_CEILING;
        self.forget_current();
    }

    fn forget_current(&mut self) {
        self.p = Covariance::of_first(self.noise.measurement, self.p.zz);
        self.i = Complex::default();
        self.held = true;
    }

    /// Advances by one block.
    pub fn step(&mut self, z: &Phasors) {
        let norm = z.i.norm_squared();
        if norm < HOLD_BELOW {
            self.forget_current();
            self.i = z.i;
            return;
        }
        if self.held {
            // The first current after a pause is taken as it is: there is no dI/dt yet.
            self.i = z.i;
        }
        self.held = false;
        self.predict(z.v, norm);
        self.update(z.i);
        self.bound();
    }

    fn bound(&mut self) {
        let (r, x) = (self.r, self.x);
        self.r = r.clamp(R_BOUNDS.0, R_BOUNDS.1);
        self.x = x.clamp(X_BOUNDS.0, X_BOUNDS.1);
        self.at_bound = r != self.r || x != self.x;
    }

    /// Resistance, from 10 milliohm on: the state's, less what the current transformer adds.
    pub fn r(&self) -> MicroOhm {
        // 2e6 µΩ per unit of 2^26: 15625 / 2^19.
        let apparent = narrow_within(wide(self.r, 15_625), 19);
        MicroOhm((apparent - apparent_r(self.l()).0).max(10_000))
    }

    /// Inductance.
    pub fn l(&self) -> PicoHenry {
        PicoHenry(narrow(i64::from(self.x) * self.henry_gain, 33))
    }

    /// Standard deviation of R, in micro-ohm, as the filter sees it.
    pub fn r_sigma(&self) -> MicroOhm {
        // √(P · 2^-29) · 2e6 µΩ; isqrt of P·2^31 has 30 fractional bits.
        let root = (i64::from(self.p.zz.max(0)) as u64) << 31;
        MicroOhm(narrow(root.isqrt() as i64 * 15_625, 23))
    }

    /// Returns `true` if the last step was held for lack of current.
    pub fn is_held(&self) -> bool {
        self.held
    }

    /// Returns `true` if the last step ran into a bound of R or X: the model does not describe the load.
    pub fn is_at_bound(&self) -> bool {
        self.at_bound
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sense::demodulator::{AMPERE_PER_UNIT, OHM_PER_UNIT, VOLT_PER_UNIT};

    fn q(x: f64) -> i32 {
        (x * f64::from(1u32 << STATE_BITS)).round() as i32
    }

    /// Steady phasors of a load: V = (R + jX) I.
    fn steady(r_ohm: f64, x_ohm: f64, i_a: f64) -> Phasors {
        let part = |ohm: f64| q(ohm * i_a / VOLT_PER_UNIT);
        Phasors {
            v: Complex {
                re: part(r_ohm),
                im: part(x_ohm),
            },
            i: Complex {
                re: q(i_a / AMPERE_PER_UNIT),
                im: 0,
            },
        }
    }

    fn filter() -> Ekf {
        Ekf::new(
            45_000,
            MicroOhm(4_000_000),
            PicoHenry(25_000_000),
            Noise::TUNED,
        )
    }

    #[test]
    fn kappa_follows_its_formula() {
        let kappa = 1.0 / (core::f64::consts::TAU * f64::from(ihd_shared::sampling::ADC_LOCK_Q));
        assert_eq!(KAPPA_Q31, (kappa * 2f64.powi(31)).round() as i32);
    }

    #[test]
    fn units_convert_both_ways() {
        let e = filter();
        assert!((e.r().0 - 4_000_000).abs() <= 1);
        assert!((e.l().0 - 25_000_000).abs() <= 2);
        let mut f = e.clone();
        f.set_frequency(78_000);
        assert!(
            (f.l().0 - 25_000_000).abs() <= 4,
            "L must survive a frequency step"
        );
        let x_ohm = f64::from(f.x) / f64::from(1u32 << STATE_BITS) * OHM_PER_UNIT;
        assert!((x_ohm - core::f64::consts::TAU * 78e3 * 25e-6).abs() < 1e-4);
        assert_eq!(e.r_sigma().0, 1_000_000);
    }

    #[test]
    fn converges_on_every_kind_of_load() {
        // Ferromagnetic, aluminium, none: (R, X, I), with the filter started on a pot.
        for (r, x, i) in [
            (3.0, 5.6, 50.0),
            (0.22, 4.8, 60.0),
            (0.1, 19.8, 10.0),
            (6.5, 8.0, 2.0),
        ] {
            let mut e = filter();
            for _ in 0..150 {
                e.step(&steady(r, x, i));
            }
            let (r_hat, l_hat) = (e.r().ohm(), e.l().henry());
            let l = x / (core::f64::consts::TAU * 45e3);
            assert!((r_hat - r).abs() < 2e-3 * (r + x), "R {r_hat} for {r}");
            assert!((l_hat / l - 1.0).abs() < 2e-3, "L {l_hat} for {l}");
        }
    }

    #[test]
    fn held_without_current() {
        let mut e = filter();
        for _ in 0..50 {
            e.step(&steady(3.0, 5.6, 0.9));
        }
        assert!(e.is_held());
        assert!((e.r().0 - 4_000_000).abs() <= 1, "R must be held");
    }

    #[test]
    fn wild_input_stays_bounded() {
        let mut e = filter();
        let extremes = [i32::MIN, i32::MAX, 0, 1, -1, 1 << 30];
        for k in 0..2_000usize {
            let pick = |n: usize| extremes[(k * 7 + n * 3 + k / 5) % extremes.len()];
            e.step(&Phasors {
                v: Complex {
                    re: pick(0),
                    im: pick(1),
                },
                i: Complex {
                    re: pick(2),
                    im: pick(3),
                },
            });
            assert!((R_BOUNDS.0..=R_BOUNDS.1).contains(&e.r));
            assert!((X_BOUNDS.0..=X_BOUNDS.1).contains(&e.x));
            assert!(e.p.zz >= VARIANCE_FLOOR && e.p.ii >= 0);
        }
    }
}
