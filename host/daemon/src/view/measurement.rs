//! Measurements of a scope, over whole switching periods.
//!
//! The ADC samples 61 pairs in three switching periods, synchronously with the bridge. In such a block every harmonic up to
//! half the sampling rate is a line of its own, so that sums over whole blocks are exact.

use std::f64::consts::TAU;

use ihd_model::ScopeMeasurement;
use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q};
use ihd_train::learning::anti_alias_loss;

/// Number of pairs in a block.
const BLOCK: usize = ADC_LOCK_P;

/// Number of switching periods in a block.
const PERIODS: usize = ADC_LOCK_Q as usize;

/// Highest harmonic below half the sampling rate.
const MAX_HARMONIC: usize = (BLOCK - 1) / 2 / PERIODS;

#[derive(Clone, Copy, Default)]
struct Complex {
    re: f64,
    im: f64,
}

impl Complex {
    fn add(self, other: Self) -> Self {
        Self {
            re: self.re + other.re,
            im: self.im + other.im,
        }
    }

    fn times(self, other: Self) -> Self {
        Self {
            re: self.re * other.re - self.im * other.im,
            im: self.re * other.im + self.im * other.re,
        }
    }

    fn scaled(self, by: f64) -> Self {
        Self {
            re: self.re * by,
            im: self.im * by,
        }
    }

    fn conjugate(self) -> Self {
        Self {
            im: -self.im,
            ..self
        }
    }

    fn magnitude(self) -> f64 {
        self.re.hypot(self.im)
    }
}

/// Returns the complex amplitudes of the harmonics 1 to [`MAX_HARMONIC`] of a block.
fn harmonics(block: &[f64], table: &[Complex; BLOCK]) -> [Complex; MAX_HARMONIC] {
    std::array::from_fn(|n| {
        let line = (n + 1) * PERIODS;
        let turned = block
            .iter()
            .enumerate()
            .map(|(k, x)| table[k * line % BLOCK].scaled(*x));
        let sum = turned.fold(Complex::default(), Complex::add);
        sum.scaled(2.0 / BLOCK as f64)
    })
}

/// Mean harmonics of one channel over many blocks, with phases relative to the fundamental and weighted with its
/// amplitude: noise averages out, and the envelope has no effect.
#[derive(Default)]
struct Distortion {
    ratios: [Complex; MAX_HARMONIC],
    weight: f64,
}

impl Distortion {
    fn add(&mut self, harmonics: &[Complex; MAX_HARMONIC]) {
        let amplitude = harmonics[0].magnitude();
        if amplitude <= 0.0 {
            return;
        }
        let back = harmonics[0].conjugate().scaled(amplitude.recip());
        let mut turn = Complex { re: 1.0, im: 0.0 };
        for (sum, harmonic) in self.ratios.iter_mut().zip(harmonics) {
            turn = turn.times(back);
            *sum = sum.add(harmonic.times(turn).scaled(amplitude));
        }
        self.weight += amplitude * amplitude;
    }

    fn thd_pct(&self) -> Option<f64> {
        let above = self.ratios[1..].iter();
        let squares: f64 = above.map(|r| r.magnitude().powi(2)).sum();
        let thd = 100.0 * squares.sqrt() / self.weight;
        thd.is_finite().then_some(thd)
    }
}

/// Measures voltage and current of a view, sampled at the ADC's rate. A view of less than three switching
/// periods holds no whole block: only its peaks are measured. Effective values and power are those before the anti-alias filters,
/// like the device's own power; peaks are those of the samples.
pub fn measure(v_v: &[f64], i_a: &[f64], f_sw_hz: f64) -> ScopeMeasurement {
    let peak = |x: &[f64]| {
        let largest = x.iter().fold(0.0, |a: f64, x| a.max(x.abs()));
        (!x.is_empty()).then_some(largest)
    };
    let blocks = v_v.len().min(i_a.len()) / BLOCK;
    let mut measurement = ScopeMeasurement {
        periods: u32::try_from(blocks * PERIODS).unwrap_or(u32::MAX),
        v_peak_v: peak(v_v),
        i_peak_a: peak(i_a),
        ..ScopeMeasurement::default()
    };
    if blocks == 0 {
        return measurement;
    }
    let (v_v, i_a) = (&v_v[..blocks * BLOCK], &i_a[..blocks * BLOCK]);
    let mean = |terms: &mut dyn Iterator<Item = f64>| terms.sum::<f64>() / v_v.len() as f64;
    let v_rms_v = mean(&mut v_v.iter().map(|v| v * v)).sqrt();
    let i_rms_a = mean(&mut i_a.iter().map(|i| i * i)).sqrt();
    let power_w = mean(&mut v_v.iter().zip(i_a).map(|(v, i)| v * i));
    let table: [Complex; BLOCK] = std::array::from_fn(|k| {
        let (sin, cos) = (TAU * k as f64 / BLOCK as f64).sin_cos();
        Complex { re: cos, im: -sin }
    });
    let mut across = Complex::default();
    let (mut v_distortion, mut i_distortion) = (Distortion::default(), Distortion::default());
    for (v, i) in v_v.chunks(BLOCK).zip(i_a.chunks(BLOCK)) {
        let (v, i) = (harmonics(v, &table), harmonics(i, &table));
        across = across.add(v[0].times(i[0].conjugate()));
        v_distortion.add(&v);
        i_distortion.add(&i);
    }
    let power_factor = power_w / (v_rms_v * i_rms_a);
    let loss = anti_alias_loss(f_sw_hz);
    measurement.v_rms_v = Some(loss * v_rms_v);
    measurement.i_rms_a = Some(loss * i_rms_a);
    measurement.power_w = Some(loss * loss * power_w);
    measurement.power_factor = power_factor.is_finite().then_some(power_factor);
    let has_phase = across.magnitude() > 0.0;
    measurement.phase_deg = has_phase.then(|| across.im.atan2(across.re).to_degrees());
    measurement.thd_v_pct = v_distortion.thd_pct();
    measurement.thd_i_pct = i_distortion.thd_pct();
    measurement
}

#[cfg(test)]
mod tests {
    use ihd_shared::sampling::ANTI_ALIAS_HZ;

    use super::*;

    /// Returns `n` samples of a sum of (order, amplitude, phase in degree).
    fn wave(n: usize, parts: &[(f64, f64, f64)], envelope: impl Fn(f64) -> f64) -> Vec<f64> {
        let sample = |k: usize| {
            let turn = TAU * k as f64 * PERIODS as f64 / BLOCK as f64;
            let parts = parts.iter();
            let sum: f64 = parts
                .map(|(order, a, deg)| a * (order * turn + deg.to_radians()).cos())
                .sum();
            sum * envelope(k as f64 / n as f64)
        };
        (0..n).map(sample).collect()
    }

    fn near(x: Option<f64>, expected: f64, relative: f64) {
        let x = x.unwrap();
        assert!(
            (x - expected).abs() <= relative * expected.abs(),
            "{x} is not {expected}"
        );
    }

    #[test]
    fn sines_are_measured_as_the_book_says() {
        // 325 V, and 20 A that lag by 60 degree, with an arbitrary initial phase and an incomplete last block.
        let v = wave(61 * 20 + 17, &[(1.0, 325.0, 23.0)], |_| 1.0);
        let i = wave(61 * 20 + 17, &[(1.0, 20.0, 23.0 - 60.0)], |_| 1.0);
        let m = measure(&v, &i, 0.0);
        assert_eq!(m.periods, 60);
        near(m.v_rms_v, 325.0 / 2f64.sqrt(), 1e-12);
        near(m.i_rms_a, 20.0 / 2f64.sqrt(), 1e-12);
        near(m.power_w, 325.0 * 20.0 / 2.0 * 0.5, 1e-12);
        near(m.power_factor, 0.5, 1e-12);
        near(m.phase_deg, 60.0, 1e-12);
        near(m.v_peak_v, 325.0, 0.02);
        assert!(m.thd_v_pct.unwrap() < 1e-9 && m.thd_i_pct.unwrap() < 1e-9);
        // At 100 kHz filters of 500 kHz leave 1/√(1 + 0.2²) of each.
        let filtered = measure(&v, &i, 0.2 * f64::from(ANTI_ALIAS_HZ));
        near(
            filtered.v_rms_v,
            1.04f64.sqrt() * 325.0 / 2f64.sqrt(),
            1e-12,
        );
        near(filtered.i_rms_a, 1.04f64.sqrt() * 20.0 / 2f64.sqrt(), 1e-12);
        near(filtered.power_w, 1.04 * 325.0 * 20.0 / 2.0 * 0.5, 1e-12);
        assert_eq!(
            (filtered.v_peak_v, filtered.phase_deg),
            (m.v_peak_v, m.phase_deg)
        );
    }

    #[test]
    fn harmonics_are_distortion_and_the_phase_is_the_fundamentals() {
        // A square wave's harmonics 3 to 9, whose amplitudes are 1/n, and a current with 30 % of the third.
        let square: Vec<_> = [1.0, 3.0, 5.0, 7.0, 9.0]
            .map(|n: f64| (n, 100.0 / n, -90.0))
            .to_vec();
        let v = wave(6_100, &square, |_| 1.0);
        let i = wave(6_100, &[(1.0, 10.0, -120.0), (3.0, 3.0, 77.0)], |_| 1.0);
        let m = measure(&v, &i, 0.0);
        let thd = [3.0, 5.0, 7.0, 9.0]
            .map(|n: f64| n.powi(-2))
            .iter()
            .sum::<f64>()
            .sqrt();
        near(m.thd_v_pct, 100.0 * thd, 1e-9);
        near(m.thd_i_pct, 30.0, 1e-9);
        near(m.phase_deg, 30.0, 1e-9);
        // Third against third: 100/3 V, 3 A, 167 degree apart.
        let power = 0.5
            * (100.0 * 10.0 * 30f64.to_radians().cos()
                + 100.0 / 3.0 * 3.0 * 167f64.to_radians().cos());
        near(m.power_w, power, 1e-9);
        near(m.i_rms_a, (50.0f64 + 4.5).sqrt(), 1e-9);
        // The tenth is the highest below half the sampling rate of 61/3.
        assert_eq!(MAX_HARMONIC, 10);
        let tenth = wave(610, &[(1.0, 1.0, 0.0), (10.0, 0.1, 40.0)], |_| 1.0);
        near(measure(&tenth, &tenth, 0.0).thd_v_pct, 10.0, 1e-9);
    }

    #[test]
    fn under_the_mains_envelope_phase_and_distortion_are_those_of_every_period() {
        let half_sine = |x: f64| (std::f64::consts::PI * x).sin();
        let v = wave(61 * 150, &[(1.0, 325.0, 0.0), (3.0, 65.0, 10.0)], half_sine);
        let i = wave(61 * 150, &[(1.0, 40.0, -75.0)], half_sine);
        let m = measure(&v, &i, 0.0);
        // The mean of the squared half-sine is 1/2; the change of the envelope within three periods has little effect.
        near(
            m.power_w,
            325.0 * 40.0 / 4.0 * 75f64.to_radians().cos(),
            1e-3,
        );
        near(m.i_rms_a, 20.0, 1e-3);
        near(m.phase_deg, 75.0, 1e-4);
        near(m.thd_v_pct, 20.0, 2e-3);
        assert!(m.thd_i_pct.unwrap() < 0.1, "{:?}", m.thd_i_pct);
    }

    #[test]
    fn noise_is_no_distortion_and_nothing_measures_nothing() {
        // Noise of 1 % of the amplitude, by a generator with a seed.
        let mut state = 7u64;
        let mut noise = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 33) as f64 / f64::from(1u32 << 31) - 0.5
        };
        let clean = wave(61 * 150, &[(1.0, 10.0, 0.0)], |_| 1.0);
        let v: Vec<f64> = clean.iter().map(|x| x + 0.35 * noise()).collect();
        let m = measure(&v, &v, 0.0);
        // Nine harmonics of white noise of 0.1 rms, averaged over 150 blocks: some 0.1 %.
        assert!(m.thd_v_pct.unwrap() < 0.2, "{:?}", m.thd_v_pct);
        let few = measure(&v[..60], &v[..60], 0.0);
        assert_eq!((few.periods, few.power_w, few.thd_v_pct), (0, None, None));
        assert!(few.v_peak_v.is_some());
        assert_eq!(measure(&[], &[], 0.0), ScopeMeasurement::default());
        let silent = measure(&[0.0; 122], &[0.0; 122], 0.0);
        assert_eq!((silent.v_rms_v, silent.power_factor), (Some(0.0), None));
        assert_eq!((silent.phase_deg, silent.thd_i_pct), (None, None));
    }
}
