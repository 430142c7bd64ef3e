//! Resampling of a capture to the times and codes of the board's ADC.
//!
//! The ADC samples and holds without a filter in the firmware's model. The waveform is therefore taken at the grid's instants,
//! and harmonics beyond half the rate alias as they do on the board. Between the capture's samples the waveform is the cubic
//! through the four nearest (Catmull-Rom), which is exact on samples that lie on the grid and has -60 dB of error at ten
//! samples per period.

use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q, CODE_BITS, Pair, Scales};

use super::TimeBase;
use crate::quantise::code;

/// Bits of the board's converters.
const BITS: u32 = CODE_BITS as u32;

/// Sampling instants of the ADC, at a rate of f_sw · 61/3.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdcGrid {
    /// Switching frequency in hertz.
    pub f_sw_hz: f64,
    /// Time of the first pair in seconds.
    pub t0_s: f64,
}

impl AdcGrid {
    /// Time from one pair to the next in seconds.
    pub fn dt_s(&self) -> f64 {
        f64::from(ADC_LOCK_Q) / (ADC_LOCK_P as f64 * self.f_sw_hz)
    }
}

/// Pairs of 12-bit codes of the given scales on the grid, from its first instant to the last sample of the capture; values
/// beyond the range saturate.
pub fn adc_pairs<T: Copy + Into<f64>>(
    time: &TimeBase,
    v_v: &[T],
    i_a: &[T],
    grid: AdcGrid,
    scales: Scales,
) -> Vec<Pair> {
    let (volt_per_code, ampere_per_code) = (scales.volt_per_code(), scales.ampere_per_code());
    let samples = v_v.len().min(i_a.len());
    let Some((last, end_s)) = samples.checked_sub(1).and_then(|k| Some((k, time.at(k)?))) else {
        return Vec::new();
    };
    // A rounding error of the times must not cost the last pair.
    let count = ((end_s - grid.t0_s) / grid.dt_s() + 1e-6).floor() + 1.0;
    let mut at = 0;
    (0..count.max(0.0) as usize)
        .map(|n| {
            let t_s = grid.t0_s + n as f64 * grid.dt_s();
            let (k, w) = position(time, t_s, &mut at, last);
            Pair {
                v: code(cubic(v_v, k, w) / volt_per_code, BITS),
                i: code(cubic(i_a, k, w) / ampere_per_code, BITS),
            }
        })
        .collect()
}

/// Index of the sample before `t_s`, and the share of the interval after it; `at` keeps the position of the search.
fn position(time: &TimeBase, t_s: f64, at: &mut usize, last: usize) -> (usize, f64) {
    match time {
        TimeBase::Even { t0_s, dt_s } => {
            let place = ((t_s - t0_s) / dt_s).clamp(0.0, last as f64);
            let k = (place as usize).min(last.saturating_sub(1));
            (k, place - k as f64)
        }
        TimeBase::Stamps(stamps) => {
            while *at + 1 < last && stamps[*at + 1] <= t_s {
                *at += 1;
            }
            let (from, to) = (stamps[*at], stamps[(*at + 1).min(last)]);
            let w = if to > from {
                (t_s - from) / (to - from)
            } else {
                0.0
            };
            (*at, w.clamp(0.0, 1.0))
        }
    }
}

/// Cubic through samples k−1 to k+2 at a share `w` of the interval after k; the outermost samples count twice at the
/// ends.
fn cubic<T: Copy + Into<f64>>(x: &[T], k: usize, w: f64) -> f64 {
    let last = x.len() - 1;
    let at = |k: usize| -> f64 { x[k.min(last)].into() };
    let (a, b, c, d) = (at(k.saturating_sub(1)), at(k), at(k + 1), at(k + 2));
    let slope = 0.5 * (c - a);
    let bend = a - 2.5 * b + 2.0 * c - 0.5 * d;
    let twist = 0.5 * (d - a) + 1.5 * (b - c);
    b + w * (slope + w * (bend + w * twist))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    /// Scales that differ from this build's.
    const SCALES: Scales = Scales {
        v_full_scale_mv: 400_000,
        i_full_scale_ma: 80_000,
    };

    #[test]
    fn samples_on_the_grid_are_taken_as_they_are() {
        let grid = AdcGrid {
            f_sw_hz: 45e3,
            t0_s: 1e-3,
        };
        let v: Vec<f64> = (0..500).map(|n| f64::from(n - 250)).collect();
        let i: Vec<f64> = v.iter().map(|v| v * 0.1).collect();
        for time in [
            TimeBase::Even {
                t0_s: grid.t0_s,
                dt_s: grid.dt_s(),
            },
            TimeBase::Stamps(
                (0..500)
                    .map(|n| 1e-3 + f64::from(n) * grid.dt_s())
                    .collect(),
            ),
        ] {
            let pairs = adc_pairs(&time, &v, &i, grid, SCALES);
            assert_eq!(pairs.len(), 500);
            for (pair, v) in pairs.iter().zip(&v) {
                assert_eq!(f64::from(pair.v), (v / SCALES.volt_per_code()).round());
            }
        }
    }

    #[test]
    fn a_sine_of_a_faster_capture_arrives_within_a_code() {
        let grid = AdcGrid {
            f_sw_hz: 60e3,
            t0_s: 0.0,
        };
        let wave = |t: f64| 300.0 * (TAU * 60e3 * t).sin();
        let v: Vec<f64> = (0..20_000).map(|n| wave(f64::from(n) * 100e-9)).collect();
        let i = vec![0.0; v.len()];
        let time = TimeBase::Even {
            t0_s: 0.0,
            dt_s: 100e-9,
        };
        let pairs = adc_pairs(&time, &v, &i, grid, SCALES);
        assert_eq!(pairs.len(), 1 + (1.9999e-3 / grid.dt_s()) as usize);
        for (n, pair) in pairs.iter().enumerate() {
            let right = wave(n as f64 * grid.dt_s());
            assert!(
                (f64::from(pair.v) * SCALES.volt_per_code() - right).abs() < SCALES.volt_per_code()
            );
        }
    }

    #[test]
    fn beyond_the_range_it_saturates_and_nothing_gives_nothing() {
        let grid = AdcGrid {
            f_sw_hz: 45e3,
            t0_s: 0.0,
        };
        let time = TimeBase::Even {
            t0_s: 0.0,
            dt_s: grid.dt_s(),
        };
        let pairs = adc_pairs(&time, &[1e9, -1e9], &[0.0, 0.0], grid, SCALES);
        assert!(pairs.iter().all(|p| p.is_saturated()) && pairs.len() == 2);
        assert!(adc_pairs::<f64>(&time, &[], &[], grid, SCALES).is_empty());
    }
}
