//! Bus voltage of a block, and its ripple at the switching frequency.
//!
//! The half-bridge draws its current from C2 while the upper switch is on, so the bus falls and rises within each period. Its
//! fundamental is part of the bridge's: whatever C2 is, and whatever line and filter feed it.

use ihd_shared::board::{BUS_POLE_HZ, SLOW_PIN_POLE_HZ};
use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q, ANTI_ALIAS_HZ};

use crate::fixed::{Complex, saturate};
use crate::sense::correlation::{TABLE_BITS, phase};

pub use ihd_shared::board::BUS_FULL_SCALE_DV;

/// Codes of the bus, and of the mains, in turn: those of two blocks, since a block has an odd number of pairs.
pub const SLOW_CODES: usize = 2 * ADC_LOCK_P;

/// Codes of the bus in a mean; four pairs apart they cover a switching period to 2 %, so that its ripple cancels.
pub const BUS_MEAN: usize = 5;
const BUS_STEP: usize = 4;
const _: () = assert!(BUS_MEAN * BUS_STEP == ADC_LOCK_P / ADC_LOCK_Q as usize);

/// Places of the last period's bus codes among the [`SLOW_CODES`], after half 0 or 1; the last one is the newest.
pub const fn bus_places(half: usize) -> [usize; BUS_MEAN] {
    let newest = (SLOW_CODES / 2 * (half + 1) - 1) & !1;
    let mut places = [0; BUS_MEAN];
    let mut k = 0;
    while k < BUS_MEAN {
        places[k] = newest - (BUS_MEAN - 1 - k) * BUS_STEP;
        k += 1;
    }
    places
}

/// cos and −sin of the carrier at those places, after half 0 or 1.
static PHASES: [[(i16, i16); BUS_MEAN]; 2] = {
    let mut phases = [[(0, 0); BUS_MEAN]; 2];
    let mut half = 0;
    while half < 2 {
        let mut k = 0;
        while k < BUS_MEAN {
            phases[half][k] = phase(bus_places(half)[k] % ADC_LOCK_P);
            k += 1;
        }
        half += 1;
    }
    phases
};

/// Bus voltage of a code, in decivolt.
pub fn bus_dv(code: u16) -> u16 {
    (u32::from(code) * BUS_FULL_SCALE_DV / 4_096) as u16
}

/// Bus over the last switching period of a block.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BusReading {
    dv: u16,
    codes: [u16; BUS_MEAN],
    half: u8,
}

impl BusReading {
    /// Reading of the codes at [`bus_places`] of half 0 or 1.
    pub fn new(codes: [u16; BUS_MEAN], half: usize) -> Self {
        Self {
            dv: bus_dv(mean(codes)),
            codes,
            half: (half % 2) as u8,
        }
    }

    /// Reading of a bus without ripple, in decivolt.
    pub const fn steady(dv: u16) -> Self {
        Self {
            dv,
            codes: [0; BUS_MEAN],
            half: 0,
        }
    }

    /// Mean, in decivolt.
    pub fn dv(&self) -> u16 {
        self.dv
    }

    /// Fundamental of the ripple as the filters of the coil's channels would show it, in decivolt: amplitude and phase with respect
    /// to the block's sums. At most 100 kHz.
    pub fn ripple_dv(&self, f_sw_hz: u32) -> Complex {
        let mean = i32::from(mean(self.codes));
        let phases = &PHASES[usize::from(self.half % 2)];
        let (mut re, mut im) = (0, 0);
        for (&code, &(cos, minus_sin)) in self.codes.iter().zip(phases) {
            let code = i64::from(i32::from(code) - mean);
            re += code * i64::from(cos);
            im += code * i64::from(minus_sin);
        }
        // (1 + jf/f₁)(1 + jf/f₂)/(1 + jf/f₃), of the divider's pole, the pin's and the anti-alias filter's.
        let [divider, pin, filter] = [BUS_POLE_HZ, SLOW_PIN_POLE_HZ, ANTI_ALIAS_HZ]
            .map(|pole_hz| i64::from((f_sw_hz.min(100_000) << RATIO_BITS) / pole_hz));
        let turned = |(re, im): (i64, i64), ratio: i64| {
            let part = |x: i64| (x * ratio) >> RATIO_BITS;
            (re - part(im), im + part(re))
        };
        let (re, im) = turned(turned(turned((re, im), divider), pin), -filter);
        let norm = (1 << RATIO_BITS) + ((filter * filter) >> RATIO_BITS) as i32;
        let dv = |sum: i64| (saturate((sum * DV_PER_SUM) >> SUM_BITS) << RATIO_BITS) / norm;
        Complex {
            re: dv(re),
            im: dv(im),
        }
    }
}

/// Fractional bits of a frequency over a pole's.
const RATIO_BITS: u32 = 10;

/// Decivolt of amplitude per sum over a period, and its fractional bits.
const DV_PER_SUM: i64 =
    ((2 * BUS_FULL_SCALE_DV as i64) << (SUM_BITS - TABLE_BITS)) / (4_096 * BUS_MEAN as i64);
const SUM_BITS: u32 = 30;

/// Mean of a period's codes, rounded.
fn mean(codes: [u16; BUS_MEAN]) -> u16 {
    let sum: u32 = codes.into_iter().map(u32::from).sum();
    ((sum + BUS_MEAN as u32 / 2) / BUS_MEAN as u32) as u16
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use core::f64::consts::TAU;
    use std::vec::Vec;

    /// Codes of a mean and a ripple at the bus, in volt, behind the divider's poles, at a phase to the carrier.
    pub(crate) fn reading(
        f_hz: f64,
        mean_v: f64,
        (ripple_v, phase): (f64, f64),
        half: usize,
    ) -> BusReading {
        let poles = [BUS_POLE_HZ, SLOW_PIN_POLE_HZ].map(|pole_hz| f_hz / f64::from(pole_hz));
        let left: f64 = poles
            .iter()
            .map(|ratio| 1.0 / f64::hypot(1.0, *ratio))
            .product();
        let lag: f64 = poles.iter().map(|ratio| ratio.atan()).sum();
        let codes = bus_places(half).map(|place| {
            let turns = (place % ADC_LOCK_P) as f64 * 3.0 / 61.0;
            let v = mean_v + ripple_v * left * (TAU * turns + phase - lag).cos();
            (v * 40_960.0 / f64::from(BUS_FULL_SCALE_DV)).round() as u16
        });
        BusReading::new(codes, half)
    }

    /// Even places are the bus's; none is of the other half.
    #[test]
    fn the_newest_codes_of_a_half_are_its_own() {
        assert_eq!(bus_places(0), [44, 48, 52, 56, 60]);
        assert_eq!(bus_places(1), [104, 108, 112, 116, 120]);
    }

    /// A ripple of the switching frequency, 61/3 pairs long, of 100 codes at any phase: a single code errs by all of it. Five
    /// equal steps over .984 of a period leave sin(.984 π) / (5 sin(.984 π/5)) of it, 1.8 %, and half a code of rounding.
    #[test]
    fn the_ripple_of_the_switching_frequency_cancels() {
        for half in [0, 1] {
            for phase in 0..24 {
                let codes = bus_places(half).map(|place| {
                    let periods = place as f64 * 3.0 / 61.0 + f64::from(phase) / 24.0;
                    (2_000.0 + 100.0 * (TAU * periods).sin()).round() as u16
                });
                let error = i32::from(mean(codes)) - 2_000;
                assert!(error.abs() <= 3, "{half} {phase}: {error}");
            }
        }
    }

    /// Amplitude and phase as they are at the bus, behind the anti-alias filter: 2 % for the five steps, and the rounding of codes of
    /// 0.12 V, which the poles' inverse makes 1 V.
    #[test]
    fn the_ripple_at_the_bus_is_found_behind_its_poles() {
        for f_hz in [34e3, 50e3, 80e3] {
            for (ripple_v, half) in [(0.0, 0), (10.0, 1), (60.0, 0), (60.0, 1)] {
                let errors: Vec<f64> = (0..12)
                    .map(|twelfth| {
                        let phase = TAU * f64::from(twelfth) / 12.0;
                        let found =
                            reading(f_hz, 300.0, (ripple_v, phase), half).ripple_dv(f_hz as u32);
                        let filter = f_hz / f64::from(ANTI_ALIAS_HZ);
                        let (amplitude, phase) = (
                            10.0 * ripple_v / f64::hypot(1.0, filter),
                            phase - filter.atan(),
                        );
                        let (re, im) = (amplitude * phase.cos(), amplitude * phase.sin());
                        f64::hypot(f64::from(found.re) - re, f64::from(found.im) - im)
                    })
                    .collect();
                let most = errors.iter().fold(0.0, |most: f64, e| most.max(*e));
                assert!(most < 10.0 + 0.2 * ripple_v, "{f_hz} {ripple_v}: {most}");
            }
        }
    }

    #[test]
    fn a_steady_bus_has_no_ripple() {
        let steady = BusReading::steady(3_000);
        assert_eq!(
            (steady.dv(), steady.ripple_dv(50_000)),
            (3_000, Complex::default())
        );
    }
}
