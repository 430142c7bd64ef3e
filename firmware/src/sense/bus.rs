//! Bus voltage of a block: the codes of its last switching period, and their mean.

use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q};

use crate::sense::supply::SupplyScale;

pub use ihd_shared::board::BUS_FULL_SCALE_DV;

/// Codes of the bus, and of the mains, in turn: those of two blocks, since a block has an odd number of pairs.
pub const SLOW_CODES: usize = 2 * ADC_LOCK_P;

/// Codes of the bus in a mean; four pairs apart they cover a switching period to 2 %, so that its ripple cancels.
pub const BUS_MEAN: usize = 5;
const BUS_STEP: usize = 4;
const _: () = assert!(BUS_MEAN * BUS_STEP == ADC_LOCK_P / ADC_LOCK_Q as usize);

/// Place of the newest bus code of half 0: the bus's are even.
const NEWEST: usize = (SLOW_CODES / 2 - 1) & !1;

/// Places of the last period's bus codes among the [`SLOW_CODES`], after half 0 or 1; the last one is the newest.
pub const fn bus_places(half: usize) -> [usize; BUS_MEAN] {
    // Two constants, so that no place needs a check.
    let newest = if half == 0 {
        NEWEST
    } else {
        NEWEST + SLOW_CODES / 2 - 1
    };
    let mut places = [0; BUS_MEAN];
    let mut k = 0;
    while k < BUS_MEAN {
        places[k] = newest - (BUS_MEAN - 1 - k) * BUS_STEP;
        k += 1;
    }
    places
}

/// Bus voltage of a code, in decivolt.
pub fn bus_dv(code: u16) -> u16 {
    (u32::from(code) * BUS_FULL_SCALE_DV / 4_096) as u16
}

/// Bus over the last switching period of a block.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BusReading {
    /// Mean, in decivolt.
    pub dv: u16,
    /// Half of the [`SLOW_CODES`], 0 or 1.
    pub half: u32,
    /// Codes at its [`bus_places`], as they came.
    pub codes: [u16; BUS_MEAN],
}

impl BusReading {
    /// Reading of the codes at [`bus_places`] of half 0 or 1, on a supply of its scale.
    pub fn new(codes: [u16; BUS_MEAN], half: usize, scale: SupplyScale) -> Self {
        Self {
            dv: bus_dv(scale.code(mean(codes))),
            half: (half % 2) as u32,
            codes,
        }
    }

    /// Reading of a bus without ripple, in decivolt.
    pub const fn steady(dv: u16) -> Self {
        Self {
            dv,
            half: 0,
            codes: [0; BUS_MEAN],
        }
    }
}

/// Mean of a period's codes, rounded.
pub fn mean(codes: [u16; BUS_MEAN]) -> u16 {
    let sum: u32 = codes.into_iter().map(u32::from).sum();
    ((sum + BUS_MEAN as u32 / 2) / BUS_MEAN as u32) as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::TAU;

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
        assert_eq!([[0, 0, 0, 0, 2], [0, 0, 0, 0, 3]].map(mean), [0, 1]);
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
}
