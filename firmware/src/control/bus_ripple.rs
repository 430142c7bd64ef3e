//! Ripple of the bus at the switching frequency.
//!
//! The half-bridge draws its current from C2 while the upper switch is on, so the bus falls and rises within each period. Its
//! fundamental is part of the bridge's: whatever C2 is, and whatever line and filter feed it.

use ihd_shared::board::{BUS_POLE_HZ, SLOW_PIN_POLE_HZ};
use ihd_shared::hob::LINK_SHARE;
use ihd_shared::sampling::ANTI_ALIAS_HZ;

use crate::fixed::{Complex, saturate};
use crate::sense::bus::{BUS_FULL_SCALE_DV, BUS_MEAN, BusReading, bus_places, mean};
use crate::sense::correlation::{TABLE_BITS, phase};

/// cos and −sin of the carrier at the [`bus_places`], after half 0 or 1.
static PHASES: [[(i16, i16); BUS_MEAN]; 2] = {
    let mut phases = [[(0, 0); BUS_MEAN]; 2];
    let mut half = 0;
    while half < 2 {
        let mut k = 0;
        while k < BUS_MEAN {
            phases[half][k] = phase(bus_places(half)[k]);
            k += 1;
        }
        half += 1;
    }
    phases
};

/// Fractional bits of a frequency over a pole's.
const RATIO_BITS: u32 = 10;

/// Decivolt of amplitude per sum over a period, and its fractional bits.
const DV_PER_SUM: i64 =
    ((2 * BUS_FULL_SCALE_DV as i64) << (SUM_BITS - TABLE_BITS)) / (4_096 * BUS_MEAN as i64);
const SUM_BITS: u32 = 30;

/// Share of the ripple in the bridge's fundamental. While the upper switch is on, a lagging current leaves the bus at a half-sine above
/// its mean: its fundamental is a half, the bridge's [`LINK_SHARE`].
pub const BRIDGE_SHARE: f64 = 2.0 * LINK_SHARE;

/// Fundamental of the ripple as the filters of the coil's channels would show it, in decivolt: amplitude and phase with respect
/// to the block's sums. At most 100 kHz.
pub fn ripple_dv(bus: &BusReading, f_sw_hz: u32) -> Complex {
    let mean = i32::from(mean(bus.codes));
    let phases = &PHASES[bus.half as usize % 2];
    let (mut re, mut im) = (0, 0);
    for (&code, &(cos, minus_sin)) in bus.codes.iter().zip(phases) {
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

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::sense::supply::SupplyScale;
    use core::f64::consts::TAU;
    use ihd_shared::sampling::ADC_LOCK_P;
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
        BusReading::new(codes, half, SupplyScale::NOMINAL)
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
                            ripple_dv(&reading(f_hz, 300.0, (ripple_v, phase), half), f_hz as u32);
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
            (steady.dv, ripple_dv(&steady, 50_000)),
            (3_000, Complex::default())
        );
    }
}
