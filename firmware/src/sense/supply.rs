//! The analogue supply, which is the reference of every converter and of the comparators' DAC, by the chip's own reference
//! voltage; the one place where readings are corrected for it.
//!
//! A code is a share of the supply, so a supply that is 1 % high reads everything 1 % low, and power 2 %. The reference's code c
//! says what the supply is: VDDA = 3.0 V · VREFINT_CAL / c (RM0440, ADC, "Calculating the actual VDDA voltage using the internal
//! reference voltage"). A reference that is wrong looks the same as a supply that is, and would be corrected into an error:
//! therefore only [`SUPPLY_MIN_MV`] to [`SUPPLY_MAX_MV`] is corrected, where either makes 4.9 % of power at most. Beyond it, and
//! with a calibration that no chip has, nothing is heated.

use ihd_shared::board::NOMINAL_SUPPLY_MV;
use ihd_shared::fault::Fault;

use crate::limits::{SUPPLY_MAX_MV, SUPPLY_MIN_MV, SUPPLY_READINGS};

/// Calibration codes that a chip may have: 1.18 to 1.24 V of 3.0 V (DS12288, "Embedded voltage reference").
const CALIBRATIONS: core::ops::RangeInclusive<u16> = 1_611..=1_693;

/// Share of a new reading that the filtered scale takes over, as a shift: 64 ms at one reading in 4 ms.
const FILTER_SHIFT: u32 = 4;

/// Change of the scale that is followed, in 1/65536: 0.1 %. A code of the reference is 0.07 %.
const FOLLOWED_Q16: u32 = 65;

/// The chip's reference voltage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reference {
    /// Its code now.
    pub code: u16,
    /// Its code at [`Reference::CALIBRATED_MV`], as the chip's maker found it.
    pub calibrated: u16,
}

impl Reference {
    /// Supply at which the chip's maker converted it, in millivolt (DS12288, "Embedded voltage reference").
    pub const CALIBRATED_MV: u32 = 3_000;

    /// The analogue supply by it, in millivolt; 0 where the numbers make no sense.
    pub fn vdda_mv(&self) -> u16 {
        let at_calibration = Self::CALIBRATED_MV * u32::from(self.calibrated);
        let vdda_mv = at_calibration.checked_div(u32::from(self.code));
        vdda_mv.and_then(|mv| u16::try_from(mv).ok()).unwrap_or(0)
    }

    /// The supply over the nominal one, in 1/65536; `None` if it is outside what is corrected.
    fn scale_q16(&self) -> Option<u32> {
        let in_range = CALIBRATIONS.contains(&self.calibrated)
            && (SUPPLY_MIN_MV..=SUPPLY_MAX_MV).contains(&u32::from(self.vdda_mv()));
        let nominal_code = NOMINAL_SUPPLY_MV * u32::from(self.code);
        let calibrated = u64::from(Self::CALIBRATED_MV * u32::from(self.calibrated));
        in_range.then(|| ((calibrated << 16) / u64::from(nominal_code.max(1))) as u32)
    }
}

/// Correction of codes: the supply over the nominal one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SupplyScale {
    q16: u32,
}

impl SupplyScale {
    /// Nothing to correct.
    pub const NOMINAL: Self = Self { q16: 1 << 16 };

    /// Encodes as a word.
    pub const fn to_bits(self) -> u32 {
        self.q16
    }

    /// Decodes what [`SupplyScale::to_bits`] gave.
    #[inline(always)]
    pub const fn from_bits(q16: u32) -> Self {
        Self { q16 }
    }

    /// Both codes of a pair as one word ([`ihd_shared::sampling::Pair::words`]), rounded down. Codes of 12 bit times the scale
    /// stay within 32 bit.
    #[inline(always)]
    pub fn pair(self, word: u32) -> u32 {
        let product = |code: i32| code.wrapping_mul(self.q16 as i32) as u32;
        let (low, high) = (
            product(i32::from(word as u16 as i16)),
            product(word as i32 >> 16),
        );
        low >> 16 | high & 0xFFFF_0000
    }

    /// A code from 0 on.
    #[inline]
    pub fn code(self, code: u16) -> u16 {
        ((u32::from(code) * self.q16) >> 16) as u16
    }

    /// The code, from mid-scale, that a DAC on this supply needs for what reads as `code` on the nominal one.
    pub fn dac_code(self, code: u16) -> u16 {
        ((u32::from(code) << 16) / self.q16.max(1)) as u16
    }
}

/// The supply as the last readings of the reference show it.
#[derive(Clone, Copy, Debug)]
pub struct Supply {
    scale: SupplyScale,
    /// `None` before the first reading.
    filtered_q16: Option<u32>,
    /// Readings in a row out of the range, or within it after a fault.
    contrary: u8,
    is_bad: bool,
}

impl Default for Supply {
    fn default() -> Self {
        Self {
            scale: SupplyScale::NOMINAL,
            filtered_q16: None,
            contrary: 0,
            is_bad: false,
        }
    }
}

impl Supply {
    /// Takes a reading of the reference.
    pub fn update(&mut self, reference: Reference) {
        let reading = reference.scale_q16();
        self.contrary = if reading.is_some() == self.is_bad {
            self.contrary + 1
        } else {
            0
        };
        if self.contrary >= SUPPLY_READINGS {
            (self.is_bad, self.contrary) = (!self.is_bad, 0);
        }
        let Some(scale_q16) = reading else { return };
        let before_q16 = self.filtered_q16.unwrap_or(scale_q16);
        let step = (scale_q16 as i32 - before_q16 as i32) >> FILTER_SHIFT;
        let filtered_q16 = before_q16.saturating_add_signed(step);
        self.filtered_q16 = Some(filtered_q16);
        if filtered_q16.abs_diff(self.scale.q16) > FOLLOWED_Q16 {
            self.scale.q16 = filtered_q16;
        }
    }

    /// Correction of every reading.
    pub fn scale(&self) -> SupplyScale {
        self.scale
    }

    /// [`Fault::SUPPLY_RANGE`] while the supply is outside what can be corrected.
    pub fn fault(&self) -> Fault {
        if self.is_bad {
            Fault::SUPPLY_RANGE
        } else {
            Fault::NONE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sense::codes::TRIP_CODE;
    use ihd_shared::sampling::{CODE_MAX, CODE_MIN, SATURATED_FROM};

    const CALIBRATED: u16 = 1_655;

    /// A chip with this supply, its reference off by a factor.
    fn reading(vdda_v: f64, factor: f64) -> Reference {
        let code = f64::from(CALIBRATED) * 3.0 / vdda_v * factor;
        Reference {
            code: code.round() as u16,
            calibrated: CALIBRATED,
        }
    }

    fn settled(reference: Reference) -> Supply {
        let mut supply = Supply::default();
        (0..300).for_each(|_| supply.update(reference));
        supply
    }

    #[test]
    fn codes_mean_the_same_whatever_the_supply() {
        for vdda_v in [3.225, 3.25, 3.29, 3.3, 3.31, 3.35, 3.375] {
            let supply = settled(reading(vdda_v, 1.0));
            assert_eq!(supply.fault(), Fault::NONE, "{vdda_v}");
            for (v, i) in [(1_000, -1_500), (-1_900, 1_945), (0, -1), (-1, 0)] {
                let raw = |code: i32| (f64::from(code) * 3.3 / vdda_v).round() as i32;
                let word = (raw(v) as u32 & 0xFFFF) | (raw(i) as u32) << 16;
                let corrected = supply.scale().pair(word);
                let (found_v, found_i) =
                    (i32::from(corrected as u16 as i16), corrected as i32 >> 16);
                // A step of the scale is 0.1 %, of rounding a code.
                let near =
                    |found: i32, code: i32| found.abs_diff(code) <= 2 + code.unsigned_abs() / 800;
                assert!(near(found_v, v), "{vdda_v}: {found_v} for {v}");
                assert!(near(found_i, i), "{vdda_v}: {found_i} for {i}");
            }
            // The comparators trip at the same current: the DAC's step times the supply.
            let level = f64::from(supply.scale().dac_code(TRIP_CODE)) * vdda_v / 3.3;
            assert!(
                (level / f64::from(TRIP_CODE) - 1.0).abs() < 0.0015,
                "{vdda_v}: {level}"
            );
        }
    }

    /// Nominal readings pass as they are, to the last bit.
    #[test]
    fn a_nominal_supply_changes_nothing() {
        let supply = settled(reading(3.3, 1.0));
        assert_eq!(supply.scale(), SupplyScale::NOMINAL);
        for code in CODE_MIN..=CODE_MAX {
            let word = (code as u16 as u32) | (code as u16 as u32) << 16;
            assert_eq!(supply.scale().pair(word), word);
        }
    }

    /// Five per cent of either, in either direction, is found; what is not found is less than 5 % of power.
    #[test]
    fn a_supply_or_a_reference_that_is_off_is_found_or_harmless() {
        for percent in -100i32..=100 {
            let factor = 1.0 + f64::from(percent) / 1_000.0;
            let supply = settled(reading(3.3 * factor, 1.0));
            let reference = settled(reading(3.3, factor));
            let is_found = |supply: &Supply| supply.fault() != Fault::NONE;
            if percent.abs() >= 25 {
                assert!(is_found(&supply) && is_found(&reference), "{factor}");
            }
            if !is_found(&reference) {
                // A true supply, corrected by a wrong reference.
                let scale = f64::from(reference.scale().to_bits()) / 65_536.0;
                assert!((scale * scale - 1.0).abs() < 0.05, "{factor}: {scale}");
            }
        }
        for (code, calibrated) in [
            (0, CALIBRATED),
            (4_095, CALIBRATED),
            (1_505, 0),
            (1_505, 0xFFFF),
            (1_860, 2_048),
        ] {
            assert_eq!(
                settled(Reference { code, calibrated }).fault(),
                Fault::SUPPLY_RANGE,
                "{code} {calibrated}"
            );
        }
    }

    #[test]
    fn one_odd_reading_is_no_fault_and_a_supply_that_is_back_ends_it() {
        let mut supply = settled(reading(3.3, 1.0));
        supply.update(reading(2.9, 1.0));
        supply.update(reading(3.3, 1.0));
        assert_eq!(supply.fault(), Fault::NONE);
        for _ in 0..SUPPLY_READINGS {
            supply.update(reading(3.5, 1.0));
        }
        assert_eq!(supply.fault(), Fault::SUPPLY_RANGE);
        for _ in 0..SUPPLY_READINGS {
            supply.update(reading(3.3, 1.0));
        }
        assert_eq!(supply.fault(), Fault::NONE);
        assert_eq!(supply.scale(), SupplyScale::NOMINAL);
    }

    /// The end of the range counts as saturated, and lies above the trip, at every supply that is corrected.
    #[test]
    fn a_saturated_code_stays_one() {
        for vdda_v in [
            f64::from(SUPPLY_MIN_MV) / 1e3 + 0.002,
            3.3,
            f64::from(SUPPLY_MAX_MV) / 1e3 - 0.002,
        ] {
            let scale = settled(reading(vdda_v, 1.0)).scale();
            for code in [CODE_MAX, CODE_MIN] {
                let word = scale.pair(code as u16 as u32);
                let corrected = (word as u16 as i16).unsigned_abs();
                assert!(
                    corrected >= SATURATED_FROM.unsigned_abs(),
                    "{vdda_v}: {corrected}"
                );
            }
        }
        assert!(SATURATED_FROM.unsigned_abs() > TRIP_CODE);
    }
}
