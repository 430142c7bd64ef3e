//! Switching and sampling periods in timer ticks, locked to each other, with a hard clamp.
//!
//! One tick is 1/8 of a cycle of 170 MHz (HRTIM prescaler 2, 735 ps). The sampling period is 3·m
//! ticks and the switching period 61·m, so 61 samples span exactly three periods whatever m is.
//! The price is a grid of frequencies, 52 Hz wide at 34 kHz and 286 Hz at 80 kHz: a requested
//! frequency becomes the nearest of the grid, and control, estimator and telemetry use that one, on every
//! board, the simulated one included. Only replay has other frequencies: those of the recording.

use ihd_shared::hob::{F_SW_MAX_HZ, F_SW_MIN_HZ};
use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q};

/// Frequency of the processor and its timers, in hertz.
pub const CORE_HZ: u32 = 170_000_000;

/// Ticks per second.
pub const TICK_HZ: u32 = 8 * CORE_HZ;

/// 5 A at turn-off move the node's 15 nF by 325 V within it, and even an empty coil carries 7 A at the probe frequency.
pub use ihd_shared::board::DEAD_TIME_NS;

const P: u32 = ADC_LOCK_P as u32;

/// Smallest and largest m: no period outside the ratings can be expressed.
const M_MIN: u32 = TICK_HZ.div_ceil(P * F_SW_MAX_HZ);
const M_MAX: u32 = TICK_HZ / (P * F_SW_MIN_HZ);

/// Timer values of one frequency.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Periods {
    /// Period of the switching timer, in ticks.
    pub switching: u16,
    /// Period of the sampling timer, in ticks.
    pub sampling: u16,
}

const fn m_of(f_sw_hz: u32) -> u32 {
    // Within the ratings first: then 32 bit do, and the sampling path divides in 12 cycles.
    let f = match f_sw_hz {
        ..F_SW_MIN_HZ => F_SW_MIN_HZ,
        F_SW_MIN_HZ..F_SW_MAX_HZ => f_sw_hz,
        _ => F_SW_MAX_HZ,
    };
    let m = (TICK_HZ + P * f / 2) / (P * f);
    match m {
        ..M_MIN => M_MIN,
        M_MIN..M_MAX => m,
        _ => M_MAX,
    }
}

impl Periods {
    /// The periods nearest to a frequency in hertz, always within the ratings.
    pub fn nearest(f_sw_hz: u32) -> Self {
        let m = m_of(f_sw_hz);
        Self {
            switching: (P * m) as u16,
            sampling: (ADC_LOCK_Q * m) as u16,
        }
    }

    /// Half the switching period: where the upper switch turns off.
    pub fn half(self) -> u16 {
        self.switching / 2
    }
}

/// The frequency of the grid nearest to one in hertz, to the nearest hertz.
pub const fn nearest_hz(f_sw_hz: u32) -> u32 {
    let period = P * m_of(f_sw_hz);
    (TICK_HZ + period / 2) / period
}

/// The grid's lowest frequency, in hertz.
pub const MIN_HZ: u32 = nearest_hz(F_SW_MIN_HZ);

/// The grid's highest frequency, in hertz: the probe frequency.
pub const MAX_HZ: u32 = nearest_hz(F_SW_MAX_HZ);

// The timer counts 16 bit, and its period may not be shorter than 96 ticks at this prescaler.
const _: () = assert!(P * M_MAX <= 0xFFDF && ADC_LOCK_Q * M_MIN >= 96 && M_MIN < M_MAX);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_request_leaves_the_ratings() {
        for f in [0, 1, 33_000, 34_000, 80_000, 80_001, 1_000_000, u32::MAX] {
            let f = nearest_hz(f);
            assert!((F_SW_MIN_HZ..=F_SW_MAX_HZ).contains(&f), "{f}");
        }
    }

    #[test]
    fn sampling_is_locked_and_near() {
        for f in (F_SW_MIN_HZ..=F_SW_MAX_HZ).step_by(37) {
            let p = Periods::nearest(f);
            assert_eq!(u32::from(p.switching) * 3, u32::from(p.sampling) * 61);
            let got = f64::from(TICK_HZ) / f64::from(p.switching);
            assert!((got - f64::from(nearest_hz(f))).abs() <= 0.5);
            // Half a step, and a whole one at the ends of the range.
            assert!((got / f64::from(f) - 1.0).abs() < 0.0036, "{f}: {got}");
            assert!(p.half() > 8_000 && p.half() < p.switching);
        }
    }

    #[test]
    fn the_grid_is_its_own_nearest() {
        for f in (F_SW_MIN_HZ..=F_SW_MAX_HZ).step_by(101) {
            let on_grid = nearest_hz(f);
            assert_eq!(nearest_hz(on_grid), on_grid);
        }
    }
}
